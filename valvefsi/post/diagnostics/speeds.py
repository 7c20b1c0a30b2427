"""Numbers read off a velocity: Courant number, largest speed, energy, velocity in the cells."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from valvefsi.fluid import stencils
from valvefsi.grid import MacGrid
from valvefsi.types import Array, Faces


def local_courant_rate(grid: MacGrid, u: Faces) -> float:
    """Largest ``|u_d| / h_d`` over this rank's faces [1/s]; infinite where a velocity is not finite."""
    rate = 0.0
    for d, c in enumerate(u):
        bits = stencils.largest_bits(c[grid.owned_faces(d)].view(np.int64))
        value = float(np.array(bits, dtype=np.int64).view(np.float64)) / grid.spacing[d]
        rate = max(rate, value) if np.isfinite(value) else np.inf
    return float(rate)


def fastest_place(grid: MacGrid, u: Faces) -> tuple[float, Array]:
    """Largest velocity component (infinite where not finite) and its position.

    Returns:
        The component's magnitude [cm/s] and the face's position, ``(3,)`` [cm], the same on all ranks.

    Note:
        Collective.
    """
    best, place = -1.0, np.zeros(3)
    for d, c in enumerate(u):
        own = np.abs(c[grid.owned_faces(d)])
        own[~np.isfinite(own)] = np.inf
        index = np.unravel_index(np.argmax(own), own.shape)
        if own[index] > best:
            best = float(own[index])
            place = np.array(
                [grid.coordinates(a, on_faces=a == d)[i + grid.ghosts[a]] for a, i in enumerate(index)]
            )
    found = grid.comm.allgather((best, grid.comm.rank, place))
    best, _, place = max(found, key=lambda entry: (entry[0], -entry[1]))
    return best, place


def kinetic_energy(grid: MacGrid, u: Faces, rho: float) -> float:
    """Kinetic energy of the fluid, rho/2 sum u^2 V over the faces and their control volumes [erg]. Collective."""
    local = 0.0
    for d, c in enumerate(u):
        own = grid.owned_faces(d)
        local += float(np.einsum("ijk,ijk,ijk->", c[own], c[own], grid.volumes(d)[own]))
    return grid.comm.allreduce(0.5 * rho * local, op=MPI.SUM)


def cell_velocity(grid: MacGrid, u: Faces) -> Array:
    """Velocity in the owned cells, the mean of each pair of faces, ``(n0, n1, n2, 3)`` [cm/s]."""
    out = np.zeros((*grid.size, 3))
    for d, c in enumerate(u):
        upper = tuple(slice(s.start + int(a == d), s.stop + int(a == d)) for a, s in enumerate(grid.owned))
        out[..., d] = 0.5 * (c[grid.owned] + c[upper])
    return out


def reynolds_number(flow: float, diameter: float, rho: float, mu: float) -> float:
    """Reynolds number rho U D/mu of a flow [cm^3/s] through a disk of a diameter [cm], U = flow/(pi D^2/4)."""
    return rho * abs(flow) * 4.0 / (np.pi * diameter * mu)
