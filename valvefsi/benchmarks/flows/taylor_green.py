"""The Taylor-Green vortex at Re 1600: from a smooth flow to turbulence and its decay.

u = sin x cos y cos z, v = -cos x sin y cos z, w = 0 in a box of edge 2 pi keeps the symmetry of its eighth, a box of
edge pi between planes that slip: N cells along that edge are 2 N along the whole. Kinetic energy (per mass,
mean over the box) and the rate at which it is lost are compared with the direct simulation on 512^3 points of Dairay
et al. 2017.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.benchmarks import references
from valvefsi.benchmarks.frame import Job, Report, Single
from valvefsi.benchmarks.options import Values, option, quantities
from valvefsi.benchmarks.results import row
from valvefsi.errors import StabilityError
from valvefsi.fluid.advection import SCHEMES
from valvefsi.fluid.boundary import SIDES, Boundary, FreeSlip
from valvefsi.fluid.navier_stokes import stable_fluid
from valvefsi.grid import Array, MacGrid
from valvefsi.io.folder import replacing
from valvefsi.post import diagnostics
from valvefsi.post.plots.decay import decay
from valvefsi.verification.norms import normalised_difference

PARAMETERS = quantities(
    "reynolds = 1600, t_end = 12 s, cfl = 0.2",
    advection=("xsppm7", tuple(SCHEMES)),
)
TABLE = "taylor_green_re1600"
SOURCE = "direct simulation 512^3 (Dairay et al. 2017)"
T_PEAK_PASSED = 10.0
"""A run to this time has the largest loss (published at 8.98) behind it."""


@dataclass(frozen=True, kw_only=True)
class Curves:
    """Curves over time, ``(n,)`` each: energy, its loss, and what of the loss the grid resolves."""

    t: Array
    energy: Array
    loss: Array
    resolved: Array


@dataclass(frozen=True, kw_only=True)
class TaylorGreen(Single):
    """The vortex."""

    name = "taylor-green"
    parameters = PARAMETERS

    cells: int = option(48, "Cells along the edge of the eighth.", flag="--grid", least=8)

    def measured(self, job: Job) -> Report:
        curves, steps = march(self.cells, self.values, job)
        peak, loss = int(np.argmax(curves.loss)), curves.loss
        q = {"peak": float(loss[peak]), "t_peak": float(curves.t[peak])}
        q["energy_end"] = float(curves.energy[-1])
        dns = compare(curves) if self.published("reynolds") else {}
        against = SOURCE if "peak" in dns else ""
        table = [
            row("largest loss of energy", q["peak"], dns.get("peak"), against),
            row("its time", q["t_peak"], dns.get("t_peak"), against),
            row("largest dissipation that the grid resolves", float(curves.resolved.max())),
            row("energy lost to the scheme at the peak", float(1.0 - curves.resolved[peak] / loss[peak])),
            row("energy at the end", q["energy_end"]),
        ]
        for name in ("energy", "loss") if dns else ():
            what = f"{name}, relative L2 difference from the table"
            table.append(row(what, dns[f"{name}_l2"], None, SOURCE))
        return Report(
            parameters=self.values | {"cells": self.cells, "whole_box": 2 * self.cells},
            quantities=q,
            reference=dns | {"source": SOURCE, "doi": references.read(TABLE).doi} if dns else {},
            table=table,
            timing={"steps": steps, "cell_steps": self.cells**3 * steps},
            draw=lambda out: self._draw(out, curves),
        )

    def _draw(self, out: Path, c: Curves) -> None:
        curves = (c.t, c.energy, c.loss, c.resolved)
        header = "t,energy,loss,resolved"
        with replacing(out / "decay.csv") as path:
            np.savetxt(path, np.stack(curves, axis=1), delimiter=",", comments="", header=header)
        rows = published(c.t[-1]) if self.published("reynolds") else None
        dns = None if rows is None else (rows.t, rows.energy, rows.loss)
        size = f"{2 * self.cells}^3 cells in the whole box"
        name = f"Taylor-Green vortex, Re {self.values['reynolds']:g}, {size}"
        decay(out / "decay.png", curves, dns, title=name, source="direct simulation, Dairay et al. 2017")


def published(t_end: float = math.inf) -> Curves:
    """Return the published curves at Re 1600 up to a time, all of the loss resolved; a run may end a little later."""
    table = references.read(TABLE)
    here = table.column("t") <= t_end + 1e-9
    t, energy, loss = (table.column(name)[here] for name in ("t", "kinetic_energy", "dissipation"))
    return Curves(t=t, energy=energy, loss=loss, resolved=loss)


def compare(curves: Curves) -> dict[str, Any]:
    """Compare curves with the published ones at the times of the table, as far as the curves go.

    Returns:
        Relative differences in L2 ``energy_l2`` and ``loss_l2``, the number of ``rows`` they are over and the time
        ``t_last`` of the last one; ``peak`` and ``t_peak`` of the table if the curves pass it. Empty with fewer than
        two rows.
    """
    rows, end = published(curves.t[-1]), curves.t[-1]
    if len(rows.t) < 2:
        return {}
    difference: dict[str, Any] = {"rows": len(rows.t), "t_last": float(rows.t[-1])}
    for name in ("energy", "loss"):
        here = np.interp(rows.t, curves.t, getattr(curves, name))
        difference[f"{name}_l2"] = normalised_difference(rows.t, here, getattr(rows, name))
    if end >= T_PEAK_PASSED:
        table = published()
        top = int(np.argmax(table.loss))
        difference |= {"peak": float(table.loss[top]), "t_peak": float(table.t[top])}
    return difference


def march(cells: int, parameters: Values, job: Job) -> tuple[Curves, int]:
    """Run the vortex (collective).

    Returns:
        Mean kinetic energy per mass, its loss, mean dissipation per mass that the grid resolves; number of steps.

    Raises:
        StabilityError: A velocity is not finite.
    """
    grid = MacGrid([0.0] * 3, [np.pi] * 3, [cells] * 3, [False] * 3, job.comm)
    nu, t_end = 1.0 / parameters["reynolds"], parameters["t_end"]
    sides = Boundary(grid, {name: FreeSlip() for name in SIDES})
    usual = parameters["cfl"] * np.pi / cells  # the largest speed is 1 at first and about that for long
    fluid = stable_fluid(grid, sides, usual, rho=1.0, mu=nu, advection=parameters["advection"])
    model, every, volume = fsi.Model(grid=grid, fluid=fluid), max(1, cells // 16), np.pi**3
    state: fsi.State | None = None
    (x, y, z), (X, Y, Z) = grid.points(0), grid.points(1)
    start = np.sin(x) * np.cos(y) * np.cos(z), -np.cos(X) * np.sin(Y) * np.cos(Z)
    u, t, rows = fluid.fill((*start, grid.zeros()), 0.0), 0.0, []
    while True:
        k = state.step if state else 0
        rate = job.comm.allreduce(diagnostics.local_courant_rate(grid, u), op=MPI.MAX)
        if not np.isfinite(rate):
            raise StabilityError(f"the velocity is not finite at t = {t:.4g}; try a smaller cfl")
        if k % every == 0 or t >= t_end:
            energy, resolved = diagnostics.kinetic_energy(grid, u, 1.0), diagnostics.dissipation(grid, u, nu)
            rows.append((t, energy / volume, resolved / volume))
        if t >= t_end:
            times, energies, rates = np.array(rows).T
            return Curves(t=times, energy=energies, loss=-np.gradient(energies, times), resolved=rates), k
        dt = min(parameters["cfl"] / rate, 1.05 * state.dt if state else np.inf)
        state = fsi.step(model, state or fsi.initial_state(model, dt, u), dt)
        u, t = state.u, state.t
        job.show(state.step, min(t, t_end), t_end, **{"kinetic energy": rows[-1][1]})
