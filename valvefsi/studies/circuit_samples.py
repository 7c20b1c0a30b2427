"""The flow loop with an orifice for all samples of its parameters at once: what a laboratory reports of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from pydantic_core import PydanticCustomError

from valvefsi.case.circuit_tables import UNITS, CircuitTable
from valvefsi.case.circulation import build_circulation, connected
from valvefsi.case.models import Case
from valvefsi.case.overrides import nearest
from valvefsi.case.quantities import Quantity
from valvefsi.case.sample_tables import OrificeModel
from valvefsi.case.valve_report import ENDS, pump_of, valve_test
from valvefsi.circulation.loop import FlowLoop
from valvefsi.circulation.orifice_samples import OrificeLoops, Orifices, Side
from valvefsi.errors import CaseError
from valvefsi.post.valve_beat import Beat
from valvefsi.types import Array
from valvefsi.units import MMHG

OWN_KEYS = {"orifice.area": "cm^2", "orifice.inertance": "g/cm^4", "fluid.density": "g/cm^3"}
DULL = ("start", "closing_volume", "leakage", "regurgitant")
"""Numbers of a beat that are none here: an orifice shuts without flowing back, and does not leak."""


@dataclass(frozen=True, kw_only=True)
class Sampled:
    """What came of samples.

    Attributes:
        outputs: Numbers of each sample by name with unit, NaN where there is none, ``(num_samples,)`` each.
        failures: Why samples failed, by their number.
    """

    outputs: Mapping[str, Array]
    failures: Mapping[int, str]


def run_circuits(
    case: Case, model: OrificeModel, keys: Sequence[str], units: Sequence[str], values: Array
) -> Sampled:
    """Run the loop of a case with an orifice for every sample to its periodic state.

    Args:
        case: The case of a valve between two circuits; its meshes are not looked at.
        model: The orifice and how the loop is run.
        keys: Keys of the inputs: ``circuit.NAME.PARAMETER``, ``orifice.area``, ``orifice.inertance`` or
            ``fluid.density``.
        units: Their units, "" for CGS.
        values: The inputs in these units, ``(num_samples, num_inputs)``.

    Raises:
        CaseError: The case has no two circuits around a valve and a periodic pump, or a key is none of these.
    """
    circuits = _circuits(case)
    known = [f"circuit.{c.name}.{f.name}" for c in circuits for f in fields(c.build().circuit)]  # type: ignore[arg-type]
    sampled = {
        key: _in_cgs(key, unit, values[:, k], [*OWN_KEYS, *known])
        for k, (key, unit) in enumerate(zip(keys, units, strict=True))
    }
    count = len(values)
    area, inertance, rho = (
        sampled.get(key, np.full(count, number))
        for key, number in zip(OWN_KEYS, (model.area, model.inertance, case.fluid.density), strict=True)
    )
    failures = {
        int(k): f"{key} = {sampled[key][k]:.4g}: expected a number above 0"
        for key in sampled
        for k in np.flatnonzero(sampled[key] <= 0.0)
    }
    good = np.array([k for k in range(count) if k not in failures], dtype=int)
    if not len(good):
        return Sampled(outputs={}, failures=failures)
    period = float(pump_of(case).period or 0.0)
    chosen = {key: numbers[good] for key, numbers in sampled.items()}
    inlet, outlet = (_side(case, c, chosen, len(good), model.steps) for c in circuits)
    valves = Orifices(loss=rho[good] / (2.0 * area[good] ** 2), inertance=inertance[good])
    waves, apart = OrificeLoops(valves, inlet, outlet, period).periodic(model.max_beats, model.tolerance)
    for k in np.flatnonzero(~(apart <= model.tolerance)):
        failures[int(good[k])] = f"not periodic after {model.max_beats} beats, it changes by {apart[k]:.2g}"
    rows: list[dict[str, float]] = [{} for _ in range(count)]
    for place, k in enumerate(good):
        if int(k) not in failures:
            rows[k] = _numbers(case, {name: wave[:, place] for name, wave in waves.items()}, period, rho[k])
    names = dict.fromkeys(name for row in rows for name in row)
    outputs = {name: np.array([row.get(name, np.nan) for row in rows]) for name in names}
    return Sampled(outputs=outputs, failures=failures)


def _circuits(case: Case) -> list[CircuitTable]:
    """Return the circuits upstream and downstream."""
    at = connected(case)
    found = [next((c for c in case.circuit if c.name == at.get(side)), None) for side in ENDS]
    if found[0] is None or found[1] is None:
        raise CaseError("the circuit alone needs a case with circuits at z_lower and z_upper", file=case.file)
    if pump_of(case).period is None:
        raise CaseError("the circuit alone needs a pump with a period", file=case.file, key="pump.period")
    return [circuit for circuit in found if circuit is not None]


def _in_cgs(key: str, unit: str, values: Array, known: Sequence[str]) -> Array:
    """Return the values of a key in CGS."""
    if key not in known:
        raise CaseError(f"the circuit alone has no such input{nearest(key, known)}", key=key)
    wanted = OWN_KEYS.get(key) or UNITS[key.rpartition(".")[2][0]]
    if not unit:
        return values
    try:
        return values * Quantity(wanted).parse(f"1 {unit}")
    except PydanticCustomError as error:
        raise CaseError(error.message(), key=key, value=unit) from None


def _side(case: Case, table: CircuitTable, sampled: Mapping[str, Array], count: int, steps: int) -> Side:
    """Return the circuit of each sample at one side."""
    period = float(pump_of(case).period or 0.0)
    built: Any = table.build().circuit
    own = {
        key.rpartition(".")[2]: values
        for key, values in sampled.items()
        if key.startswith(f"circuit.{table.name}.")
    }
    systems = [
        replace(built, **{name: float(values[k]) for name, values in own.items()}).system()
        for k in range(count)
    ]
    circulation = build_circulation(case)
    connections = circulation.connections if isinstance(circulation, FlowLoop) else ()
    drive = next(c for c in connections if connected(case)[c.side] == table.name)
    inputs = np.array([drive.inputs(period * step / steps, 0.0) for step in range(steps + 1)])
    start = np.array([table.start.get(name, 0.0) for name in systems[0].states])
    return Side(systems=systems, start=start, drive=inputs)


def _numbers(case: Case, waves: Mapping[str, Array], period: float, rho: float) -> dict[str, float]:
    """Return what a laboratory reports of a beat, and its pressures."""
    values = {name: wave[:-1] for name, wave in waves.items()}
    t = period * np.arange(len(values["q_ao"])) / len(values["q_ao"])
    test = replace(valve_test(case), rho=float(rho))
    found, _ = Beat(name="sample", t=t, period=period, values=values, test=test).numbers()
    numbers = {} if found is None else found.in_lab_units()
    kept = {
        name: value
        for name, value in numbers.items()
        if isinstance(value, float) and not name.startswith(DULL)
    }
    p_lv, p_ao = values["p_lv"] / MMHG, values["p_ao"] / MMHG
    return kept | {
        "peak_ventricular_pressure_mmHg": float(p_lv.max()),
        "systolic_aortic_pressure_mmHg": float(p_ao.max()),
        "diastolic_aortic_pressure_mmHg": float(p_ao.min()),
    }
