"""Published numbers, one CSV file each, with source, doi, units and method in the header; see `read`."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FOLDER = Path(__file__).parent
KEYS = ("source", "doi", "units", "method")


@dataclass(frozen=True, kw_only=True)
class Table:
    """One file.

    Attributes:
        source: Where the numbers are from.
        doi: Digital object identifier.
        units: Unit of each column.
        method: How they were found.
        rows: Texts by column.
    """

    source: str
    doi: str
    units: str
    method: str
    rows: tuple[Mapping[str, str], ...]

    def column(self, name: str, **where: str | float) -> NDArray[np.float64]:
        """Return the numbers of a column in the rows whose other columns read as asked, ``(n,)``."""
        rows = [row for row in self.rows if all(row[key] == str(value) for key, value in where.items())]
        return np.array([float(row[name]) for row in rows])

    def value(self, name: str, **where: str | float) -> float:
        """Return the only number of a column in the rows whose other columns read as asked."""
        (number,) = self.column(name, **where)
        return float(number)


def header(text: str) -> dict[str, str]:
    """Return the lines ``# key: value`` above the first line of data; empty ones count as missing."""
    entries: dict[str, str] = {}
    for line in text.splitlines():
        if not line.startswith("#"):
            break
        key, _, value = line[1:].partition(":")
        if value.strip():
            entries[key.strip()] = value.strip()
    return entries


@cache
def read(name: str) -> Table:
    """Return the table of the file ``name.csv`` in this folder."""
    text = (FOLDER / f"{name}.csv").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    entries = header(text)
    return Table(**{key: entries[key] for key in KEYS}, rows=tuple(csv.DictReader(lines)))
