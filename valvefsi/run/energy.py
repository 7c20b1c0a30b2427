"""The balance of energy of a run: where the work of the circuits goes.

Over any time, with u the velocity on the faces and every term summed with the volumes of the faces,

    change of 1/2 rho u . u  =  pressures + inflow - viscosity - scheme + bodies - residual

pressures: work of the normal tractions on the sides, integral of -p u . n; for a circuit its pressure times its flow
inflow: kinetic energy that comes in with the fluid, less what leaves
viscosity: integral of 2 mu S : S
scheme: what the advection scheme takes beside carrying energy out, integral of rho u . N(u) plus inflow: its numerical
    dissipation, measured by the very term of the step
bodies: work of the bodies on the fluid, summed step by step (`State.given`): -(change of what they store) - (what they
    lose: to their dampers, their viscosity and their slip through the fluid, less the work of their loads)

The work of walls that move along themselves and of forces from outside is in no term: it stands in the residual, with
the shear at the corners of a lid or of an inflow that is not zero at the wall. A flow that starts at once needs a row
every step there, or the balance is to be read between later rows.

Rates are read at the rows of the history and integrated by the trapezium rule; the residual is what is left: of that
rule, of the mean velocity in a step that viscosity and advection are not taken at, of sides and their backflow.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.post import diagnostics

if TYPE_CHECKING:
    from valvefsi.fsi import Model, State
    from valvefsi.types import Array

TERMS = ("pressures", "inflow", "viscosity", "scheme")
"""What is integrated from row to row."""


@dataclass(frozen=True, kw_only=True)
class Sums:
    """Integrals up to a row.

    Attributes:
        t: Its time [s].
        rates: Rates of `TERMS` there, ``(4,)`` [erg/s].
        work: Their integrals, ``(4,)`` [erg].
        start: Kinetic energy, what the bodies have given and what they stored at the first row [erg].
    """

    t: float
    rates: Array
    work: Array
    start: Array


class EnergyMeter:
    """Gives the balance of energy of a run at the rows of its history.

    Args:
        model: The model.
        on: Whether it is asked for.

    Attributes:
        columns: Names of its columns [erg]; all are integrals from the first row on.
        last: Sums at the last row, None before the first.
    """

    def __init__(self, model: Model, on: bool) -> None:
        self.model, self.on = model, on
        self.last: Sums | None = None
        self._newest: Sums | None = None
        bodies = [f"energy_{what}_{body.name}_erg" for body in model.bodies for what in ("stored", "lost")]
        names = [f"energy_{name}_erg" for name in ("kinetic", *TERMS, "bodies", "residual")]
        self.columns = [*names, *bodies] if on else []

    def row(self, state: State) -> dict[str, float]:
        """Return the balance up to a state (collective)."""
        if not self.on:
            return {}
        bodies = zip(self.model.bodies, state.bodies, strict=True)
        stored = np.array([body.stored(q) for body, q in bodies])
        kinetic = diagnostics.kinetic_energy(self.model.grid, state.u, self.model.fluid.rho)
        rates, old = self._rates(state), self.last
        now = np.concatenate([[kinetic], state.given[:, 3], stored])
        work = np.zeros(len(TERMS))
        if old is not None:
            work = old.work + 0.5 * (state.t - old.t) * (rates + old.rates)
        start = now if old is None else old.start
        self._newest = Sums(t=state.t, rates=rates, work=work, start=start)
        change = now - start
        given, stored = np.split(change[1:], 2)
        pressures, inflow, viscosity, scheme = work
        residual = pressures + inflow - viscosity - scheme + given.sum() - change[0]
        parts = np.stack([stored, -given - stored], axis=1).ravel()
        return dict(
            zip(self.columns, map(float, [change[0], *work, given.sum(), residual, *parts]), strict=True)
        )

    def _rates(self, state: State) -> Array:
        """Rates of `TERMS`, ``(4,)`` [erg/s]. Collective."""
        model, fluid, grid = self.model, self.model.fluid, self.model.grid
        pressures = model.circulation.pressures(state.circuits, state.t)
        sides = fluid.boundary.power(state.u, state.p, fluid.rho, state.t, pressures)
        pressure, inflow = np.sum([np.zeros(2), *sides.values()], axis=0)
        advection, carried = NavierStokes.advection(fluid, state.u), 0.0
        for d, (N, u) in enumerate(zip(advection, state.u, strict=True)):
            here = fluid.boundary.unknown_faces(d)
            carried += fluid.rho * float(np.einsum("ijk,ijk,ijk->", u[here], N[here], grid.volumes(d)[here]))
        loss = grid.comm.allreduce(carried) + inflow
        return np.array([pressure, inflow, diagnostics.dissipation(grid, state.u, fluid.mu), loss])

    def keep(self) -> None:
        """Go on from the newest row: it is in the history."""
        self.last = self._newest

    def meta(self) -> dict[str, Any] | None:
        """Return what a checkpoint keeps."""
        last = self.last
        return None if last is None else {k: np.asarray(v).tolist() for k, v in vars(last).items()}

    def restore(self, meta: Mapping[str, Any] | None) -> None:
        """Go on from what `meta` was."""
        if meta is not None:
            arrays = {k: np.array(v) for k, v in meta.items() if k != "t"}
            self.last = Sums(t=meta["t"], **arrays)


def balance(history: Mapping[str, list[float]], begin: float, end: float) -> dict[str, float]:
    """Return the balance between two times of a history, and its residual as a part of the work.

    Args:
        history: Columns of a history with `EnergyMeter`'s.
        begin: First time [s]; the nearest rows are taken.
        end: Last time [s].

    Returns:
        Each term [erg], and ``residual_percent`` of the largest of the works that come in.
    """
    t = np.asarray(history["t_s"])
    first, last = (int(np.argmin(np.abs(t - at))) for at in (begin, end))
    terms = {
        name.removeprefix("energy_"): float(values[last]) - float(values[first])
        for name, values in history.items()
        if name.startswith("energy_")
    }
    work = abs(terms["pressures_erg"]) + abs(terms["inflow_erg"]) + abs(min(terms["kinetic_erg"], 0.0))
    terms["residual_percent"] = 100.0 * terms["residual_erg"] / max(work, abs(terms["viscosity_erg"]), 1e-300)
    return terms
