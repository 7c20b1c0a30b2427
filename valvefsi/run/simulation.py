"""The time loop: step size, health checks, history, checkpoints, output."""

from __future__ import annotations

import contextlib
import math
import signal
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.errors import CaseError, StabilityError, Stopped, SurroundingsError, reason_of
from valvefsi.fsi import Model, State
from valvefsi.grid import MacGrid
from valvefsi.io.checkpoint import list_checkpoints
from valvefsi.io.folder import stop_requested
from valvefsi.post import diagnostics
from valvefsi.run.checkpoints import load_state, memory_of, refuse_to_overwrite, save_state
from valvefsi.run.disk import warn_of_disk
from valvefsi.run.recording import Output, Recorder, box_of
from valvefsi.run.schedule import AdaptiveSchedule, Schedule, check_end
from valvefsi.run.stable_step import has_changed, stable_step
from valvefsi.runtime.clock import Timed
from valvefsi.runtime.memory import forget_earlier_runs, keep_freed_memory
from valvefsi.runtime.signals import collected_signals
from valvefsi.types import Array, Progress

LOOKS = 16
"""Times between two measurements of the stable step that a run looks whether it must come sooner."""

LOOK_S = 1.0
"""Wall-clock time between two looks for a request to stop [s]."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a run ends with.

    Attributes:
        state: The last state.
        steps: Steps taken in this run, without those before a restart.
        wall_s: Wall-clock time of these steps [s].
        phases: Wall-clock time on rank 0 by phase [s].
        recoveries: Each return to an earlier state: time it failed at and went back to, next step, reason. These and
            the warnings are of the whole run, those before a restart included.
        warnings: What was warned of during the run, see `valvefsi.run.health`.
    """

    state: State
    steps: int
    wall_s: float
    phases: dict[str, float] = field(default_factory=dict)
    recoveries: tuple[dict[str, object], ...] = ()
    warnings: tuple[dict[str, object], ...] = ()

    def timing(self, grid: MacGrid) -> dict[str, object]:
        """Steps, cells, wall-clock time, cell steps per second and phases, as in ``result.json``."""
        cells = math.prod(grid.cells)
        return {
            "steps": self.steps,
            "cells": cells,
            "wall_s": self.wall_s,
            "cell_steps_per_s": cells * self.steps / self.wall_s,
            "phases": self.phases,
            "recoveries": list(self.recoveries),
            "warnings": list(self.warnings),
        }


class Simulation:
    """A coupled run from a model to files.

    Args:
        model: The model.
        schedule: The steps, fixed or adaptive.
        output: What is written.
        initial: State at t = 0; the fluid at rest by default.
    """

    def __init__(
        self,
        model: Model,
        schedule: Schedule | AdaptiveSchedule,
        output: Output,
        initial: State | None = None,
    ) -> None:
        self.model, self.schedule, self.output = model, schedule, output
        self.initial = initial
        forget_earlier_runs()
        self.memory = memory_of(model, output)
        self.phases: dict[str, float] = defaultdict(float)
        self.earlier = 0
        self.look_at = 0.0

    def run(self, *, resume: bool = False, progress: Progress | None = None) -> Outcome:
        """Run to the end, or until something is wrong.

        Args:
            resume: Whether to go on from the newest whole checkpoint in the output folder.
            progress: Called with step, time, end and the newest row of the history.

        Raises:
            CaseError: There is no checkpoint to resume from, or one of an unfinished run would be overwritten.
            StabilityError: A velocity is not finite, the Courant number is too large, an element is inverted, or
                a node is lost; the last good state has been written.
            Stopped: SIGTERM or SIGINT arrived, or a request as of `valvefsi.io.folder.request_stop`, which is taken for
                SIGINT; a checkpoint has been written.
            SurroundingsError: The disk, the folder or the memory failed; says which checkpoint there is.

        Note:
            Collective.
        """
        keep_freed_memory()
        state = self._first_state(resume)
        warn_of_disk(self.model, self.output, self.schedule.num_steps(state.t))
        first, self.earlier = state.step, len(self.memory.recoveries)
        try:
            memory, before = self.memory, state if resume else None
            meters = (memory.forces, memory.energy)
            recorder = Recorder(self.model, self.output, memory.statistics, meters, memory.frames, before)
            if resume:
                recorder.reopen(state, finished=self.schedule.finished(state))
            else:
                self._record(recorder, None, state)
            started = time.perf_counter()
            with collected_signals() as received:
                state = self._march(state, recorder, received, progress)
            wall = time.perf_counter() - started
            with self._clock("output"):
                save_state(self.model, state, self.output, self.memory, finished=True)
                self.memory.statistics.write(state, self.output.directory, box_of(self.model.grid))
        except (OSError, MemoryError) as error:
            raise SurroundingsError(f"{reason_of(error)}; {self._safe()}") from error
        return Outcome(
            state=state,
            steps=state.step - first,
            wall_s=max(wall, 1e-9),
            phases=dict(self.phases),
            recoveries=tuple(self.memory.recoveries),
            warnings=tuple(self.memory.health.report()),
        )

    def _safe(self) -> str:
        """Say how to go on after a fault, from what this rank sees of the folder."""
        with contextlib.suppress(OSError):
            paths = list_checkpoints(self.output.directory / "checkpoints")
            if paths:
                return f"{paths[-1]} is written, --resume goes on from there"
        return "no checkpoint is written"

    def pictures(
        self, state: State, title: str = "", references: Mapping[str, tuple[str, float]] | None = None
    ) -> dict[str, float]:
        """Draw the histories and, in two dimensions, the solids over the flow.

        Args:
            state: The last state.
            title: Heading of the pictures.
            references: Line and its value in the plot of a column of the history, by column.

        Returns:
            The last row of the history.

        Note:
            Collective.
        """
        from valvefsi.run.pictures import draw

        return draw(self.model, state, self.output, title, references or {})

    def _first_state(self, resume: bool) -> State:
        if not resume:
            refuse_to_overwrite(self.output.directory, self.model.grid.comm, finished=False)
            return self.initial or fsi.initial_state(self.model, self.schedule.dt)
        state = load_state(self.model, self.output, self.memory)
        if state is None:
            folder = self.output.directory / "checkpoints"
            raise CaseError("there is no whole checkpoint to resume from", file=folder)
        check_end(state.t, state.dt, self.schedule.t_end)
        return state

    def _march(
        self, state: State, recorder: Recorder, received: list[int], progress: Progress | None
    ) -> State:
        model, schedule = timed(self.model, self.phases), self.schedule
        rate = self.model.grid.comm.allreduce(
            diagnostics.local_courant_rate(self.model.grid, state.u), op=MPI.MAX
        )
        good, row, cuts, retries, saved = (state, rate), {}, 0, 0, time.perf_counter()
        while not schedule.finished(state):
            try:
                if schedule.measure_every and self._measuring_due(state):
                    state = self._measured(state)
                new = fsi.step(model, state, schedule.next_dt(state, rate) * (0.5**cuts))
                rate, stop, late = self._check(new, received, time.perf_counter() - saved)
                if self._due(state, new):
                    row = self._record(recorder, state, new)
                    good, retries = (new, rate), 0
                elif stop or late:
                    self._check_bodies(recorder.row(new), new)
            except StabilityError as error:
                retries += 1
                state, rate, cuts = self._go_back(error, good, retries)
                state = replace(state, measure_at=state.step)  # now: the last measurement was no guide
                continue
            state, cuts = new, 0
            if progress is not None:
                progress(state.step, state.t, schedule.t_end, row)
            if stop or late or self._checkpoint_due(state):
                saved = time.perf_counter()
                with self._clock("output"):
                    path = save_state(model, state, self.output, self.memory)
                if stop:
                    raise Stopped(
                        f"stopped at step {state.step}, t = {state.t:.6g} s; {path} is written, "
                        "--resume goes on from there",
                        stop,
                    )
        return state

    def _measuring_due(self, state: State) -> bool:
        """Whether the stable step is measured now: after the longest time, or as a body is no longer what it was."""
        left = state.measure_at - state.step
        if left <= 0:
            return True
        every = max(1, self.schedule.measure_every // LOOKS)
        if left % every or left == self.schedule.measure_every:
            return False
        with self._clock("stable step"):
            return has_changed(self.model, state, self.schedule.spare(state))

    def _measured(self, state: State) -> State:
        """Return a state with the largest stable step, for steps about as long as the longest (collective)."""
        with self._clock("stable step"):
            now = stable_step(self.model, state, self.schedule.dt)
        at = state.step + self.schedule.measure_every
        return replace(state, dt_stable=now.limit, measure_at=at, modes=now.modes, energies=now.energies)

    def _due(self, old: State, new: State) -> bool:
        """Whether the elements are checked: whatever is written has passed."""
        return self._row_due(new) or self._frame_due(old, new) or self._checkpoint_due(new)

    def _row_due(self, state: State) -> bool:
        return state.step % self.output.history_every == 0 or self.schedule.finished(state)

    def _frame_due(self, old: State, new: State) -> bool:
        first, last = (math.floor(self.schedule.share(s) * self.output.frames + 1e-9) for s in (old, new))
        return first != last

    def _checkpoint_due(self, state: State) -> bool:
        every = self.output.checkpoint_every
        return bool(every) and state.step % every == 0 and not self.schedule.finished(state)

    def _record(self, recorder: Recorder, old: State | None, state: State) -> dict[str, float]:
        """Write a row of the history, and a frame where one is due; check the elements first."""
        with self._clock("output"):
            row = recorder.row(state)
            self._check_bodies(row, state)
            if self._row_due(state):
                self.memory.health.look(state)
                recorder.append(row, state)
            if old is None or self._frame_due(old, state):
                recorder.frame(state)
        return row

    def _check(self, state: State, received: list[int], unsaved: float) -> tuple[float, int, bool]:
        """Raise where the velocity is out of bounds; look round for signals, a request to stop and the clock.

        Args:
            state: The new state.
            received: Signals that this rank has received; a request is added to rank 0's.
            unsaved: Wall-clock time since the last checkpoint [s].

        Returns:
            Largest ``|u| / h`` [1/s], the signal that any rank has received (or 0), whether a checkpoint is due.
        """
        every = self.output.checkpoint_wall_s
        if self.model.grid.comm.rank == 0 and time.perf_counter() >= self.look_at:
            self.look_at = time.perf_counter() + LOOK_S
            received += [signal.SIGINT] * stop_requested(self.output.directory)
        local = diagnostics.local_courant_rate(self.model.grid, state.u)
        values = np.array([local, received[-1] if received else 0.0, float(0.0 < every < unsaved)])
        with self._clock("checks"):
            self.model.grid.comm.Allreduce(MPI.IN_PLACE, values, op=MPI.MAX)
        rate, stop, late = values
        courant = rate * state.dt
        if not courant <= self.schedule.cfl_max:
            speed, place = diagnostics.fastest_place(self.model.grid, state.u)
            where = f"at {_place(place, self.model.grid.dim)}, t = {state.t:.6g} s (step {state.step})"
            if not math.isfinite(courant):
                raise StabilityError(
                    f"the velocity is not finite {where}; try a smaller time step or a longer ramp"
                )
            raise StabilityError(
                f"the Courant number is {courant:.3g} > {self.schedule.cfl_max:g} {where}, |u| = {speed:.3g} cm/s; "
                "try a smaller time step"
            )
        return rate, int(stop), bool(late)

    def _check_bodies(self, row: dict[str, float], state: State) -> None:
        for body, q in zip(self.model.bodies, state.bodies, strict=True):
            fault = body.fault(q, row)
            if fault is not None:
                raise StabilityError(
                    f"{fault}, t = {state.t:.6g} s (step {state.step}); try a smaller time step, a finer mesh or a "
                    "larger nu_stab"
                )

    def _go_back(
        self, error: StabilityError, good: tuple[State, float], retries: int
    ) -> tuple[State, float, int]:
        """Return the last good state, its rate and how often to halve the next step; or give up."""
        state, rate = good
        recoveries = self.memory.recoveries
        if len(recoveries) - self.earlier >= self.schedule.max_recoveries:
            raise self._explained(error, state) from None
        dt = self.schedule.next_dt(state, rate) * 0.5**retries
        recoveries.append({"t_s": state.t, "step": state.step, "dt_s": dt, "reason": str(error)})
        return state, rate, retries

    def _explained(self, error: StabilityError, good: State) -> StabilityError:
        try:
            path = save_state(self.model, good, self.output, self.memory)
        except OSError as failure:
            return StabilityError(f"{error}. The last good state cannot be written: {reason_of(failure)}")
        return StabilityError(f"{error}. The last good state, t = {good.t:.6g} s, is in {path}")

    @contextlib.contextmanager
    def _clock(self, phase: str) -> Iterator[None]:
        started = time.perf_counter()
        yield
        self.phases[phase] += time.perf_counter() - started


def _place(place: Array, dim: int) -> str:
    return "(" + ", ".join(f"{x:.4g}" for x in place[:dim]) + ") cm"


def timed(model: Model, table: dict[str, float]) -> Model:
    """Return the model with a clock around its parts, so that the step itself needs none.

    Args:
        model: The model.
        table: Wall-clock time by phase, added to [s].
    """
    fluid: Any = Timed(model.fluid, table, {"advection": "advection", "step": "fluid solve"})
    return replace(model, fluid=fluid, bodies=tuple(body.timed(table) for body in model.bodies))
