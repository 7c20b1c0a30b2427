"""Runs that are killed, go on, are killed again, and are compared with the uninterrupted run at their end.

Each kill comes at a random moment of the computing time of a random rank, and each process goes on with what the one
before it left. All kills of a chain count by the answer at its end: one that spoils anything spoils the chain.
"""

from __future__ import annotations

import contextlib
import os
import random
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.campaign.comparison import torn
from tests.campaign.outcomes import is_bad
from tests.campaign.processes import ENDING, PATIENCE, Job, Popen, answer, empty, nothing_to_resume
from tests.campaign.warm import Warm

LINKS = 10
"""Kills in a chain, at most."""
PART = 0.35
"""Part of the whole run's computing time within which a process is killed, from its start or its next file."""
SHORT = 0.03
"""Longest time between two looks at a process [s]; what waits for the disk is met too."""


@dataclass(frozen=True)
class Chain:
    """A run that is killed again and again.

    Attributes:
        job: The run; its processes are forks of `warm`.
        warm: The server of forks.
        out: Folder of the run.
        rng: Where the moments come from.
        length: Computing time of one rank in the uninterrupted run [s].
    """

    job: Job
    warm: Warm
    out: Path
    rng: random.Random
    length: float

    def outcomes(self, whole: Path, most: int) -> list[str]:
        """Return what came of each of up to ``most`` kills, by the answer at the end of the chain."""
        kills, end = self.kill(most)
        said = end or answer(whole, self.out)
        return [f"{kill}, {said}" for kill in kills or ["without a kill"] * is_bad(f"kill -9: {said}")]

    def kill(self, most: int) -> tuple[list[str], str]:
        """Kill it up to ``most`` times, let it come to its end, return what each kill met and how it ended."""
        empty(self.out)
        more: tuple[str, ...] = ()
        kills: list[str] = []
        while True:
            process = self.job.start(self.out, *more)
            rank = self._strike(process) if len(kills) < most else None
            try:
                _, said = process.communicate(timeout=PATIENCE if rank is None else ENDING)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.communicate()
                return [*kills, "kill -9: the ranks hung"], "failed: hung"
            if not self.warm.settle():
                return [*kills, "kill -9: the other ranks hung"], "failed: hung"
            broken = next(torn(self.out), None)
            if broken is not None:
                return [*kills, f"kill -9: torn file {broken}"], f"torn file {broken}"
            if rank is not None:
                kills.append(f"kill -9{f' rank {rank}' if self.job.ranks > 1 else ''}: {self._met()}")
                more = self.job.again
            elif nothing_to_resume(process.returncode, said) and more and not self._checkpoints():
                more = ("--overwrite",)
            elif process.returncode != 0:
                last = said.strip().splitlines()[-1] if said.strip() else process.returncode
                return kills, f"failed: {last}"
            else:
                return kills, ""

    def _strike(self, process: Popen) -> int | None:
        """Kill a random rank at a random moment; return it, None where the run came to its end before.

        Half of the moments are counted from the start, half from the first checkpoint or file that it writes.
        """
        rank = self.rng.randrange(self.job.ranks)
        moment = self.rng.uniform(0.0, (1.0 if self.job.writes_late else PART) * self.length)
        later = self.rng.uniform(0.0, (0.1 if self.job.writes_late else PART) * self.length)
        late = self.rng.random() < 0.5
        old = self._files()
        deadline = time.monotonic() + PATIENCE
        while process.poll() is None and time.monotonic() < deadline:
            spent = self.warm.spent(rank)
            if late and spent is not None and self._files() != old:
                moment, late = spent + later, False
            if spent is not None and spent >= moment and not late:
                return rank if self.warm.kill(rank) else None
            time.sleep(self.rng.uniform(0.0, SHORT))
        return None

    def _files(self) -> set[tuple[str, int]]:
        """Return what the run has written: its checkpoints, or where it has none, all files of its folder."""
        names = "checkpoints/step_*.vfc" if "--resume" in self.job.again else "*"
        found = set()
        for path in self.out.glob(names):
            with contextlib.suppress(FileNotFoundError):  # renamed or removed meanwhile
                found.add((path.name, path.stat().st_mtime_ns))
        return found

    def _met(self) -> str:
        if "--resume" not in self.job.again:
            return "done again"
        return "resumed" if self._checkpoints() else "begun anew"

    def _checkpoints(self) -> bool:
        return any(self.out.glob("checkpoints/step_*.vfc"))


def kill_in_chains(
    job: Job, warm: Warm, folder: Path, count: int, seed: int, first: int = 0
) -> Iterator[list[str]]:
    """Kill a job ``count`` times; yield what came of each chain of kills.

    Args:
        job: The job; its uninterrupted run is one of ``python -m valvefsi``.
        warm: The server of the forks that are killed.
        folder: Where it may write.
        count: Number of kills that are wanted.
        seed: Of the moments.
        first: Number of the first chain; each follows from its number alone.
    """
    whole, out = folder / "whole", folder / "killed"
    empty(whole)
    code, said = job.run(whole)
    if code != 0:
        yield [f"the run itself fails: {said[-300:]}"]
        return
    job = job.forked_by(warm)
    length = _length(job, warm, out)
    if "same" not in answer(whole, out):
        yield [f"the forked run gives {answer(whole, out)}"]
        return
    done, number = 0, first
    while done < count:
        rng = random.Random(f"{seed} {job.name} {number}")
        outcomes = Chain(job, warm, out, rng, length).outcomes(whole, min(LINKS, count - done))
        if any(map(is_bad, outcomes)):
            shutil.copytree(out, folder / f"bad_{number}", dirs_exist_ok=True)
        yield outcomes
        done, number = done + len(outcomes), number + 1


def _length(job: Job, warm: Warm, out: Path) -> float:
    """Return the computing time of rank 0 in a run that is let alone [s]."""
    empty(out)
    process, length = job.start(out), 0.0
    while process.poll() is None:
        length = warm.spent(0) or length
        time.sleep(SHORT)
    process.communicate()
    return length
