"""What pages of studies have in common: waveforms of members over one another, what is said of one, hashes of files."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from valvefsi.io.folder import sha256
from valvefsi.post.columns import units_of_run
from valvefsi.report.blocks import Block, Cell, Figure, Section, Table, missing
from valvefsi.report.evidence import the_evidence
from valvefsi.report.geometry import the_geometry
from valvefsi.report.inputs import the_case, what_was_run
from valvefsi.report.results import MOST_ROWS, curve, pictures, warnings_of
from valvefsi.report.runs import Run
from valvefsi.report.scenes import the_scene
from valvefsi.report.words import pretty
from valvefsi.types import Array
from valvefsi.verification.answers import why_no_order

FIRST = ("pdva_", "q_", "p_", "u_", "force_", "flow_", "pressure_")
"""Waveforms that are drawn before others."""
MOST = 6
"""Waveforms that are drawn."""
DULL = re.compile(r"step|t_s|energy_.*")
"""Columns of a history that are not drawn, beside those without an order."""


def over_one_another(runs: Mapping[str, Run]) -> Block:
    """Return the waveforms that all runs have, a panel for each and a curve for each run.

    Args:
        runs: The runs by what they are called.
    """
    histories = [run.history for run in runs.values() if len(run.history.get("t_s", ())) > 1]
    names = [n for n in (histories[0] if histories else ()) if all(n in history for history in histories)]
    names = [n for n in names if not DULL.fullmatch(n) and not why_no_order(n)]
    names = [n for n in names if any(np.ptp(history[n]) > 0 for history in histories)]
    names.sort(key=lambda name: (not name.startswith(FIRST), name))
    units = units_of_run(next(iter(runs.values())).folder)
    panels = []
    for name in names[:MOST]:
        shown = units.of(name)
        curves = [
            curve(member, run.history["t_s"][kept], shown.factor * run.history[name][kept], k)
            for k, (member, run) in enumerate(runs.items())
            if len(kept := _kept(run.history.get("t_s", np.zeros(0)))) > 1
        ]
        unit = pretty(shown.unit)
        panels.append({"label": f"{shown.words} [{unit or '-'}]", "unit": unit, "curves": curves})
    if not panels:
        return missing("The histories of the members are not there, or have nothing in common.")
    drawn, left = ", ".join(str(panel["label"]) for panel in panels), len(names) - len(panels)
    also = f" {left} more are in the members' history.csv." if left > 0 else ""
    caption = f"From history.csv of {len(histories)} members; point at a curve to read it.{also}"
    return Figure(
        kind="chart",
        alt=f"Curves over time, one for each member: {drawn}.",
        caption=caption,
        data={"x": {"label": "t [s]"}, "panels": panels},
    )


def _kept(t: Array) -> Any:
    return np.unique(np.linspace(0, len(t) - 1, min(len(t), MOST_ROWS)).round().astype(int)) if len(t) else t


def files_of(folder: Path, names: Sequence[str]) -> list[Block]:
    """Return the hashes of those of some files that are there, folded away."""
    rows = [(name, sha256(folder / name)) for name in names if (folder / name).is_file()]
    said = "Files that came out"
    return [Table(caption=said, headings=("file", "SHA-256"), rows=rows, folded=said)]


def of_member(run: Run | None, which: str) -> list[Section]:
    """Return what the page of a run says of one member.

    Args:
        run: The member, None for nothing.
        which: What it is called in headings.
    """
    if run is None:
        return []
    sections = [
        what_was_run(run),
        the_scene(run),
        warnings_of(run),
        the_evidence(run, studied=True),
        the_geometry(run),
        pictures(run.folder),
        the_case(run),
    ]
    return [Section(title=f"{part.title}, {which} ({run.name})", blocks=part.blocks) for part in sections]


def or_dash(value: Cell) -> Cell:
    """Return a cell, a dash for one that means nothing."""
    return "-" if value is None else value
