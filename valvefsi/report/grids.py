"""The page of a study of grids: orders and indices, waveforms over one another, what else was varied."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from valvefsi.report.blocks import Block, Cell, Chapter, Note, Section, Table, missing
from valvefsi.report.members import files_of, of_member, or_dash, over_one_another
from valvefsi.report.results import pictures
from valvefsi.report.runs import is_table, open_run, read_table

NUMBER = ("order", "Richardson's value", "GCI [%]", "uncertainty")
"""Headings of what grids or time steps say of a number."""
MOVED = ("number that moves most", "by [%]", "waveform that moves most, L2", "by [%] of its norm")
SAME, NO_ORDER = ("unchanged",), ("no order",)
SORTS = {
    "Numbers that change with the spacing": (),
    "Numbers for which an order means nothing": NO_ORDER,
    "Numbers that are the same on the last grids": SAME,
}
"""Tables of numbers by how these go with the spacing; the first has all others, and is open."""


def a_verification(folder: Path, *, trust: bool = False) -> Chapter:
    """Return the part on a case on several grids.

    Args:
        folder: The folder of the study.
        trust: Whether Python files of materials may be run.
    """
    result, name = read_table(folder / "verification.json"), folder.resolve().name
    grids = [str(grid["member"]) for grid in result.get("grids", ())]
    runs = {grid: open_run(folder / grid, trust=trust) for grid in grids}
    finest = runs[grids[-1]] if grids else None
    sections = [
        Section(title="What was studied", blocks=_grid_study(folder, result)),
        Section(title="Numbers on the grids", blocks=_grid_numbers(grids, result)),
        Section(
            title="Waveforms of the grids over one another",
            blocks=[over_one_another(runs), *_wave_norms(grids, result)],
        ),
        Section(title="What else moves the numbers", blocks=_dependence(result)),
        pictures(folder),
    ]
    case = Path(str(result.get("case", name))).name
    title = f"Grids of {case}" if finest is None else f"Grids of {case}: {finest.title}"
    return Chapter(title=title, about=name, sections=[*sections, *of_member(finest, "the finest grid")])


def _grid_study(folder: Path, result: Mapping[str, Any]) -> list[Block]:
    """Return what was studied, what must be known of it, its members, and the files that came out."""
    about = [
        (key, result.get(key.replace(" ", "_"))) for key in ("case", "version", "expected order", "base")
    ]
    blocks: list[Block] = [Table(caption="The study", headings=("what", "value"), rows=about)]
    blocks += [
        Note(text=note, tone="warning" if note.split(":")[0].isupper() else "plain")
        for note in result.get("notes", ())
    ]
    blocks += [
        Note(text=f"{name} failed and is in no number: {why}", tone="warning")
        for name, why in result.get("failed", {}).items()
    ]
    blocks += _gone(folder, result)
    blocks.append(_members(folder, result))
    return [*blocks, *files_of(folder, ("verification.json", "verification.csv", "changes.csv"))]


def _gone(folder: Path, result: Mapping[str, Any]) -> list[Block]:
    """Return which files of members, whose numbers are in the result, are not beside it."""
    changed = [place.parent for place in sorted(folder.glob("*/member.json")) if _ended(place)]
    places = dict.fromkeys([*(folder / str(grid["member"]) for grid in result.get("grids", ())), *changed])
    held = {place: (is_table(place / "summary.json"), (place / "history.csv").is_file()) for place in places}
    return [
        Note(text=f"{place.name}/{file} is not there or cannot be read.", tone="warning")
        for place, found in held.items()
        for file, there in zip(("summary.json", "history.csv"), found, strict=True)
        if not there
    ]


def _ended(record: Path) -> bool:
    return read_table(record).get("state") in ("done", "kept")


def _members(folder: Path, result: Mapping[str, Any]) -> Block:
    """Return the members with what each changes, how it ended and how long it took."""
    spacings = {grid["member"]: grid for grid in result.get("grids", ())}
    rows: list[tuple[Cell, ...]] = []
    for place in sorted(folder.glob("*/member.json"), key=lambda path: path.parent.name):
        record, timing = read_table(place), read_table(place.parent / "summary.json").get("timing", {})
        grid = spacings.get(place.parent.name, {})
        h, dt = (
            None if grid.get(key) is None else 10.0**power * grid[key]
            for key, power in (("h_cm", 1), ("dt_s", 3))
        )
        changed = ", ".join(record.get("overrides", ())) or "nothing"
        rows.append(
            (
                place.parent.name,
                record.get("state"),
                or_dash(h),
                or_dash(dt),
                timing.get("steps"),
                timing.get("wall_s"),
                changed,
            )
        )
    headings = (
        "member",
        "state",
        "h [mm]",
        "time step [ms]",
        "steps",
        "wall-clock time [s]",
        "what it changes in the case",
    )
    caption = "Members: the grids, and the base with one thing changed at a time"
    return (
        Table(caption=caption, headings=headings, rows=rows)
        if rows
        else missing("The members are not beside the result.")
    )


def _grid_numbers(grids: Sequence[str], result: Mapping[str, Any]) -> list[Block]:
    """Return the table of orders and indices; what has no order, or does not change, is folded away."""
    every = result.get("quantities", ())
    blocks: list[Block] = []
    for caption, kinds in SORTS.items():
        rows = [
            (row["quantity"], row["kind"], *row["values"], *_judged(row))
            for row in every
            if (row["kind"] in kinds if kinds else row["kind"] not in (*SAME, *NO_ORDER))
        ]
        folded = f"{caption} ({len(rows)})" if kinds else ""
        if rows:
            headings = ("number", "verdict", *grids, *NUMBER)
            blocks.append(Table(caption=caption, headings=headings, rows=rows, folded=folded))
    if not blocks:
        return [missing("No number is there on all of the grids that are done.")]
    said = (
        "Order: observed on the last three grids (Celik et al. 2008). GCI: grid convergence index of the finest, with "
        "that order. Uncertainty: of the finest value, with the expected order where the observed one is not near it "
        "(Oberkampf and Roy 2010), in the number's unit."
    )
    return [*blocks, *_in_words(every, "Verdicts on the numbers in words"), Note(text=said)]


def _judged(row: Mapping[str, Any]) -> tuple[Cell, ...]:
    index = None if row["index"] is None else 100.0 * row["index"]
    return tuple(map(or_dash, (row["order"], row["extrapolated"], index, row["uncertainty"])))


def _in_words(every: Sequence[Mapping[str, Any]], caption: str) -> list[Block]:
    """Return what the grids say of each number or waveform in words, folded away."""
    rows = [(f"{row['quantity']}{', ' + row['norm'] if 'norm' in row else ''}", row["text"]) for row in every]
    return [Table(caption=caption, headings=("of", "in words"), rows=rows, folded=caption)] if rows else []


def _wave_norms(grids: Sequence[str], result: Mapping[str, Any]) -> list[Block]:
    """Return the norms of the differences between grids."""
    every = [row for row in result.get("waveforms", ()) if row["kind"] != "no order"]
    if not every:
        return []
    rows = []
    for row in every:
        index, bound = (None if row[key] is None else 100.0 * row[key] for key in ("index", "uncertainty"))
        gaps = [100.0 * gap for gap in row["differences"]]
        judged = (or_dash(row["order"]), or_dash(index), or_dash(bound))
        rows.append((f"{row['quantity']}, {row['norm']}", row["kind"], *gaps, *judged))
    between = [f"{a} - {b} [%]" for a, b in itertools.pairwise(grids)]
    headings = ("waveform, norm", "verdict", *between, "order", "GCI [%]", "uncertainty [%]")
    caption = "Differences of waveforms between grids, over the norm on the finest"
    words = _in_words(every, "Verdicts on the waveforms in words")
    return [Table(caption=caption, headings=headings, rows=rows), *words]


def _dependence(result: Mapping[str, Any]) -> list[Block]:
    """Return what else than the spacing was varied and what it moves; what was not is said."""
    found = result.get("dependence", ())
    if not found:
        return [missing("Nothing else was varied, or the base has failed.")]
    rows: list[tuple[Cell, ...]] = []
    for row in found:
        moved = [(row[what] or "-", or_dash(row[f"{what}_percent"])) for what in ("number", "waveform")]
        rows.append((row["of"], ", ".join(row["changes"]) or row["text"], *moved[0], *moved[1]))
    headings = ("depends on", "changed", *MOVED)
    varied = Table(caption="What else than the spacing was varied", headings=headings, rows=rows)
    meanings = [(row["of"], row["meaning"]) for row in found]
    means = Table(caption="What these mean", headings=("depends on", "which is"), rows=meanings)
    return [
        varied,
        means,
        *_time_steps(result),
        *_iterations(result.get("iterations", {})),
        *_changes(result),
    ]


def _time_steps(result: Mapping[str, Any]) -> list[Block]:
    """Return the table of the smaller time steps."""
    steps = result.get("time_steps", ())
    if not steps:
        return []
    rows = [
        (row["quantity"], row["kind"], *row["values"], *_judged(row))
        for row in steps
        if row["kind"] not in ("unchanged", "no order")
    ]
    headings = ("number", "verdict", *(f"dt x {factor:g}" for factor in steps[0]["factors"]), *NUMBER)
    caption = f"Time steps of {result['base']}"
    return [Table(caption=caption, headings=headings, rows=rows, folded=caption)]


def _iterations(found: Mapping[str, Any]) -> list[Block]:
    """Return what iterations leave: of the solves of a step, and of beats."""
    if not found:
        return [missing("What iterations leave was not recorded.")]
    said = Note(text=f"Iterations: {found['solves']}; {found['text']}.")
    rows = [
        (row["quantity"], row["values"][-1], row["error"], or_dash(row["error_percent"]))
        for row in found["beats"]
    ]
    headings = ("number", "last beat", "error of the last beat", "error [%]")
    caption = "What beats that have not come to repeat leave"
    return [said, *([Table(caption=caption, headings=headings, rows=rows)] if rows else [])]


def _changes(result: Mapping[str, Any]) -> list[Block]:
    """Return every change of every number and waveform, folded away."""
    rows = [
        (
            f"{row['quantity']}{', ' + row['norm'] if 'norm' in row else ''}",
            row["change"],
            or_dash(row["difference_percent"]),
        )
        for row in result.get("changes", ())
    ]
    caption = f"Every number and waveform under every change ({len(rows)})"
    headings = ("number or waveform", "change", "difference [%]")
    return [Table(caption=caption, headings=headings, rows=rows, folded=caption)] if rows else []
