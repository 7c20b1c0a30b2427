"""The screen that a run ends with: its numbers in units people use, what it has drawn, how to go on."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from valvefsi.cli.tables import number, print_lines, print_table, terminal
from valvefsi.post.columns import Units
from valvefsi.units import format_time

if TYPE_CHECKING:
    from mpi4py import MPI

NOTHING = 1e-9
"""Part of the largest number with the same unit below which one is round-off."""


def show_run(result: Mapping[str, Any], comm: MPI.Comm, folder: Path, units: Units) -> None:
    """Print on rank 0 what a run has ended with.

    Args:
        result: What `valvefsi.case.build.run_case` returned.
        comm: Communicator of the run.
        folder: Folder of the results.
        units: The units of its numbers.
    """
    if comm.rank != 0 or not result:
        return
    console, timing = terminal(), dict(result.get("timing", {}))
    if "last" in result:
        headings = {"quantity": "left", "value": "right", "unit": "left"}
        print_table(console, "at the end", headings, in_units(result["last"], units))
    plausible = result.get("valve", {}).get("plausible", {})
    rows = [_judged(name, found) for name, found in plausible.items() if found["value"] is not None]
    if rows:
        headings = {"the valve, last cycle": "left", "value": "right", "unit": "left", "": "left"}
        print_table(console, "", headings, rows)
    again = [f"recovery: {found['reason']}" for found in timing.pop("recoveries", ())]
    again += [f"warning: {found['text']}" for found in timing.pop("warnings", ())]
    print_lines(console, [*again, *_ended(result, timing), *_on_disk(folder), *_next(result, folder)])


def in_units(row: Mapping[str, float], units: Units) -> list[tuple[str, str, str]]:
    """Return quantity, value and unit of each column of a history, in the units of a run."""
    found = []
    for name, value in row.items():
        shown = units.of(name)
        found.append((shown.words, shown.factor * value, shown.unit))
    largest: dict[str, float] = {}
    for _, value, unit in found:
        largest[unit] = max(largest.get(unit, 0.0), abs(value))
    return [(n, number(0.0 if abs(v) < NOTHING * largest[unit] else v), unit) for n, v, unit in found]


def _judged(name: str, found: Mapping[str, Any]) -> tuple[str, str, str, str]:
    """Return the cells of a number of a valve, with what is plausible where it is not."""
    verdict = "" if found["plausible"] else f"plausible are {found['from']:g} to {found['to']:g}"
    return name, number(found["value"]), found["unit"], verdict


def _ended(result: Mapping[str, Any], timing: Mapping[str, Any]) -> list[str]:
    """Say how long it took, or that there was nothing to do."""
    if result.get("finished"):
        return ["this run is finished: nothing was computed, its summary and pictures are as they were"]
    if "wall_s" not in timing:
        return []
    rate = timing.get("cell_steps_per_s", 0.0)
    speed = f", {rate:.3g} cells times steps a second" if rate else ""
    return [f"{timing.get('steps', 0)} steps in {format_time(timing['wall_s'])}{speed}"]


def _on_disk(folder: Path) -> list[str]:
    """Say where the results are, and which pictures there are."""
    pictures = ", ".join(sorted(path.name for path in folder.glob("*.png")))
    return [f"results in {folder}", *([f"pictures: {pictures}"] if pictures else [])]


def _next(result: Mapping[str, Any], folder: Path) -> list[str]:
    """Name the commands to go on with; the folder's own case has what --set changed."""
    if "last" not in result:
        return []
    later = f"time.t_end='{2.0 * float(result['last'].get('t_s', 0.0)):.4g} s'"
    more = f"valvefsi run {folder / 'case.toml'} --out {folder} --resume --set {later}"
    correct = []
    if "target" in result and any(
        "cardiac_output_l_per_min" in c for c in result.get("valve", {}).get("cycles", ())
    ):
        correct = ["to correct the pump and the resistance for the target:", f"  valvefsi target {folder}"]
    return ["next:", f"  valvefsi plot {folder}", f"  valvefsi report {folder}", f"  {more}", *correct]
