"""Soft bodies in a lid-driven cavity: a sphere in three dimensions, a disk in two; volume kept, path, speed.

A ball of radius 0.2 cm at (0.6, 0.5[, 0.5]) in a unit box whose lid moves with 1 cm/s: rho = 1, mu = 0.01, Re = 100.
Its stress is P = 2 c1 F - 2 p0 F^-T. The time of a step is given in pairs of cosine transforms of the same grid, timed
in the same run (see `speed`).

The disk is drawn along under the lid, nearer than the kernel reaches, and stretched: with nodal coupling and a mesh as
coarse as the grid its nodes come to lie several h apart, and fluid leaks in. The table says how far.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.fft
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.benchmarks.immersed import Numerics, couple
from valvefsi.benchmarks.results import environment, row, write_result
from valvefsi.benchmarks.static_study import read_parameters
from valvefsi.bodies.elastic import Elastic
from valvefsi.bodies.elastic_plan import LONGEST_GAP
from valvefsi.fluid.boundary import Boundary, Wall
from valvefsi.fluid.navier_stokes import ExplicitViscosity, NavierStokes
from valvefsi.geometry.blocks import ball
from valvefsi.grid import MacGrid
from valvefsi.run.simulation import timed
from valvefsi.runtime.memory import keep_freed_memory
from valvefsi.solid.structure import Discretisation, Structure

PARAMETERS = {
    "c1": (0.05, "dyn/cm^2"),
    "p0": (0.05, "dyn/cm^2"),
    "rho": (1.0, "g/cm^3"),
    "mu": (0.01, "dyn*s/cm^2"),
    "lid": (1.0, "cm/s"),
    "dt_per_h": (1.0 / 32.0, "s/cm"),
}
RADIUS, CENTRE = 0.2, (0.6, 0.5, 0.5)
ELSEWHERE = {"change": -1.6e-7, "pairs": 234.0}
"""IBAMR 0.19, 64^3 cells, 28,672 hexahedra, ib4, elemental, 60 steps of h/32, one rank."""
PAIR_LIMIT, CHANGE_LIMIT = 25.0, 1e-6
PAIRS = 60
"""Steps that take turns with cosine transforms."""


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

    def energy(self, kinematics: object) -> object:
        """Return W [dyn/cm^2]."""
        return self.c1 * (kinematics.I1 - 3) - 2 * self.p0 * kinematics.log_J


@dataclass(frozen=True, kw_only=True)
class Setup:
    """What is run.

    Attributes:
        numerics: The coarsest grid, kernel and coupling.
        dim: 3 for the sphere, 2 for the disk.
        elements: Elements along the edge of each block, 16 makes 28,672 hexahedra; None for the numerics' ratio.
        steps: Number of steps; None to run to ``t_end``.
        t_end: End of the run where ``steps`` is None [s].
        refine: Number of finer grids, each with half the spacing.
        overrides: ``key=value``, names in `PARAMETERS`.
    """

    numerics: Numerics
    dim: int = 3
    elements: int | None = None
    steps: int | None = 60
    t_end: float = 10.0
    refine: int = 0
    overrides: Sequence[str] = ()

    @property
    def name(self) -> str:
        """Name of the benchmark."""
        return "sphere-in-cavity" if self.dim == 3 else "disk-in-cavity"


def model_of(
    setup: Setup, n: int, values: Mapping[str, float], comm: MPI.Comm
) -> tuple[fsi.Model, Structure]:
    """Return the model on a grid of n cells along each axis, and the solid (collective)."""
    dim, numerics = setup.dim, setup.numerics
    blocks = setup.elements or max(2, round(0.36 * 2 * RADIUS * n / numerics.ratio))
    blocks = blocks if setup.elements is None else blocks * n // numerics.grid
    mesh = ball(comm, centre=CENTRE[:dim], radius=RADIUS, elements=blocks)
    solid = Structure(
        mesh,
        SoftMatter(c1=values["c1"], p0=values["p0"]),
        name="sphere" if dim == 3 else "disk",
        nu_stab=numerics.nu_stab,
        discretisation=Discretisation(kernel=numerics.kernel),
    )
    grid = MacGrid([0.0] * dim, [1.0] * dim, [n] * dim, [False] * dim, comm)
    lid = (values["lid"],) + (0.0,) * (dim - 1)
    sides = Boundary(grid, {"y_upper": Wall(velocity=lid)})
    dt, physics = values["dt_per_h"] / n, {"rho": values["rho"], "mu": values["mu"]}
    explicit = 2.0 * dt < ExplicitViscosity.limit(grid, **physics)
    fluid = (ExplicitViscosity if explicit else NavierStokes)(grid, sides, **physics)
    return fsi.Model(grid=grid, fluid=fluid, bodies=(Elastic(solid, couple(fluid, solid, numerics)),)), solid


def run(
    setup: Setup,
    *,
    out: Path,
    comm: MPI.Comm = MPI.COMM_WORLD,
    progress: Callable[[str], Callable] | None = None,
) -> dict[str, object]:
    """Run the benchmark on every grid (collective)."""
    keep_freed_memory()
    values = read_parameters(PARAMETERS, setup.overrides)
    grids = [setup.numerics.grid * 2**k for k in range(setup.refine + 1)]
    runs = [_one(setup, n, values, comm, progress(f"N = {n}") if progress else None) for n in grids]
    result = {
        "benchmark": setup.name,
        "parameters": dict(values) | {"grids": grids, "dim": setup.dim, "numerics": vars(setup.numerics)},
        "quantities": {r["cells"]: {k: r[k] for k in ("volume_change", "pairs", "step_s")} for r in runs},
        "reference": ELSEWHERE,
        "runs": runs,
        "table": _table(setup, runs, comm.size),
        "timing": {"wall_s": sum(r["wall_s"] for r in runs)},
        "environment": environment(comm),
    }
    write_result(out, result, comm)
    if comm.rank == 0:
        _draw(setup, runs, Path(out) / f"{setup.name}.png")
    comm.barrier()
    return result


def _one(
    setup: Setup, n: int, values: Mapping[str, float], comm: MPI.Comm, progress: Callable | None
) -> dict[str, object]:
    """Run one grid: volume and centre of mass over time, and the median time of a step."""
    model, solid = model_of(setup, n, values, comm)
    dt = values["dt_per_h"] / n
    steps = setup.steps if setup.steps is not None else round(setup.t_end / dt)
    phases: dict[str, float] = {}
    clocked = timed(model, _Sums(phases))
    state, every, times, pairs = fsi.initial_state(model, dt), max(1, steps // 200), [], []
    history: dict[str, list[float]] = {"t": [], "change": [], "x": [], "y": [], "gap": []}
    begin = time.perf_counter()
    for step in range(steps):
        if step == 2:
            phases.clear()  # the first steps compile
        started = time.perf_counter()
        state = fsi.step(clocked, state, dt)
        times.append(time.perf_counter() - started)
        if step < PAIRS:  # in turns with the steps: a load on the machine slows both
            pairs.append(time_of_pair(n, setup.dim) if comm.rank == 0 else 0.0)
            comm.barrier()
        if (step + 1) % every == 0 or step + 1 == steps:
            _record(history, model, state)
            if progress is not None:
                progress(state.step, state.t, steps * dt, {"volume_change": history["change"][-1]})
    each = comm.allreduce(float(np.median(times[2:])), op=MPI.MAX)
    pair = comm.bcast(float(np.median(pairs[2:])) if comm.rank == 0 else None)
    return {
        "cells": n,
        "nodes": solid.num_nodes,
        "steps": steps,
        "history": history,
        "volume_change": history["change"][-1],
        "largest_change": float(np.abs(history["change"]).max()),
        "largest_gap_per_h": max(history["gap"]),
        "step_s": each,
        "pair_s": pair,
        "pairs": each / pair,
        "phases_pairs": {k: v / max(1, steps - 2) / pair for k, v in phases.items()},
        "wall_s": time.perf_counter() - begin,
    }


class _Sums(dict):
    """A view of a table that starts every entry at zero."""

    def __init__(self, table: dict[str, float]) -> None:
        self.table = table

    def __getitem__(self, key: str) -> float:
        return self.table.get(key, 0.0)

    def __setitem__(self, key: str, value: float) -> None:
        self.table[key] = value


def _record(history: dict[str, list[float]], model: fsi.Model, state: fsi.State) -> None:
    chi, solid, grid = state.bodies[0]["chi"], model.bodies[0].solid, model.grid
    moment = grid.comm.allreduce((solid.weights[:, None] * chi).sum(axis=0))
    centre = moment / solid.reference_volume
    history["t"].append(state.t)
    history["change"].append(solid.volume(chi) / solid.reference_volume - 1.0)
    history["x"].append(float(centre[0]))
    history["y"].append(float(centre[1]))
    history["gap"].append(model.bodies[0].gap(state.bodies[0]) / float(grid.spacing[0]))


def time_of_pair(n: int, dim: int) -> float:
    """Return the time of a cosine transform of the grid and back, on one thread [s].

    In memory that the process keeps, as steps have it: with fresh pages a pair takes up to twice as long.
    """
    field = np.random.default_rng(0).standard_normal((n,) * dim)
    started = time.perf_counter()
    scipy.fft.idctn(scipy.fft.dctn(field, workers=1), workers=1)
    return time.perf_counter() - started


def _table(setup: Setup, runs: Sequence[Mapping], ranks: int) -> list[dict[str, object]]:
    lines, published = [], setup.dim == 3
    for r in runs:
        known = f"IBAMR 0.19: {ELSEWHERE['change']:.1e}; wanted <= {CHANGE_LIMIT:g}" if published else ""
        name = f"N = {r['cells']}, {r['nodes']} nodes, {r['steps']} steps"
        what = "volume" if setup.dim == 3 else "area"
        lines.append(row(f"relative {what} change, {name}", r["volume_change"], 0.0, known, relative=False))
        known = (
            f"IBAMR 0.19, one rank: {ELSEWHERE['pairs']:.0f}; wanted <= {PAIR_LIMIT:g}" if published else ""
        )
        lines.append(row(f"  time of a step, {ranks} rank(s)", r["pairs"], source=known, unit="pairs"))
        parts = ", ".join(f"{k} {v:.1f}" for k, v in r["phases_pairs"].items())
        lines.append(row("  step", 1e3 * r["step_s"], source=parts, unit="ms"))
        place = f"({r['history']['x'][-1]:.5f}, {r['history']['y'][-1]:.5f})"
        gap = r["largest_gap_per_h"]
        leaks = f"above {LONGEST_GAP:g} fluid leaks" if gap > LONGEST_GAP else ""
        lines.append(row("  largest distance of neighbouring points", gap, source=leaks, unit="h"))
        lines.append(row(f"  centre at t = {r['history']['t'][-1]:.4g} s", place, unit="cm"))
    if len(runs) > 2:
        a, b, c = (np.array([r["history"]["x"][-1], r["history"]["y"][-1]]) for r in runs[-3:])
        near, far = np.linalg.norm(c - b), np.linalg.norm(b - a)
        lines.append(row("observed order of the path's end", math.log2(far / near), source="three grids"))
    return lines


def _draw(setup: Setup, runs: Sequence[Mapping], path: Path) -> None:
    from valvefsi.post.plots.immersed import Line, Panel, panels

    def lines(x: str, y: str) -> list[Line]:
        return [
            Line(label=f"N = {r['cells']}", x=r["history"][x], y=r["history"][y], colour=k)
            for k, r in enumerate(runs)
        ]

    what = "volume" if setup.dim == 3 else "area"
    shown = [
        Panel(lines=lines("x", "y"), xlabel="x of the centre [cm]", ylabel="y of the centre [cm]"),
        Panel(
            lines=lines("t", "change"), xlabel="t [s]", ylabel=f"relative {what} change [-]", reference=0.0
        ),
    ]
    n = setup.numerics
    panels(path, shown, title=setup.name.replace("-", " "), caption=f"{n.kernel}, {n.coupling}, Re 100")
