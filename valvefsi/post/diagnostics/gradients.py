"""What follows from the velocity gradient: vorticity, Q criterion, dissipation, enstrophy.

du_d/dx_d lives in the cells, du_d/dx_a on the edges of the cells, where it is exact for linear fields. Dissipation is
summed there, so that in a periodic box or between walls at rest it is what the viscous term takes from the kinetic
energy, to round-off. Ghosts of the velocity must be filled.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from valvefsi.grid import MacGrid
from valvefsi.types import Array, Faces, Slices


def _shift(place: Slices, axis: int, step: int) -> Slices:
    x, y, z = (slice(s.start + step, s.stop + step) if a == axis else s for a, s in enumerate(place))
    return x, y, z


def _along(values: Array, axis: int) -> Array:
    return values.reshape([-1 if a == axis else 1 for a in range(3)])


def _edges(grid: MacGrid, axes: tuple[int, int], *, upper: bool) -> Slices:
    """Local edges at the lower faces along two axes; with ``upper`` those on both ends of the owned cells."""
    x, y, z = (
        slice(s.start, s.stop + int(upper and a in axes and a < grid.dim)) for a, s in enumerate(grid.owned)
    )
    return x, y, z


def _on_edges(grid: MacGrid, u: Faces, d: int, a: int, place: Slices) -> Array:
    """du_d/dx_a on the edges at the lower faces along d and a [1/s]."""
    return (u[d][place] - u[d][_shift(place, a, -1)]) / _along(grid.gaps[a][place[a]], a)


def _in_cells(grid: MacGrid, u: Faces, d: int) -> Array:
    """du_d/dx_d in the owned cells [1/s]."""
    own = grid.owned
    return (u[d][_shift(own, d, 1)] - u[d][own]) / _along(grid.widths[d][own[d]], d)


def velocity_gradient(grid: MacGrid, u: Faces) -> Array:
    """Velocity gradient in the owned cells, ``(n0, n1, n2, 3, 3)`` [1/s].

    Entry ``[..., d, a]`` is du_d/dx_a: a difference of the faces where a = d, else the mean over the four edges.
    """
    out = np.zeros((*grid.size, 3, 3))
    for d in range(grid.dim):
        out[..., d, d] = _in_cells(grid, u, d)
        for a in range(grid.dim):
            if a != d:
                edge = _on_edges(grid, u, d, a, _edges(grid, (d, a), upper=True))
                for axis in (d, a):
                    low = (slice(None),) * axis
                    edge = 0.5 * (edge[(*low, slice(None, -1))] + edge[(*low, slice(1, None))])
                out[..., d, a] = edge
    return out


def vorticity(grid: MacGrid, u: Faces) -> Array:
    """Vorticity in the owned cells, ``(n0, n1, n2, 3)``; in two dimensions only the third entry is not zero [1/s]."""
    G = velocity_gradient(grid, u)
    pairs = ((2, 1), (0, 2), (1, 0))
    return np.stack([G[..., i, j] - G[..., j, i] for i, j in pairs], axis=-1)


def q_criterion(grid: MacGrid, u: Faces) -> Array:
    """Q = (|W|^2 - |S|^2)/2 with spin W and strain rate S, in the owned cells, ``(n0, n1, n2)`` [1/s^2]."""
    G = velocity_gradient(grid, u)
    return -0.5 * np.einsum("...ij,...ji->...", G, G)


def dissipation(grid: MacGrid, u: Faces, mu: float) -> float:
    """Viscous dissipation of the box, integral of 2 mu S:S [erg/s]. Collective.

    Args:
        grid: The grid.
        u: Velocity with filled ghosts [cm/s].
        mu: Dynamic viscosity [dyn s/cm^2].
    """
    volume = grid.volumes()[grid.owned]
    local = sum(2.0 * float((np.square(_in_cells(grid, u, d)) * volume).sum()) for d in range(grid.dim))
    for d in range(grid.dim):
        for a in range(d):
            place = _owned_edges(grid, (d, a))
            shear = _on_edges(grid, u, d, a, place) + _on_edges(grid, u, a, d, place)
            local += float((np.square(shear) * _edge_volumes(grid, (d, a), place)).sum())
    return grid.comm.allreduce(mu * local, op=MPI.SUM)


def enstrophy(grid: MacGrid, u: Faces) -> float:
    """Enstrophy of the box, integral of |vorticity|^2/2, on the edges [cm^3/s^2]. Collective."""
    local = 0.0
    for d in range(grid.dim):
        for a in range(d):
            place = _owned_edges(grid, (d, a))
            spin = _on_edges(grid, u, d, a, place) - _on_edges(grid, u, a, d, place)
            local += 0.5 * float((np.square(spin) * _edge_volumes(grid, (d, a), place)).sum())
    return grid.comm.allreduce(local, op=MPI.SUM)


def _owned_edges(grid: MacGrid, axes: tuple[int, int]) -> Slices:
    """Local edges, each on one rank: at the lower faces of the owned cells, and on the upper sides."""
    x, y, z = (
        slice(s.start, s.stop + int(a in axes and grid.is_last[a] and not grid.periodic[a]))
        for a, s in enumerate(grid.owned)
    )
    return x, y, z


def _edge_volumes(grid: MacGrid, axes: tuple[int, int], place: Slices) -> Array:
    """Volumes around edges, half along each axis where an edge is on a side [cm^3]."""
    out = np.ones((1, 1, 1))
    for a in range(3):
        size = (grid.gaps[a] if a in axes else grid.widths[a]).copy()
        if a in axes and not grid.periodic[a]:
            ends = ((grid.is_first[a], grid.owned[a].start), (grid.is_last[a], grid.owned[a].stop))
            size[[at for here, at in ends if here]] *= 0.5
        out = out * _along(size[place[a]], a)
    return out
