"""Numbers, curves, pictures and warnings of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from valvefsi.case.valve_report import valve_columns
from valvefsi.post.columns import units_of_run
from valvefsi.report.blocks import Block, Cell, Figure, Note, Section, Table, missing, packed, picture
from valvefsi.report.runs import Run
from valvefsi.report.words import FITTED_PROFILES, PEAKS, PICTURES, defined, definitions, pretty
from valvefsi.types import Array
from valvefsi.units import MMHG

WAVES = {"p_lv": "before the valve", "p_ao": "after the valve", "q": "flow", "pdva": "open area"}
PANELS = (
    ("pressure [mmHg]", "mmHg", ("p_lv", "p_ao")),
    ("flow [ml/s]", "ml/s", ("q",)),
    ("open area [cm²]", "cm²", ("pdva",)),
)
"""Panels of the waveforms of a valve: label, unit, waveforms."""
MOST_ROWS = 4000
"""Rows of a history that a chart shows."""
MOST_PANELS = 10
LONGEST_PICTURES = 12
"""Most pictures of a folder that go into a page."""


def curve(
    name: str, x: Array, y: Array, colour: int, *, band: Array | None = None, dash: str = "solid"
) -> dict[str, Any]:
    """Return a curve of a chart; a band lies this far to both sides of it."""
    around = {} if band is None else {"band": packed(band)}
    return {"name": name, "x": packed(x), "y": packed(y), "colour": colour, "dash": dash, **around}


def waveforms(run: Run) -> Section:
    """Return the curves of a run: pressures, flow and open area of a valve, else what its history holds."""
    t = run.history.get("t_s", np.zeros(0))
    if len(t) < 2:
        return Section(title="Curves", blocks=[missing("There is no history to draw.")])
    kept = np.unique(np.linspace(0, len(t) - 1, min(len(t), MOST_ROWS)).round().astype(int))
    panels = _valve_panels(run, kept) or _panels(run, kept)
    if not panels:
        return Section(title="Curves", blocks=[missing("Nothing in the history changes.")])
    caption = f"From history.csv, {len(kept)} of {len(t)} rows; point at a curve to read it."
    names = ", ".join(str(panel["label"]) for panel in panels)
    figure = Figure(
        kind="chart",
        alt=f"Curves over time: {names}.",
        caption=caption,
        data={"x": {"label": "t [s]"}, "panels": panels},
    )
    return Section(title="Curves", blocks=[figure])


def _valve_panels(run: Run, kept: Array) -> list[dict[str, Any]]:
    """Return the panels of a valve between two circuits; none for another run."""
    columns = None if run.case is None else valve_columns(run.case)
    if columns is None or any(column not in run.history for column, _ in columns.values()):
        return []
    waves = {name: run.history[column] * unit for name, (column, unit) in columns.items()}
    if "pdva_cm2" in run.history:
        waves["pdva"] = run.history["pdva_cm2"]
    t, found = run.history["t_s"][kept], []
    for label, unit, names in PANELS:
        scale = MMHG if unit == "mmHg" else 1.0
        curves = [
            curve(WAVES[name], t, waves[name][kept] / scale, 1 - k if len(names) > 1 else 2)
            for k, name in enumerate(names)
            if name in waves
        ]
        if curves:
            found.append({"label": label, "unit": unit, "curves": curves})
    return found


def _panels(run: Run, kept: Array) -> list[dict[str, Any]]:
    """Return a panel for each unit that columns of a history have, of those that change."""
    groups: dict[str, list[tuple[str, Array]]] = {}
    units = units_of_run(run.folder)
    for name, values in run.history.items():
        if name in ("step", "t_s") or name.startswith("energy_") or not np.ptp(values) > 0:
            continue
        shown = units.of(name)
        groups.setdefault(pretty(shown.unit), []).append((shown.words, shown.factor * values[kept]))
    t = run.history["t_s"][kept]
    return [
        {
            "label": f"[{unit or '-'}]" if len(group) > 1 else f"{group[0][0]} [{unit or '-'}]",
            "unit": unit,
            "curves": [curve(words, t, values, k) for k, (words, values) in enumerate(group)],
        }
        for unit, group in list(groups.items())[:MOST_PANELS]
    ]


def numbers(run: Run) -> Section:
    """Return the numbers of a run with what they mean."""
    valve = run.summary.get("valve", {})
    blocks: list[Block] = []
    if not run.summary:
        blocks.append(missing("There is no summary.json to take numbers from: the run has not ended."))
    if valve.get("cycles"):
        blocks += _cycles(valve["cycles"])
    blocks += [missing(f"Of the valve: {why}.") for why in valve.get("reasons", ())]
    blocks += _plausible(valve.get("plausible", {}))
    blocks += _leaflets(valve.get("leaflets", {}))
    if run.summary.get("last"):
        last = [(name, value) for name, value in run.summary["last"].items()]
        headings, caption = (
            ("column, its unit last", "value"),
            "The last row of the history, as the summary has it",
        )
        blocks.append(Table(caption=caption, headings=headings, rows=last, folded=caption if valve else ""))
    return Section(title="Numbers", blocks=blocks)


def _cycles(cycles: Sequence[Mapping[str, Any]]) -> list[Block]:
    """Return the hydrodynamic numbers of each cycle, with definitions and why some are missing."""
    known = definitions()
    names = [n for n in dict.fromkeys(n for cycle in cycles for n in cycle) if n not in ("cycle", "missing")]
    rows: list[tuple[Cell, ...]] = []
    for name in names:
        words, unit, meaning = defined(name, known)
        rows.append((words, *(cycle.get(name) for cycle in cycles), unit, meaning))
    headings = ("number", *(f"cycle {cycle['cycle']}" for cycle in cycles), "unit", "definition")
    blocks: list[Block] = [Table(caption="Hydrodynamic numbers of the valve", headings=headings, rows=rows)]
    for cycle in cycles:
        for why, lacking in cycle.get("missing", {}).items():
            listed = ", ".join(name.replace("_", " ") for name in lacking)
            blocks.append(missing(f"Missing of cycle {cycle['cycle']}: {listed}: {why}."))
    said = "Terms are those of ISO 5840; where it leaves a choice, valvefsi.post.valve_numbers says what is taken."
    return [*blocks, Note(text=said)]


def _plausible(judged: Mapping[str, Mapping[str, Any]]) -> list[Block]:
    """Return what is plausible for a valve in a pulse duplicator, and what the run gives."""
    if not judged:
        return []
    rows = [
        (name, it["value"], f"{it['from']:g} ... {it['to']:g}", it["unit"], it["plausible"])
        for name, it in judged.items()
    ]
    headings = ("number", "value", "plausible range", "unit", "inside")
    outside = [name for name, it in judged.items() if it["plausible"] is False]
    said = (
        [Note(text=f"Outside the plausible range: {', '.join(outside)}.", tone="warning")] if outside else []
    )
    return [*said, Table(caption="Plausibility of the last cycle", headings=headings, rows=rows)]


def _leaflets(leaflets: Mapping[str, Mapping[str, Mapping[str, float]]]) -> list[Block]:
    """Return the structural numbers: peaks of strain and stress in each leaflet, and when."""
    if not leaflets:
        return []
    names = list(dict.fromkeys(name for peaks in leaflets.values() for name in peaks))
    rows = [
        (
            name,
            *(peaks[key][what] if key in peaks else None for peaks in leaflets.values()),
            PEAKS.get(key, ""),
        )
        for key in names
        for name, what in ((key.replace("_", " "), "value"), (f"{key.replace('_', ' ')}, at [s]", "t_s"))
    ]
    headings = ("number", *(name.replace("_", " ") for name in leaflets), "definition")
    return [Table(caption="Peaks of strain and stress over all frames", headings=headings, rows=rows)]


def warnings_of(run: Run) -> Section:
    """Return warnings and recoveries, or that there were none."""
    timing = run.summary.get("timing", {})
    again, said = timing.get("recoveries", ()), timing.get("warnings", ())
    blocks: list[Block] = [Note(text=str(item["text"]), tone="warning") for item in said]
    blocks += [Note(text=f"On reading: {text}", tone="warning") for text in run.remarks]
    if not timing:
        blocks.append(missing("There is no summary.json: warnings and recoveries of the run are not known."))
    elif not said:
        blocks.append(Note(text="The run gave no warning."))
    if again:
        rows = [(k, r["t_s"], r["step"], r["dt_s"], r["reason"]) for k, r in enumerate(again, 1)]
        headings = ("recovery", "back to t [s]", "step", "new time step [s]", "reason")
        blocks.append(
            Table(caption="Recoveries: the run went back to a good state", headings=headings, rows=rows)
        )
    elif timing:
        blocks.append(Note(text="The run never had to go back."))
    return Section(title="Warnings and recoveries", blocks=blocks)


def pictures(folder: Path) -> Section:
    """Return the pictures of a folder."""
    found = sorted(Path(folder).glob("*.png"))
    blocks: list[Block] = [picture(path, _alt(path)) for path in found[:LONGEST_PICTURES]]
    if len(found) > LONGEST_PICTURES:
        left = ", ".join(path.name for path in found[LONGEST_PICTURES:])
        blocks.append(missing(f"Pictures that are not on this page: {left}."))
    return Section(title="Pictures", blocks=blocks or [missing("The folder holds no pictures.")])


def _alt(path: Path) -> str:
    if path.name == "profiles.png" and (path.parent / "fit.json").is_file():
        return FITTED_PROFILES
    return PICTURES.get(path.name, f"Picture {path.stem.replace('_', ' ')}.")
