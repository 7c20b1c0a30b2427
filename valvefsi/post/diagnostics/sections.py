"""Flow and mean pressure on planes and disks across the box.

A face counts with the exact area of what a disk covers of it, so that the area is pi r^2 on every grid and the flow
changes continuously with centre and radius. Between two planes of faces (or centres) values are interpolated linearly:
the flow through a whole plane is then the same everywhere in a box with closed sides around it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from valvefsi.grid import MacGrid
from valvefsi.types import Array, Faces


@dataclass(frozen=True, kw_only=True)
class Section:
    """A plane across the box, or a disk in it; in two dimensions a line, or an interval on it.

    Attributes:
        axis: Axis the plane is normal to.
        position: Where it cuts that axis [cm].
        centre: Centre of the disk, its entry normal to the plane is not looked at, ``(3,)`` [cm]; None: the plane.
        radius: Radius of the disk [cm].
    """

    axis: int
    position: float
    centre: tuple[float, ...] | None = None
    radius: float = 0.0

    def check(self, grid: MacGrid) -> None:
        """Raise ValueError where the section is not in the box."""
        a, lower, upper = self.axis, grid.lower, grid.upper
        if not 0 <= a < grid.dim:
            raise ValueError(f"a grid in {grid.dim} dimensions has no axis {'xyz'[a]}")
        if not lower[a] <= self.position <= upper[a]:
            raise ValueError(f"{'xyz'[a]} = {self.position:g} cm is outside the box")
        if self.centre is None:
            return
        if not self.radius > 0.0:
            raise ValueError("a disk needs a radius above zero")
        for b in range(grid.dim):
            inside = lower[b] <= self.centre[b] - self.radius and self.centre[b] + self.radius <= upper[b]
            if b != a and not inside:
                raise ValueError(f"the disk leaves the box along {'xyz'[b]}")

    def areas(self, grid: MacGrid) -> Array:
        """Area of the section in each local column of cells along its axis, ``(.., 1, ..)``, owned cells [cm^2]."""
        a = self.axis
        others = [b for b in range(3) if b != a]
        edges = []
        for b in others:
            own = grid.owned[b]
            start = grid.lower[b] + grid.cell_widths[b][: grid.start[b]].sum()
            edges.append(start + np.concatenate([[0.0], np.cumsum(grid.widths[b][own])]))
        if self.centre is None:
            area = np.diff(edges[0])[:, None] * np.diff(edges[1])
        elif grid.dim == 2:
            b = others[0]
            ends = np.clip(edges[0], self.centre[b] - self.radius, self.centre[b] + self.radius)
            area = np.diff(ends)[:, None] * np.diff(edges[1])
        else:
            x, y = (e - self.centre[b] for e, b in zip(edges, others, strict=True))
            area = np.diff(np.diff(_covered(x[:, None], y, self.radius), axis=0), axis=1)
        return np.expand_dims(area, a)


def _covered(x: Array, y: Array, r: float) -> Array:
    """Area of the part of a disk about the origin with X < x and Y < y."""
    x, y = np.broadcast_arrays(np.clip(x, -r, r), np.clip(y, -r, r))
    above = np.abs(y)

    def half(s: Array) -> Array:  # area between the axis and the circle from 0 to s
        return 0.5 * (s * np.sqrt(np.maximum(r * r - s * s, 0.0)) + r * r * np.arcsin(s / r))

    c = np.sqrt(r * r - above * above)
    strip = half(np.minimum(x, -c)) - half(np.full_like(x, -r))
    strip = strip + above * (np.clip(x, -c, c) + c) + half(np.maximum(x, c)) - half(c)
    left = half(x) - half(np.full_like(x, -r))
    return np.where(y >= 0.0, left + strip, left - strip)


def flow(grid: MacGrid, u: Faces, section: Section) -> float:
    """Flow through a section along its axis, integral of u_n dA [cm^3/s]. Collective."""
    own = grid.owned_faces(section.axis)
    return _total(grid, u[section.axis][own], section, on_faces=True)


def mean_pressure(grid: MacGrid, p: Array, section: Section) -> float:
    """Mean pressure on a section [dyn/cm^2]; next to a side that is not periodic it is extrapolated. Collective."""
    total = _total(grid, p[grid.owned], section, on_faces=False)
    return total / grid.comm.allreduce(_area(grid, section), op=MPI.SUM)


def _area(grid: MacGrid, section: Section) -> float:
    first = grid.is_first[section.axis]  # every column once
    return float(section.areas(grid).sum()) if first else 0.0


def _total(grid: MacGrid, values: Array, section: Section, *, on_faces: bool) -> float:
    a = section.axis
    weights = _weights(grid, section, on_faces)[grid.start[a] :][: values.shape[a]]
    used = np.flatnonzero(weights)
    local = 0.0
    if used.size:
        layers = np.tensordot(np.take(values, used, axis=a), weights[used], axes=(a, 0))
        local = float((layers * section.areas(grid).squeeze(a)).sum())
    return grid.comm.allreduce(local, op=MPI.SUM)


def _weights(grid: MacGrid, section: Section, on_faces: bool) -> Array:
    """Weights of linear interpolation along the section's axis, over all faces or cells of the grid."""
    a, x = section.axis, section.position
    n, length = grid.cells[a], grid.upper[a] - grid.lower[a]
    at = grid.centres(a)
    if on_faces:
        at = grid.lower[a] + np.concatenate([[0.0], np.cumsum(grid.cell_widths[a])])
    elif grid.periodic[a]:
        at = np.concatenate([[at[-1] - length], at, [at[0] + length]])
    k = int(np.clip(np.searchsorted(at, x, side="right") - 1, 0, len(at) - 2))
    s = (x - at[k]) / (at[k + 1] - at[k])
    if abs(s) < 1e-9 or abs(s - 1.0) < 1e-9:  # on the faces themselves
        s = round(s)
    shift = -1 if grid.periodic[a] and not on_faces else 0
    weights = np.zeros(n + int(on_faces and not grid.periodic[a]))
    for index, weight in ((k + shift, 1.0 - s), (k + 1 + shift, s)):
        weights[index % n if grid.periodic[a] else index] += weight
    return weights
