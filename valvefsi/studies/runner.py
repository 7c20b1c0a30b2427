"""Runs the members of a study, each as a process of its own, as many at once as there are cores.

A member is ``python -m valvefsi run CASE --set ... --out FOLDER/NAME`` with one thread. What is done is not done again,
what was begun goes on from its checkpoint; one that fails does not hold up the others.
"""

from __future__ import annotations

import math
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from mpi4py import MPI

from valvefsi.case.models import Case
from valvefsi.case.resuming import check_start, clear
from valvefsi.errors import CaseError, Stopped
from valvefsi.io.checkpoint import list_checkpoints
from valvefsi.io.folder import held
from valvefsi.io.history import last_row
from valvefsi.runtime.signals import collected_signals
from valvefsi.runtime.surroundings import on_ranks, without_launcher
from valvefsi.studies.members import (
    LOG,
    RECORD,
    SUMMARY,
    Member,
    Outcome,
    Standing,
    inputs_of,
    read_cases,
    standing,
    write_record,
)
from valvefsi.types import Scalar

PROGRAM = (sys.executable, "-m", "valvefsi")
POLL = 0.2
"""Time between two looks at the processes [s]."""
KNOWN = 0.2
"""Part of a member from which its own pace says how long it takes: its start is behind it."""


@dataclass(frozen=True, kw_only=True)
class Tally:
    """How far a study is.

    Attributes:
        total: Number of members.
        kept: How many were done before.
        done: How many have been done here.
        failed: How many have failed.
        running: Part that is done of each running member by name.
        share: Part of all that is done, weighed by steps and cells.
        left_s: Time left, None where it is not known yet [s].
        ended: Members that have ended since the last call.
        stopping: Whether the members have been asked to stop.
    """

    total: int
    kept: int
    done: int
    failed: int
    running: Mapping[str, float]
    share: float
    left_s: float | None
    ended: tuple[Outcome, ...] = ()
    stopping: bool = False


Notify = Callable[[Tally], None]


@dataclass
class _Task:
    """A member with its process."""

    member: Member
    folder: Path
    case: Case
    standing: Standing = "new"
    process: subprocess.Popen[bytes] | None = None
    started: float = 0.0
    first: float = 0.0
    share: float = 0.0
    outcome: Outcome | None = None

    @property
    def part(self) -> float:
        """Part that is done or given up."""
        return self.share if self.outcome is None else 1.0

    @property
    def work(self) -> float:
        """Steps times cells."""
        cells = math.prod(len(edges) - 1 for edges in self.case.grid.edges)
        return max(1.0, self.case.time.t_end / self.case.dt) * cells

    def look(self) -> None:
        """See in its history how far it is."""
        t = last_row(self.folder / "history.csv").get("t_s", 0.0)
        self.share = min(1.0, max(self.first, t / self.case.time.t_end))

    def start(self, command: Sequence[str]) -> None:
        """Start its process; what an earlier one has printed stays."""
        if self.standing == "begun":
            self.look()
            self.first = self.share
        (self.folder / SUMMARY).unlink(missing_ok=True)  # of another end of the run
        write_record(self.folder, self.member, inputs_of(self.case), state="running")
        words = [*PROGRAM, *command, *(word for text in self.member.overrides for word in ("--set", text))]
        words += ["--out", str(self.folder), *(["--resume"] if self.standing == "begun" else [])]
        words = on_ranks(words, self.member.ranks)
        self.started = time.monotonic()
        with (self.folder / LOG).open("ab") as log:
            log.write(f"$ {shlex.join(words)}\n".encode())
            log.flush()
            self.process = subprocess.Popen(
                words,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=_environment(),
                process_group=0,  # Ctrl-C reaches the study, which passes it on
            )

    def end(self, code: int, *, stopping: bool) -> Outcome | None:
        """Return how it ended, None where it was stopped; say so in its record."""
        done = code == 0 and (self.folder / SUMMARY).is_file()
        state: Literal["done", "failed"] = "done" if done else "failed"
        message, wall = "" if done else _last_words(code, self.folder / LOG), time.monotonic() - self.started
        how: dict[str, Scalar] = {"message": message, "wall_s": wall}
        said = "stopped" if stopping and not done else state
        write_record(self.folder, self.member, inputs_of(self.case), state=said, **how)
        if stopping and not done:
            return None
        return Outcome(member=self.member, folder=self.folder, state=state, message=message, wall_s=wall)


def _environment() -> dict[str, str]:
    """Return what a member finds around it: one thread, no launcher, no colours, nothing held back in a buffer."""
    kept = without_launcher()
    for name in ("VALVEFSI_THREADS", "FORCE_COLOR", "TTY_COMPATIBLE"):
        kept.pop(name, None)
    return kept | {"OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1", "MPLBACKEND": "Agg"}


def _last_words(code: int, log: Path) -> str:
    """Return why a process ended: the signal, or the last line that it printed."""
    if code < 0:
        why = ", perhaps for want of memory" if -code == signal.SIGKILL else ""
        return f"ended by {signal.Signals(-code).name}{why}"
    lines = log.read_text(encoding="utf-8", errors="replace").split("\n")
    said = next((line.strip() for line in reversed(lines) if line.strip()), "")
    return said.removeprefix("error: ") or f"ended with code {code}"


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0))


def run_members(
    case: Path,
    members: Sequence[Member],
    folder: Path,
    *,
    jobs: int | None = None,
    resume: bool = False,
    overwrite: bool = False,
    trust: bool = False,
    progress: Notify | None = None,
) -> list[Outcome]:
    """Run members of a study, those that are not done yet.

    Args:
        case: The case file.
        members: The members.
        folder: Folder of the study; each member has one of its name in it.
        jobs: How many run at once, the number of cores by default.
        resume: Whether to go on with what the folder holds.
        overwrite: Whether to run anew what it holds.
        trust: Whether Python files of materials may be run.
        progress: Called again and again with how far it all is.

    Returns:
        How each member ended, in their order.

    Raises:
        CaseError: A member's case is wrong, or the folder holds something else; no member has been started.
        Stopped: SIGINT or SIGTERM arrived; each running member has written a checkpoint.
    """
    if MPI.COMM_WORLD.size > 1:
        raise CaseError("a study starts a process for each member: call it without mpirun", file="mpirun")
    if jobs is not None and jobs < 1:
        raise CaseError("expected 1 or more", key="--jobs", value=jobs)
    if resume and overwrite:
        raise CaseError("go on with the study or replace it, not both", key="--overwrite", value="--resume")
    folder, cases = Path(folder), read_cases(case, members, trust=trust)
    with held(folder, MPI.COMM_SELF):
        tasks = [_Task(member, folder / member.name, cases[member.name]) for member in members]
        if overwrite:
            for task in tasks:
                _clear(task.folder)
        for task in tasks:
            task.standing = standing(task.folder, task.member, task.case)
            if task.standing == "new":
                check_start(task.case)
        if not resume:
            _refuse_to_go_on(folder, tasks)
        command = ["run", str(case), *(["--trust"] if trust else [])]
        return _Runner(command, tasks, jobs or cores(), progress).run()


def run_member(case: Path, member: Member, folder: Path, *, trust: bool = False) -> Outcome:
    """Run one member of a study by itself, as a task of an array of jobs does; others may run beside it.

    Args:
        case: The case file.
        member: The member.
        folder: Folder of the study.
        trust: Whether Python files of materials may be run.

    Returns:
        How it ended; kept where it was done before, gone on with where it was begun.

    Raises:
        CaseError: Its case is wrong, or its folder holds something else.
        Stopped: SIGINT or SIGTERM arrived; it has written a checkpoint.
    """
    task = _Task(member, Path(folder) / member.name, read_cases(case, [member], trust=trust)[member.name])
    task.standing = standing(task.folder, member, task.case)
    command = ["run", str(case), *(["--trust"] if trust else [])]
    return _Runner(command, [task], 1, None).run()[0]


def waiting_members(
    case: Path,
    members: Sequence[Member],
    folder: Path,
    *,
    resume: bool = False,
    overwrite: bool = False,
    trust: bool = False,
) -> list[Member]:
    """Return the members that `run_members` would run, without touching anything.

    Raises:
        CaseError: As `run_members` would.
    """
    folder, cases = Path(folder), read_cases(case, members, trust=trust)
    if overwrite:
        return list(members)
    tasks = [_Task(member, folder / member.name, cases[member.name]) for member in members]
    for task in tasks:
        task.standing = standing(task.folder, task.member, task.case)
    if not resume:
        _refuse_to_go_on(folder, tasks)
    return [task.member for task in tasks if task.standing != "done"]


def _clear(folder: Path) -> None:
    """Remove what an earlier run would be taken for, unless it is still running."""
    if folder.exists():
        with held(folder, MPI.COMM_SELF):
            clear(folder, MPI.COMM_SELF)
            (folder / RECORD).unlink(missing_ok=True)


def _refuse_to_go_on(folder: Path, tasks: Sequence[_Task]) -> None:
    done = sum(task.standing == "done" for task in tasks)
    begun = sum(task.standing == "begun" for task in tasks)
    if done or begun:
        raise CaseError(
            f"this folder holds a study, {done} of {len(tasks)} members are done and {begun} begun; --resume goes on "
            "with it, --overwrite replaces it, another --out keeps it",
            file=folder,
        )


@dataclass
class _Runner:
    """The members that wait, run, and have ended."""

    command: Sequence[str]
    tasks: Sequence[_Task]
    jobs: int
    progress: Notify | None
    began: float = field(default_factory=time.monotonic)
    stopping: bool = False

    def run(self) -> list[Outcome]:
        """Run what is not done; see `run_members`."""
        for task in self.tasks:
            if task.standing == "done":
                task.share = task.first = 1.0
                task.outcome = Outcome(member=task.member, folder=task.folder, state="kept")
        self._say(())
        with collected_signals() as received:
            try:
                while any(task.outcome is None for task in self.tasks):
                    self._round(received)
            finally:
                self._end_all()
        return [task.outcome for task in self.tasks if task.outcome is not None]

    @property
    def _running(self) -> dict[str, tuple[_Task, subprocess.Popen[bytes]]]:
        return {
            task.member.name: (task, task.process)
            for task in self.tasks
            if task.process is not None and task.process.returncode is None
        }

    def _round(self, received: Sequence[int]) -> None:
        """Look after the processes once: those that have ended, signals, those that can start."""
        if received and not self.stopping:
            self.stopping = True
            self._signal(signal.SIGTERM)
        elif len(received) > 1:
            self._signal(signal.SIGKILL)
        ended = []
        for task, process in self._running.values():
            code = process.poll()
            if code is None:
                task.look()
                continue
            task.outcome = task.end(code, stopping=self.stopping)
            if task.outcome is not None:
                task.share = 1.0 if task.outcome.state == "done" else task.share
                ended.append(task.outcome)
        waiting = [task for task in self.tasks if task.process is None and task.outcome is None]
        for task in waiting[: 0 if self.stopping else self.jobs - len(self._running)]:
            task.start(self.command)
        self._say(tuple(ended))
        if self.stopping and not self._running and any(task.outcome is None for task in self.tasks):
            raise Stopped(self._stopped(), received[0])
        time.sleep(POLL)

    def _signal(self, number: int) -> None:
        for _, process in self._running.values():
            process.send_signal(number)

    def _end_all(self) -> None:
        """Ask what still runs to stop, and wait for it: only where something here has failed."""
        self._signal(signal.SIGTERM)
        for _, process in self._running.values():
            process.wait()

    def _stopped(self) -> str:
        done = sum(task.outcome is not None and task.outcome.state != "failed" for task in self.tasks)
        begun = sum(
            task.outcome is None and bool(list_checkpoints(task.folder / "checkpoints"))
            for task in self.tasks
        )
        return (
            f"stopped; {done} of {len(self.tasks)} members are done, {begun} more have a checkpoint, --resume goes on "
            "from there"
        )

    def _say(self, ended: tuple[Outcome, ...]) -> None:
        if self.progress is None:
            return
        states = [task.outcome.state for task in self.tasks if task.outcome is not None]
        total = sum(task.work for task in self.tasks)
        self.progress(
            Tally(
                total=len(self.tasks),
                kept=states.count("kept"),
                done=states.count("done"),
                failed=states.count("failed"),
                running={name: task.share for name, (task, _) in self._running.items()},
                share=sum(task.work * task.part for task in self.tasks) / total if total else 1.0,
                left_s=self._left(),
                ended=ended,
                stopping=self.stopping,
            )
        )

    def _left(self) -> float | None:
        """Return the time left at the pace so far, no less than the slowest member that runs needs [s]."""
        now = time.monotonic()
        computed = sum(task.work * (task.share - task.first) for task in self.tasks)
        if computed <= 0.0:
            return None
        left = (now - self.began) * sum(task.work * (1.0 - task.part) for task in self.tasks) / computed
        alone = (
            (now - task.started) * (1.0 - task.share) / (task.share - task.first)
            for task, _ in self._running.values()
            if task.share > task.first + KNOWN
        )
        return max(left, *alone, 0.0)
