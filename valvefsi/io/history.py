"""Histories: a CSV file that grows by one row every few steps and survives a restart."""

from __future__ import annotations

import contextlib
import csv
import math
import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.errors import CaseError, raise_together
from valvefsi.types import Array

if TYPE_CHECKING:
    from mpi4py import MPI

TAIL = 1 << 16
"""Bytes at the end of a history in which its last row is looked for."""


class History:
    """Appends rows to a CSV file, on rank 0.

    Args:
        path: The file. Without ``resume_step`` an existing one is replaced.
        columns: Names of the columns with their units, the first one is "step".
        comm: Communicator of the run.
        resume_step: Step of the checkpoint that the run goes on from: later rows, and a row that was not
            written to its end, are dropped. One that is missing begins anew, with a warning.

    Attributes:
        last: Step of the last row that it began with, None where it has none.

    Raises:
        CaseError: The file to go on with has other columns.
        OSError: The file cannot be written.

    Note:
        Collective.
    """

    def __init__(
        self, path: Path, columns: Sequence[str], comm: MPI.Comm, resume_step: int | None = None
    ) -> None:
        self.path, self.columns, self.comm = Path(path), tuple(columns), comm
        self.last: float | None = None
        if self.columns[:1] != ("step",):
            raise ValueError(f"the first column of a history is 'step', not {self.columns[:1]}")
        error = None
        try:
            if comm.rank == 0:
                self._start(resume_step)
        except (OSError, CaseError) as failure:
            error = failure
        raise_together(comm, error)
        self.last = comm.bcast(self.last)

    def append(self, row: Mapping[str, float]) -> None:
        """Append a row, one value for each column, and hand it to the operating system.

        Note:
            Collective. Rank 0's row is written, its numbers to the last digit.
        """
        error = None
        try:
            if self.comm.rank == 0:
                if set(row) != set(self.columns):
                    wrong = sorted(set(row) ^ set(self.columns))
                    raise ValueError(f"the row and the columns differ in {', '.join(wrong)}")
                with self.path.open("a", newline="") as file:
                    csv.writer(file, lineterminator="\n").writerow([_text(row[c]) for c in self.columns])
        except (OSError, ValueError) as failure:
            error = failure
        raise_together(self.comm, error)

    def _start(self, resume_step: int | None) -> None:
        """Write the heading and the rows that stay, in one go."""
        rows: list[list[str]] = []
        if resume_step is not None:
            columns, rows = _read_rows(self.path) if self.path.is_file() else ((), [])
            if columns and columns != self.columns:
                found = ", ".join(columns)
                raise CaseError(f"cannot go on with this history, its columns are {found}", file=self.path)
            rows = [row for row in rows if float(row[0]) <= resume_step]
        if resume_step is not None and not rows:
            state = "holds no whole row" if self.path.is_file() else "is missing"
            lost = f"{self.path} {state}: its rows up to step {resume_step} are lost, it begins anew there"
            warnings.warn(lost, stacklevel=2)
        self.last = float(rows[-1][0]) if rows else None
        self.path.parent.mkdir(parents=True, exist_ok=True)
        temporary = self.path.with_name(f".{self.path.name}.part")
        with temporary.open("w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([self.columns, *rows])
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(self.path)


def read_history(path: Path) -> dict[str, list[float]]:
    """Return the columns of a history by name, "step" included."""
    columns, rows = _read_rows(Path(path))
    return {name: [float(row[k]) for row in rows] for k, name in enumerate(columns)}


class HistoryReader:
    """Reads a history that grows, only what is new of it each time.

    Args:
        path: The file, which need not be there yet.

    Attributes:
        columns: Its columns by name so far, ``(n,)`` each; empty before its heading is there.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self._begin(0)

    def _begin(self, inode: int) -> None:
        self.inode, self.place, self.names = inode, 0, list[str]()
        self.columns: dict[str, Array] = {}

    def read(self) -> bool:
        """Read on to the last whole row; return whether anything is new.

        A file that was replaced is read from its start. A row that is damaged, or not written to its end, is left out.
        """
        try:
            with self.path.open("rb") as file:
                about = os.fstat(file.fileno())
                if about.st_ino != self.inode or about.st_size < self.place:
                    self._begin(about.st_ino)
                file.seek(self.place)
                new = file.read()
        except FileNotFoundError:
            was = bool(self.columns)
            self._begin(0)
            return was
        whole = new[: new.rfind(b"\n") + 1]
        self.place += len(whole)
        lines = whole.decode(errors="replace").splitlines()
        if lines and not self.names:
            self.names, lines = lines[0].split(","), lines[1:]
            self.columns = {name: np.zeros(0) for name in self.names}
        rows = [row for row in map(_numbers, lines) if len(row) == len(self.names)]
        if rows:
            table = np.array(rows).T
            self.columns = {
                name: np.concatenate([self.columns[name], column])
                for name, column in zip(self.names, table, strict=True)
            }
        return bool(whole)


def _numbers(line: str) -> list[float]:
    """Return the numbers of a row, none where it is damaged."""
    try:
        return [float(value) for value in line.split(",")]
    except ValueError:
        return []


def last_row(path: Path) -> dict[str, float]:
    """Return the last whole row of a history that may be growing, by column; empty where there is none yet."""
    try:
        with Path(path).open("rb") as file:
            heading = file.readline()
            file.seek(max(len(heading), file.seek(0, os.SEEK_END) - TAIL))
            lines = file.read().decode(errors="replace").split("\n")[:-1]
    except FileNotFoundError:
        return {}
    columns = heading.decode(errors="replace").rstrip("\r\n").split(",")
    rows = (_numbers(line) for line in reversed(lines))
    row = next((row for row in rows if len(row) == len(columns)), None)
    return {} if row is None else dict(zip(columns, row, strict=True))


def _read_rows(path: Path) -> tuple[tuple[str, ...], list[list[str]]]:
    """Return the column names and the rows that are whole: ended by a newline, one number for each column.

    Others are passed over, and so is a row whose step (the first column) is not above the one before it.
    """
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    *lines, rest = text.replace("\r\n", "\n").split("\n")
    columns: tuple[str, ...] = tuple(lines[0].split(",")) if lines else ()
    rows: list[list[str]] = []
    last = -math.inf
    for row in (line.split(",") for line in lines[1:]):
        with contextlib.suppress(ValueError):
            if len([float(value) for value in row]) == len(columns) and float(row[0]) > last:
                rows.append(row)
                last = float(row[0])
    passed = max(len(lines) - 1, 0) - len(rows) + bool(rest)
    if passed and columns:
        warnings.warn(f"{path}: {passed} damaged row{'s' * (passed > 1)} passed over", stacklevel=3)
    return columns, rows


def _text(value: float) -> str:
    """Return the shortest text that reads back as the same number."""
    return str(int(value)) if isinstance(value, int) or hasattr(value, "__index__") else repr(float(value))
