"""What a valve lab reports, from the history of a run: numbers of each cycle and a picture of the waveforms."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from valvefsi.case.circulation import connected
from valvefsi.case.models import Case
from valvefsi.diagnostics.valve_numbers import CycleNumbers, cycle_change, valve_numbers
from valvefsi.diagnostics.valve_record import ValveRecord, ValveTest
from valvefsi.io.history import read_history
from valvefsi.units import MMHG

ENDS = ("z_lower", "z_upper")
"""Sides upstream and downstream of a valve."""
SANE = {
    "mean difference": (2.0, 20.0, "mmHg"),
    "closing volume": (0.0, 10.0, "% of stroke volume"),
    "leakage volume": (0.0, 5.0, "% of stroke volume"),
    "largest open area": (50.0, 95.0, "% of the orifice"),
    "volume change of the leaflets": (-1.0, 1.0, "%"),
}
"""What is sane for a valve in a pulse duplicator: lower and upper end, unit."""


def report_valve(case: Case, out: Path) -> dict[str, object]:
    """Return the numbers of a valve between two circuits for ``summary.json``, and draw ``valve.png``.

    Empty for a case without a valve in a housing whose ends have circuits, and for a run that recorded too little.
    """
    if case.housing is None or case.housing.stent is None or not set(ENDS) <= set(connected(case)):
        return {}
    history = {name: np.array(column) for name, column in read_history(Path(out) / "history.csv").items()}
    if len(history["t_s"]) < 3:
        return {}
    record, test = _record(case, history), _test(case)
    cycles = valve_numbers(record, test)
    change, why = cycle_change(record)
    numbers = [_told(cycle) for cycle in cycles]
    _draw(case, out, record, cycles[-1])
    return {
        "valve": {
            "cycles": numbers,
            "change_between_cycles": change,
            "reasons": sorted(set(why.values())),
            "sane": _sane(case, history, cycles[-1].as_dict()),
        }
    }


def _told(cycle: CycleNumbers) -> dict[str, object]:
    """The numbers that a cycle has, and what is missing, by its reason."""
    known = {name: value for name, value in cycle.in_lab_units().items() if value is not None}
    missing: dict[str, list[str]] = {}
    for name, reason in cycle.reasons.items():
        missing.setdefault(reason, []).append(name)
    return known | ({"missing": missing} if missing else {})


def _record(case: Case, history: dict[str, np.ndarray]) -> ValveRecord:
    drive = next(c for c in case.circuit if c.name == connected(case)[ENDS[0]])
    period = drive.pump.period or case.time.t_end
    return ValveRecord(
        t=history["t_s"],
        p_lv=history[f"p_{ENDS[0]}_mmHg"] * MMHG,
        p_ao=history[f"p_{ENDS[1]}_mmHg"] * MMHG,
        q=history[f"q_{ENDS[1]}_ml_s"],
        pdva=history["pdva_cm2"],
        period=period,
    )


def _test(case: Case) -> ValveTest:
    diameter = next(s.mesh.valve.diameter for s in case.solid if s.name == case.housing.stent)
    return ValveTest(rho=case.fluid.density, mu=case.fluid.viscosity, diameter=diameter)


def _sane(case: Case, history: dict[str, np.ndarray], cycle: dict[str, object]) -> dict[str, object]:
    """Compare the last cycle with what is sane; None where there is no number."""
    forward, name = cycle["forward_volume"], case.housing.stent
    orifice = math.pi * (0.5 * _test(case).diameter) ** 2
    change = history[f"{name}_volume_change_percent"]

    def part(value: float | None, whole: float | None) -> float | None:
        return None if value is None or not whole else 100.0 * value / whole

    difference = cycle["mean_pressure_difference"]
    values = {
        "mean difference": None if difference is None else difference / MMHG,
        "closing volume": part(cycle["closing_volume"], forward),
        "leakage volume": part(cycle["leakage_volume"], forward),
        "largest open area": part(float(history["pdva_cm2"].max()), orifice),
        "volume change of the leaflets": float(change[np.argmax(np.abs(change))]),
    }
    return {
        key: {
            "value": value,
            "from": SANE[key][0],
            "to": SANE[key][1],
            "unit": SANE[key][2],
            "sane": None if value is None else bool(SANE[key][0] <= value <= SANE[key][1]),
        }
        for key, value in values.items()
    }


def _draw(case: Case, out: Path, record: ValveRecord, cycle: CycleNumbers) -> None:
    from valvefsi.io.valve_waveform_plots import valve_waveforms

    waves = {"t": record.t, "p_lv": record.p_lv, "p_ao": record.p_ao, "q": record.q, "pdva": record.pdva}
    if cycle.forward_start is not None:
        waves["forward"] = np.array([[cycle.start + cycle.forward_start, cycle.start + cycle.forward_end]])
    valve_waveforms(Path(out) / "valve.png", waves, title=case.title)
