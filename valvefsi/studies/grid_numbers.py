"""What a study of grids shows: orders, extrapolated values and uncertainties of numbers and waveforms."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from valvefsi.case.valve_runs import read_run
from valvefsi.errors import CaseError
from valvefsi.io.history import read_history
from valvefsi.post.valve_beat import Beat
from valvefsi.post.valve_comparison import Pair
from valvefsi.studies.dependence import add_dependence
from valvefsi.studies.grid_study import GridStudy, too_few
from valvefsi.studies.members import Outcome, Values
from valvefsi.studies.sweep import scalars
from valvefsi.types import Array
from valvefsi.verification.answers import why_no_order
from valvefsi.verification.convergence import ROUND_OFF
from valvefsi.verification.norms import time_norm
from valvefsi.verification.refinement import refinement, two_grid_error, without_order

NO_ANSWER = re.compile(
    r"timing\..*|last\.(step|t_s)|.*\.plausible\..*\.(from|to)|.*\.cycles\.\d+\.(cycle|start_s)"
)
"""Numbers of a summary that are no answers: what the run took, and what it was asked for."""
NORMS = {"L2": 2.0, "Linf": math.inf}
STEP_ORDER = 1.0
"""Order of the time step that two of them are judged with: what the splitting of circuits and bodies guarantees."""
Waves = dict[str, Array]
Row = dict[str, Any]


def numbers_of(summary: Mapping[str, Any]) -> dict[str, float]:
    """Return the numbers of a ``summary.json`` that are answers, by their path."""
    found = scalars(dict(summary)).items()
    numbers = {
        name: value for name, value in found if isinstance(value, int | float) and not isinstance(value, bool)
    }
    return {name: float(value) for name, value in numbers.items() if not NO_ANSWER.fullmatch(name)}


def assess(study: GridStudy, outcomes: Sequence[Outcome], *, trust: bool = False) -> Values:
    """Return what ``verification.json`` holds.

    Args:
        study: The study.
        outcomes: How its members ended; what failed is left out of the numbers and named.
        trust: Whether Python files of materials may be run.
    """
    done = {outcome.member.name: outcome for outcome in outcomes if outcome.state != "failed"}
    pairs = [(m, h) for m, h in zip(study.grids, study.spacings, strict=True) if m.name in done]
    result: Values = {
        "grids": [{"member": m.name, "h_cm": h, "dt_s": study.cases[m.name].dt} for m, h in pairs],
        "expected_order": study.expected,
        "base": study.base.name,
        "notes": _few(study, len(pairs)) + study.notes(),
        "failed": {o.member.name: o.message for o in outcomes if o.state == "failed"},
        "quantities": [],
        "waveforms": [],
        "beats": [],
        "changes": [],
        "time_steps": [],
        "dependence": [],
        "iterations": {},
    }
    if not pairs:
        return result
    ratios = [a / b for (_, a), (_, b) in itertools.pairwise(pairs)]
    numbers, silent = without_round_off({name: numbers_of(o.summary) for name, o in done.items()})
    on_grids = [m.name for m, _ in pairs]
    result["quantities"] = _quantities([numbers[name] for name in on_grids], ratios, study.expected)
    waves, _ = without_round_off({name: _history(outcome) for name, outcome in done.items()})
    beats = {name: beat for name, outcome in done.items() if (beat := _beat(outcome, trust)) is not None}
    result["notes"] += _taken_as_zero(silent) + _gone(numbers, waves)
    result["waveforms"] = waveform_rows([waves[name] for name in on_grids], ratios, study.expected)
    if all(name in beats for name in on_grids):
        result["beats"] = beat_rows([beats[name] for name in on_grids])
    if study.base.name in done:
        kept = {key: m.name for key, m in _changes(study).items() if m.name in done}
        result["changes"] = [
            *_changed_numbers(numbers, study.base.name, kept),
            *changed_waves(waves, study.base.name, kept),
        ]
        result["time_steps"] = _time_steps(numbers, study, set(done))
        add_dependence(result, study, numbers[study.base.name])
    return result


def _few(study: GridStudy, done: int) -> list[str]:
    """Return what the grids that are done cannot say where others have failed."""
    return too_few(done, study.expected) if 0 < done < len(study.grids) else []


def _taken_as_zero(names: Iterable[str]) -> list[str]:
    said = ", ".join(sorted(names))
    return [f"round-off beside others of their unit, taken as zero: {said}"] if said else []


def _gone(numbers: Mapping[str, Mapping[str, float]], waves: Mapping[str, Waves]) -> list[str]:
    """Return which members that are done have left no numbers or no waveforms."""
    left = {"summary.json": ("number", numbers), "history.csv": ("waveform", waves)}
    return [
        f"MISSING FILE: {member}/{file} is not there or cannot be read: no {what} of {member} is in any table, "
        "and none that needs it on all grids"
        for file, (what, held) in left.items()
        for member, found in held.items()
        if not found
    ]


def _changes(study: GridStudy) -> dict[str, Any]:
    return {f"time step x {factor:g}": member for factor, member in study.steps.items()} | dict(study.changes)


def without_round_off(runs: Mapping[str, Mapping[str, Any]]) -> tuple[dict[str, Any], set[str]]:
    """Set to zero what is round-off in all runs beside the largest of its unit, with which a name ends.

    A displacement that symmetry forbids is 1e-14 and no answer; its changes would be by hundreds of per cent.

    Args:
        runs: Numbers or waveforms by name, of each run by its name.

    Returns:
        The same without round-off, and the names of what was round-off.
    """
    sizes: dict[str, float] = {}
    for numbers in runs.values():
        for name, value in numbers.items():
            known = np.abs(np.asarray(value, dtype=float))
            sizes[name] = max(sizes.get(name, 0.0), float(np.max(known[np.isfinite(known)], initial=0.0)))
    largest: dict[str, float] = {}
    for name, size in sizes.items():
        unit = name.rpartition("_")[2]
        largest[unit] = max(largest.get(unit, 0.0), size)
    silent = {
        name for name, size in sizes.items() if 0.0 < size <= ROUND_OFF * largest[name.rpartition("_")[2]]
    }
    return {
        run: {name: 0.0 * value if name in silent else value for name, value in numbers.items()}
        for run, numbers in runs.items()
    }, silent


def _quantities(grids: Sequence[Mapping[str, float]], ratios: Sequence[float], expected: float) -> list[Row]:
    """Return a row for every number that all grids have; one for which an order means nothing has its range."""
    rows = []
    for name in grids[-1]:
        if not all(name in numbers and math.isfinite(numbers[name]) for numbers in grids):
            continue
        values, why = [numbers[name] for numbers in grids], why_no_order(name)
        found = without_order(values, why) if why else refinement(values, ratios, expected)
        rows.append({"quantity": name, "values": values, **asdict(found)})
    return rows


def waveform_rows(grids: Sequence[Waves], ratios: Sequence[float], expected: float) -> list[Row]:
    """Return a row for every waveform and norm: the differences between successive grids, and what follows.

        e_k = ||M_k - M_{k+1}|| / ||M_finest||,   order from e_k / e_{k+1},   index 1.25 e / (r^p - 1)

    A norm of differences takes the place of a difference of values, so that p is that of the whole waveform; all is
    taken at the times of the grid with the fewest rows, as far as all runs go.

    Args:
        grids: Waveforms by column from the coarsest grid on, ``t_s`` among them.
        ratios: Between successive grids.
        expected: Expected order.
    """
    rows: list[Row] = []
    if len(grids) < 2 or not all("t_s" in waves for waves in grids):
        return rows
    t = _common(grids)
    for name in grids[-1]:
        if name in ("t_s", "step") or not all(name in waves for waves in grids):
            continue
        on = [np.interp(t, waves["t_s"], waves[name]) for waves in grids]
        for norm, q in NORMS.items():
            size = time_norm(t, on[-1], q)
            if not size > 0.0:
                continue
            gaps = [time_norm(t, b - a, q) / size for a, b in itertools.pairwise(on)]
            found = _ranging(why) if (why := why_no_order(name)) else _of_norms(gaps, ratios, expected)
            rows.append({"quantity": name, "norm": norm, "differences": gaps} | found)
    return rows


def _ranging(why: str) -> Row:
    """Return the row of a waveform for which an order means nothing."""
    return {"kind": "no order", "order": None, "index": None, "uncertainty": None, "text": f"no order: {why}"}


def _of_norms(gaps: Sequence[float], ratios: Sequence[float], expected: float) -> Row:
    """Return order, index and uncertainty of norms of differences, the size of the waveform being one."""
    if len(gaps) < 2 or gaps[-1] <= ROUND_OFF or gaps[-2] <= ROUND_OFF:
        bound = two_grid_error(gaps[-1], ratios[-1], expected)
        text = "two grids show no order" if len(gaps) < 2 else "the same to round-off: no order"
        return {"kind": "two grids" if len(gaps) < 2 else "unchanged", "order": None, "index": None} | {
            "uncertainty": bound,
            "text": text,
        }
    found = refinement([1.0 - gaps[-1] - gaps[-2], 1.0 - gaps[-1], 1.0], ratios[-2:], expected)
    return {name: getattr(found, name) for name in ("kind", "order", "index", "uncertainty", "text")}


def beat_rows(beats: Sequence[Beat]) -> list[Row]:
    """Return the norms of `valvefsi compare` between successive grids: the coarser's cycle less the finer's."""
    return [
        {"a": a.name, "b": b.name, "quantity": name, **pair.norms(name)}
        for a, b in itertools.pairwise(beats)
        if (pair := Pair(a=a, b=b))
        for name in pair.quantities
    ]


def _changed_numbers(
    numbers: Mapping[str, Mapping[str, float]], base: str, changed: Mapping[str, str]
) -> list[Row]:
    """Return by how much each number moves with each change of the base, alone."""
    return [
        {
            "quantity": name,
            "change": key,
            "base": value,
            "value": numbers[member][name],
            "difference": numbers[member][name] - value,
            "difference_percent": 100.0 * (numbers[member][name] - value) / abs(value) if value else None,
        }
        for key, member in changed.items()
        for name, value in numbers[base].items()
        if name in numbers[member]
    ]


def changed_waves(waves: Mapping[str, Waves], base: str, changed: Mapping[str, str]) -> list[Row]:
    """Return how far each waveform moves with each change, relative to the base's norm [%].

    Args:
        waves: Waveforms by column of each member by its name.
        base: Name of the base.
        changed: Name of the member of each change.
    """
    rows: list[Row] = []
    for key, member in changed.items():
        pair = [waves[base], waves[member]]
        if not all("t_s" in part for part in pair):
            continue
        t = _common(pair)
        for name in (name for name in pair[0] if name not in ("t_s", "step") and name in pair[1]):
            a, b = (np.interp(t, part["t_s"], part[name]) for part in pair)
            for norm, q in NORMS.items():
                if (size := time_norm(t, a, q)) > 0.0:
                    moved = 100.0 * time_norm(t, b - a, q) / size
                    rows.append({"quantity": name, "norm": norm, "change": key, "difference_percent": moved})
    return rows


def _time_steps(numbers: Mapping[str, Mapping[str, float]], study: GridStudy, done: set[str]) -> list[Row]:
    """Return what the steps say of each number: three or more an order, two an uncertainty with first order."""
    members = [(1.0, study.base), *study.steps.items()]
    members = [(factor, m) for factor, m in members if m.name in done]
    if len(members) < 2:
        return []
    ratios = [a / b for (a, _), (b, _) in itertools.pairwise(members)]
    rows = _quantities([numbers[m.name] for _, m in members], ratios, STEP_ORDER)
    return [{**row, "factors": [factor for factor, _ in members]} for row in rows]


def _common(grids: Sequence[Waves]) -> Array:
    """Return the times of the one with the fewest rows up to the earliest end of all: between rows nothing is known."""
    end = min(float(waves["t_s"][-1]) for waves in grids)
    t = min((waves["t_s"] for waves in grids), key=len)
    return t[t <= end * (1.0 + 1e-12)]


def _history(outcome: Outcome) -> Waves:
    path = outcome.folder / "history.csv"
    if not path.is_file():
        return {}
    columns = {name: np.array(column, dtype=float) for name, column in read_history(path).items()}
    return columns if len(columns.get("t_s", ())) else {}


def _beat(outcome: Outcome, trust: bool) -> Beat | None:
    """Return the last whole cycle of a run of a valve, None where there is none."""
    try:
        return read_run(outcome.folder, trust=trust)[1]
    except CaseError:
        return None
