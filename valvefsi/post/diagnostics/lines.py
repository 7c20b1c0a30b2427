"""Profiles along straight lines (as Figures S10 to S13)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI

from valvefsi.grid import MacGrid
from valvefsi.types import Array, Faces, Indices, Mask


def line(start: Sequence[float], end: Sequence[float], points: int) -> Array:
    """Return evenly spaced points from start to end, ``(points, 3)``; two entries mean a third of 0.5 cm."""
    ends = np.array([(*map(float, e), 0.5)[:3] for e in (start, end)])
    return ends[0] + np.linspace(0.0, 1.0, points)[:, None] * (ends[1] - ends[0])


def sample_velocity(grid: MacGrid, u: Faces, points: Array) -> Array:
    """Velocity at points, linear between the faces, the same on all ranks, ``(n, 3)`` [cm/s]. Collective.

    Args:
        grid: The grid.
        u: Velocity with filled ghosts [cm/s].
        points: Positions in the box, ``(n, 3)`` [cm].
    """
    out = np.zeros((len(points), 3))
    mine = _owner(grid, points)
    for d, c in enumerate(u):
        out[mine, d] = _interpolate(grid, c, points[mine], d)
    return grid.comm.allreduce(out, op=MPI.SUM)


def sample_cells(grid: MacGrid, values: Array, points: Array) -> Array:
    """A field of the owned cells at points, linear between the centres, ``(n,)``, the same on all ranks. Collective.

    Args:
        grid: The grid.
        values: The field in the owned cells, ``(n0, n1, n2)``.
        points: Positions in the box, ``(n, 3)`` [cm].
    """
    local = grid.zeros()
    local[grid.owned] = values
    grid.exchange((local,), width=1)
    for axis in range(grid.dim):
        _extrapolate(grid, local, axis)
    out = np.zeros(len(points))
    mine = _owner(grid, points)
    out[mine] = _interpolate(grid, local, points[mine], None)
    return grid.comm.allreduce(out, op=MPI.SUM)


def _extrapolate(grid: MacGrid, q: Array, axis: int) -> None:
    """Set the layer beyond each side that is not periodic so that the field goes on straight, in place."""
    if grid.periodic[axis]:
        return
    own, x = grid.owned[axis], grid.coordinates(axis, on_faces=False)
    planes = np.moveaxis(q, axis, 0)
    ends = ((grid.is_first[axis], own.start, 1), (grid.is_last[axis], own.stop - 1, -1))
    for here, inside, step in ends:
        if here:
            slope = (planes[inside + step] - planes[inside]) / (x[inside + step] - x[inside])
            planes[inside - step] = planes[inside] + slope * (x[inside - step] - x[inside])


def _owner(grid: MacGrid, points: Array) -> Mask:
    """Which points are in this rank's part of the box; one rank owns each."""
    mine = np.ones(len(points), dtype=bool)
    for a in range(grid.dim):
        edges = grid.lower[a] + np.concatenate([[0.0], np.cumsum(grid.cell_widths[a])])
        cell = np.clip(np.searchsorted(edges, points[:, a], side="right") - 1, 0, grid.cells[a] - 1)
        mine &= (cell >= grid.start[a]) & (cell < grid.start[a] + grid.size[a])
    return mine


def _interpolate(grid: MacGrid, q: Array, points: Array, d: int | None) -> Array:
    """Linear interpolation of a local array of cells (None) or of the faces of component d."""
    corners: list[tuple[Array, tuple[Indices, ...]]] = [(np.ones(len(points)), ())]
    for a in range(3):
        if a >= grid.dim:
            corners = [(w, (*index, np.zeros(len(points), dtype=int))) for w, index in corners]
            continue
        at = grid.coordinates(a, on_faces=a == d)
        k = np.clip(np.searchsorted(at, points[:, a], side="right") - 1, 0, len(at) - 2)
        s = (points[:, a] - at[k]) / (at[k + 1] - at[k])
        corners = [
            (w * part, (*index, k + up)) for w, index in corners for up, part in ((0, 1.0 - s), (1, s))
        ]
    values = np.zeros(len(points))
    for w, index in corners:
        values += w * q[index]
    return values
