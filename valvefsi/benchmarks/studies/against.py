"""A step of two commits: processes of their own that take turns, and the ratio of each turn.

A load on the machine that comes and goes slows both of a turn. The other commit is checked out in a temporary folder
for as long as this takes; both run in the same interpreter with the same libraries.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import valvefsi
from valvefsi.benchmarks.frame import Announce, Report
from valvefsi.benchmarks.results import Row, row
from valvefsi.errors import CaseError
from valvefsi.runtime.surroundings import without_launcher

FLAG = "--against"
SURE = 5
"""Turns from which on all ratios on one side of 1 are hardly chance: one in sixteen where nothing has changed."""
USAGE = 2
"""Exit code of a command that does not know an option."""
FRAME = "│╭╮╰╯─ "
"""What stands around the messages of a command."""


@dataclass(frozen=True, kw_only=True)
class Against:
    """Another commit that the step is timed against.

    Attributes:
        rev: Its name in git.
        turns: Processes of each of the two.
        root: Folder of the repository, with the package of this commit.
    """

    rev: str
    turns: int
    root: Path = Path(valvefsi.__file__).resolve().parents[1]

    def commit(self) -> str:
        """Return the hash of the other commit.

        Raises:
            CaseError: The package does not lie in a repository, or that has no such commit.
        """
        if self._git("rev-parse", "--show-toplevel") != str(self.root):
            raise CaseError("valvefsi is not run from a git repository here", file=self.root, key=FLAG)
        if (commit := self._git("rev-parse", "--verify", "--quiet", f"{self.rev}^{{commit}}")) is None:
            raise CaseError("the repository has no such commit", file=self.root, key=FLAG, value=self.rev)
        return commit

    def compare(self, subjects: Mapping[str, Sequence[str]], announce: Announce | None = None) -> Report:
        """Time the step of both commits in turns.

        Args:
            subjects: Options of ``bench speed`` by the name of what they time.
            announce: Makes what shows each turn.

        Raises:
            CaseError: There is no such commit, it is too old, or the steps fail.
        """
        begin, commit = time.perf_counter(), self.commit()
        tell = announce or (lambda *_: None)
        times = {name: list[tuple[float, float]]() for name in subjects}
        rounds = [(turn, name) for turn in range(self.turns) for name in subjects]
        with self._checked_out(commit) as tree:
            for k, (turn, name) in enumerate(rounds):
                tell(f"{name}, turn {turn + 1}", k, len(rounds), None)
                times[name].append(self._turn(tree, subjects[name], turn))
        tell("", len(rounds), len(rounds), 0.0)
        here = self._git("describe", "--always", "--dirty", "--abbrev=9")
        numbers = {name: _numbers(np.array(pairs)) for name, pairs in times.items()}
        return Report(
            parameters={"against": self.rev, "commit": commit, "here": here, "turns": self.turns},
            quantities=numbers,
            reference={"ratio": 1.0},
            more={"turns_ms": times},
            table=[line for name, number in numbers.items() for line in self._lines(name, number)],
            timing={"wall_s": time.perf_counter() - begin},
        )

    def _turn(self, tree: Path, words: Sequence[str], turn: int) -> tuple[float, float]:
        """Return the time of a step of this commit and of the other [ms]; who begins changes from turn to turn."""
        trees = (self.root, tree)
        first, second = (self._step_ms(where, words) for where in trees[:: 1 if turn % 2 else -1])
        return (first, second) if turn % 2 else (second, first)

    def _step_ms(self, tree: Path, words: Sequence[str]) -> float:
        with tempfile.TemporaryDirectory(prefix="valvefsi-speed-") as out:
            command = [sys.executable, "-m", "valvefsi", "bench", "speed", *words, "--out", out]
            around = without_launcher() | {"PYTHONPATH": str(tree), "NO_COLOR": "1"}
            end = subprocess.run(command, cwd=tree, env=around, stdin=subprocess.DEVNULL, **_CAUGHT)
            try:
                result = json.loads((Path(out) / "result.json").read_text(encoding="utf-8"))
                return float((result["case"] if "case" in result else result["grids"][0])["step_ms"])
            except (OSError, ValueError, LookupError):
                reason = _last_words(f"{end.stdout}\n{end.stderr}")
        if tree == self.root:
            raise CaseError(f"the steps of this commit fail: {reason}", key=FLAG, value=self.rev)
        old = "No module named" in reason or (end.returncode == USAGE and not reason.startswith("error:"))
        what = "the commit is too old to time these steps" if old else "the steps of that commit fail"
        raise CaseError(f"{what}: {reason}", key=FLAG, value=self.rev)

    @contextmanager
    def _checked_out(self, commit: str) -> Iterator[Path]:
        with tempfile.TemporaryDirectory(prefix="valvefsi-against-") as folder:
            tree = Path(folder).resolve() / "tree"
            if self._git("worktree", "add", "--detach", str(tree), commit) is None:
                raise CaseError("the commit cannot be checked out", file=tree, key=FLAG, value=self.rev)
            try:
                yield tree
            finally:
                self._git("worktree", "remove", "--force", str(tree))

    def _git(self, *words: str) -> str | None:
        """Return what git prints, None where it fails."""
        try:
            end = subprocess.run(["git", "-C", str(self.root), *words], **_CAUGHT)
        except FileNotFoundError:
            raise CaseError("git is not installed", key=FLAG, value=self.rev) from None
        return str(end.stdout).strip() if end.returncode == 0 else None

    def _lines(self, name: str, number: Mapping[str, Any]) -> list[Row]:
        low, high = number["ratio_range"]
        side = "slower in every turn: " if low > 1.0 else "faster in every turn: " if high < 1.0 else ""
        source = f"{side if self.turns >= SURE else ''}{low:.3f} ... {high:.3f} in {self.turns} turns"
        return [
            row(f"{name}: step here / at {self.rev}", number["ratio"], 1.0, source),
            row("  step here", number["here_ms"], unit="ms"),
            row(f"  step at {self.rev}", number["there_ms"], unit="ms"),
        ]


_CAUGHT: dict[str, Any] = {"capture_output": True, "text": True, "check": False}


def _numbers(pairs: np.ndarray) -> dict[str, Any]:
    """Return the median and the range of the ratios of the turns, and the medians of both times [ms]."""
    ratios, (here, there) = pairs[:, 0] / pairs[:, 1], np.median(pairs, axis=0)
    spread = [float(ratios.min()), float(ratios.max())]
    return {"ratio": float(np.median(ratios)), "ratio_range": spread, "here_ms": here, "there_ms": there}


def _last_words(text: str) -> str:
    """Return the last line of what a command has printed, without a frame around it."""
    lines = [line.strip(FRAME) for line in text.splitlines()]
    return next((line.removeprefix("Error: ") for line in reversed(lines) if line), "it says nothing")
