"""What a valve lab reports, from the history of a run: numbers of each cycle and a picture of the waveforms."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from valvefsi.case.circuit_tables import CircuitTable, Pump
from valvefsi.case.circulation import connected
from valvefsi.case.models import Case
from valvefsi.case.valve import find_valve, valve_of
from valvefsi.case.valve_motion import MEANINGS as MOTION
from valvefsi.case.valve_motion import coaptation_numbers, flutter_numbers, place_numbers, post_numbers
from valvefsi.case.valve_shear import MEANINGS as SHEAR
from valvefsi.case.valve_shear import shear_numbers
from valvefsi.case.valve_views import draw_leaflets, read_leaflets
from valvefsi.io.grid_files import times_of
from valvefsi.io.history import read_history
from valvefsi.post.valve_numbers import (
    CycleNumbers,
    cycle_change,
    lab_name,
    number_meanings,
    repeated_cycle,
    valve_numbers,
)
from valvefsi.post.valve_phases import Window, cycle_window
from valvefsi.post.valve_record import ValveRecord, ValveTest, fault, first_closed
from valvefsi.run.recorded_stress import leaflet_peaks
from valvefsi.units import MMHG

History = dict[str, np.ndarray]
ENDS = ("z_lower", "z_upper")
"""Sides upstream and downstream of a valve."""
SECTIONS = ("upstream", "downstream")
"""Names of the sections that stand in for circuits there."""
PLAUSIBLE = {
    "mean difference": (2.0, 20.0, "mmHg"),
    "closing volume": (0.0, 10.0, "% of stroke volume"),
    "leakage volume": (0.0, 5.0, "% of stroke volume"),
    "largest open area": (50.0, 95.0, "% of the orifice"),
    "volume change of the leaflets": (-1.0, 1.0, "%"),
    "change between cycles": (0.0, 10.0, "% of the waveform that changes most"),
    "cardiac output": (90.0, 110.0, "% of the target"),
    "mean aortic pressure": (90.0, 110.0, "% of the target"),
}
"""What is plausible for a valve in a pulse duplicator: lower and upper end, unit."""


def report_valve(case: Case, out: Path) -> dict[str, object]:
    """Return the numbers of a valve for ``summary.json``, and draw its pictures.

    Where the run has written frames: peaks of strain and stress in each leaflet, and by place; flutter, coaptation,
    shear stress and its exposure; ``leaflets.png`` and ``free_edges.png``. Numbers of each cycle and ``valve.png`` for
    a valve between two circuits, or two sections that are called upstream and downstream. What each means is beside
    them. Empty for a case without a valve.
    """
    if not has_valve(case):
        return {}
    draw_valve(case, out, out)
    return report_numbers(case, out)


def report_numbers(case: Case, folder: Path) -> dict[str, object]:
    """Return what `report_valve` does of a run in a folder, and draw nothing."""
    found = _cycles(case, folder)
    numbers = {} if found is None else _numbers(case, *found)
    leaflets = leaflet_peaks(folder)
    numbers |= {"leaflets": leaflets} if leaflets else {}
    numbers |= post_numbers(case, folder) | _of_frames(case, folder, found)
    if not numbers:
        return {}
    told = meanings()
    return {"valve": numbers | {"definitions": {name: told[name] for name in told if _is_in(name, numbers)}}}


def meanings() -> dict[str, str]:
    """Return what the numbers of a valve mean, by their names with units."""
    cycle = {lab_name(name): text for name, text in number_meanings().items()}
    return cycle | MOTION | SHEAR


def _is_in(name: str, numbers: Mapping[str, Any]) -> bool:
    """Whether a name is one of those of a report, or of its cycles."""
    return name in numbers or any(name in cycle for cycle in numbers.get("cycles", ()))


def _of_frames(
    case: Case, folder: Path, found: tuple[History, ValveRecord, list[CycleNumbers]] | None
) -> dict[str, object]:
    """Numbers of the leaflets' motion and of the shear stress in the last whole cycle, from the frames."""
    valve = valve_of(case)
    if not (Path(folder) / "paraview" / f"{valve.name}.pvd").is_file():
        return {}
    window = _window(case, folder, found)
    leaflets = read_leaflets(case, folder, (window.start, window.end))
    if len(leaflets.t) < 2:
        return {}
    return {
        "window": {"from_s": window.start, "to_s": window.end, "phases": list(window.names)},
        "flutter": flutter_numbers(folder, window),
        "coaptation": coaptation_numbers(case, leaflets, window),
        "places": place_numbers(case, folder, leaflets, window),
    } | shear_numbers(case, folder, window)


def _window(
    case: Case, folder: Path, found: tuple[History, ValveRecord, list[CycleNumbers]] | None
) -> Window:
    """Part of a run that its frames are reported of: the last whole cycle, else all that is averaged, else all."""
    if found is not None and found[2] and found[2][-1].net_volume is not None:
        _, record, cycles = found
        first = record.first + cycles[-1].cycle * record.period
        window = cycle_window(cycles[-1], record.period, first, first + record.period)
        if window is not None:
            return window
    times = [t for t, _ in times_of(Path(folder) / "paraview" / f"{valve_of(case).name}.pvd")]
    start = max(times[0], case.output.averages_from or 0.0)
    start = start if start < times[-1] else times[0]
    return Window(start=start, end=times[-1], forward=(start, times[-1]))


def has_valve(case: Case) -> bool:
    """Whether a case has a valve, meshed or of the user's own."""
    return find_valve(case) is not None


def draw_valve(case: Case, folder: Path, out: Path) -> list[Path]:
    """Draw the pictures of a valve that a run in a folder allows; the leaflets in its last whole cycle."""
    made, window, found = [], None, _cycles(case, folder)
    if found is not None and found[2]:
        _, record, cycles = found
        made.append(_draw(case, out, record, cycles[-1]))
        if cycles[-1].net_volume is not None:
            start = record.first + cycles[-1].cycle * record.period
            window = start, start + record.period
    return made + draw_leaflets(case, folder, out, window)


def _cycles(case: Case, out: Path) -> tuple[History, ValveRecord, list[CycleNumbers]] | None:
    """The history of a run, its record and its whole cycles, or the one begun last; None where there is no record."""
    path = Path(out) / "history.csv"
    if valve_columns(case) is None or not path.is_file():
        return None
    history = {name: np.array(column) for name, column in read_history(path).items()}
    if missing_columns(case, history) or len(history["t_s"]) < 3:
        return None
    record = _begun(case, valve_record(case, history, pump_of(case).period or case.time.t_end))
    begun = valve_numbers(record, valve_test(case))
    whole = [_uncut(case, record, c) for k, c in enumerate(begun) if not fault(record, k)]
    return history, record, whole or begun[-1:]


def _uncut(case: Case, record: ValveRecord, cycle: CycleNumbers) -> CycleNumbers:
    """A whole cycle, repeated where its edge cuts forward flow."""
    if cycle.forward_volume is not None and cycle.opening_start is not None:
        return cycle
    found = repeated_cycle(record, valve_test(case), cycle.cycle)
    return found if found is not None and found.forward_volume is not None else cycle


def _numbers(
    case: Case, history: History, record: ValveRecord, cycles: list[CycleNumbers]
) -> dict[str, object]:
    """The numbers of each cycle, and how they compare with what is plausible."""
    if not cycles:
        reason = f"the record ends before the first cycle starts, at {record.first:.6g} s"
        return {"cycles": [], "reasons": [reason]}
    change, why = cycle_change(record)
    return {
        "cycles": [_told(cycle) for cycle in cycles],
        "change_between_cycles": change,
        "reasons": sorted(set(why.values())),
        "plausible": _plausible(case, history, cycles[-1].as_dict(), change),
    }


def _told(cycle: CycleNumbers) -> dict[str, object]:
    """The numbers that a cycle has, and what is missing, by its reason."""
    told = cycle.in_lab_units().items()
    known = {name: value for name, value in told if value is not None and value is not False}
    missing: dict[str, list[str]] = {}
    for name, reason in cycle.reasons.items():
        missing.setdefault(reason, []).append(name)
    return known | ({"missing": missing} if missing else {})


def _circuit(case: Case, end: int) -> CircuitTable | None:
    """The circuit upstream (0) or downstream (1) of the valve, None without one."""
    name = connected(case).get(ENDS[end])
    return next((circuit for circuit in case.circuit if circuit.name == name), None)


def pump_of(case: Case) -> Pump:
    """What drives the circuit upstream of the valve, an empty table without one."""
    drive = _circuit(case, 0)
    return drive.pump if drive is not None else Pump()


def valve_columns(case: Case) -> dict[str, tuple[str, float]] | None:
    """Column and unit of the pressures and the flow: at the circuits, or at sections; None without either."""
    if set(ENDS) <= set(connected(case)):
        pressures = {"p_lv": (f"p_{ENDS[0]}_mmHg", MMHG), "p_ao": (f"p_{ENDS[1]}_mmHg", MMHG)}
        return pressures | {"q": (f"q_{ENDS[1]}_ml_s", 1.0)}
    if set(SECTIONS) <= {section.name for section in case.output.section}:
        p_lv, p_ao = ((f"pressure_{name}_dyn_per_cm2", 1.0) for name in SECTIONS)
        return {"p_lv": p_lv, "p_ao": p_ao, "q": (f"flow_{SECTIONS[1]}_cm3_per_s", 1.0)}
    return None


def missing_columns(case: Case, history: Collection[str]) -> list[str]:
    """Names of the columns that the history of a case with a valve between two circuits lacks."""
    columns = (column for column, _ in (valve_columns(case) or {}).values())
    return [name for name in ("t_s", *columns, "pdva_cm2") if name not in history]


def valve_record(case: Case, history: History, period: float) -> ValveRecord:
    """Pressures, flow and area of a whole run; cycles of a length [s] start with it."""
    waves: dict[str, Any] = {
        name: history[column] * unit for name, (column, unit) in (valve_columns(case) or {}).items()
    }
    return ValveRecord(t=history["t_s"], **waves, pdva=history["pdva_cm2"], period=period)


def valve_test(case: Case) -> ValveTest:
    """The fluid and the valve of a case."""
    return ValveTest(rho=case.fluid.density, mu=case.fluid.viscosity, diameter=valve_of(case).diameter)


def _begun(case: Case, record: ValveRecord) -> ValveRecord:
    """The record with cycles that start where the case says, or in the first closed phase."""
    pump = pump_of(case)
    start = first_closed(record) if pump.cycles_from is None else pump.cycles_from
    return record if start is None else replace(record, start=max(start, record.first))


def _plausible(
    case: Case, history: History, cycle: dict[str, Any], change: dict[str, float | None]
) -> dict[str, object]:
    """Compare the last cycle with what is plausible; None where there is no number."""
    forward, name = cycle["forward_volume"], valve_of(case).name
    orifice = math.pi * (0.5 * valve_test(case).diameter) ** 2
    swelling = history[f"{name}_volume_change_percent"]

    def part(value: float | None, whole: float | None) -> float | None:
        return None if value is None or not whole else 100.0 * value / whole

    difference = cycle["mean_pressure_difference"]
    values: dict[str, float | None] = {
        "mean difference": None if difference is None else difference / MMHG,
        "closing volume": part(cycle["closing_volume"], forward),
        "leakage volume": part(cycle["leakage_volume"], forward),
        "largest open area": part(float(history["pdva_cm2"].max()), orifice),
        "volume change of the leaflets": float(swelling[np.argmax(np.abs(swelling))]),
    }
    changes = [value for value in change.values() if value is not None]
    if len(changes) == len(change):
        values["change between cycles"] = 100.0 * max(changes)
    if case.target is not None:
        values["cardiac output"] = part(cycle["cardiac_output"], case.target.cardiac_output)
    outlet = _circuit(case, 1)
    if outlet is not None and outlet.target_pressure is not None:
        values["mean aortic pressure"] = part(cycle["mean_aortic_pressure"], outlet.target_pressure)
    return {
        key: {
            "value": value,
            "from": PLAUSIBLE[key][0],
            "to": PLAUSIBLE[key][1],
            "unit": PLAUSIBLE[key][2],
            "plausible": None if value is None else bool(PLAUSIBLE[key][0] <= value <= PLAUSIBLE[key][1]),
        }
        for key, value in values.items()
    }


def _draw(case: Case, out: Path, record: ValveRecord, cycle: CycleNumbers) -> Path:
    from valvefsi.post.plots.valve_waveform import valve_waveforms

    waves: dict[str, Any] = {
        "t": record.t,
        "p_lv": record.p_lv,
        "p_ao": record.p_ao,
        "q": record.q,
        "pdva": record.pdva,
    }
    if cycle.forward_start is not None and cycle.forward_end is not None:
        ends = np.array([[cycle.start + cycle.forward_start, cycle.start + cycle.forward_end]])
        waves["forward"] = ends - record.period * (ends[0, 1] > record.t[-1])
    return valve_waveforms(Path(out) / "valve.png", waves, title=case.title)
