"""What the picture of a sweep shows: which numbers of the members' summaries, which waveforms of their histories."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from valvefsi.case.models import Case
from valvefsi.case.valve_report import has_valve, missing_columns, pump_of, valve_columns
from valvefsi.io.history import read_history
from valvefsi.post.columns import Units
from valvefsi.studies.members import Outcome
from valvefsi.studies.sweep import Sweep

VALVE = (
    "mean_pressure_difference_mmHg",
    "effective_orifice_area_cm2",
    "peak_pdva_cm2",
    "peak_flow_ml_per_s",
    "forward_volume_ml",
    "regurgitant_fraction_percent",
    "closing_volume_ml",
    "leakage_volume_ml",
)
"""Numbers of a valve's cycle that are drawn."""
DULL = ("step", "t_s", "energy_", "courant")
"""What the end of a history is not drawn of."""
FIRST = ("u_", "pdva_", "p_", "q_", "force_", "flow_", "pressure_")
"""What comes before the rest of it."""
MOST = 8
"""Panels of numbers."""
SAME = 1e-9
"""Part of its size by which a number must change to be drawn."""
LASTS = 1.5
"""Cycles of a run above which only its last cycle is drawn."""


def draw_sweep(
    sweep: Sweep, cases: Mapping[str, Case], outcomes: Sequence[Outcome], path: Path
) -> Path | None:
    """Draw numbers against the first parameter of a sweep, and the waveforms of valves.

    Args:
        sweep: The sweep.
        cases: The case of each member by its name.
        outcomes: How its members ended.
        path: The picture.

    Returns:
        The path, None where no member has anything to show.
    """
    from valvefsi.post.plots.sweep import SweepPicture, sweep_picture

    shown = [k for k, outcome in enumerate(outcomes) if outcome.state != "failed"]
    numbers = varying([outcomes[k].summary for k in shown])
    waves = [_waves(cases[outcomes[k].member.name], outcomes[k].folder) for k in shown]
    if not numbers and not any(waves):
        return None
    first = next((n for n, p in enumerate(sweep.parameters) if len(p.values) > 1), 0)
    rest = [n for n, p in enumerate(sweep.parameters) if n != first and len(p.values) > 1]
    parameter = sweep.parameters[first]
    case = next(iter(cases.values()))
    failed = len(outcomes) - len(shown)
    text = f"{len(shown)} of {len(outcomes)} members" if failed else f"{len(outcomes)} members"
    return sweep_picture(
        path,
        SweepPicture(
            label=parameter.label,
            x=[parameter.shown(sweep.points[k][first]) for k in shown],
            names=[", ".join(_said(sweep, k, n) for n in rest) for k in shown],
            numbers=numbers,
            waves=waves if any(waves) else (),
            members=[", ".join(_said(sweep, k, n, alone=not rest) for n in (first, *rest)) for k in shown],
            title=case.title or "sweep",
            units=Units(system=case.output.units, dim=case.grid.dim),
            caption=f"{text} over {' and '.join(p.short.replace('_', ' ') for p in sweep.parameters)}; "
            f"numbers: {moment([outcomes[k].summary for k in shown])}",
        ),
    )


def headlines(summary: Mapping[str, Any]) -> dict[str, float]:
    """Return the numbers of a run that are worth a picture, by name with unit.

    Those of the last whole cycle of a valve; else what the history ends with, displacements, area, pressures and
    flows first.
    """
    whole = [cycle for cycle in summary.get("valve", {}).get("cycles", []) if VALVE[0] in cycle]
    if whole:
        return {name: whole[-1][name] for name in VALVE if isinstance(whole[-1].get(name), float)}
    last = {name: value for name, value in summary.get("last", {}).items() if not name.startswith(DULL)}
    return dict(sorted(last.items(), key=lambda item: not item[0].startswith(FIRST)))


def moment(summaries: Sequence[Mapping[str, Any]]) -> str:
    """Return what the headlines of some members are of: their last whole cycle, or the last row of their history."""
    cycles = [any(VALVE[0] in c for c in s.get("valve", {}).get("cycles", [])) for s in summaries if s]
    cycle, end = "last whole cycle", "last values of each history"
    if any(cycles):
        return cycle if all(cycles) else f"{cycle}, without one the {end}"
    return end


def varying(summaries: Sequence[Mapping[str, Any]]) -> dict[str, np.ndarray]:
    """Return the first few headlines that change from member to member, NaN where a member has none.

    Args:
        summaries: The ``summary.json`` of each member, empty where it failed.

    Returns:
        Values of the members by name with unit, ``(num_members,)`` each.
    """
    found, numbers = [headlines(summary) for summary in summaries], {}
    for name in dict.fromkeys(name for values in found for name in values):
        values = np.array([row.get(name, np.nan) for row in found], dtype=float)
        known = values[np.isfinite(values)]
        if len(known) and (np.ptp(known) > SAME * np.abs(known).max() or len(found) == 1):
            numbers[name] = values
    return dict(list(numbers.items())[:MOST])


def _said(sweep: Sweep, member: int, number: int, *, alone: bool = False) -> str:
    """Return what a member's value of a parameter is called; its name is left out where it is the only one."""
    parameter, k = sweep.parameters[number], sweep.points[member][number]
    value = (
        f"{parameter.numbers[k]:g} {parameter.unit}".rstrip() if parameter.numbers else parameter.values[k]
    )
    return value if alone else f"{parameter.short.replace('_', ' ')} {value}"


def _waves(case: Case, folder: Path) -> dict[str, np.ndarray]:
    """Return the waveforms of a valve between two circuits or sections; of several cycles the last, from its start."""
    columns = valve_columns(case)
    if not has_valve(case) or columns is None or not (folder / "history.csv").is_file():
        return {}
    history = {name: np.array(column) for name, column in read_history(folder / "history.csv").items()}
    if missing_columns(case, history) or len(history["t_s"]) < 2:
        return {}
    t, period = history["t_s"], pump_of(case).period
    start = t[-1] - period if period and t[-1] > LASTS * period else 0.0
    part = t >= start
    waves = {name: unit * history[column][part] for name, (column, unit) in columns.items()}
    return {"t": t[part] - start, "pdva": history["pdva_cm2"][part], **waves}
