"""Results of benchmarks gathered into one table: what was compared, how far off it is, when and on what it was run."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from valvefsi.errors import CaseError

COLUMNS = ("benchmark", "quantity", "computed", "reference", "off", "source", "grid", "ranks", "date", "time")
"""Headings of the table."""


@dataclass(frozen=True, kw_only=True)
class Line:
    """One comparison of one result.

    Attributes:
        benchmark: Name of the benchmark.
        quantity: What is compared.
        computed: The value found, in ``unit``, or text.
        reference: What it is compared with, None where nothing is.
        difference_percent: 100 (computed - reference) / |reference|, None where this means nothing.
        unit: Unit of both.
        source: Where the reference comes from.
        grid: Cells or elements of the run, as the benchmark counts them; empty where it does not say.
        ranks: Number of MPI ranks.
        date: Day of the run, ISO 8601.
        wall_s: Wall-clock time of the whole result [s], None where it does not say.
        file: The file it was read from.
    """

    benchmark: str
    quantity: str
    computed: float | str
    reference: float | str | None
    difference_percent: float | None
    unit: str
    source: str
    grid: str
    ranks: int
    date: str
    wall_s: float | None
    file: Path

    def label(self) -> str:
        """Return the quantity, with the grid where a result has one and does not name it there."""
        complete = not self.grid or "," in self.grid or f"= {self.grid}" in self.quantity
        return self.quantity if complete else f"{self.quantity} ({self.grid})"

    def cells(self) -> tuple[str, ...]:
        """Return the texts under `COLUMNS`."""
        off = "" if self.difference_percent is None else f"{self.difference_percent:+.2f} %"
        computed = f"{_number(self.computed)} {self.unit}".strip()
        reference = "" if self.reference is None else _number(self.reference)
        took = "" if self.wall_s is None else _duration(self.wall_s)
        values = (self.benchmark, self.quantity, computed, reference, off, self.source, self.grid)
        return (*values, str(self.ranks), self.date, took)


def collect(folders: Sequence[Path], *, everything: bool = False) -> list[Line]:
    """Read every ``result.json`` with a table below some folders, ordered by benchmark and date.

    Args:
        folders: Folders, searched with all that is in them.
        everything: Also lines that are compared with nothing.

    Raises:
        CaseError: A folder is missing or holds no result with a table; a file cannot be read.
    """
    files: dict[Path, list[Line]] = {}
    for folder in map(Path, folders):
        if not folder.is_dir():
            raise CaseError("this folder does not exist", file=folder)
        here = {path.resolve(): _lines(path) for path in sorted(folder.rglob("result.json"))}
        if not any(here.values()):
            raise CaseError(
                "there is no result of a benchmark in this folder (result.json with a table)", file=folder
            )
        files |= here
    lines = [line for part in files.values() for line in part if everything or line.reference is not None]
    return sorted(lines, key=lambda line: (line.benchmark, line.date, str(line.file)))


def markdown(lines: Sequence[Line]) -> str:
    """Return the lines as a table in Markdown."""
    rows = [COLUMNS, ("---",) * len(COLUMNS), *(line.cells() for line in lines)]
    return (
        "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows) + "\n"
    )


def _lines(path: Path) -> list[Line]:
    try:
        result = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise CaseError(f"this file is no whole result: {error}", file=path) from None
    if not isinstance(result, dict) or not isinstance(result.get("table"), list):
        return []
    environment, timing = result.get("environment", {}), result.get("timing", {})
    shared = {
        "benchmark": str(result.get("benchmark", path.parent.name)),
        "grid": _grid(result),
        "ranks": int(environment.get("ranks", 1)),
        "date": str(environment.get("date", ""))[:10],
        "wall_s": timing.get("wall_s"),
        "file": path,
    }
    keys = ("computed", "reference", "difference_percent")
    names: list[str] = []  # a row without a name compares the quantity above with another reference
    for row in result["table"]:
        names.append(str(row["quantity"]).strip() or (names[-1] if names else ""))
    return [
        Line(
            quantity=name,
            **{key: row.get(key) for key in keys},
            unit=row.get("unit", ""),
            source=row.get("source", ""),
            **shared,
        )
        for name, row in zip(names, result["table"], strict=True)
    ]


def _grid(result: Mapping[str, Any]) -> str:
    """Cells along the box of each run, or what else the benchmark counts its mesh in."""
    parameters = result.get("parameters", {})
    runs = [run for run in result.get("runs", ()) if isinstance(run, dict)]
    for grids in (parameters.get("grids"), [run.get("numerics", {}).get("grid") for run in runs]):
        if grids and all(grids):
            return ", ".join(map(str, dict.fromkeys(grids)))
    for holder in (parameters, *runs[:1]):
        shape = holder.get("grid") or holder.get("cells") or holder.get("elements")
        if shape:
            return " x ".join(map(str, shape)) if isinstance(shape, list) else str(shape)
    return f"h = {parameters['h']:g} cm" if "h" in parameters else ""


def _number(value: float | str) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _duration(seconds: float) -> str:
    return (
        f"{seconds:.2g} s"
        if seconds < 10.0
        else f"{seconds:.0f} s"
        if seconds < 120.0
        else f"{seconds / 60.0:.0f} min"
    )
