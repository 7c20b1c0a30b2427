"""Two runs of a valve, or a run and a record, over one another."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from valvefsi.case.values import case_differences
from valvefsi.case.valve import find_valve
from valvefsi.case.valve_views import draw_moments, moments, read_leaflets
from valvefsi.errors import CaseError
from valvefsi.post.valve_beat import QUANTITIES, Beat
from valvefsi.post.valve_comparison import DEFINITIONS, Pair, compare_pair
from valvefsi.report.blocks import Block, Cell, Chapter, Figure, Note, Section, Table, missing, picture
from valvefsi.report.results import PANELS, curve
from valvefsi.report.runs import Run
from valvefsi.report.scenes import MOST_FRAMES, frames_of
from valvefsi.report.words import defined, definitions
from valvefsi.units import MMHG

KINDS = {"l2_percent": "L2 [%]", "linf_percent": "Linf [%]", "nrmse_percent": "NRMSE [%]"}
OPEN = "open_over_10_percent"
WORDS = {
    "p_lv": "P_LV",
    "p_ao": "P_Ao",
    "q_ao": "Q_Ao",
    "q_ao_without_offset": "Q_Ao without offset",
    "pdva": "open area",
}


@dataclass(frozen=True, kw_only=True)
class Side:
    """One of the two that are compared.

    Attributes:
        beat: Its cycle.
        run: The run that it is of, None for a record.
    """

    beat: Beat
    run: Run | None = None


def compared(a: Side, b: Side, *, start: float = 0.0, shift_max: float = 7e-3) -> Chapter:
    """Return the part of a page on two beats, the second the reference.

    Args:
        a: The first.
        b: The second, the reference.
        start: Time in the cycle of B at which that of A begins [s].
        shift_max: Largest common shift of A [s].

    Raises:
        CaseError: The two cannot be compared.
    """
    pair, result = compare_pair(a.beat, b.beat, start=start, shift_max=shift_max)
    names = _names(result)
    sections = [_who(result), _norms(result), _curves(pair, result, names), _numbers(result, names)]
    sections += [_cases(a.run, b.run)] if a.run is not None and b.run is not None else []
    sections.append(_moments((a, b), names, pair))
    sections += [_scenes((a, b), names, pair)] if a.run is not None and b.run is not None else []
    about = (
        "A is compared with B, the reference: the last whole cycle of a run, the mean of a record's cycles."
    )
    return Chapter(title=f"{names['a']} against {names['b']}", about=about, sections=sections)


def _names(result: Mapping[str, Any]) -> dict[str, str]:
    return {side: f"{result[side]['name']} ({side.upper()})" for side in "ab"}


def _who(result: Mapping[str, Any]) -> Section:
    rows: list[tuple[Cell, ...]] = []
    for side in "ab":
        it = result[side]
        notes = "; ".join(it["notes"])
        rows.append(
            (
                side.upper(),
                it["name"],
                it["kind"],
                it["period_s"],
                it["cycle_from_s"],
                it["mean_of_cycles"],
                notes,
            )
        )
    headings = ("", "name", "kind", "period [s]", "cycle from [s]", "cycles in the mean", "notes")
    return Section(
        title="What is compared",
        blocks=[Table(caption="The two", headings=("side", *headings[1:]), rows=rows)],
    )


def _norms(result: Mapping[str, Any]) -> Section:
    shift = result["shift_ms"]
    rows: list[tuple[Cell, ...]] = []
    for name, row in result["quantities"].items():
        found = [row[which][kind] for which in ("as_they_are", "shifted") for kind in KINDS]
        repeats = row["repeatability_l2_percent"]
        rows.append((WORDS[name], *found, *(_dash(repeats[side]) for side in "ab")))
    headings = (
        "waveform",
        *KINDS.values(),
        *(f"{text} shifted" for text in KINDS.values()),
        "repeats A [%]",
        "repeats B [%]",
    )
    way = "earlier" if shift < 0 else "later"
    blocks: list[Block] = [
        Table(caption="How far A is from B, relative to B", headings=headings, rows=rows),
        Note(text=f"Shifted: all of A is moved {way} by {abs(shift):.2f} ms."),
    ]
    if result["shift_at_its_bound"]:
        blocks.append(Note(text="The shift is at its bound: a larger one may fit better.", tone="warning"))
    for side, offset in result["diastolic_offset_ml_per_s"].items():
        if offset is not None:
            said = f"The flow of {side.upper()} while the valve is shut is {offset:.3g} ml/s on average."
            blocks.append(Note(text=said))
    defined = list(result["definitions"].items())
    headings, text = ("number", "definition"), "Definitions of these numbers"
    return Section(
        title="Norms", blocks=[*blocks, Table(caption=text, headings=headings, rows=defined, folded=text)]
    )


def _dash(value: float | None) -> Cell:
    return "-" if value is None else value


def _curves(pair: Pair, result: Mapping[str, Any], names: Mapping[str, str]) -> Section:
    """Return the waveforms over one another, with the standard deviations of a record as a band."""
    shift, panels = 1e-3 * result["shift_ms"], []
    units = {name: (unit, MMHG if unit == "mmHg" else 1.0) for _, unit, of in PANELS for name in of}
    units["q_ao"] = units["q"]
    for name in (name for name in pair.quantities if name in QUANTITIES):
        unit, scale = units[name]
        x, y = pair.values(name)
        known = name in pair.b.deviations
        band = 2.0 * pair.b.deviation_at(name, pair.t) / scale if known else None
        moved = pair.values(name, shift)[0]
        curves = [
            curve(names["b"], pair.t, y / scale, 0, band=band),
            curve(names["a"], pair.t, x / scale, 1),
        ]
        curves.append(curve(f"A moved by {1e3 * shift:+.2f} ms", pair.t, moved / scale, 2, dash="dot"))
        panels.append({"label": f"{WORDS[name]} [{unit}]", "unit": unit, "curves": curves})
    caption = "One cycle on the clock of B. The band is twice the standard deviation of B, if it has one."
    listed = ", ".join(str(panel["label"]) for panel in panels)
    alt = f"Waveforms of {names['a']} and {names['b']} over one cycle: {listed}."
    data = {"x": {"label": "t in the cycle of B [s]"}, "panels": panels}
    return Section(title="Waveforms", blocks=[Figure(kind="chart", alt=alt, caption=caption, data=data)])


def _numbers(result: Mapping[str, Any], names: Mapping[str, str]) -> Section:
    known, rows = definitions() | {OPEN: DEFINITIONS[f"{OPEN}_ms"]}, list[tuple[Cell, ...]]()
    for name, row in result["numbers"]["rows"].items():
        words, unit, meaning = defined(name, known)
        apart = (_dash(row[key]) for key in ("difference", "difference_percent"))
        rows.append((words, row["a"], row["b"], *apart, unit, meaning))
    headings = ("number", names["a"], names["b"], "A - B", "over B [%]", "unit", "definition")
    blocks: list[Block] = [Table(caption="Numbers of the valve side by side", headings=headings, rows=rows)]
    missed = result["numbers"].get("missing", {})
    blocks += [missing(f"Missing of {side.upper()}: {why}.") for side, why in missed.items()]
    return Section(title="Numbers side by side", blocks=blocks)


def _cases(a: Run, b: Run) -> Section:
    title, caption = "What differs between the cases", "Keys of the cases that differ, CGS"
    if a.case is None or b.case is None:
        return Section(title=title, blocks=[missing(f"A case cannot be read: {a.why or b.why}")])
    rows = [
        (key, *("not there" if v is None else str(v) for v in pair))
        for key, pair in case_differences(a.case, b.case).items()
    ]
    if not rows:
        return Section(title=title, blocks=[Note(text="Nothing: the two cases have the same values.")])
    return Section(title=title, blocks=[Table(caption=caption, headings=("key", "A", "B"), rows=rows)])


def _window(side: Side) -> tuple[float, float]:
    return side.beat.start, side.beat.start + side.beat.period


def _moments(sides: Sequence[Side], names: Mapping[str, str], pair: Pair) -> Section:
    """Return end views of the leaflets of both at the same times of the cycle."""
    title, blocks = "Leaflets at the same moments", list[Block]()
    phases: Any = None
    for letter, side in zip("ab", sides, strict=True):
        if side.run is None or side.run.case is None or find_valve(side.run.case) is None:
            blocks.append(missing(f"{names[letter]} is a record, or has no leaflets: no pictures of them."))
            continue
        try:
            leaflets = read_leaflets(side.run.case, side.run.folder, _window(side))
        except CaseError as error:
            blocks.append(missing(f"No frames of {names[letter]}: {error}"))
            continue
        if len(leaflets.t) < 2:
            blocks.append(missing(f"{names[letter]} has fewer than two frames in its last whole cycle."))
            continue
        phase = leaflets.t - side.beat.start + (pair.start if letter == "a" else 0.0)
        if phases is None:
            phases = phase[moments(leaflets.t, leaflets.area)]
        apart = np.abs(
            (phase[None, :] - phases[:, None] + 0.5 * pair.b.period) % pair.b.period - 0.5 * pair.b.period
        )
        with tempfile.TemporaryDirectory() as folder:
            made = draw_moments(leaflets, side.run.case, apart.argmin(axis=1), Path(folder) / "leaflets.png")
            when = "at the moments nearest to those of A" if blocks else "at moments of its last whole cycle"
            said = f"{names[letter]}, from downstream, {when}"
            blocks.append(picture(made, f"Leaflets of {said}; what is dark is open.", f"{said}."))
    return Section(title=title, blocks=blocks)


def _scenes(sides: Sequence[Side], names: Mapping[str, str], pair: Pair) -> Section:
    """Return the bodies of both side by side over one clock."""
    title, period = "Scenes side by side", pair.b.period
    phases = np.linspace(0.0, period, MOST_FRAMES // 2, endpoint=False)
    panels, blocks = [], list[Block]()
    for letter, side in zip("ab", sides, strict=True):
        lag = pair.start if letter == "a" else 0.0
        times = side.beat.start + (phases - lag) % period
        try:
            found = None if side.run is None else frames_of(side.run, times=times.tolist())
        except CaseError as error:
            blocks.append(missing(f"The frames of {names[letter]} cannot be read: {error}"))
            continue
        if found is None:
            blocks.append(missing(f"{names[letter]} has no frames to show."))
            continue
        panels += [{**panel, "title": f"{panel['title']}: {names[letter]}"} for panel in found.panels]
    _one_scale(panels)
    if panels:
        scene = {
            "t": (1e3 * phases).tolist(),
            "unit": "ms",
            "clock": "time in the cycle of B",
            "panels": panels,
        }
        panels.sort(key=lambda panel: "bodies" not in panel)
        alt = " and ".join(str(panel["title"]) for panel in panels) + " over one cycle."
        caption = "Each at its frame nearest to the time of the slider; drag to turn."
        blocks.insert(0, Figure(kind="scene", alt=alt, caption=caption, data=scene))
    return Section(title=title, blocks=blocks)


def _one_scale(panels: Sequence[dict[str, Any]]) -> None:
    """Give fields of one name one scale, and planes too."""
    fields = [field for panel in panels for body in panel.get("bodies", ()) for field in body["fields"]]
    for one in (fields, [panel for panel in panels if "values" in panel]):
        for name in {field["name"] for field in one}:
            alike = [field for field in one if field["name"] == name]
            ends = min(field["low"] for field in alike), max(field["high"] for field in alike)
            for field in alike:
                field["low"], field["high"] = ends
