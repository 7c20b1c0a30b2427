"""Results on the terminal."""

from __future__ import annotations

import os
import re
import sys
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from valvefsi.units import format_time

if TYPE_CHECKING:
    from mpi4py import MPI
    from rich.console import Console

    from valvefsi.bodies.body import Entry
    from valvefsi.fitting.report import Report
    from valvefsi.types import Scalar

WIDE = 120
WORDS = re.compile(r"(?:[^\s'\"]|'[^']*'|\"[^\"]*\"|['\"])+")
"""The words of a command; blanks between quotes part none."""
PLAN_UNITS = {"s": (1e3, "ms"), "cm": (10.0, "mm")}
"""In which a plan shows steps, whatever takes time within one, and lengths: factor and unit."""


def show_result(result: Mapping[str, Any], comm: MPI.Comm, folder: Path | None = None) -> None:
    """Print a result on rank 0: its plan or its table of what is compared, else everything by name."""
    if comm.rank != 0 or not result:
        return
    console = terminal()
    rest, rows = dict(result.get("timing", {})), list[tuple[str, ...]]()
    if "plan" in result:
        rows = planned(result["plan"])
        print_table(console, "plan", {"quantity": "left", "value": "right", "unit": "left", "": "left"}, rows)
    elif "table" in result:
        rows = [_compared(row) for row in result["table"]]
        headings = {
            "quantity": "left",
            "computed": "right",
            "reference": "right",
            "difference": "right",
        }
        print_table(
            console, str(result.get("benchmark", "result")), {**headings, "unit": "left", "": "left"}, rows
        )
    else:
        rest = dict(result)
    again = [("recovery", found["reason"]) for found in rest.pop("recoveries", ())]
    again += [("warning", found["text"]) for found in rest.pop("warnings", ())]
    lines = [
        f"{name}: {value}"
        for name, value in [*_flat(rest), *again]
        if not name.startswith(("phases.", "timing.phases."))
    ]
    print_lines(console, [*lines, *([] if folder is None else [f"results in {folder}"])])


def terminal(wide: int = WIDE) -> Console:
    """Return the standard output; where it is no terminal, as wide as COLUMNS says, and else so many characters."""
    from rich.console import Console

    return Console(width=None if _has_width() else wide)


def _has_width() -> bool:
    """Whether somebody says how wide the standard output is: a terminal, or COLUMNS."""
    columns = os.environ.get("COLUMNS", "")
    return sys.stdout.isatty() or (columns.isdecimal() and int(columns) > 0)


def print_lines(console: Console, lines: Sequence[str]) -> None:
    """Print lines as they are; on a terminal, or where COLUMNS is set, long ones break between words."""
    for line in lines:
        for piece in folded(line, console.width) if _has_width() else (line,):
            console.print(piece, highlight=False, soft_wrap=True, markup=False)


def folded(line: str, width: int) -> list[str]:
    """Return a line in pieces of at most a width, but for longer words; a command stays one that a shell takes.

    Args:
        line: The line; one that begins with ``  valvefsi`` is a command.
        width: Most characters of a piece.
    """
    if len(line) <= width:
        return [line]
    lead = line[: len(line) - len(line.lstrip())]
    if not line.startswith("  valvefsi "):
        wrapper = textwrap.TextWrapper(width=width, break_long_words=False, break_on_hyphens=False)
        wrapper.initial_indent, wrapper.subsequent_indent = lead, f"{lead}  "
        return wrapper.wrap(line) or [line]
    pieces = [lead[:-1]]
    for word in WORDS.findall(line):
        if len(pieces[-1]) + len(word) + 3 > width and pieces[-1].strip():
            pieces[-1] += " \\"
            pieces.append(f"{lead} ")
        pieces[-1] += f" {word}"
    return pieces


def planned(entries: Sequence[Entry]) -> list[tuple[str, ...]]:
    """Return the lines of a plan: the wall-clock time of a run as people say it, one unit for each other quantity."""
    rows: list[tuple[str, ...]] = []
    for entry in entries:
        value, shown = entry.value, entry.unit
        if entry.wall:
            value, shown = format_time(float(value)), ""
        rows.append((entry.quantity, *in_plan(value, shown), entry.note))
    return rows


def in_plan(value: Scalar, unit: str) -> tuple[str, str]:
    """Return a value and its unit as a plan shows them."""
    if unit not in PLAN_UNITS or not isinstance(value, int | float):
        return number(value), unit
    factor, shown = PLAN_UNITS[unit]
    return number(factor * value), shown


def _compared(row: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the cells of one line of a benchmark's table."""
    difference, reference = row.get("difference_percent"), row.get("reference")
    known = "" if reference is None else number(reference)
    shown = "" if difference is None else f"{difference:+.2f} %"
    return row["quantity"], number(row["computed"]), known, shown, row.get("unit", ""), row.get("source", "")


def print_table(
    console: Console, title: str, columns: Mapping[str, str], rows: Sequence[tuple[str, ...]]
) -> None:
    """Print a table, all its text as it is; ``columns`` gives the side that each heading's cells lean to."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(title, style="table.title"), title_justify="left", box=box.SIMPLE_HEAD)
    for heading, side in columns.items():
        table.add_column(Text(heading), justify=cast(Any, side))
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    console.print(table)


def print_fit(console: Console, report: Report, lines: Sequence[str]) -> None:
    """Print what a fit warns of, its table of parameters, and more lines under it."""
    headings = {
        "parameter": "left",
        "value": "right",
        "unit": "left",
        "std": "right",
        "95 % interval": "left",
    }
    print_lines(console, [f"note: {note}" for note in report.notes])
    title = f"{report.kind} fit, {report.model}"
    print_table(console, title, {**headings, "verdict": "left"}, report.rows())
    print_lines(console, lines)


def _flat(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    lines = []
    for name, value in values.items():
        key = f"{prefix}{name}"
        lines += _flat(value, f"{key}.") if isinstance(value, Mapping) else [(key, number(value))]
    return lines


def number(value: Scalar) -> str:
    """Return a value in few digits."""
    return f"{value:.5g}" if isinstance(value, float) else str(value)
