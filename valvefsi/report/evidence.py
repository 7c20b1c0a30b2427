"""What a run's results rest on: its own balances, and the committed results that apply to what it uses."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import valvefsi
from valvefsi.case import Case
from valvefsi.case.valve import find_valve
from valvefsi.report.blocks import Block, Cell, Section, Table, is_numeric, missing
from valvefsi.report.runs import Run
from valvefsi.report.words import TERMS, pretty

VALVE = (
    "valve-beat",
    "valve-measured",
    "valve-size",
    "valve-grid",
    "valve-kappa",
    "valve-steady",
    "leakage",
    "held-outside",
)
APPLIES = {
    "a valve in a flow loop": VALVE,
    "solid-shell elements": ("bending", "thick-shells", "shells", "strips"),
    "solids immersed in a fluid": ("compression", "plate", "kernels", "turek-fsi2", "sphere-in-cavity"),
    "a fluid in space": ("taylor-green", "tube", "sphere"),
    "a fluid in a plane": ("cavity", "channel", "cylinder"),
    "fits": ("fits",),
}
"""Committed results, by what they are evidence for."""


def the_evidence(run: Run, *, studied: bool = False) -> Section:
    """Return the balances of a run and the committed results that apply to it.

    Args:
        run: The run.
        studied: Whether it is a member of a study that the page is of.
    """
    blocks: list[Block] = [*_energy(run), *_volume(run), *_periodic(run)]
    if not studied:
        blocks.append(
            missing(
                "Whether the numbers depend on grid and time step is not known from one run: no study of several grids "
                "of this case stands on this page."
            )
        )
    blocks += committed(_features(run.case) if run.case is not None else ())
    return Section(title="Evidence", blocks=blocks)


def _energy(run: Run) -> list[Block]:
    """Return the balance of energy."""
    energy: Mapping[str, Any] = run.summary.get("energy", {})
    if not energy:
        return [missing("The balance of energy was not recorded (output.energy = true records it).")]
    rows: list[tuple[Cell, ...]] = []
    for name, value in energy.items():
        term = name.removesuffix("_erg")
        joule = name.endswith("_erg")
        shown = 1e-4 * value if joule and value is not None else value
        kind, _, body = term.partition("_")
        said = TERMS.get(term) or {"stored": f"stored by {body}", "lost": f"lost by {body}"}.get(kind, "")
        rows.append((term.replace("_", " "), shown, "mJ" if joule else "%", said))
    caption = "Balance of energy from the first row of the history to the last"
    return [Table(caption=caption, headings=("term", "value", "unit", "meaning"), rows=rows)]


def _volume(run: Run) -> list[Block]:
    """Return how far the solids keep their volume, over the whole run."""
    rows: list[tuple[Cell, ...]] = []
    for column, values in run.history.items():
        name = re.sub("_(volume|area)_change_percent$", "", column)
        if name != column and len(values):
            least, most = (run.history.get(f"{name}_J_{end}") for end in ("min", "max"))
            change = float(values[np.abs(values).argmax()])
            ends = (
                None if least is None else float(least.min()),
                None if most is None else float(most.max()),
            )
            rows.append((name, change, *ends))
    if not rows:
        return []
    headings = ("solid", "largest change of volume (area in a plane) [%]", "smallest J", "largest J")
    return [
        Table(
            caption="Volume of the solids over the run (1 is kept, J = det F)", headings=headings, rows=rows
        )
    ]


def _periodic(run: Run) -> list[Block]:
    """Return how far the last two cycles of a valve are apart."""
    change = run.summary.get("valve", {}).get("change_between_cycles", {})
    if not change:
        return []
    rows = [(name, None if value is None else 100.0 * value) for name, value in change.items()]
    caption = "Change from the last but one whole cycle to the last, |x - x_before| / |x| in L2"
    return [Table(caption=caption, headings=("waveform", "change [%]"), rows=rows)]


def _features(case: Case) -> Iterator[str]:
    """Yield what of `APPLIES` a case uses."""
    if find_valve(case) is not None:
        yield "a valve in a flow loop"
    if any(solid.element == "solid_shell" for solid in case.solid):
        yield "solid-shell elements"
    if case.solid:
        yield "solids immersed in a fluid"
    yield "a fluid in space" if case.grid.dim == 3 else "a fluid in a plane"


def committed(features: Any) -> list[Block]:
    """Return the committed results for some features, each file with its date, and its comparisons folded away."""
    folder = Path(valvefsi.__file__).parents[1] / "docs" / "results"
    names = {name: feature for feature in features for name in APPLIES[feature]}
    found = {
        name: json.loads((folder / f"{name}.json").read_text())
        for name in names
        if (folder / f"{name}.json").is_file()
    }
    if not found:
        return [missing("The committed results (docs/results) are not beside this installation.")]
    rows: list[tuple[Cell, ...]] = []
    for name, result in found.items():
        compared = [
            q for q in result["quantities"] if is_numeric(q.get("reference")) and is_numeric(q["computed"])
        ]
        counts = (len(result["quantities"]), len(compared))
        rows.append(
            (
                result["title"],
                names[name],
                *counts,
                result["date"],
                result["commit"],
                f"docs/results/{name}.json",
            )
        )
    headings = ("result", "evidence for", "numbers", "with a reference", "date", "commit", "file")
    caption = "Committed results of this program that apply to what was run here"
    return [Table(caption=caption, headings=headings, rows=rows), *_comparisons(found)]


def _comparisons(found: Mapping[str, Mapping[str, Any]]) -> list[Block]:
    """Return what these results compare with what."""
    rows: list[tuple[Cell, ...]] = []
    for name, result in found.items():
        for q in result["quantities"]:
            if "reference" in q:
                words = ", ".join(filter(None, (q.get("case", ""), q["quantity"])))
                rows.append(
                    (
                        words,
                        q["computed"],
                        q["reference"],
                        _off(q),
                        pretty(q.get("unit", "")),
                        q.get("source", ""),
                        name,
                    )
                )
    headings = ("quantity", "computed", "reference", "difference [%]", "unit", "source", "result")
    text = f"Committed numbers beside their references ({len(rows)})"
    return [Table(caption=text, headings=headings, rows=rows, folded=text)] if rows else []


def _off(row: Mapping[str, Any]) -> Cell:
    """Return the difference to a reference in per cent, a dash where that means nothing."""
    value, reference = row["computed"], row["reference"]
    if not is_numeric(value) or not is_numeric(reference) or not reference:
        return "-"
    return float(100.0 * (value - reference) / abs(reference))
