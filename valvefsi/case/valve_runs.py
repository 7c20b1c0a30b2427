"""The whole cycles of a run with a valve, from the folder that the run left."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from valvefsi.case.models import Case
from valvefsi.case.reading import load_case
from valvefsi.case.valve_report import missing_columns, pump_of, valve_columns, valve_record, valve_test
from valvefsi.errors import CaseError
from valvefsi.io.history import read_history
from valvefsi.post.valve_beat import Beat
from valvefsi.post.valve_record import ValveRecord, ValveTest, cut, fault

SEAM = 0.05
"""Part of a waveform's range by which the ends of a cycle may differ before it is said."""
NAMES = {"p_lv": "p_lv", "p_ao": "p_ao", "q": "q_ao", "pdva": "pdva"}


def read_run(folder: Path, *, period: float | None = None, trust: bool = False) -> tuple[Case, Beat]:
    """Return the case of a run and its last whole cycle, see `read_beats`."""
    case, beats = read_beats(folder, period=period, trust=trust)
    return case, beats[-1]


def read_beats(folder: Path, *, period: float | None = None, trust: bool = False) -> tuple[Case, list[Beat]]:
    """Return the case of a run and its whole cycles.

    Cycles count from ``cycles_from`` of the pump, or from the start of the run.

    Args:
        folder: The folder of a run of a valve between two circuits, or sections called upstream and downstream.
        period: Length of a cycle; that of the pump's record unless given [s].
        trust: Whether Python files of materials may be run.

    Raises:
        CaseError: There is no such run, it lacks a column, or it is shorter than a cycle.
    """
    folder = Path(folder)
    for name in ("case.toml", "history.csv"):
        if not (folder / name).is_file():
            raise CaseError(f"there is no run of a valve here, {name} is missing", file=folder)
    case = load_case(folder / "case.toml", trust=trust)
    test = valve_test(case)
    record = _record(case, folder / "history.csv", period)
    whole = [k for k in range(record.num_cycles) if not fault(record, k)]
    if not whole:
        why = fault(record, 0) if record.num_cycles else f"the run ends at {record.t[-1]:.6g} s"
        message = f"no whole cycle of {record.period:.6g} s from {record.first:.6g} s on: {why}"
        raise CaseError(message, file=folder / "history.csv")
    return case, [_beat(folder.resolve().name, record, k, test) for k in whole]


def _beat(name: str, record: ValveRecord, k: int, test: ValveTest) -> Beat:
    """Return a whole cycle of a run."""
    cycle = cut(record, k)
    return Beat(
        name=name,
        t=cycle["t"][:-1],
        period=record.period,
        values={NAMES[signal]: cycle[signal][:-1] for signal in record.signals},
        start=record.first + k * record.period,
        test=test,
        notes=_seams(cycle, record.signals),
    )


def _record(case: Case, path: Path, period: float | None) -> ValveRecord:
    """Return the waveforms of a run, from its first cycle on."""
    if valve_columns(case) is None:
        message = "expected a valve between two circuits, or sections called upstream and downstream"
        raise CaseError(message, file=case.file)
    history = {name: np.array(column) for name, column in read_history(path).items()}
    if missing := missing_columns(case, history):
        raise CaseError(f"missing column{'s' * (len(missing) > 1)} {', '.join(missing)}", file=path)
    pump = pump_of(case)
    length = period or pump.period
    if length is None:
        raise CaseError("the pump has no period; give one with --period", file=case.file, key="period")
    try:
        record = valve_record(case, history, length)
        return replace(record, start=max(pump.cycles_from or 0.0, record.first))
    except ValueError as error:
        raise CaseError(str(error), file=path) from None


def _seams(cycle: dict[str, np.ndarray], names: tuple[str, ...]) -> tuple[str, ...]:
    """Return a note on waveforms that end elsewhere than they began."""
    apart = {
        NAMES[name]: abs(cycle[name][-1] - cycle[name][0]) / (np.ptp(cycle[name]) or 1.0) for name in names
    }
    far = [f"{name} by {100 * gap:.0f} %" for name, gap in apart.items() if gap > SEAM]
    return (
        (f"not periodic yet, the cycle ends elsewhere than it began: {', '.join(far)} of the range",)
        if far
        else ()
    )
