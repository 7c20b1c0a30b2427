"""Flow in a square cavity whose lid slides: velocity on the centre lines against Ghia, Ghia and Shin (1982)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.interpolate import CubicSpline

from valvefsi import fsi
from valvefsi.benchmarks import references
from valvefsi.benchmarks.frame import Job, Report, Single
from valvefsi.benchmarks.options import Values, option, quantities
from valvefsi.benchmarks.results import row
from valvefsi.benchmarks.running import whole_of
from valvefsi.errors import ConvergenceError
from valvefsi.fluid.boundary import Boundary, Wall
from valvefsi.fluid.navier_stokes import stable_fluid
from valvefsi.grid import Array, Faces, MacGrid
from valvefsi.post import diagnostics
from valvefsi.post.plots.decay import centre_lines

SOURCE = "Ghia et al. 1982, tables I and II"
NOTE = "the table for Re 100 is itself off by about 0.009 in one place"
REYNOLDS = (100, 1000, 5000)


def published(reynolds: int, component: str) -> tuple[Array, Array]:
    """Return positions and velocity: u on the vertical centre line, v on the horizontal one, ``(n,)`` each."""
    table, where = references.read("ghia1982_cavity"), {"reynolds": str(reynolds), "component": component}
    return table.column("position", **where), table.column("velocity", **where)


@dataclass(frozen=True, kw_only=True)
class Cavity(Single):
    """The cavity, until it is steady, changing by less than ``steady`` per time, or to ``t_end``."""

    name = "cavity"
    parameters = quantities("cfl = 0.3, steady = 1e-5, t_end = 1000 s")

    reynolds: int = option(100, "100, 1000 or 5000.", choices=REYNOLDS)
    cells: int = option(64, "Cells along an edge.", flag="--grid", least=8)

    def measured(self, job: Job) -> Report:
        grid, u, t, steps, change = march(self.reynolds, self.cells, self.values, job)
        curves, table, quantities = profiles(grid, u), [], {}
        for name, line in (("u", "vertical"), ("v", "horizontal")):
            place, values = published(self.reynolds, name)
            spline, low = CubicSpline(*curves[name]), int(np.argmin(values))
            quantities[f"{name}_gap"] = gap = float(np.abs(spline(place) - values).max())
            table += [
                row(f"{name} on the {line} centre line, largest difference", gap, None, SOURCE),
                row(f"{name} at {place[low]:.4f}", float(spline(place[low])), float(values[low]), SOURCE),
            ]
        if change > self.values["steady"]:
            table.append(row("not steady yet, it changes per time by", change, source=f"at t = {t:.4g}"))
        return Report(
            parameters=self.values | {"reynolds": self.reynolds, "cells": self.cells},
            quantities=quantities | {"t_steady": t},
            reference={"source": SOURCE, "note": NOTE},
            table=table,
            timing={"steps": steps, "cell_steps": self.cells**2 * steps},
            draw=lambda out: self._draw(out, curves),
        )

    def _draw(self, out: Path, curves: dict[str, Any]) -> None:
        name = f"Cavity at Re {self.reynolds}, {self.cells} x {self.cells} cells"
        points = {c: tuple(zip(*published(self.reynolds, c), strict=True)) for c in "uv"}
        centre_lines(out / "profiles.png", curves, points, title=name)


def march(
    reynolds: int, cells: int, parameters: Values, job: Job
) -> tuple[MacGrid, Faces, float, int, float]:
    """Run from rest until nothing changes; return grid, velocity, time, steps and the last change (collective)."""
    grid = MacGrid([0.0, 0.0], [1.0, 1.0], [cells] * 2, [False] * 2, job.comm)
    mu, t_end = 1.0 / reynolds, parameters["t_end"]
    steps = max(1, math.ceil(t_end * cells / parameters["cfl"] - 1e-9))
    dt = t_end / steps  # the last step ends at t_end
    lid = Boundary(grid, {"y_upper": Wall(velocity=(1.0, 0.0))})
    model = fsi.Model(grid=grid, fluid=stable_fluid(grid, lid, dt, rho=1.0, mu=mu))
    state, k, change = fsi.initial_state(model, dt), 0, np.inf
    while change > parameters["steady"] and k < steps:
        before, state = state.u, fsi.step(model, state, dt)
        k += 1
        if k % 20 == 0:
            pairs = zip(state.u, before, strict=True)
            local = max(float(np.abs(a - b)[grid.owned].max()) for a, b in pairs) / dt
            change = job.comm.allreduce(local, op=MPI.MAX)
            if not np.isfinite(diagnostics.kinetic_energy(grid, state.u, 1.0)):
                raise ConvergenceError(f"the velocity is not finite at t = {k * dt:.4g}; try a smaller cfl")
        job.show(k, k * dt, t_end, change=change)
    return grid, state.u, k * dt, k, change


def profiles(grid: MacGrid, u: Faces) -> dict[str, tuple[Array, Array]]:
    """Positions and velocity on both centre lines, walls included, on all ranks (collective)."""
    curves = {}
    for d, name in enumerate("uv"):
        whole = whole_of(grid, u[d][grid.owned_faces(d)], grid.face_shape(d))[:, :, 0]
        middle = grid.cells[d] // 2
        values = whole[middle] if d == 0 else whole[:, middle]
        at = np.concatenate([[0.0], grid.centres(1 - d), [1.0]])
        curves[name] = (at, np.concatenate([[0.0], values, [1.0 if d == 0 else 0.0]]))
    return curves
