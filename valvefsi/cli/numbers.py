"""``valvefsi numbers``: what a valve lab reports, from what a run has written."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from valvefsi.cli.options import Out, Trust
from valvefsi.cli.tables import number
from valvefsi.errors import CaseError
from valvefsi.post.columns import WORDS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from valvefsi.post.columns import Units

Row = tuple[str, str, str]
FRAMES = {
    "flutter": "flutter",
    "coaptation": "coaptation",
    "strain and stress by place": "places",
    "shear stress in the fluid": "shear",
    "exposure to shear stress": "exposure",
}
"""Titles of what comes from the frames, and its tables."""


def numbers(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a run with a valve.")],
    out: Out = None,
    trust: Trust = False,
) -> None:
    """Take the numbers of a run's valve from its history and its frames, and print them.

    They replace those in its summary.json; with --out, or where the run has not ended, they are in valve.json.
    """
    from mpi4py import MPI

    if MPI.COMM_WORLD.rank != 0:
        return
    from valvefsi.case import load_case
    from valvefsi.case.valve_report import has_valve, report_numbers
    from valvefsi.cli.tables import print_table, terminal
    from valvefsi.io.folder import write_text
    from valvefsi.post.columns import Units

    folder = Path(folder)
    for name in ("case.toml", "history.csv"):
        if not (folder / name).is_file():
            raise CaseError(f"there is no run of a valve here, {name} is missing", file=folder)
    case = load_case(folder / "case.toml", trust=trust)
    found: dict[str, Any] = report_numbers(case, folder) if has_valve(case) else {}
    if not found:
        raise CaseError("this run has no valve, or nothing of it yet", file=folder)
    summary, path = folder / "summary.json", (out or folder) / "valve.json"
    if out is None and summary.is_file():
        found, path = json.loads(summary.read_text(encoding="utf-8")) | found, summary
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, json.dumps(found, indent=2) + "\n")
    units = Units(system=case.output.units, dim=case.grid.dim)
    for title, rows in groups(found["valve"], units):
        print_table(terminal(), title, {"number": "left", "value": "right", "unit": "left"}, rows)
    typer.echo(f"numbers and what they mean in {path}")


def groups(valve: Mapping[str, Any], units: Units) -> Iterator[tuple[str, list[Row]]]:
    """Yield what is printed: titles, and quantity, value and unit of the last cycle's numbers and the frames'.

    Args:
        valve: The numbers of a valve, as in ``summary.json``.
        units: The units of the run.
    """
    last = (valve.get("cycles") or [{}])[-1]
    parts = {"last cycle": {name: value for name, value in last.items() if name != "missing"}}
    parts |= {title: valve.get(key, {}) for title, key in FRAMES.items()}
    for title, part in parts.items():
        rows = list(_rows(part, units))
        if rows:
            yield title, rows


def _rows(part: Mapping[str, Any], units: Units, where: str = "") -> Iterator[Row]:
    """Yield the rows of nested tables, each with the names of the tables it is in; a value with its time alone."""
    for name, item in part.items():
        value = item.get("value", item) if isinstance(item, dict) else item
        shown = units.of(name)
        if isinstance(value, dict):
            yield from _rows(value, units, f"{where}{shown.words}, ")
        elif isinstance(value, float):
            yield f"{where}{shown.words}", number(shown.factor * value), shown.unit
        else:
            text = "-" if value is None else "yes" if value is True else WORDS.get(value, str(value))
            yield f"{where}{shown.words}", text, ""
