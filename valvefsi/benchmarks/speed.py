"""Speed of the fluid step: phases, and the ratio to a fast cosine transform of the same grid in the same run.

One pair is scipy.fft.dctn and idctn of the grid on one thread: a yardstick that moves with the machine. The bytes that
a step must move, over its time, compare with the bandwidth of a triad on all ranks at once.
"""

from __future__ import annotations

import resource
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import scipy.fft
from mpi4py import MPI

from valvefsi.benchmarks import cost_model, elastic_speed
from valvefsi.benchmarks.parameters import read_parameters
from valvefsi.benchmarks.results import environment, row, write_result
from valvefsi.fluid.advection import SCHEMES
from valvefsi.fluid.boundary import Boundary, Wall
from valvefsi.fluid.direct_solver import TensorSolver
from valvefsi.fluid.navier_stokes import ExplicitViscosity, NavierStokes
from valvefsi.grid import Faces, MacGrid
from valvefsi.run.simulation import Timed
from valvefsi.runtime import threads
from valvefsi.runtime.memory import keep_freed_memory

PARAMETERS = {
    "rho": (1.0, "g/cm^3"),
    "mu": (0.01, "dyn*s/cm^2"),
    "cfl": (0.3, "1"),
    "advection": ("centred", tuple(SCHEMES)),
    "viscous": ("implicit", ("implicit", "explicit")),
}
PARTS = ("viscous solves", "pressure solve", "ghosts", "right-hand side", "projection")
CALIBRATION = 96
"""Cells along each axis of the grid from which the cost model takes the constants of one core."""


def run(
    *,
    sizes: Sequence[int] = (32, 64, 128),
    dim: int = 3,
    steps: int = 5,
    out: Path = Path("results/speed"),
    overrides: Sequence[str] = (),
    comm: MPI.Comm = MPI.COMM_WORLD,
    model: bool = False,
) -> dict[str, object]:
    """Time fluid steps on grids of N cells along each axis, walls on all sides but one pair.

    Args:
        sizes: Grid sizes N.
        dim: 2 or 3 dimensions.
        steps: Steps timed per grid, after two that are not.
        out: Folder of ``result.json`` and ``speed.png``.
        overrides: ``rho``, ``mu``, ``cfl``, ``advection`` or ``viscous`` as ``key=value``.
        comm: Communicator.
        model: Whether to predict steps on many cores, in three dimensions, and compare with the steps measured here.

    Returns:
        The contents of ``result.json``.

    Note:
        Collective.
    """
    parameters = read_parameters(PARAMETERS, overrides)
    keep_freed_memory()
    grids = [_measure((n,) * dim, steps, parameters, comm) for n in sizes]
    table = [_row(g, dim, comm.size, parameters["advection"] == "xsppm7") for g in grids]
    elastic = elastic_speed.measure(comm)
    table.append(elastic.pop("row"))
    predicted = _model(grids, steps, parameters, comm) if model else {"rows": []}
    table += predicted.pop("rows")
    result = {
        "benchmark": "speed",
        "parameters": parameters | {"sizes": list(sizes), "dim": dim, "steps": steps},
        "grids": grids,
        "elastic_force": elastic,
        "cost_model": predicted,
        "table": table,
        "environment": environment(comm),
    }
    write_result(out, result, comm)
    if comm.rank == 0:
        from valvefsi.post.plots.base import phase_bars

        heading = f"One fluid step on {comm.size} rank{'s' * (comm.size > 1)}"
        phase_bars(Path(out) / "speed.png", {f"{g['N']}^{dim}": g["phases_ms"] for g in grids}, title=heading)
    comm.barrier()
    return result


def _model(
    grids: Sequence[dict[str, object]], steps: int, parameters: dict[str, float | str], comm: MPI.Comm
) -> dict[str, object]:
    """Calibrate the cost model on every core at once, compare it with the grids measured, and predict. Collective."""
    solves = 4 if parameters["viscous"] == "implicit" else 1
    machine = machine_here(parameters, comm, steps)
    network, rows = cost_model.measure_network(comm), []
    for grid in grids:
        count = cost_model.work(grid["N"], comm.size, solves=solves, advection=parameters["advection"])
        step = cost_model.predict(count, machine, network or cost_model.Network())["step"]
        name = f"model: {grid['N']}^3, {comm.size} rank{'s' * (comm.size > 1)}"
        rows.append(row(name, 1e3 * step, grid["step_ms"], "measured here", unit="ms"))
    lines = cost_model.table(machine, cost_model.Network(), solves=solves, advection=parameters["advection"])
    for line in lines:
        each = f"per core {line['flops']:.2g} flops, {line['bytes']:.2g} bytes, {line['messages']} messages"
        rows.append(
            row(f"model: {line['N']}^3, {line['cores']} cores", 1e3 * line["step_s"], None, each, unit="ms")
        )
    return {
        "calibration_N": CALIBRATION,
        "machine": asdict(machine),
        "network_measured": network and asdict(network),
        "network_assumed": asdict(cost_model.Network()),
        "predictions": lines,
        "rows": rows,
    }


def machine_here(parameters: dict[str, float | str], comm: MPI.Comm, steps: int = 3) -> cost_model.Machine:
    """Return the times of one core of this machine, with all of them at work. Collective."""
    solves = 4 if parameters["viscous"] == "implicit" else 1
    alone = _measure((CALIBRATION,) * 3, steps, parameters, MPI.COMM_SELF)
    phases = {k: comm.allreduce(v, op=MPI.MAX) for k, v in alone["phases_ms"].items()}
    return cost_model.calibrate(CALIBRATION, phases, solves=solves)


def _row(grid: dict[str, object], dim: int, ranks: int, upwind: bool) -> dict[str, object]:
    """One line of the table; the budget is that of an xsPPM7 step of 128^3 cells on one rank."""
    each = grid["threads"]
    due = upwind and (grid["N"], dim, ranks, each) == (128, 3, 1, 1)
    name = f"{grid['N']}^{dim}, {ranks} rank{'s' * (ranks > 1)}: step / DCT pair"
    name = name.replace(":", f" of {each} threads:") if each > 1 else name
    return row(
        name, grid["pairs_per_step"], 8.0 if due else None, "budget of the finished fluid" if due else ""
    )


def _measure(
    cells: tuple[int, ...], steps: int, parameters: dict[str, float | str], comm: MPI.Comm
) -> dict[str, object]:
    n, dim = cells[0], len(cells)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    started = time.perf_counter()
    grid = MacGrid([0.0] * dim, [1.0] * dim, cells, [False] * (dim - 1) + [True], comm)
    lid = Wall(velocity=(0.0,) + (1.0,) * (dim - 1))
    physics = {key: parameters[key] for key in ("rho", "mu", "advection")}
    kind = ExplicitViscosity if parameters["viscous"] == "explicit" else NavierStokes
    fluid = kind(grid, Boundary(grid, {"x_upper": lid}), **physics)
    set_up = time.perf_counter() - started
    phases: dict[str, float] = defaultdict(float)
    dt = min(parameters["cfl"] / n, fluid.dt_limit)
    times, pairs = _march(fluid, dt, steps, phases)
    step, pair = float(np.median(times)), float(np.median(pairs))
    grown = comm.allreduce((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024.0)
    return {
        "N": n,
        "cells": n**dim,
        "ranks": comm.size,
        "threads": threads.count(),
        "step_ms": 1e3 * step,
        "step_ms_range": [1e3 * min(times), 1e3 * max(times)],
        "set_up_ms": 1e3 * set_up,
        "dct_pair_ms": 1e3 * pair,
        "pairs_per_step": step / pair,
        "cell_steps_per_s": n**dim / step,
        # The process grows by its largest grid so far: no number for a grid that is small beside the rest.
        "memory_growth_float64_per_cell": grown / 8.0 / n**dim if n**dim > 10**6 else None,
        "phases_ms": _exclusive({k: 1e3 * v / steps for k, v in phases.items()}),
        **_traffic(n, dim, step, parameters, comm),
    }


def _traffic(
    n: int, dim: int, step: float, parameters: dict[str, float | str], comm: MPI.Comm
) -> dict[str, float]:
    """Bytes that a rank must move in a step of a cube, by the count of the cost model, and a triad's in this run."""
    if dim == 2:
        return {}
    solves = 4 if parameters["viscous"] == "implicit" else 1
    moved = cost_model.work(n, comm.size, solves=solves, advection=parameters["advection"]).bytes
    triad = cost_model.triad_bandwidth(comm)
    return {
        "bytes_per_step": moved,
        "gigabytes_per_s": 1e-9 * moved / step,
        "triad_gigabytes_per_s": 1e-9 * triad,
        "part_of_triad": moved / step / triad,
    }


def _march(
    fluid: NavierStokes, dt: float, steps: int, phases: dict[str, float]
) -> tuple[list[float], list[float]]:
    """Take two steps and then ``steps`` more; return their times on all ranks together, and those of pairs after them.

    Pairs and steps take turns, so that a load on the machine that comes and goes slows both [s].
    """
    grid = fluid.grid
    clocked = _clock(fluid, phases)
    u, p, f = fluid.fill(_swirl(grid), 0.0), grid.zeros(), grid.zero_faces()
    N_old, times, pairs = fluid.advection(u), [], []
    for k in range(steps + 2):
        if k == 2:
            phases.clear()
        grid.comm.barrier()
        started = time.perf_counter()
        N = clocked.advection(u)
        u, p = clocked.step(u, p, (N, N_old, 1.0), f, k * dt, dt)
        N_old = N
        grid.comm.barrier()
        times.append(time.perf_counter() - started)
        pairs.append(grid.comm.bcast(_time_of_pair(grid.cells[: grid.dim]) if grid.comm.rank == 0 else None))
    return times[2:], pairs[2:]


def _swirl(grid: MacGrid) -> Faces:
    """A smooth flow that fills the box: a fluid at rest is no work for an upwind scheme."""
    u = grid.zero_faces()
    for d in range(grid.dim):
        a, b = (grid.points(d)[(d + k) % grid.dim] for k in (1, 2))
        u[d][...] = 0.5 * np.sin(2 * np.pi * a) + 0.5 * np.cos(4 * np.pi * b)
    return u


def _time_of_pair(cells: Sequence[int]) -> float:
    """Time of dctn and idctn of the grid on one thread [s]."""
    x = np.random.default_rng(0).standard_normal(cells)
    started = time.perf_counter()
    scipy.fft.idctn(scipy.fft.dctn(x, workers=1), workers=1)
    return time.perf_counter() - started


def _clock(fluid: NavierStokes, table: dict[str, float]) -> Timed:
    """Put clocks into the parts of a fluid step, and around the step."""
    fluid.velocity_solvers = [
        _clock_solver(s, table, "viscous solves") for s in getattr(fluid, "velocity_solvers", ())
    ]
    fluid.pressure_solver = _clock_solver(fluid.pressure_solver, table, "pressure solve")
    fluid.grid = Timed(fluid.grid, table, {"exchange": "ghosts"})
    kernels = {"momentum": "right-hand side", "advance": "right-hand side"}
    kernels |= {"divergence": "projection", "subtract_gradient": "projection"}
    fluid.operators = Timed(fluid.operators, table, kernels)
    return Timed(fluid, table, {"advection": "advection", "step": "step"})


def _clock_solver(solver: TensorSolver, table: dict[str, float], phase: str) -> Timed:
    moves = dict.fromkeys(("forward", "backward"), f"transposes in {phase}")
    solver.transposes = tuple(t and Timed(t, table, moves) for t in solver.transposes)
    return Timed(solver, table, {"solve": phase})


def _exclusive(phases: dict[str, float]) -> dict[str, float]:
    """Take the parts out of the time of a whole step, and the transposes out of that of solves."""
    rest = phases.pop("step", 0.0) - sum(phases.get(name, 0.0) for name in PARTS)
    moves = 0.0
    for name in ("viscous solves", "pressure solve"):
        inside = phases.pop(f"transposes in {name}", 0.0)
        moves += inside
        if inside:
            phases[name] -= inside
    return {**phases, **({"transposes": moves} if moves else {}), "all else": rest}
