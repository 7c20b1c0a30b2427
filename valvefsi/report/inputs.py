"""What was run: values of the case with their origins, hashes of files, versions, machine, time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from valvefsi.case.origins import DEFAULT, Entry, entries_of
from valvefsi.io.folder import sha256
from valvefsi.report.blocks import Block, Cell, Note, Section, Table, missing
from valvefsi.report.runs import Run
from valvefsi.report.words import pretty

OUTPUTS = ("case.toml", "history.csv", "leaflets.csv", "summary.json", "provenance.json")
"""Files of a run whose hashes are told."""


def what_was_run(run: Run) -> Section:
    """Return how the run was made and how long it took."""
    timing = run.summary.get("timing", {})
    calls: Sequence[Mapping[str, Any]] = run.provenance.get("calls", ())
    rows: list[Sequence[Cell]] = [("folder", run.name), ("title", run.title)]
    rows += [("time reached [s]", run.t_end)] if run.t_end is not None else []
    if run.case is not None:
        cells = [len(edges) - 1 for edges in run.case.grid.edges]
        rows.append(("cells of the grid", " x ".join(map(str, cells))))
        rows.append(("spacing h [mm]", 10.0 * run.case.grid.spacing))
        rows.append(("nominal time step [ms]", 1e3 * run.case.dt))
    names = {
        "steps": "steps",
        "wall_s": "wall-clock time [s]",
        "cell_steps_per_s": "cells times steps a second",
    }
    rows += [(text, timing[name]) for name, text in names.items() if name in timing]
    blocks: list[Block] = [Table(caption="The run", headings=("what", "value"), rows=rows)]
    if not run.summary:
        blocks.append(missing("There is no summary.json: the run has not ended, or was ended from outside."))
    blocks += versions(calls[-1] if calls else {}, "This run did not record versions and machine.")
    blocks += _calls(calls)
    if timing.get("phases"):
        whole = sum(timing["phases"].values()) or 1.0
        rows = [(name, took, 100.0 * took / whole) for name, took in timing["phases"].items()]
        headings = ("phase", "time [s]", "share [%]")
        blocks.append(
            Table(caption="Where the time went", headings=headings, rows=rows, folded="Where the time went")
        )
    return Section(title="What was run", blocks=[*blocks, *_files(run)])


def versions(environment: Mapping[str, Any], otherwise: str) -> list[Block]:
    """Return versions and machine as a table, or that they were not recorded."""
    if not environment:
        return [missing(otherwise)]
    host = environment.get("machine", {})
    rows: list[Sequence[Cell]] = [(name, text) for name, text in environment.get("versions", {}).items()]
    rows += [
        (name, environment[name]) for name in ("mpi", "platform", "ranks", "date") if name in environment
    ]
    rows += [("processor", host.get("processor", environment.get("processor")))]
    rows += [("cores", host["cores"]), ("memory [GiB]", host.get("memory_gib"))] if "cores" in host else []
    return [
        Table(
            caption="Versions and machine",
            headings=("what", "value"),
            rows=rows,
            folded="Versions and machine",
        )
    ]


def _calls(calls: Sequence[Mapping[str, Any]]) -> list[Block]:
    """Return when and how the run was called, where it was more than once."""
    if not calls:
        return []
    rows = [
        (
            number,
            str(call.get("date", "")),
            "valvefsi " + " ".join(map(str, call.get("command", ()))),
            call.get("ranks"),
        )
        for number, call in enumerate(calls, 1)
    ]
    return [Table(caption="Calls of the command", headings=("call", "date", "command", "ranks"), rows=rows)]


def _files(run: Run) -> list[Block]:
    """Return hashes of what went in and of what came out."""
    headings = ("part", "file", "SHA-256")
    into = [(item["part"], item["file"], item["sha256"]) for item in run.provenance.get("inputs", ())]
    blocks: list[Block] = []
    if into:
        blocks.append(Table(caption="Files that went in", headings=headings, rows=into))
    else:
        blocks.append(missing("This run did not record hashes of the files that went in."))
    out = [("result", name, sha256(run.folder / name)) for name in OUTPUTS if (run.folder / name).is_file()]
    return [
        *blocks,
        Table(caption="Files that came out", headings=headings, rows=out, folded="Files that came out"),
    ]


def the_case(run: Run) -> Section:
    """Return every value of the case: those that were given, then the others."""
    if run.case is None:
        return Section(title="The case", blocks=[missing(f"The case cannot be read: {run.why}")])
    origins = run.provenance.get("origins")
    entries = entries_of(run.case, origins)
    given = [entry for entry in entries if not _is_default(entry)]
    rest = [entry for entry in entries if _is_default(entry)]
    blocks: list[Block] = []
    if origins is None:
        blocks.append(
            missing(
                "This run did not record where its values are from; those like the default are told from the others."
            )
        )
    blocks += _changes(run)
    blocks.append(_values(f"Values that were given, CGS ({len(given)})", given))
    folded = f"Values left at their defaults ({len(rest)})"
    blocks.append(_values(f"Values left at their defaults, CGS ({len(rest)})", rest, folded))
    return Section(title="The case", blocks=blocks)


def _is_default(entry: Entry) -> bool:
    return DEFAULT in entry.origin.split(",")[0]


def _values(caption: str, entries: Sequence[Entry], folded: str = "") -> Table:
    headings = ("key", "value", "unit", "origin", "meaning")
    rows = [(e.path, _text(e.value), pretty(e.unit), e.origin, e.meaning) for e in entries]
    return Table(caption=caption, headings=headings, rows=rows, folded=folded)


def _text(value: object) -> Cell:
    """Return a value of a case as a cell; what was left out is said."""
    if isinstance(value, list | tuple):
        return ", ".join(str(_text(item)) for item in value) or "none"
    if isinstance(value, dict):
        return ", ".join(f"{key} = {_text(item)}" for key, item in value.items()) or "none"
    if value is None:
        return "left out"
    return value if isinstance(value, int | float | bool) else str(value) or "empty"


def _changes(run: Run) -> list[Block]:
    """Return what of the case was changed on the way."""
    changes = run.summary.get("changes", ())
    rows = [(c["key"], c["t_s"], _text(c["old"]), _text(c["new"])) for c in changes]
    if not rows:
        return []
    said = Note(text="The case was changed on the way: earlier times belong to other values.", tone="warning")
    headings = ("key", "time [s]", "before", "after")
    return [said, Table(caption="Changes on the way", headings=headings, rows=rows)]
