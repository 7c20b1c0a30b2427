"""Flow in a plane channel between open sides: steady (Poiseuille) and oscillating (Womersley), against closed forms.

Height, density and the amplitude of the pressure gradient are 1, see `valvefsi.verification.closed_forms`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.benchmarks.frame import Benchmark, Job, Record, Report, refined
from valvefsi.benchmarks.options import UNSET, Values, option, quantities
from valvefsi.benchmarks.results import order_row, row
from valvefsi.benchmarks.running import whole_of
from valvefsi.fluid.boundary import Boundary, Open
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.grid import Array, MacGrid
from valvefsi.post.plots.decay import profiles
from valvefsi.verification.closed_forms import poiseuille, womersley

KINDS = ("poiseuille", "womersley")


@dataclass(frozen=True, kw_only=True)
class Channel(Benchmark[int, None]):
    """Both flows on grids of N, 2 N, ... cells across."""

    name = "channel"
    parameters = quantities("womersley = 6, viscosity = 0.1, length = 2", t_end=(UNSET, "s"))
    """``t_end`` is of both flows; unset it is half a viscous time for the steady one, a period for the other."""

    cells: int = option(16, "Cells across on the coarsest grid.", flag="--grid", least=4)
    refine: int = option(2, "Number of finer grids.", least=0)

    def runs(self) -> list[int]:
        return refined(self.cells, self.refine)

    def one(self, run: int, job: Job) -> Record:
        flows = {kind: measure(kind, run, self.values, job.comm) for kind in KINDS}
        return {"cells": run, "errors": {kind: flows[kind].pop("error") for kind in KINDS}, "_curves": flows}

    def report(self, records: Sequence[Record], reference: None) -> Report:
        errors = {kind: [record["errors"][kind] for record in records] for kind in KINDS}
        table = []
        for kind, each in errors.items():
            name = f"{kind}, {{}} across: largest error / largest speed"
            table += [row(name.format(r["cells"]), e) for r, e in zip(records, each, strict=True)]
            table += order_row(
                f"{kind}: observed order", each, exact=0.0, expected=2.0, source="order of the scheme"
            )
        return Report(
            parameters=self.values | {"cells": self.runs()},
            quantities=errors,
            reference={"source": "closed form"},
            table=table,
        )

    def draw(self, records: Sequence[Record], reference: None, out: Path) -> None:
        curves = {kind: list(flow.values()) for kind, flow in records[-1]["_curves"].items()}
        title = f"Flow in a channel, {records[-1]['cells']} cells across"
        profiles(out / "profiles.png", curves, title=title)


def measure(kind: str, n: int, parameters: Values, comm: MPI.Comm) -> dict[str, Any]:
    """Run one flow from its closed form and return its largest error and its profiles at four times (collective)."""
    mu, length = parameters["viscosity"], parameters["length"]
    number = parameters["womersley"]
    frequency = mu * (2.0 * number) ** 2
    steady = kind == "poiseuille"
    usual = 0.5 / mu if steady else 2.0 * np.pi / frequency
    t_end = parameters.get("t_end", usual)

    def exact(y: Array, t: float) -> Array:
        return poiseuille(y, mu) if steady else womersley(y, t, number, mu)

    def pressure(x: Array, y: Array, z: Array, t: float) -> float:
        return length * (1.0 if steady else float(np.cos(frequency * t)))

    grid = MacGrid([0.0, 0.0], [length, 1.0], [max(8, n // 4), n], [False, False], comm)
    ends = {"x_lower": Open(pressure=pressure, backflow=0.0), "x_upper": Open(backflow=0.0)}
    fluid = NavierStokes(grid, Boundary(grid, ends), rho=1.0, mu=mu)
    y = grid.points(0)[1]
    steps = 4 * max(1, round(max(4, n) * t_end / usual))
    dt, x = t_end / steps, grid.points()[0]
    p = grid.zeros() + pressure(x, y, y, -0.5 * dt) * (1.0 - x / length)
    model = fsi.Model(grid=grid, fluid=fluid)
    state = fsi.initial_state(model, dt, (exact(y, 0.0) + grid.zeros(), grid.zeros()), p)
    error, speed, profiles = 0.0, 0.0, []
    own = grid.owned_faces(0)
    for k in range(steps):
        state, t = fsi.step(model, state, dt), (k + 1) * dt
        if (k + 1) % (steps // 4) == 0:
            here = exact(y, t) + grid.zeros()
            error = max(error, float(np.abs(state.u[0] - here)[own].max()))
            speed = max(speed, float(np.abs(here[own]).max()))
            profiles.append((t, whole_of(grid, state.u[0][grid.owned][:, :, 0], grid.cells[:2]).mean(axis=0)))
    return {
        "error": comm.allreduce(error, op=MPI.MAX) / comm.allreduce(speed, op=MPI.MAX),
        "y": grid.centres(1),
        "profiles": profiles,
        "exact": [exact(np.linspace(0, 1, 201), t) for t, _ in profiles],
    }
