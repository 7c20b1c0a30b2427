"""Tables of text: a header, rows of cells, and errors that name file, row and column."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from valvefsi.errors import CaseError
from valvefsi.types import Array, Indices, Scalar

STATISTICS = {
    *("sd", "std", "stdev", "stddev", "se", "sem", "err", "error", "unc", "uncertainty"),
    *("var", "variance", "ci", "ci95", "lower", "upper"),
}
"""Words that make a column the spread of another: it is passed over."""
COMMA = re.compile(r"[+-]?\d+,\d+(?:[eE][+-]?\d+)?")
"""A number with a decimal comma."""
HUGE = 1e100
"""Size of a number that no record holds."""


@dataclass(frozen=True, kw_only=True)
class Table:
    """The text of a file.

    Attributes:
        path: The file.
        header: Names of the columns.
        rows: Cells of each row.
        lines: Number of each row's line, from 1, ``(rows,)``.
        header_line: Number of the header's line.
        decimal: The decimal mark.
    """

    path: Path
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: Indices
    header_line: int
    decimal: str = "."

    def numbers(self, header: str) -> Array:
        """Return a column as numbers, ``(rows,)``.

        Raises:
            CaseError: A cell is empty, not a number, not finite, or has the other decimal mark.
        """
        at, values = self.header.index(header), []
        for line, row in zip(self.lines, self.rows, strict=True):
            if self.decimal != "." and "." in row[at]:
                raise self.fault("expected a decimal comma", header, line, row[at])
            try:
                values.append(float(row[at].replace(self.decimal, ".")))
            except ValueError:
                hint = (
                    ", with a decimal point; --decimal comma reads commas" if COMMA.fullmatch(row[at]) else ""
                )
                raise self.fault(f"expected a number{hint}", header, line, row[at]) from None
            if not abs(values[-1]) <= HUGE:
                raise self.fault("expected a finite number", header, line, row[at])
        return np.array(values)

    def fault(self, message: str, header: str, line: int | None = None, value: Scalar = None) -> CaseError:
        """Return an error that names file, row (the header's if not given) and column."""
        line = self.header_line if line is None else int(line)
        return CaseError(message, file=self.path, key=f"row {line}, column {header}", value=value)

    def unused(self, used: Iterable[str]) -> tuple[str, ...]:
        """Return one note on the columns that are not among those ``used``, if there are any."""
        names = set(used)
        left = [header for header in self.header if header not in names]
        return (f"{self.path.name}: columns not used: {', '.join(left)}",) if left else ()

    def renamed(self, columns: Mapping[str, str], key: str) -> dict[str, str]:
        """Return what each header stands for: itself, or the name that ``columns`` gives to it.

        Raises:
            CaseError: ``columns`` names a header that is not there.
        """
        missing = [header for header in columns.values() if header not in self.header]
        if missing:
            message = f"no such column{'s' * (len(missing) > 1)}, there are {', '.join(self.header)}"
            raise CaseError(message, file=self.path, key=key, value=", ".join(missing))
        return {header: header for header in self.header} | {header: name for name, header in columns.items()}


def is_statistic(heading: str) -> bool:
    """Whether a heading says the spread of a quantity, such as ``p_lv_sd`` or ``sd_p_lv``, not the quantity."""
    return not STATISTICS.isdisjoint(re.split(r"[^a-z0-9]+", heading.lower()))


def read_table(path: Path, decimal: str = ".") -> Table:
    """Return the text of a file: commas, semicolons, tabs or blanks between cells, # before remarks.

    Args:
        path: The file.
        decimal: The decimal mark; where it is a comma, none stands between cells.

    Raises:
        CaseError: It cannot be read, has no rows, a row of another length, or two columns of one name.
    """
    try:
        content = path.read_bytes()
        text = content.decode("utf-8-sig")
    except OSError as error:
        raise CaseError(f"cannot read this file: {error.strerror}", file=path) from None
    except UnicodeDecodeError:  # a ValueError, too
        is_utf16 = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        found = "it is in UTF-16" if is_utf16 else "it may be in another encoding"
        reason = f"not a text file in UTF-8; {found}: save it as CSV in UTF-8"
        raise CaseError(f"cannot read this file: {reason}", file=path) from None
    except ValueError as error:  # of the name
        raise CaseError(f"cannot read this file: {error}", file=path) from None
    if "\0" in text:
        raise CaseError("cannot read this file: not a text file", file=path)
    lines = [(n, line) for n, line in enumerate(text.split("\n"), 1) if line.split("#")[0].strip()]
    if len(lines) < 2:
        raise CaseError("expected a header and rows of numbers", file=path)
    mark = next((m for m in (",", ";", "\t") if m in lines[0][1] and m != decimal), None)
    (first, header), *rows = [(number, _cells(line, mark, path, number)) for number, line in lines]
    for number, row in rows:
        if len(row) != len(header):
            message = f"expected {len(header)} cells as in the header, found {len(row)}"
            raise CaseError(message, file=path, key=f"row {number}")
    for name in header:
        if header.count(name) > 1:
            raise CaseError("two columns have this name", file=path, key=f"row {first}, column {name}")
    return Table(
        path=path,
        header=header,
        rows=tuple(row for _, row in rows),
        lines=np.array([number for number, _ in rows]),
        header_line=first,
        decimal=decimal,
    )


def _cells(line: str, mark: str | None, path: Path, number: int) -> tuple[str, ...]:
    if mark is None:
        return tuple(line.split())
    try:
        split = next(csv.reader([line.rstrip("\r")], delimiter=mark, strict=True))
        return tuple(cell.strip() for cell in split)
    except (csv.Error, StopIteration):
        raise CaseError("cannot split this row into cells", file=path, key=f"row {number}") from None
