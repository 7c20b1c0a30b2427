"""Soft bodies in a lid-driven cavity: a sphere in three dimensions, a disk in two; volume kept, path, speed.

A ball of radius 0.2 cm at (0.6, 0.5[, 0.5]) in a unit box whose lid moves with 1 cm/s: rho = 1, mu = 0.01, Re = 100.
Its stress is P = 2 c1 F - 2 p0 F^-T. The time of a step is given in pairs of cosine transforms of the same grid, timed
in the same run (see `speed`).

The disk is drawn along under the lid, nearer than the kernel reaches, and stretched: with nodal coupling and a mesh as
coarse as the grid its nodes come to lie several h apart, and fluid leaks in. The table says how far.
"""

from __future__ import annotations

import itertools
from abc import abstractmethod
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.benchmarks import references
from valvefsi.benchmarks.frame import Benchmark, Job, Record, Report, public, refined
from valvefsi.benchmarks.immersed.study import COUPLINGS, Numerics, couple
from valvefsi.benchmarks.options import UNSET, Values, option, quantities, require_steps
from valvefsi.benchmarks.results import Row, order_row, row
from valvefsi.benchmarks.running import in_turns
from valvefsi.bodies.elastic import Elastic
from valvefsi.bodies.elastic_plan import LONGEST_GAP
from valvefsi.coupling.kernels import KERNELS
from valvefsi.fluid.boundary import Boundary, Wall
from valvefsi.fluid.navier_stokes import stable_fluid
from valvefsi.geometry.blocks import ball
from valvefsi.grid import MacGrid
from valvefsi.post.plots.immersed import Line, Panel, panels
from valvefsi.run.simulation import timed
from valvefsi.solid.structure import Structure

PARAMETERS = quantities("""
    c1 = 0.05 dyn/cm^2, p0 = 0.05 dyn/cm^2, rho = 1 g/cm^3, mu = 0.01 dyn*s/cm^2, lid = 1 cm/s,
    dt_per_h = 1/32 s/cm
""")
IBAMR = references.read("ibamr_sphere_in_cavity")
RADIUS, CENTRE = 0.2, (0.6, 0.5, 0.5)
PAIR_LIMIT, CHANGE_LIMIT = 25.0, 1e-6
LEAST_STEPS = 3
"""Steps of a run at least; the first two, which compile, are not timed."""


@dataclass(frozen=True, kw_only=True)
class SoftMatter:
    """W = c1 (I1 - 3) - 2 p0 ln J, so that P = 2 c1 F - 2 p0 F^-T; free of stress at F = I where c1 = p0.

    Args:
        c1: First constant [dyn/cm^2].
        p0: Second constant [dyn/cm^2].
    """

    c1: float
    p0: float

    @property
    def shear_modulus(self) -> float:
        """Shear modulus 2 c1 [dyn/cm^2]."""
        return 2.0 * self.c1

    def energy(self, kinematics: Any) -> Any:
        """Return W [dyn/cm^2]."""
        return self.c1 * (kinematics.I1 - 3) - 2 * self.p0 * kinematics.log_J


@dataclass(frozen=True, kw_only=True)
class SoftBody(Benchmark[int, None]):
    """A soft body in the cavity, on one or several grids."""

    parameters = PARAMETERS
    dim: ClassVar[int]
    body: ClassVar[str]
    measure: ClassVar[str]
    elsewhere: ClassVar[Mapping[str, float]] = {}
    """What another code gives, empty where it did not run this body."""

    grid: int = option(64, "Cells along each edge of the box.", least=8)
    kernel: str = option("ib4", "Kernel of the coupling.", choices=tuple(KERNELS))
    coupling: str = option("nodal", "nodal, elemental or lumped.", choices=COUPLINGS)

    def check(self, values: Values) -> None:
        if "t_end" in values:
            require_steps(values, values["dt_per_h"] / self.grid, LEAST_STEPS, "the first two are not timed")

    @property
    def numerics(self) -> Numerics:
        """How the coarsest grid is coupled."""
        return Numerics(grid=self.grid, kernel=self.kernel, coupling=self.coupling, nu_stab=None)

    def blocks(self, n: int) -> int:
        """Return the elements along the edge of each block of the body on a grid of n cells."""
        return max(2, round(0.36 * 2 * RADIUS * n / self.numerics.ratio))

    @abstractmethod
    def count(self, dt: float) -> int:
        """Return the number of steps."""

    def runs(self) -> list[int]:
        return [self.grid]

    def label(self, run: int) -> str:
        return f"N = {run}"

    def model(self, n: int, comm: MPI.Comm) -> fsi.Model:
        """Return the model on a grid of n cells along each axis (collective)."""
        dim, numerics, values = self.dim, self.numerics, self.values
        solid = Structure(
            ball(comm, centre=CENTRE[:dim], radius=RADIUS, elements=self.blocks(n)),
            SoftMatter(c1=values["c1"], p0=values["p0"]),
            name=self.body,
            nu_stab=numerics.nu_stab,
        )
        grid = MacGrid([0.0] * dim, [1.0] * dim, [n] * dim, [False] * dim, comm)
        sides = Boundary(grid, {"y_upper": Wall(velocity=(values["lid"],) + (0.0,) * (dim - 1))})
        fluid = stable_fluid(grid, sides, values["dt_per_h"] / n, rho=values["rho"], mu=values["mu"])
        return fsi.Model(grid=grid, fluid=fluid, bodies=(Elastic(solid, couple(fluid, solid, numerics)),))

    def one(self, run: int, job: Job) -> Record:
        model, dt = self.model(run, job.comm), self.values["dt_per_h"] / run
        steps, phases = self.count(dt), defaultdict[str, float](float)
        clocked, state = timed(model, phases), fsi.initial_state(model, dt)
        body: Any = model.bodies[0]
        rows, every, solid = [], max(1, steps // 200), body.solid

        def step() -> None:
            nonlocal state
            if state.step == 2:
                phases.clear()  # the first steps compile
            state = fsi.step(clocked, state, dt)

        def look() -> None:
            if state.step % every == 0 or state.step == steps:
                chi = state.bodies[0]["chi"]
                change = solid.volume(chi) / solid.reference_volume - 1.0
                moment = model.grid.comm.allreduce((solid.weights[:, None] * chi).sum(axis=0))
                x, y = moment[:2] / solid.reference_volume
                rows.append((state.t, change, x, y, body.gap(state.bodies[0]) * run))
                job.show(state.step, state.t, steps * dt, volume_change=rows[-1][1])

        each, pair = map(float, np.median(in_turns(step, model.grid, steps - 2, look), axis=1))
        history = dict(zip(("t", "change", "x", "y", "gap"), np.array(rows).T.tolist(), strict=True))
        return {
            "cells": run,
            "nodes": model.bodies[0].num_points,
            "steps": steps,
            "history": history,
            "volume_change": history["change"][-1],
            "largest_change": float(np.abs(history["change"]).max()),
            "largest_gap_per_h": max(history["gap"]),
            "step_s": each,
            "pair_s": pair,
            "pairs": each / pair,
            "phases_pairs": {k: v / max(1, steps - 2) / pair for k, v in phases.items()},
        }

    def report(self, records: Sequence[Record], reference: None) -> Report:
        keys = ("volume_change", "pairs", "step_s")
        table = [line for record in records for line in self._lines(record)]
        ends = [np.array([r["history"]["x"][-1], r["history"]["y"][-1]]) for r in records[-3:]]
        if len(ends) == 3:
            far, near = (float(np.linalg.norm(b - a)) for a, b in itertools.pairwise(ends))
            name = "observed order of the path's end"
            table += order_row(name, [0.0, far, far + near], source="three grids")
        grids = {"grids": self.runs(), "dim": self.dim, "numerics": vars(self.numerics)}
        return Report(
            parameters=self.values | grids,
            quantities={r["cells"]: {key: r[key] for key in keys} for r in records},
            reference=self.elsewhere,
            more={"runs": [public(r) for r in records]},
            table=table,
        )

    def _lines(self, r: Record) -> list[Row]:
        change, pairs = self.elsewhere.get("change"), self.elsewhere.get("pairs")
        note = "" if change is None else f"IBAMR 0.19: {change:.1e}; wanted <= {CHANGE_LIMIT:g}"
        took = "" if pairs is None else f"IBAMR 0.19, one rank: {pairs:.0f}; wanted <= {PAIR_LIMIT:g}"
        parts = ", ".join(f"{k} {v:.1f}" for k, v in r["phases_pairs"].items())
        gap, end = r["largest_gap_per_h"], {key: column[-1] for key, column in r["history"].items()}
        leaks = f"above {LONGEST_GAP:g} fluid leaks" if gap > LONGEST_GAP else ""
        name = f"relative {self.measure} change, N = {r['cells']}, {r['nodes']} nodes, {r['steps']} steps"
        return [
            row(name, r["volume_change"], 0.0, note, relative=False),
            row(f"  time of a step, {r['ranks']} rank(s)", r["pairs"], source=took, unit="pairs"),
            row("  step", 1e3 * r["step_s"], source=parts, unit="ms"),
            row("  largest distance of neighbouring points", gap, source=leaks, unit="h"),
            row(f"  centre at t = {end['t']:.4g} s", f"({end['x']:.5f}, {end['y']:.5f})", unit="cm"),
        ]

    def draw(self, records: Sequence[Record], reference: None, out: Path) -> None:
        def lines(x: str, y: str) -> list[Line]:
            return [
                Line(label=f"N = {r['cells']}", x=r["history"][x], y=r["history"][y], colour=k)
                for k, r in enumerate(records)
            ]

        change = f"relative {self.measure} change [-]"
        both = [
            Panel(lines=lines("x", "y"), xlabel="x of the centre [cm]", ylabel="y of the centre [cm]"),
            Panel(lines=lines("t", "change"), xlabel="t [s]", ylabel=change, reference=0.0),
        ]
        caption = f"{self.kernel}, {self.coupling}, Re 100"
        panels(out / f"{self.name}.png", both, title=self.name.replace("-", " "), caption=caption)


@dataclass(frozen=True, kw_only=True)
class SphereInCavity(SoftBody):
    """The sphere, a number of steps on one grid, or to the end of a time where one is set."""

    name = "sphere-in-cavity"
    dim, body, measure = 3, "sphere", "volume"
    parameters = {**PARAMETERS, "t_end": (UNSET, "s")}
    elsewhere = {key: IBAMR.value("value", quantity=key) for key in ("change", "pairs")}

    elements: int | None = option(16, "Elements along the edge of each block of the body.", least=1)
    steps: int = option(60, "Number of steps; of no account with --set t_end.", least=LEAST_STEPS)

    def blocks(self, n: int) -> int:
        return self.elements or super().blocks(n)

    def count(self, dt: float) -> int:
        return round(self.values["t_end"] / dt) if "t_end" in self.values else self.steps


@dataclass(frozen=True, kw_only=True)
class DiskInCavity(SoftBody):
    """The disk, to the end of a time, on grids of which each has half the spacing of the one before."""

    name = "disk-in-cavity"
    dim, body, measure = 2, "disk", "area"
    parameters = {**PARAMETERS, "t_end": (10.0, "s")}

    grid: int = option(32, "Cells along each edge of the box.", least=8)
    refine: int = option(2, "Number of finer grids.", least=0, most=4)
    t_end: float | None = option(None, "End of the run [s], as --set t_end.", least=0.01)
    ratio: float = option(0.5, "Size of the disk's elements over h.", least=0.1)

    @property
    def numerics(self) -> Numerics:
        return replace(super().numerics, ratio=self.ratio)

    def runs(self) -> list[int]:
        return refined(self.grid, self.refine)

    def count(self, dt: float) -> int:
        return round(self.values["t_end"] / dt)
