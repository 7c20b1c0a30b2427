"""The page of uncertain inputs: what was drawn, what failed, outputs with intervals, Sobol indices, the samples."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from valvefsi.report.blocks import Block, Cell, Chapter, Note, Section, Table, missing
from valvefsi.report.members import files_of, of_member, or_dash, over_one_another
from valvefsi.report.results import MOST_ROWS, pictures
from valvefsi.report.runs import Run, open_run, read_table
from valvefsi.report.words import pretty

MOST_CURVES = 24
"""Members whose waveforms are drawn over one another."""


def a_sample(folder: Path, *, trust: bool = False) -> Chapter:
    """Return the part on uncertain inputs.

    Args:
        folder: The folder of the study.
        trust: Whether Python files of materials may be run.
    """
    result, name = read_table(folder / "sample.json"), folder.resolve().name
    members = result.get("members", {})
    runs = {
        place.name: open_run(place, trust=trust)
        for number, place in ((k, folder / f"s{k:04d}") for k in members.get("sample", ())[:MOST_CURVES])
        if members["state"][number] == "done" and (place / "case.toml").is_file()
    }
    sections = [
        Section(title="What was sampled", blocks=_sample_study(folder, result)),
        Section(title="Samples that failed", blocks=_failed(result)),
        Section(title="Outputs", blocks=[_outputs(result)]),
        Section(title="Sobol indices", blocks=_indices(result)),
        Section(title="The samples", blocks=_samples(result)),
        *_member_waves(runs, int(result.get("samples", 0))),
        pictures(folder),
    ]
    first = next(iter(runs.values()), None)
    title = str(result.get("title") or Path(str(result.get("study", name))).name)
    return Chapter(
        title=f"Uncertain inputs: {title}", about=name, sections=[*sections, *of_member(first, "a sample")]
    )


def _sample_study(folder: Path, result: Mapping[str, Any]) -> list[Block]:
    """Return what was sampled and where the distributions are from."""
    about: list[tuple[str, Cell]] = [
        (key, result.get(key)) for key in ("study", "case", "target", "version", "samples")
    ]
    about += [(f"design: {key}", value) for key, value in result.get("design", {}).items()]
    about += [("changes of the case", ", ".join(result.get("changes", ())) or "none")]
    blocks: list[Block] = [Table(caption="The study", headings=("what", "value"), rows=about)]
    groups = {name: group for group, names in result.get("groups", {}).items() for name in names}
    drawn = result.get("members", {}).get("inputs", {})
    rows: list[tuple[Cell, ...]] = []
    for one in result.get("inputs", ()):
        values = np.asarray(drawn.get(one["name"], ()), dtype=float)
        ends = (float(values.min()), float(values.max())) if len(values) else (None, None)
        rows.append(
            (
                one["name"],
                one["key"],
                pretty(one["unit"]) or "-",
                one.get("from", "not recorded"),
                groups.get(one["name"], "-"),
                *ends,
            )
        )
    headings = (
        "input",
        "key",
        "unit",
        "distribution, and where it is from",
        "group",
        "smallest drawn",
        "largest drawn",
    )
    blocks.append(Table(caption="Uncertain inputs", headings=headings, rows=rows))
    blocks += [
        Note(text=note, tone="warning" if "FAILED" in note or note.startswith("NO VALUE") else "plain")
        for note in result.get("notes", ())
    ]
    return [*blocks, *files_of(folder, ("sample.json", "samples.csv"))]


def _failed(result: Mapping[str, Any]) -> list[Block]:
    failed = result.get("failed")
    if failed is None:
        return [missing("Which samples failed is not recorded.")]
    if not failed:
        return [Note(text="No sample failed.")]
    said = f"{len(failed)} of {result['samples']} samples failed and are in no number: all holds for the others only."
    rows = [(f"sample {number}", why) for number, why in failed.items()]
    return [
        Note(text=said, tone="warning"),
        Table(caption="Samples that failed, and why", headings=("sample", "reason"), rows=rows),
    ]


def _outputs(result: Mapping[str, Any]) -> Block:
    rows = [
        (
            row["output"],
            *(or_dash(row.get(key)) for key in ("mean", "std", "median", "low", "high")),
            row["count"],
            row["text"],
        )
        for row in result.get("outputs", ())
    ]
    if not rows:
        return missing("No output was found in the samples.")
    headings = ("output", "mean", "std", "median", "2.5 %", "97.5 %", "samples", "how")
    return Table(
        caption="Outputs with their 95 % intervals, of the named inputs alone", headings=headings, rows=rows
    )


def _indices(result: Mapping[str, Any]) -> list[Block]:
    """Return the indices of every output and group with their intervals."""
    rows: list[tuple[Cell, ...]] = []
    said: list[Block] = []
    for row in result.get("outputs", ()):
        if "DO NOT TRUST" in row["text"]:
            said.append(Note(text=f"{row['output']}: {row['text']}.", tone="warning"))
        for one in row["indices"]:
            rows.append(
                (
                    f"{row['output']}, {one['group']}",
                    one["first"],
                    *one["first_interval"],
                    one["total"],
                    *one["total_interval"],
                )
            )
    if not rows:
        return [missing("No output has indices.")]
    headings = (
        "output, input",
        "first order",
        "95 % from",
        "95 % to",
        "total",
        "total, 95 % from",
        "total, 95 % to",
    )
    what = (
        "First order: the part of the variance that goes when this input is known. Total: the part that stays when all "
        "others are known."
    )
    return [*said, Table(caption="Sobol indices", headings=headings, rows=rows), Note(text=what)]


def _samples(result: Mapping[str, Any]) -> list[Block]:
    """Return the samples one by one."""
    members = result.get("members")
    if not members:
        return [missing("The result does not hold the samples themselves: samples.csv beside it does.")]
    columns = {**members["inputs"], **members["outputs"]}
    rows = [
        (f"sample {k}", state, *(or_dash(values[k]) for values in columns.values()))
        for k, state in enumerate(members["state"])
    ]
    kept, text = rows[:MOST_ROWS], f"Inputs and outputs of {len(rows)} samples"
    more = [missing(f"{len(rows) - len(kept)} more are in samples.csv.")] if len(rows) > len(kept) else []
    return [Table(caption=text, headings=("sample", "state", *columns), rows=kept, folded=text), *more]


def _member_waves(runs: Mapping[str, Run], samples: int) -> list[Section]:
    """Return the waveforms of samples that are runs."""
    if not runs:
        return []
    blocks = [over_one_another(runs)]
    if samples > len(runs):
        blocks.append(
            missing(
                f"Of {samples} samples {len(runs)} are drawn: of the first {MOST_CURVES} those that ended."
            )
        )
    return [Section(title="Waveforms of the samples over one another", blocks=blocks)]
