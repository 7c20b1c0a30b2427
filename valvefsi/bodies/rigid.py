"""Rigid surfaces: points on a surface that stay where they are (Lee2020, section C: the aortic test section).

Springs and dampers hold each point, F = w (-kappa d - eta U), with d the way the fluid has carried it. As d is a small
part of a grid spacing, the kernel stays where the point is at rest: its weights are made once, and every rank keeps the
points of its own cells.

Where points lie closer than their kernel tells apart, springs whose forces cancel in it grow for as long as a run lasts
and thicken the surface. `valvefsi.bodies.patches` holds them in patches, which nothing drives through the surface; or
points slip back through the fluid to their place, d' = u - slip d.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np

from valvefsi.bodies import rigid_kernels
from valvefsi.bodies.body import BodyBase, NoSeries
from valvefsi.io.solid_body import Body, write_body
from valvefsi.runtime.clock import Timed

if TYPE_CHECKING:
    from mpi4py import MPI

    from valvefsi.types import Array, Faces, Indices, Keeping, Table, Transfer

QUADRILATERAL = 9
"""VTK's number of the cell type."""


@dataclass(frozen=True)
class RigidHalf:
    """A rigid surface halfway through a step."""

    d: Array
    force: Array
    transfer: Transfer
    surface: RigidSurface
    dt: float

    def spread(self, f: Faces) -> None:
        """Add the forces to the force density f on the faces [dyn/cm^3]. Collective."""
        self.transfer.spread(self.force, out=f)

    def velocity(self, u_half: Faces) -> Array:
        """Return the velocity of the fluid at the points, ``(n, 3)`` [cm/s]. Collective."""
        return self.transfer.interpolate(u_half)

    def whole(self, U: Array) -> Table:
        """Return the state after the step, carried by the velocity U at its middle. Collective."""
        v = self.surface.held(U)
        if self.surface.slips:
            v = v - self.surface.back(self.d)
        d: Array = self.dt * v
        d += self.d
        return {"d": d}


class RigidSurface(BodyBase):
    """A rigid surface; every rank holds the points in its own cells.

    Its state is ``d``, how far the fluid has carried its points, ``(n, 3)`` [cm].

    Args:
        points: The points of the whole surface, the same on all ranks, ``(num_points, 3)`` [cm].
        areas: Area of each, ``(num_points,)`` [cm^2].
        coupling: Its kernel on the grid.
        name: Name in files.
        stiffness: kappa per area [dyn/cm^3].
        damping: eta per area [dyn s/cm^3].
        slip: Rate at which a point slips back through the fluid to its place, one for all or a symmetric matrix for
            each, ``(num_points, 3, 3)`` [1/s]; a traction f drives fluid through the surface with slip f / kappa.
        faces: Corners of quadrilaterals between the points, for pictures, ``(m, 4)``.

    Attributes:
        X: Points of this rank, ``(n, 3)`` [cm].
        ids: Their numbers in the whole surface, ``(n,)``.
        num_points: Number of points on all ranks.

    Raises:
        StabilityError: A point lies too near to a side, on the rank of the point.
    """

    def __init__(
        self,
        points: Array,
        areas: Array,
        coupling: Keeping,
        *,
        name: str,
        stiffness: float,
        damping: float,
        slip: float | Array = 0.0,
        faces: Indices | None = None,
    ) -> None:
        if not stiffness > 0.0 or not damping >= 0.0 or not _least(slip) >= 0.0:
            message = "expected stiffness > 0, damping >= 0 and slip >= 0"
            raise ValueError(f"{message}, got {stiffness}, {damping}, {slip}")
        self.name, self.comm = name, coupling.grid.comm
        self.stiffness, self.damping = float(stiffness), float(damping)
        self.ids = np.asarray(coupling.own(points), dtype=np.int64)
        self.num_points = len(points)
        self.points, self.faces = points, faces
        self.X: Array = np.ascontiguousarray(points[self.ids])
        self.slip = slip if isinstance(slip, float | int) else np.asarray(slip, dtype=float)[self.ids]
        self.slipping = np.zeros(0, dtype=np.int64)
        if not isinstance(self.slip, float | int):
            self.slipping = np.flatnonzero(self.slip.any(axis=(1, 2)))
        self.transfer: Transfer = coupling.stay(self.X)
        self.weights = areas[self.ids]

    def start(self, u: Faces) -> Table:
        """Return the state at t = 0."""
        return {"d": np.zeros_like(self.X)}

    def half(self, q: Table, u: Faces, t: float, dt_old: float, dt: float) -> RigidHalf:
        """Move half a step with the velocity that the points feel now, see `valvefsi.types.Body`. Collective."""
        U = self.transfer.interpolate(u)
        force = self.force(q["d"], U, 0.5 * dt)
        return RigidHalf(q["d"], force, self.transfer, self, dt)

    def stored(self, q: Table) -> float:
        """Return the energy of its springs [erg] (collective)."""
        here = 0.5 * self.stiffness * float(self.weights @ (q["d"] ** 2).sum(axis=1))
        return self.comm.allreduce(here)

    def force(self, d: Array, U: Array, ahead: float = 0.0) -> Array:
        """Return the force on the fluid of points carried by d, moving with U for a time ahead, ``(n, 3)`` [dyn]."""
        F = np.empty_like(d)
        rigid_kernels.tractions(F, d, U, ahead, (self.stiffness, self.damping))
        F = self.held(F)
        F *= self.weights[:, None]
        return F

    @property
    def slips(self) -> bool:
        """Whether any of its points slips back."""
        return not isinstance(self.slip, float | int) or self.slip > 0.0

    def back(self, d: Array) -> Array:
        """Return the velocity at which points carried by d slip back, ``(n, 3)`` [cm/s]."""
        if isinstance(self.slip, float | int):
            return self.slip * d
        v, at = np.zeros_like(d), self.slipping
        v[at] = np.einsum("nij,nj->ni", self.slip[at], d[at])
        return v

    def held(self, v: Array) -> Array:
        """Return what the springs and dampers hold of a vector at the points, ``(n, 3)``: all of it (collective)."""
        return v

    def timed(self, table: dict[str, float]) -> Self:
        """Return the surface with a clock around its transfer."""
        other = copy(self)
        phases = {"spread": "rigid surfaces", "interpolate": "rigid surfaces"}
        other.transfer = Timed(self.transfer, table, phases)
        return other

    def series(self, folder: Path, comm: MPI.Comm, resume_time: float | None) -> NoSeries:
        """Write it once, where it has faces. Collective."""
        if comm.rank == 0 and self.faces is not None and len(self.faces):
            write_body(
                folder / f"{self.name}.vtu", Body(points=self.points, cells={QUADRILATERAL: self.faces})
            )
        comm.barrier()
        return NoSeries()


def _least(slip: float | Array) -> float:
    """Return the smallest rate at which anything slips back, 0 to round-off."""
    rates = np.linalg.eigvalsh(slip) if np.ndim(slip) else np.array([slip], dtype=float)
    least, largest = np.min(rates, initial=np.inf), np.max(rates, initial=0.0)
    return 0.0 if -1e-12 * largest <= least <= 0.0 else float(least)
