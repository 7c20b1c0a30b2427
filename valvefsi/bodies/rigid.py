"""Rigid surfaces: points on a surface that stay where they are (Lee2020, section C: the aortic test section).

Springs and dampers hold each point, F = w (-kappa d - eta U), with d the way the fluid has carried it. As d is a small
part of a grid spacing, the kernel stays where the point is at rest: every rank keeps the points of its own cells, and
what they feel is linear in the fluid's velocity. So it is read once a step, at its middle: the velocity at the end is
twice that less the one at the beginning.

Where points lie closer than their kernel tells apart, springs whose forces cancel in it grow for as long as a run lasts
and thicken the surface. `valvefsi.bodies.patches` holds them in patches, which nothing drives through the surface; or
points slip back through the fluid to their place, d' = u - slip d.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from valvefsi.bodies import rigid_kernels
from valvefsi.bodies.body import BodyBase, NoSeries
from valvefsi.coupling.kernel_properties import largest_square_sum
from valvefsi.io.solid_body import Body, write_body
from valvefsi.runtime.clock import Timed

if TYPE_CHECKING:
    from mpi4py import MPI

    from valvefsi.io.series import Frames
    from valvefsi.types import Array, Faces, Indices, Keeping, Table, Transfer

QUADRILATERAL = 9
"""VTK's number of the cell type."""


def explicit_springs(kernel: str, h: float, dt: float, hold: float, rho: float = 1.0) -> dict[str, Any]:
    """Return stiffness and damping that hold the points of a surface [dyn/cm^3, dyn s/cm^3].

    Args:
        kernel: Name of the regularised delta function.
        h: Grid spacing [cm].
        dt: Length of a step [s].
        hold: Part of the limits of an explicit spring and damper on the fluid that the kernel moves.
        rho: Density of the fluid [g/cm^3].
    """
    share = hold * rho * h / largest_square_sum(kernel)
    return {"stiffness": share / dt**2, "damping": share / dt}


@dataclass(frozen=True)
class RigidHalf:
    """A rigid surface halfway through a step."""

    d: Array
    U: Array
    force: Array
    surface: RigidSurface
    dt: float

    def spread(self, f: Faces) -> None:
        """Add the forces to the force density f on the faces [dyn/cm^3]. Collective."""
        self.surface.transfer.spread(self.force, out=f)

    def velocity(self, u_half: Faces) -> Array:
        """Return what is held of the velocity of the fluid at the points, ``(n, 3)`` [cm/s]. Collective."""
        return self.surface.felt(u_half)

    def whole(self, U: Array) -> Table:
        """Return the state after the step, carried by the velocity U at its middle, the mean of both ends."""
        d, U_new = np.empty_like(U), np.empty_like(U)
        rigid_kernels.carry(d, U_new, self.d, self.U, U, self.dt)
        self.surface.slip_back(d, self.d, self.dt)
        return {"d": d, "U": U_new}


class RigidSurface(BodyBase):
    """A rigid surface; every rank holds the points in its own cells.

    Its state is ``d``, how far the fluid has carried its points, and ``U``, the velocity of the fluid there, ``(n, 3)``
    [cm, cm/s].

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

    derived = frozenset({"U"})

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
            self._rates: Array = self.slip[self.slipping]
        self.transfer: Transfer = coupling.stay(self.X)
        self.weights = areas[self.ids]

    def start(self, u: Faces) -> Table:
        """Return the state at t = 0."""
        return {"d": np.zeros_like(self.X), "U": self.felt(u)}

    def completed(self, q: Table, u: Faces) -> Table:
        """Return the state with the velocity that earlier versions did not keep, see `BodyBase`. Collective."""
        return q if "U" in q else {"d": self.held(q["d"]), "U": self.felt(u)}

    def felt(self, u: Faces) -> Array:
        """Return what is held of the velocity of the fluid at the points, ``(n, 3)`` [cm/s] (collective)."""
        return self.held(self.transfer.interpolate(u))

    def half(self, q: Table, u: Faces, t: float, dt_old: float, dt: float) -> RigidHalf:
        """Move half a step with the velocity that the points feel now, which its state holds."""
        return RigidHalf(q["d"], q["U"], self.force(q["d"], q["U"], 0.5 * dt), self, dt)

    def stored(self, q: Table) -> float:
        """Return the energy of its springs [erg] (collective)."""
        here = 0.5 * self.stiffness * float(self.weights @ (q["d"] ** 2).sum(axis=1))
        return self.comm.allreduce(here)

    def force(self, d: Array, U: Array, ahead: float = 0.0) -> Array:
        """Return the force on the fluid, ``(n, 3)`` [dyn].

        Args:
            d: How far the points are carried, of what is held, ``(n, 3)`` [cm].
            U: Velocity that they move with, of what is held, ``(n, 3)`` [cm/s].
            ahead: For how long [s].
        """
        F = np.empty_like(d)
        rigid_kernels.spring_forces(F, d, U, self.weights, ahead, (self.stiffness, self.damping))
        return F

    def slip_back(self, out: Array, d: Array, dt: float) -> None:
        """Take from ``out`` how far points carried by d slip back in a time dt, both ``(n, 3)`` [cm]."""
        if isinstance(self.slip, float | int):
            if self.slip > 0.0:
                out -= dt * self.slip * d
            return
        at = self.slipping
        out[at] -= dt * np.einsum("nij,nj->ni", self._rates, d[at])

    def held(self, v: Array) -> Array:
        """Return what the springs and dampers hold of a vector at the points, ``(n, 3)``: all of it (collective)."""
        return v

    def timed(self, table: dict[str, float]) -> Self:
        """Return the surface with a clock around its transfer."""
        other = copy(self)
        phases = {"spread": "rigid surfaces", "interpolate": "rigid surfaces"}
        other.transfer = Timed(self.transfer, table, phases)
        return other

    def series(self, folder: Path, comm: MPI.Comm, frames: Frames | None) -> NoSeries:
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
