"""A step of a case by its parts, in milliseconds and in pairs of cosine transforms of its grid, timed in turns."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.benchmarks.frame import Record, Report
from valvefsi.benchmarks.results import Row, row
from valvefsi.benchmarks.running import in_turns, pace
from valvefsi.errors import CaseError
from valvefsi.fsi import Model, State
from valvefsi.post import diagnostics
from valvefsi.run.checkpoints import load_state
from valvefsi.run.simulation import Simulation
from valvefsi.run.stable_step import stable_step
from valvefsi.runtime import threads
from valvefsi.runtime.clock import Timed, timed_call


class TimedBody(Timed):
    """Stands for a body and adds the time of all its parts of a step to a table under its name [s]."""

    def __init__(self, body: Any, table: dict[str, float]) -> None:
        super().__init__(body, table, {})
        half, parts = timed_call(body.half, table, body.name), ("spread", "velocity", "whole")
        self.half = lambda *args: Timed(half(*args), table, dict.fromkeys(parts, body.name))


def report(case: Path, overrides: Sequence[str], folder: Path | None, steps: int, comm: MPI.Comm) -> Report:
    """Time steps of a case (collective).

    Args:
        case: Its file.
        overrides: What is set in it, ``key=value``.
        folder: Folder of a run of it, whose newest checkpoint is the first state; None to begin at rest.
        steps: Steps that are timed, after two that are not.
        comm: Communicator.

    Raises:
        CaseError: The case cannot be read or built, or there is no checkpoint.
    """
    from valvefsi.case import load_case
    from valvefsi.case.build import build

    simulation = build(load_case(case, list(overrides)), folder or Path(), comm)
    record = measure(simulation, _first_state(simulation, folder), steps)
    return Report(
        parameters={"case": str(case), "state": folder and str(folder), "steps": steps},
        quantities={"pairs_per_step": record["pairs_per_step"]},
        more={"case": record},
        table=_table(record),
    )


def _first_state(simulation: Simulation, folder: Path | None) -> State:
    model, schedule = simulation.model, simulation.schedule
    if folder is None:
        return simulation.initial or fsi.initial_state(model, schedule.dt)
    state = load_state(model, simulation.output, simulation.memory)
    if state is None:
        raise CaseError("there is no whole checkpoint", file=folder, key="--state")
    return state


def measure(simulation: Simulation, state: State, steps: int) -> Record:
    """Time steps from a state: medians of the whole and of its parts (collective)."""
    model, comm = simulation.model, simulation.model.grid.comm
    first = stable_step(model, state, simulation.schedule.dt)
    tracked = replace(state, modes=first.modes)
    started = time.perf_counter()
    limit = stable_step(model, tracked, simulation.schedule.dt).limit
    stable = time.perf_counter() - started
    rate = comm.allreduce(diagnostics.local_courant_rate(model.grid, state.u), op=MPI.MAX)
    dt = simulation.schedule.next_dt(replace(state, dt_stable=limit), rate)
    times, parts, pairs = _march(model, state, dt, steps)
    medians = {name: 1e3 * float(np.median([part[name] for part in parts])) for name in parts[0]}
    return {
        "cells": model.grid.cells,
        "ranks": comm.size,
        "threads": threads.count(),
        "dt": dt,
        **pace(times, pairs),
        "parts_ms": medians,
        "stable_step_ms": 1e3 * stable,
    }


def _march(
    model: Model, state: State, dt: float, steps: int
) -> tuple[list[float], list[dict[str, float]], list[float]]:
    """Take two steps and then ``steps`` more, each before a pair; return their times, their parts and pairs [s]."""
    table: dict[str, float] = defaultdict(float)
    fluid: Any = Timed(model.fluid, table, {"advection": "advection", "step": "fluid solve"})
    bodies: Any = tuple(TimedBody(body, table) for body in model.bodies)
    clocked, parts = replace(model, fluid=fluid, bodies=bodies), []

    def step() -> None:
        nonlocal state
        table.clear()
        state = fsi.step(clocked, state, dt)
        parts.append(dict(table))

    times, pairs = in_turns(step, model.grid, steps)
    whole = [part | {"all else": t - sum(part.values())} for part, t in zip(parts[2:], times, strict=True)]
    return times, whole, pairs


def _table(record: Record) -> list[Row]:
    """Lines for the step and each of its parts, in milliseconds and in pairs."""
    cells = " x ".join(map(str, record["cells"]))
    parts, step, pair = record["parts_ms"], record["step_ms"], record["dct_pair_ms"]
    rows = [
        row(name, value, None, f"{value / pair:.2f} pairs, {100 * value / step:.0f} %", unit="ms")
        for name, value in {f"step, {cells} cells": step, **parts}.items()
    ]
    stable = record["stable_step_ms"]
    note = f"{stable / step:.2f} steps, from the mode found before"
    rest = row("measuring the stable step", stable, None, note, unit="ms")
    return [*rows, row("pair of transforms", pair, unit="ms"), rest]
