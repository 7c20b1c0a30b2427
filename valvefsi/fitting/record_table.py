"""Tables of text: a header, rows of cells, and errors that name file, row and column."""

from __future__ import annotations

import csv
import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from valvefsi.errors import CaseError

STATISTIC = re.compile(r"(^|[^a-z])(sd|std|se|sem|stdev|stderr|var|err|error)([^a-z]|$)", re.I)
"""Part of the heading of a column that says how another one scatters."""


@dataclass(frozen=True, kw_only=True)
class Table:
    """The text of a file.

    Attributes:
        path: The file.
        header: Names of the columns.
        rows: Cells of each row.
        lines: Number of each row's line, from 1.
        header_line: Number of the header's line.
    """

    path: Path
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]
    header_line: int

    def numbers(self, header: str) -> NDArray:
        """Return a column as numbers.

        Raises:
            CaseError: A cell is empty, not a number, or not finite.
        """
        at, found = self.header.index(header), []
        for line, row in zip(self.lines, self.rows, strict=True):
            try:
                value = float(row[at])
            except ValueError:
                raise self.fault("expected a number", header, line, row[at]) from None
            if not math.isfinite(value):
                raise self.fault("expected a finite number", header, line, row[at])
            found.append(value)
        return np.array(found)

    def fault(self, message: str, header: str, line: int, value: object = None) -> CaseError:
        """Return an error that names file, row and column."""
        return CaseError(message, file=self.path, key=f"row {line}, column {header}", value=value)


def read_table(path: Path) -> Table:
    """Return the text of a file: commas, semicolons, tabs or blanks between cells, # before remarks.

    Raises:
        CaseError: It cannot be read, has no rows, a row of another length, or two columns of one name.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not a text file"
        raise CaseError(f"cannot read this file: {reason}", file=path) from None
    if "\0" in text:
        raise CaseError("cannot read this file: not a text file", file=path)
    kept = [
        (number, line)
        for number, line in enumerate(text.split("\n"), 1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if len(kept) < 2:
        raise CaseError("expected a header and rows of numbers", file=path)
    mark = next((m for m in (",", ";", "\t") if m in kept[0][1]), None)
    rows = [(number, _cells(line, mark, path, number)) for number, line in kept]
    header = tuple(rows[0][1])
    for number, row in rows[1:]:
        if len(row) != len(header):
            message = f"expected {len(header)} cells as in the header, found {len(row)}"
            raise CaseError(message, file=path, key=f"row {number}")
    for name in header:
        if header.count(name) > 1:
            raise CaseError("two columns have this name", file=path, key=f"row {rows[0][0]}, column {name}")
    body = rows[1:]
    return Table(
        path=path,
        header=header,
        rows=tuple(tuple(row) for _, row in body),
        lines=tuple(number for number, _ in body),
        header_line=rows[0][0],
    )


def _cells(line: str, mark: str | None, path: Path, number: int) -> list[str]:
    if mark is None:
        return line.split()
    try:
        return [cell.strip() for cell in next(csv.reader([line.rstrip("\r")], delimiter=mark, strict=True))]
    except (csv.Error, StopIteration):
        raise CaseError("cannot split this row into cells", file=path, key=f"row {number}") from None
