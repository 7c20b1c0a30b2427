"""``valvefsi numbers``: what a valve lab reports, from what a run has written."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from valvefsi.cli.options import Out, Trust
from valvefsi.errors import CaseError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping


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
    from valvefsi.cli.fit_output import console
    from valvefsi.cli.tables import number, print_table
    from valvefsi.io.folder import write_text

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
    rows = [(name, number(value)) for name, value in told(found["valve"])]
    print_table(console(), "the valve", {"number": "left", "value": "right"}, rows)
    typer.echo(f"numbers and what they mean in {path}")


def told(valve: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield the names and values that are printed: the last cycle's, and those of the frames."""
    last = (valve.get("cycles") or [{}])[-1]
    yield from ((name, value) for name, value in last.items() if name != "missing")
    for part in ("flutter", "coaptation", "places", "shear", "exposure"):
        yield from _flat(part, valve.get(part, {}))


def _flat(name: str, part: Any) -> Iterator[tuple[str, Any]]:
    """Yield the values of nested tables by their names, one after the other; a value with its time alone."""
    if not isinstance(part, dict):
        yield name, part
    elif "value" in part:
        yield name, part["value"]
    else:
        for key, item in part.items():
            yield from _flat(f"{name}, {key}", item)
