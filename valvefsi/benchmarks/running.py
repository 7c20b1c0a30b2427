"""What benchmarks that are simulations share: the fluid that fits a step, an attempt to run, what is read off a run."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import scipy.fft
from mpi4py import MPI

from valvefsi.benchmarks.frame import Job
from valvefsi.errors import CaseError, StabilityError
from valvefsi.fsi import Model, State
from valvefsi.grid import MacGrid
from valvefsi.io.checkpoint import newest_meta
from valvefsi.io.history import read_history
from valvefsi.run.recording import Output
from valvefsi.run.schedule import Schedule
from valvefsi.run.simulation import Outcome, Simulation
from valvefsi.runtime.clock import seconds
from valvefsi.solid.structure import Structure
from valvefsi.types import Array, Indices, Mask

AVERAGED = 0.2
"""Part of a run at its end that is averaged over."""

History = Mapping[str, Array]
"""Columns of a history over time, ``(n,)`` each."""


@dataclass(frozen=True)
class Columns:
    """Adds columns to a history: their names, and what gives their values from a state (collective)."""

    columns: tuple[str, ...]
    values: Callable[[State], Sequence[float]]

    def row(self, state: State) -> dict[str, float]:
        """Return a value for each column (collective)."""
        return dict(zip(self.columns, map(float, self.values(state)), strict=True))


def fixed_steps(
    model: Model,
    folder: Path,
    dt: float,
    steps: int,
    *,
    rows: int,
    cfl_max: float = math.inf,
    initial: State | None = None,
    **output: Any,
) -> Simulation:
    """Return a simulation of steps of one length.

    Args:
        model: The model.
        folder: Folder of the run.
        dt: Length of a step [s].
        steps: Number of steps.
        rows: Rows of the history that are wanted, at most twice as many are written.
        cfl_max: Largest Courant number that is accepted.
        initial: State at t = 0; the fluid at rest by default.
        output: What else is written, see `Output`; by default a checkpoint every ten minutes.
    """
    settings = {"history_every": max(1, steps // rows), "checkpoint_wall_s": 600.0} | output
    schedule = Schedule(dt=dt, t_end=steps * dt, cfl_max=cfl_max)
    return Simulation(model, schedule, Output(directory=folder, **settings), initial)


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """A run that came to its end, or as far as it could.

    Attributes:
        history: Its history, the same on all ranks.
        steps: Steps taken in this call.
        failed: Why it broke down, None where it did not.
        outcome: What it ended with, None where it broke down.
    """

    history: History
    steps: int
    failed: str | None
    outcome: Outcome | None


def attempt(simulation: Simulation, job: Job, *, clear: bool = False) -> Attempt:
    """Run a simulation; a run that breaks down keeps its record and says why (collective).

    With ``job.resume`` it goes on from the newest checkpoint in the folder, if there is one.

    Args:
        simulation: The simulation.
        job: Where it runs.
        clear: Whether what an interrupted run has left there is removed; else that is refused.

    Raises:
        CaseError: The checkpoints belong to a run of other numbers, or one that is not finished would be lost.
    """
    folder, output = job.folder, simulation.output
    meta = newest_meta(folder / "checkpoints", job.comm) if job.resume else None
    if meta is not None and meta["provenance"] != dict(output.provenance):
        raise CaseError("the checkpoints there belong to another run", file=folder, key="--resume")
    if clear and meta is None and job.comm.rank == 0:
        for path in [*folder.glob("checkpoints/*"), *folder.glob("history.csv")]:
            path.unlink()
    job.comm.barrier()
    outcome, failed = None, None
    try:
        outcome = simulation.run(resume=meta is not None, progress=job.progress)
    except StabilityError as error:
        failed = str(error)
    history = history_of(folder, job.comm)
    steps = outcome.steps if outcome is not None else int(history["step"][-1])
    return Attempt(history=history, steps=steps, failed=failed, outcome=outcome)


def history_of(folder: Path, comm: MPI.Comm) -> History:
    """Return the columns of the history in a folder, on all ranks (collective)."""
    columns = read_history(folder / "history.csv") if comm.rank == 0 else None
    return {name: np.array(column) for name, column in comm.bcast(columns).items()}


def completed(simulation: Simulation, job: Job) -> History:
    """Run a simulation to its end and return its history (collective).

    Raises:
        StabilityError: It broke down.
    """
    end = attempt(simulation, job)
    if end.failed is not None:
        raise StabilityError(end.failed)
    return end.history


def late_size(history: History, column: str) -> float:
    """Return the mean magnitude of a column over the last part of a run."""
    return late_mean({"t_s": history["t_s"], column: np.abs(history[column])}, column)


def late_mean(history: History, column: str) -> float:
    """Return the mean of a column over the last part of a run."""
    return float(history[column][late(history)].mean())


def late(history: History) -> Mask:
    """Return which rows of a history lie in the last part of the run, ``(n,)``."""
    t = history["t_s"]
    return t >= (1.0 - AVERAGED) * t[-1]


def gathered(solid: Structure, comm: MPI.Comm, chi: Array) -> Array:
    """Return the positions of all nodes of a solid by number, on all ranks, ``(num_nodes, 3)`` [cm] (collective)."""
    whole = np.zeros((solid.num_nodes, 3))
    whole[solid.ids] = chi
    comm.Allreduce(MPI.IN_PLACE, whole)
    return whole


def whole_of(grid: MacGrid, own: Array, shape: Sequence[int]) -> Array:
    """Return values on all ranks from this rank's, which begin where its cells do, ``shape`` (collective)."""
    whole = np.zeros(shape)
    whole[tuple(slice(s, s + n) for s, n in zip(grid.start, own.shape, strict=False))] = own
    values: Array = grid.comm.allreduce(whole)
    return values


def time_of_pair(cells: Sequence[int]) -> float:
    """Return the time of a cosine transform of a grid and back, on one thread [s].

    In memory that the process keeps, as steps have it: with fresh pages a pair takes up to twice as long.
    """
    field = np.random.default_rng(0).standard_normal(cells)
    return seconds(lambda: scipy.fft.idctn(scipy.fft.dctn(field, workers=1), workers=1))


def in_turns(
    step: Callable[[], None], grid: MacGrid, steps: int, after: Callable[[], None] = lambda: None
) -> tuple[list[float], list[float]]:
    """Return the times of steps, after two that are not timed, and of a pair of transforms after each [s] (collective).

    They take turns, so that a load on the machine that comes and goes slows both; ``after`` each step is not timed.
    """
    times, pairs = [], []
    for _ in range(steps + 2):
        grid.comm.barrier()
        started = time.perf_counter()
        step()
        grid.comm.barrier()
        times.append(time.perf_counter() - started)
        after()
        pairs.append(grid.comm.bcast(time_of_pair(grid.cells[: grid.dim]) if grid.comm.rank == 0 else None))
    return times[2:], pairs[2:]


def pace(times: Sequence[float], pairs: Sequence[float]) -> dict[str, Any]:
    """Return medians and range of times of steps and pairs, as results hold them."""
    step, pair = float(np.median(times)), float(np.median(pairs))
    return {
        "step_ms": 1e3 * step,
        "step_ms_range": [1e3 * min(times), 1e3 * max(times)],
        "dct_pair_ms": 1e3 * pair,
        "pairs_per_step": step / pair,
    }


def outline_of(along: Array, across: Array, half: float, end: float) -> Indices:
    """Return numbers of the points on the outline of a strip: up one side, over its end, down the other, ``(m,)``.

    Args:
        along: Positions along the strip, ``(n,)`` [cm].
        across: Distances from its middle line, ``(n,)`` [cm].
        half: Half of its thickness [cm].
        end: Where it ends [cm].
    """
    first, second = (np.abs(across - sign * half) < 1e-6 for sign in (-1.0, 1.0))
    tip: Mask = (along > end - 1e-6) & ~first & ~second
    parts = ((first, along), (tip, across), (second, -along))
    return np.concatenate([np.flatnonzero(on)[np.argsort(order[on])] for on, order in parts])


def off_one(history: History, body: str) -> float:
    """Return the largest |J - 1| of a solid over a run."""
    return float(np.maximum(1.0 - history[f"{body}_J_min"], history[f"{body}_J_max"] - 1.0).max())


@dataclass(frozen=True)
class Snapshot:
    """A field in the cells ``(nx, ny)`` between edges [cm] at a time [s], and outlines of bodies ``(n, 2)`` [cm]."""

    t: float
    edges: list[Array]
    field: Array
    outlines: list[Array]


@dataclass
class Sights:
    """Steps at or after which the flow is kept for a picture, and what was kept."""

    due: list[int]
    snapshots: list[Snapshot] = field(default_factory=list)

    def take(self, state: State, grid: MacGrid, look: Callable[[], tuple[Array, list[Array]]]) -> None:
        """Keep a field in this rank's cells and outlines, ``look()``, where a picture is due (collective)."""
        if self.due and state.step >= self.due[0]:
            self.due = [later for later in self.due if later > state.step]
            own, outlines = look()
            edges = [
                grid.lower[d] + np.concatenate([[0.0], np.cumsum(grid.cell_widths[d])]) for d in range(2)
            ]
            self.snapshots.append(Snapshot(state.t, edges, whole_of(grid, own, grid.cells[:2]), outlines))
