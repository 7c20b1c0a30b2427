"""Stages of a study: each makes files from others, is skipped while its inputs stay as they are, and can run alone.

A stage has a folder of its own, where ``stage.json`` says what it was made from, what came of it and when. It is up to
date where that says the inputs of today and all its files are there; a stage that was interrupted has none.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

import valvefsi
from valvefsi.errors import CaseError
from valvefsi.fitting.report import write_json
from valvefsi.io.folder import held, sha256
from valvefsi.types import Unchecked

RECORD = "stage.json"


@dataclass(frozen=True, kw_only=True)
class Stage:
    """One stage.

    Attributes:
        name: Its name, and that of its folder.
        inputs: What it depends on beside the files of other stages, by name: numbers, texts, lists and tables of them,
            and paths of files, which count by what they hold.
        make: Does the work in a folder, which is there, and returns what came of it for ``stage.json``. Where it can go
            on with what an interrupted call has left there, it does.
        outputs: Names of the files that it leaves in its folder.
        after: Names of the stages whose files it reads.
    """

    name: str
    inputs: Mapping[str, object]
    make: Callable[[Path], Mapping[str, Any]]
    outputs: tuple[str, ...]
    after: tuple[str, ...] = ()


class Stages:
    """The stages of a study in the order of their making, each after those that it reads.

    Args:
        folder: Folder of the study.
        stages: The stages.
        say: Called with a line on each.

    Raises:
        ValueError: A stage reads one that does not stand before it, or two have one name.
    """

    def __init__(
        self, folder: Path, stages: Sequence[Stage], say: Callable[[str], None] = lambda line: None
    ) -> None:
        self.folder, self.say = Path(folder), say
        self.stages: dict[str, Stage] = {}
        for stage in stages:
            if stage.name in self.stages or not set(stage.after) <= set(self.stages):
                raise ValueError(f"{stage.name}: expected a name of its own, after {', '.join(stage.after)}")
            self.stages[stage.name] = stage

    def chosen(self, name: str) -> tuple[str, ...]:
        """Return the stages that a name stands for: its own, or all of a kind (``run`` for ``run-1mm``).

        Raises:
            CaseError: There is none.
        """
        found = tuple(key for key in self.stages if key == name or key.startswith(f"{name}-"))
        if not found:
            raise CaseError(
                f"no such stage, expected one of {', '.join(self.stages)}", key="stage", value=name
            )
        return found

    def outdated(self, name: str) -> str:
        """Return why a stage has to be made; empty where it is up to date.

        Raises:
            CaseError: A file that it reads is missing.
        """
        record = self.record(name)
        if record is None:
            return "not made yet"
        missing = [file for file in self.stages[name].outputs if not (self.folder / name / file).exists()]
        if missing:
            return f"{missing[0]} is missing"
        old, new = record["inputs"], self._inputs(name)
        changed = [key for key in {**old, **new} if old.get(key) != new.get(key)]
        more = f" and {len(changed) - 1} more" if len(changed) > 1 else ""
        return f"changed: {changed[0]}{more}" if changed else ""

    def record(self, name: str) -> dict[str, Any] | None:
        """Return what ``stage.json`` of a stage holds, None where it was not made to its end."""
        return read_record(self.folder / name)

    def make(self, only: Sequence[str] | None = None, *, again: bool = False) -> None:
        """Make what is not up to date.

        Args:
            only: Stages to look at; all unless given. What they read must have been made.
            again: Make them though they are up to date.

        Raises:
            CaseError: Another process makes stages in the folder; a stage that is asked for alone reads one that was
                not made; or what a stage raises.
        """
        with held(self.folder, MPI.COMM_SELF):
            for name in self.stages if only is None else only:
                self._check(name, alone=only is not None)
                reason = self.outdated(name) or ("asked for again" if again else "")
                self.say(f"{name}: {reason or 'unchanged'}")
                if reason:
                    self._make(name)

    def _make(self, name: str) -> None:
        """Make a stage, and say so in its record."""
        folder, began = self.folder / name, time.perf_counter()
        folder.mkdir(parents=True, exist_ok=True)
        (folder / RECORD).unlink(missing_ok=True)
        inputs = self._inputs(name)
        result = self.stages[name].make(folder)
        took = time.perf_counter() - began
        about = {
            "valvefsi": valvefsi.__version__,
            "date": time.strftime("%Y-%m-%d"),
            "wall_s": round(took, 3),
        }
        write_json(folder / RECORD, {"stage": name, "inputs": inputs, "result": dict(result), **about})
        self.say(f"{name}: made in {took:.3g} s")

    def _check(self, name: str, *, alone: bool) -> None:
        """Refuse a stage whose sources are missing; say where they are not up to date."""
        for source in self.stages[name].after if alone else ():
            if self.record(source) is None:
                raise CaseError(
                    f"it reads the files of {source}, which was not made: make that first, or all of them",
                    key="stage",
                    value=name,
                )
            if reason := self.outdated(source):
                self.say(f"note: {source} is not up to date ({reason})")

    def _inputs(self, name: str) -> dict[str, Any]:
        """Return the inputs of a stage as ``stage.json`` holds them: values, and hashes of files."""
        stage = self.stages[name]
        files = {
            f"{source}/{file}": self.folder / source / file
            for source in stage.after
            for file in self.stages[source].outputs
        }
        found: dict[str, Any] = json.loads(json.dumps({**stage.inputs, **files}, default=_hash))
        return found


def read_record(folder: Path) -> dict[str, Any] | None:
    """Return what ``stage.json`` in the folder of a stage holds, None where there is none that is whole."""
    try:
        found: dict[str, Any] = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found


def _hash(value: Unchecked) -> str:
    """Return the hash of a file."""
    if not isinstance(value, Path):
        raise TypeError(f"expected a number, a text, a table or a path, found {type(value).__name__}")
    try:
        return sha256(value)
    except OSError as error:
        raise CaseError(f"cannot read this file: {error.strerror}", file=value) from None
