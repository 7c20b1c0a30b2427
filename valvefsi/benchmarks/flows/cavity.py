"""Flow in a square cavity whose lid slides: velocity on the centre lines against Ghia, Ghia and Shin (1982)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mpi4py import MPI
from scipy.interpolate import CubicSpline

from valvefsi import fsi
from valvefsi.benchmarks import references
from valvefsi.benchmarks.frame import Benchmark, Job, Record, Report
from valvefsi.benchmarks.options import Values, option
from valvefsi.benchmarks.results import row
from valvefsi.errors import ConvergenceError
from valvefsi.fluid.boundary import Boundary, Wall
from valvefsi.fluid.navier_stokes import ExplicitViscosity, NavierStokes
from valvefsi.grid import Array, Faces, MacGrid
from valvefsi.post import diagnostics

SOURCE = "Ghia et al. 1982, tables I and II"
NOTE = "the table for Re 100 is itself off by about 0.009 in one place"
REYNOLDS = (100, 1000, 5000)


def published(reynolds: int, component: str) -> tuple[Array, Array]:
    """Return positions and velocity: u on the vertical centre line, v on the horizontal one, ``(n,)`` each."""
    table, where = references.read("ghia1982_cavity"), {"reynolds": reynolds, "component": component}
    return table.column("position", **where), table.column("velocity", **where)


@dataclass(frozen=True, kw_only=True)
class Cavity(Benchmark[int, None]):
    """The cavity, run until the flow is steady: ``steady`` is the largest change per time that counts as none."""

    name = "cavity"
    parameters = {"cfl": (0.3, "1"), "steady": (1e-5, "1"), "t_max": (1000.0, "1")}

    reynolds: int = option(100, "100, 1000 or 5000.", choices=REYNOLDS)
    cells: int = option(64, "Cells along an edge.", flag="--grid", least=8)

    def runs(self) -> list[int]:
        return [self.cells]

    def one(self, run: int, job: Job) -> Record:
        grid, u, t, steps = march(self.reynolds, run, self.values, job)
        curves, gaps, lows = profiles(grid, u), {}, {}
        for name, (at, values) in curves.items():
            place, known = published(self.reynolds, name)
            spline, lowest = CubicSpline(at, values), int(np.argmin(known))
            gaps[name] = float(np.abs(spline(place) - known).max())
            lows[name] = {
                "at": place[lowest],
                "computed": float(spline(place[lowest])),
                "known": known[lowest],
            }
        return {"cells": run, "gaps": gaps, "lows": lows, "t": t, "steps": steps, "_curves": curves}

    def report(self, records: Sequence[Record], known: None) -> Report:
        (r,), table = records, []
        for name, line in (("u", "vertical"), ("v", "horizontal")):
            low = r["lows"][name]
            table.append(
                row(f"{name} on the {line} centre line, largest difference", r["gaps"][name], None, SOURCE)
            )
            table.append(row(f"{name} at {low['at']:.4f}", low["computed"], float(low["known"]), SOURCE))
        speed = self.cells**2 * r["steps"] / r["wall_s"]
        return Report(
            parameters=self.values | {"reynolds": self.reynolds, "cells": self.cells},
            quantities={f"{name}_gap": gap for name, gap in r["gaps"].items()} | {"t_steady": r["t"]},
            reference={"source": SOURCE, "note": NOTE},
            table=table,
            timing={"steps": r["steps"], "cell_steps_per_s": speed},
        )

    def draw(self, records: Sequence[Record], known: None, out: Path) -> None:
        from valvefsi.post.plots.decay import centre_lines

        name = f"Cavity at Re {self.reynolds}, {self.cells} x {self.cells} cells"
        points = {c: tuple(zip(*published(self.reynolds, c), strict=True)) for c in "uv"}
        centre_lines(out / "profiles.png", records[0]["_curves"], points, title=name)


def march(reynolds: int, cells: int, parameters: Values, job: Job) -> tuple[MacGrid, Faces, float, int]:
    """Run from rest until nothing changes; return grid, velocity, time and steps (collective)."""
    grid = MacGrid([0.0, 0.0], [1.0, 1.0], [cells] * 2, [False] * 2, job.comm)
    mu, t_max = 1.0 / reynolds, parameters["t_max"]
    dt = parameters["cfl"] / cells
    explicit = 2.0 * dt < ExplicitViscosity.limit(grid, rho=1.0, mu=mu)
    kind = ExplicitViscosity if explicit else NavierStokes
    fluid = kind(grid, Boundary(grid, {"y_upper": Wall(velocity=(1.0, 0.0))}), rho=1.0, mu=mu)
    model = fsi.Model(grid=grid, fluid=fluid)
    state, k, change = fsi.initial_state(model, dt), 0, np.inf
    while change > parameters["steady"]:
        if k * dt > t_max:
            raise ConvergenceError(
                f"the flow still changes by {change:.1e} per time at t = {k * dt:.4g}; try a larger t_max"
            )
        before, state = state.u, fsi.step(model, state, dt)
        k += 1
        if k % 20 == 0:
            pairs = zip(state.u, before, strict=True)
            local = max(float(np.abs(a - b)[grid.owned].max()) for a, b in pairs) / dt
            change = job.comm.allreduce(local, op=MPI.MAX)
            if not np.isfinite(diagnostics.kinetic_energy(grid, state.u, 1.0)):
                raise ConvergenceError(f"the velocity is not finite at t = {k * dt:.4g}; try a smaller cfl")
        job.show(k, min(k * dt, t_max), t_max, change=change)
    return grid, state.u, k * dt, k


def profiles(grid: MacGrid, u: Faces) -> dict[str, tuple[Array, Array]]:
    """Positions and velocity on both centre lines, walls included, on all ranks (collective)."""
    found = {}
    for d, name in enumerate("uv"):
        whole = np.zeros(grid.face_shape(d))
        block = u[d][grid.owned_faces(d)]
        whole[tuple(slice(s, s + n) for s, n in zip(grid.start, block.shape, strict=True))] = block
        whole = grid.comm.allreduce(whole)[:, :, 0]
        middle = grid.cells[d] // 2
        values = whole[middle] if d == 0 else whole[:, middle]
        at = np.concatenate([[0.0], grid.centres(1 - d), [1.0]])
        found[name] = (at, np.concatenate([[0.0], values, [1.0 if d == 0 else 0.0]]))
    return found
