"""A hyperelastic solid that the fluid carries (Lee2020, S11 to S14)."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np
from mpi4py import MPI

from valvefsi.bodies import elastic_plan
from valvefsi.bodies.body import BodyBase, Entry, SmallMotion
from valvefsi.io.paraview import SolidSeries
from valvefsi.runtime.clock import Timed, TimedCoupling
from valvefsi.solid.carrying import at_points

if TYPE_CHECKING:
    from valvefsi.bodies.slip import Slip
    from valvefsi.coupling.elemental import ElementalCoupling
    from valvefsi.coupling.transfer import Coupling
    from valvefsi.grid import MacGrid
    from valvefsi.io.series import Frames
    from valvefsi.solid.structure import Structure
    from valvefsi.types import Array, Faces, Indices, Table, Transfer


@dataclass(frozen=True, kw_only=True)
class ElasticHalf:
    """An elastic body halfway through a step: positions at its beginning and its middle, forces and transfer there."""

    chi: Array
    chi_half: Array
    force: Array
    transfer: Transfer
    slip: Slip | None
    dt: float

    def spread(self, f: Faces) -> None:
        """Add the forces to the force density f on the faces [dyn/cm^3]. Collective."""
        self.transfer.spread(self.force, out=f)

    def velocity(self, u_half: Faces) -> Array:
        """Return the velocity of the fluid at the nodes, ``(n, 3)`` [cm/s]. Collective."""
        return self.transfer.interpolate(u_half)

    def whole(self, U: Array) -> Table:
        """Return the state after the step: carried by the velocity U at its middle, and by slip. Collective."""
        V = U if self.slip is None else U + self.slip.velocity(self.force, self.transfer)
        return {"chi": self.chi + self.dt * V}


class Elastic(BodyBase):
    """A hyperelastic solid with the fluid's density.

    Its state is ``chi``, the positions of its nodes, ``(n, 3)`` [cm].

    Args:
        solid: The solid.
        coupling: How it and the grid see each other.
        slip: How its nodes slip through the fluid; None for not.
    """

    def __init__(
        self, solid: Structure, coupling: Coupling | ElementalCoupling, *, slip: Slip | None = None
    ) -> None:
        self.solid: Structure = solid
        self.coupling = coupling
        self.slip = slip

    @property
    def name(self) -> str:  # type: ignore[override]
        """Name in files."""
        return self.solid.name

    @property
    def X(self) -> Array:  # type: ignore[override]
        """Reference positions of this rank's nodes, ``(n, 3)`` [cm]."""
        return self.solid.X

    @property
    def ids(self) -> Indices:  # type: ignore[override]
        """Numbers of this rank's nodes, ``(n,)``."""
        return self.solid.ids

    @property
    def num_points(self) -> int:  # type: ignore[override]
        """Number of nodes on all ranks."""
        return self.solid.num_nodes

    def start(self, u: Faces) -> Table:
        """Return the state at t = 0, the reference positions."""
        return {"chi": self.X.copy()}

    def continued(self, other: BodyBase, q: Table, u: Faces) -> Table:
        """Return the state with the displacement of another mesh, see `BodyBase`. Collective."""
        if other.solid is None:
            return self.start(u)
        return {"chi": self.X + at_points(other.solid, q["chi"] - other.X, self.X)}

    def half(self, q: Table, u: Faces, t: float, dt_old: float, dt: float) -> ElasticHalf:
        """Move half a step with the velocity that the nodes feel now, see `valvefsi.types.Body`. Collective."""
        chi = q["chi"]
        U = self.coupling.at(chi).interpolate(u)
        chi_half = chi + 0.5 * dt * U
        transfer = self.coupling.at(chi_half)
        force = self.solid.force(chi_half, U, t + 0.5 * dt)
        return ElasticHalf(chi=chi, chi_half=chi_half, force=force, transfer=transfer, slip=self.slip, dt=dt)

    def timed(self, table: dict[str, float]) -> Self:
        """Return the body with clocks around its elastic force and its coupling."""
        other = copy(self)
        other.solid = Timed(self.solid, table, {"force": "elastic force"})  # type: ignore[assignment]
        other.coupling = TimedCoupling(self.coupling, table)  # type: ignore[assignment]
        return other

    def momentum(self, q: Table, u: Faces, rho: float) -> Array:
        """Return the momentum of the fluid in it, ``(3,)`` [g cm/s] (collective)."""
        U = self.coupling.at(q["chi"]).interpolate(u)
        return self.solid.comm.allreduce(rho * self.solid.weights @ U)

    def stored(self, q: Table) -> float:
        """Return the elastic energy and that of its tethers [erg] (collective)."""
        return self.solid.energy(q["chi"]) + self.solid.tether_energy(q["chi"])

    @property
    def _change(self) -> str:
        return f"{self.name}_{'area' if self.coupling.grid.dim == 2 else 'volume'}_change_percent"

    def columns(self) -> list[str]:
        """Return the names of its columns in the history."""
        return [self._change, f"{self.name}_J_min", f"{self.name}_J_max"]

    def row(self, q: Table) -> dict[str, float]:
        """Return change of volume [%] and extremes of J (collective)."""
        J = self.solid.jacobian(q["chi"])
        extremes = np.array([-J.min(initial=np.inf), J.max(initial=-np.inf)])
        self.coupling.grid.comm.Allreduce(MPI.IN_PLACE, extremes, op=MPI.MAX)
        change = self.solid.volume(q["chi"]) / self.solid.reference_volume - 1.0
        return dict(zip(self.columns(), (100.0 * change, -extremes[0], extremes[1]), strict=False))

    def fault(self, q: Table, row: dict[str, float]) -> str | None:
        """Return that an element is inverted, and where (collective)."""
        smallest = row[f"{self.name}_J_min"]
        if smallest > 0.0:
            return None
        place = self._worst_cell(q["chi"])[: self.coupling.grid.dim]
        where = "(" + ", ".join(f"{x:.4g}" for x in place) + ") cm"
        free = "" if self.solid.kappa > 0.0 else "; it has no volumetric energy to keep J near 1 (nu_stab)"
        return f"an element of {self.name} is inverted, J = {smallest:.3g}, near {where}{free}"

    def _worst_cell(self, chi: Array) -> Array:
        """Centre of the cell with the smallest mean J, on all ranks, ``(3,)`` [cm]."""
        gathered = self.solid.cells_on_root(chi)
        place = None
        if gathered is not None:
            points, cells, J = gathered
            nodes = np.concatenate(list(cells.values()))[np.argmin(np.nan_to_num(J, nan=-np.inf))]
            place = points[nodes].mean(axis=0)
        return self.coupling.grid.comm.bcast(place)

    def gap(self, q: Table) -> float:
        """Return the largest distance between neighbouring points [cm] (collective).

        The points are the nodes, or for elemental coupling those that are refined until no gap is larger than allowed.
        """
        gap = self.solid.longest_gap(q["chi"])
        return min(gap, self.coupling.gap)

    @property
    def remedy(self) -> str:
        """What to do against points too far apart."""
        if not self.coupling.nodal:
            return "lower point_gap"
        other = ' or take coupling = "elemental"' if self.slip is None or self.slip.elemental else ""
        return f"refine the mesh{other}"

    def follow(self, at: tuple[float, ...]) -> Callable[[Table], Array]:
        """Return the displacement ``(3,)`` [cm] of the node nearest to ``at`` by state (collective)."""
        node = self.solid.node_at(at)
        start = self.solid.position_of(node, self.X)
        return lambda q: self.solid.position_of(node, q["chi"]) - start

    def series(self, folder: Path, comm: MPI.Comm, frames: Frames | None) -> ElasticSeries:
        """Return what draws it over time, in a folder (collective)."""
        return ElasticSeries(self.solid, SolidSeries(folder, self.name, comm, frames=frames))

    def small_motion(self, q: Table | None, t: float, dt: float, nudge: float) -> SmallMotion | None:
        """Return it as a small displacement sees it: forces there and back, and slip (collective)."""
        grid, chi = self.coupling.grid, self.X if q is None else q["chi"]

        def stiffness(d: Array) -> Array:
            longest = grid.comm.allreduce(float(np.abs(d).max(initial=0.0)), op=MPI.MAX)
            if not longest > 0.0:
                return np.zeros_like(d)
            step = nudge / longest
            forth, back = (
                self.solid.force(chi + part * d, (2.0 / dt) * part * d, t).copy() for part in (step, -step)
            )
            return (back - forth) / (2.0 * step)

        start = np.random.default_rng(1).standard_normal((self.num_points, 3))[self.ids]
        start[:, grid.dim :] = 0.0
        transfer, law = self.coupling.at(chi), self.slip

        def slip(F: Array) -> Array:
            return np.zeros_like(F) if law is None else 2.0 / dt * law.velocity(F, transfer)

        return SmallMotion(
            transfer=transfer,
            stiffness=stiffness,
            slip=slip,
            start=start,
            reserve=self.reserve,
        )

    @property
    def reserve(self) -> float:
        """Part of the square of the explicit step's limit that is left to its own stiffness."""
        return 1.0

    def size(self, grid: MacGrid) -> list[Entry]:
        """Return the lines of a plan about its points, with warnings outside the kernel study's range (collective)."""
        return elastic_plan.size(self, grid)

    def memory(self) -> int:
        """Return the bytes that a step takes for it on this rank: six weights and indices a point."""
        return len(self.X) * 8 * (2 * 6 * (self.coupling.kind[1] + 1) + 15)

    def step_limits(self, h: float, rho: float) -> dict[str, float]:
        """Return bounds of a stable step by cause [s], see `valvefsi.run.planning` (collective)."""
        return elastic_plan.step_limits(self, h, rho)

    def statics(self, dt: float) -> list[Entry]:
        """Return the static displacement of each tether under the mean of the loads (collective)."""
        return elastic_plan.static_displacements(self.solid)


class ElasticSeries:
    """Pictures of an elastic body over time.

    Args:
        solid: The solid.
        files: Its ParaView series.
    """

    def __init__(self, solid: Structure, files: SolidSeries) -> None:
        self.solid, self.files = solid, files

    def write(self, t: float, q: Table) -> None:
        """Write the solid in state q at time t [s]. Collective."""
        now, first = self.solid.cells_on_root(q["chi"]), self.solid.cells_on_root(self.solid.X)
        if now is None or first is None:
            self.files.write(t, None, None, None, None)
        else:
            points, cells, J = now
            self.files.write(t, points, cells, J, points - first[0])
