"""The operating condition of a case: pump and peripheral resistance from the loop with an orifice for the valve.

In a periodic state the mean pressure over a downstream circuit is that of the mean flow,

    mean P_Ao = (R_p + R) mean Q,      R = R_c (three elements) or 0 (two, four),

so that the peripheral resistance R_p follows from the targets. The amplitude of the pump is the root of the loop's mean
flow less the target, at the target's pressure. Where a beat in three dimensions has shown another flow than the loop
under the same pump and pressure, by a factor, the response, the loop is asked for the target over it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.optimize import brentq

from valvefsi.bodies.body import Entry
from valvefsi.case.circuit_tables import CircuitTable
from valvefsi.case.circulation import build_circulation, connected
from valvefsi.case.models import Case
from valvefsi.case.schedule import end_of
from valvefsi.case.target_tables import Target
from valvefsi.case.valve import find_valve
from valvefsi.circulation.linear import CircuitState, LinearSystem
from valvefsi.circulation.loop import FlowLoop
from valvefsi.circulation.orifice import LoopState, Orifice, OrificeLoop
from valvefsi.errors import CaseError, raise_together
from valvefsi.post.valve_record import integral
from valvefsi.types import Array
from valvefsi.units import LITRE_PER_MINUTE, MMHG

STEPS = 300
"""Steps of a beat of the loop."""
MOST_BEATS = 40
"""Beats after which a loop is taken as it is."""
SAME = 1e-4
"""Relative change of mean flow and mean pressure from beat to beat below which the loop is settled."""
FACTOR, TRIALS = 1.25, 20
"""By what the pump's record is multiplied or divided until it brackets the target, and how often."""
CLOSE = 1e-4
"""How closely the amplitude is found."""
USUAL_PART = 0.6
"""Effective orifice area over that of the diameter, as the valves in docs/validation/valves.md have it."""
RESISTANCE = "R_p"
MOST_PRESSURE = 500.0 * MMHG
"""Pressure upstream of the valve that no pump of a pulse duplicator is asked for [dyn/cm^2]."""


@dataclass(frozen=True, kw_only=True)
class Chosen:
    """What was chosen for a target, and what comes of it by the loop with an orifice and the response of the valve.

    Attributes:
        inlet: Name of the circuit upstream.
        outlet: Name of the circuit downstream.
        amplitude: Factor on the pump's record.
        record_period: Length of a beat in the record [s].
        period: Length of a beat [s].
        resistance: Peripheral resistance R_p [dyn s/cm^5].
        start: States of both circuits at the start of a periodic beat, by circuit and name [CGS].
        cardiac_output: Mean flow, that of the loop times the response [cm^3/s].
        mean_aortic_pressure: Mean pressure downstream that belongs to it [dyn/cm^2].
    """

    inlet: str
    outlet: str
    amplitude: float
    record_period: float
    period: float
    resistance: float
    start: Mapping[str, Mapping[str, float]]
    cardiac_output: float = math.nan
    mean_aortic_pressure: float = math.nan


@dataclass(frozen=True, kw_only=True)
class _Beat:
    """A beat of the loop: mean flow, largest pressure upstream, state at which the next one begins."""

    flow: float
    peak: float
    end: LoopState


def at_target(case: Case, comm: MPI.Comm = MPI.COMM_SELF) -> tuple[Case, Chosen | None]:
    """Return a case with pump, peripheral resistance, start and length for its target, and what was chosen.

    What it returns does not depend on what an earlier call has chosen, so that it may be called with its own answer.

    Args:
        case: The case; one without a target is returned as it is.
        comm: Communicator of the run.

    Raises:
        CaseError: The case has no pump or orifice for it, or the target cannot be reached.

    Note:
        Collective; rank 0 chooses.
    """
    if case.target is None:
        return case, None
    found, error = None, None
    try:
        found = _choose(case, case.target) if comm.rank == 0 else None
    except CaseError as failure:
        error = failure
    raise_together(comm, error)
    chosen: Chosen = comm.bcast(found)
    return _with(case, chosen), chosen


def plan_target(case: Case, chosen: Chosen | None) -> list[Entry]:
    """Return the lines of a plan about what was chosen, and how far the loop is from the target."""
    if chosen is None or case.target is None:
        return []
    target, per_minute = case.target, case.target.beats_per_minute
    lines = [
        ("cardiac output", chosen.cardiac_output, target.cardiac_output, LITRE_PER_MINUTE, "l/min"),
        ("mean aortic pressure", chosen.mean_aortic_pressure, target.mean_aortic_pressure, MMHG, "mmHg"),
    ]
    note = f"{chosen.outlet}.{RESISTANCE}, from the targets"
    beat = (
        f"factor on the record, stretched from {chosen.record_period:.4g} s to {per_minute:g} beats a minute"
    )
    return [
        Entry(quantity="target: amplitude of the pump", value=chosen.amplitude, note=beat),
        Entry(
            quantity="target: peripheral resistance",
            value=chosen.resistance / MMHG,
            unit="mmHg*s/ml",
            note=note,
        ),
        *(
            Entry(
                quantity=f"target: {name} of the loop",
                value=value / unit,
                unit=word,
                note=f"{100.0 * (value / wanted - 1.0):+.2g} % from the target, {wanted / unit:.4g} {word}",
            )
            for name, value, wanted, unit, word in lines
        ),
    ]


def target_numbers(case: Case, chosen: Chosen) -> dict[str, Any]:
    """Return what was chosen, and what for, for ``summary.json``, CGS."""
    return {"wanted": case.target.model_dump(exclude_none=True) if case.target else {}, **asdict(chosen)}


def loop_of(case: Case) -> OrificeLoop:
    """Return the loop of a case with an orifice in place of its valve.

    Raises:
        CaseError: The case lacks a circuit on one side, a pump, or what the orifice is made from.
    """
    circulation = build_circulation(case)
    ends = circulation.connections if isinstance(circulation, FlowLoop) else ()
    by_flow = {name: c for c in ends for name in ("q_lv", "q_ao") if name in c.system.inputs}
    if len(by_flow) < 2:
        raise _error(case, "a target needs a circuit with a pump upstream of the valve, and one downstream")
    return OrificeLoop(orifice_of_case(case), by_flow["q_lv"], by_flow["q_ao"])


def orifice_of_case(case: Case) -> Orifice:
    """Return the orifice that stands for the valve of a case.

    Raises:
        CaseError: Area or inertance is not known, as there is no valve.
    """
    target, valve = case.target, find_valve(case)
    rho = case.fluid.density
    area, inertance = (target.orifice_area, target.inertance) if target else (None, None)
    if valve is not None:
        whole, (low, high) = 0.25 * math.pi * valve.diameter**2, case.grid.bounds[2]
        area, inertance = area or USUAL_PART * whole, inertance or rho * (high - low) / whole
    if area is None or inertance is None:
        key = "target.orifice_area" if area is None else "target.inertance"
        raise CaseError("this key is required in a case without a valve", file=case.file, key=key)
    return Orifice(area=area, inertance=inertance, rho=rho)


def flow_at(case: Case, pressure: float, flow: float) -> float:
    """Return the mean flow through the orifice of a case's loop, under its pump against a mean pressure [cm^3/s].

    Args:
        case: The case, with the pump that it ran with.
        pressure: Mean pressure downstream over a beat [dyn/cm^2].
        flow: Mean flow to begin with [cm^3/s].
    """
    return _settled(case, flow, pressure, []).flow


def _choose(case: Case, target: Target) -> Chosen:
    """Return what reaches the target."""
    inlet, outlet = _circuits(case)
    period, own = 60.0 / target.beats_per_minute, inlet.pump.record_period or inlet.pump.period
    if inlet.pump.file is None or own is None:
        key = f"circuit.{inlet.name}.pump.{'period' if inlet.pump.file else 'file'}"
        raise CaseError("a target needs the record of a pump, and its period", file=case.file, key=key)
    base = Chosen(
        inlet=inlet.name,
        outlet=outlet.name,
        amplitude=1.0,
        record_period=own,
        period=period,
        resistance=_resistance(case, outlet, target),
        start={},
    )
    wanted, last = target.cardiac_output / target.response, list[LoopState]()

    def beat(amplitude: float) -> _Beat:
        trial = _with(case, replace(base, amplitude=amplitude))
        found = _settled(trial, wanted, target.mean_aortic_pressure, last)
        last[:] = [found.end]
        return found

    def gap(amplitude: float) -> float:
        return beat(amplitude).flow - wanted

    low, high = _bracket(case, target, gap)
    amplitude = low if low == high else float(brentq(gap, low, high, xtol=CLOSE, rtol=CLOSE))
    found = beat(amplitude)
    _check_pressure(case, found.peak)
    ends = (inlet.build().circuit.system().states, outlet.build().circuit.system().states)
    at = (found.end.inlet.x, found.end.outlet.x)
    output = target.response * found.flow
    return replace(
        base,
        amplitude=amplitude,
        start={
            name: dict(zip(states, map(float, x), strict=True))
            for name, states, x in zip((inlet.name, outlet.name), ends, at, strict=True)
        },
        cardiac_output=output,
        mean_aortic_pressure=output * target.mean_aortic_pressure / target.cardiac_output,
    )


def _error(case: Case, message: str, key: str = "target", value: object = None) -> CaseError:
    return CaseError(message, file=case.file, key=key, value=value)


def _circuits(case: Case) -> tuple[CircuitTable, CircuitTable]:
    """Return the circuits upstream and downstream of the valve."""
    loop, names = loop_of(case), connected(case)
    inlet, outlet = (
        next(c for c in case.circuit if c.name == names[end.side]) for end in (loop.inlet, loop.outlet)
    )
    return inlet, outlet


def _resistance(case: Case, outlet: CircuitTable, target: Target) -> float:
    """Return R_p, of which the mean pressure is that of the mean flow."""
    kind, own = type(outlet.build().circuit), dict[str, Any](outlet.parameters)
    system = kind(**(own | {RESISTANCE: 1.0})).system()
    rest = float(system.C @ system.steady_state([1.0]) + system.D[0]) - 1.0
    wanted = target.mean_aortic_pressure / target.cardiac_output
    if wanted <= rest * (1.0 + 1e-9):
        least = rest * target.cardiac_output / MMHG
        message = (
            f"expected more than the {least:.4g} mmHg that the flow takes through {outlet.name}.R_c alone"
        )
        raise _error(case, message, "target.mean_aortic_pressure", target.mean_aortic_pressure)
    return wanted - rest


def _settled(case: Case, flow: float, pressure: float, last: list[LoopState]) -> _Beat:
    """Return a beat of the loop that has settled, its mean pressure downstream held.

    By itself a Windkessel takes many beats to settle. Here each beat begins with its pressure moved to where the mean
    of the beat is the one that is held; that is periodic where the flow is the one that belongs to it.

    Args:
        case: The case.
        flow: Mean flow to begin with, and to measure changes by [cm^3/s].
        pressure: Mean pressure downstream [dyn/cm^2].
        last: The state to begin with, at the start of a beat; none for the mean flow.
    """
    loop, period = loop_of(case), 60.0 / case.target.beats_per_minute if case.target else math.nan
    inputs = [loop.inlet.inputs(t, -flow) for t in np.linspace(0.0, period, STEPS, endpoint=False)]
    x_in = loop.inlet.system.steady_state(np.mean(inputs, axis=0))
    x_out, q = loop.outlet.system.steady_state([flow]), 0.0
    stored = np.array([name == "p_wk" for name in loop.outlet.system.states], dtype=bool)
    slope = _mean_of_start(loop.outlet.system, period)
    if last:
        x_in, x_out, q = last[0].inlet.x, last[0].outlet.x, last[0].q
    s = LoopState(
        inlet=CircuitState(t=0.0, x=x_in, u=loop.inlet.inputs(0.0, -q)),
        outlet=CircuitState(t=0.0, x=x_out, u=loop.outlet.inputs(0.0, q)),
        q=q,
    )
    q_mean = p_mean = math.inf
    for _ in range(MOST_BEATS):
        begun, before = s.outlet.x, (q_mean, p_mean)
        found, s = loop.run(s, STEPS, period / STEPS)
        q_mean, p_mean = (integral(found["t"], found[name]) / period for name in ("q_ao", "p_ao"))
        if abs(q_mean - before[0]) <= SAME * flow and abs(p_mean - before[1]) <= SAME * pressure:
            break
        x = np.where(stored, begun + (pressure - p_mean) / slope, s.outlet.x)
        s = replace(s, outlet=replace(s.outlet, x=x))
    return _Beat(flow=q_mean, peak=float(found["p_lv"].max()), end=replace(s, outlet=replace(s.outlet, x=x)))


def _mean_of_start(system: LinearSystem, period: float) -> Array:
    """Return by how much the mean output of a beat rises with each state at its start, C A^-1 (exp(A T) - 1) / T."""
    if not system.states:
        return np.ones(0)
    gone = system.propagators(period)[0][0] - np.eye(len(system.states))
    slope: Array = system.C @ np.linalg.solve(system.A, gone) / period
    return np.where(slope == 0.0, 1.0, slope)


def _check_pressure(case: Case, peak: float) -> None:
    """Refuse what no pump gives."""
    if peak > MOST_PRESSURE and case.target is not None:
        most = f"expected at most {MOST_PRESSURE / MMHG:g} mmHg"
        message = f"it takes {peak / MMHG:.4g} mmHg upstream of the valve, {most}"
        raise _error(case, message, "target.cardiac_output", case.target.cardiac_output)


def _bracket(case: Case, target: Target, gap: Callable[[float], float]) -> tuple[float, float]:
    """Return two neighbouring amplitudes between which the mean flow passes the target."""
    a, start = 1.0, gap(1.0)
    for _ in range(TRIALS):
        b = FACTOR * a if start < 0.0 else a / FACTOR
        there = gap(b)
        if there * start <= 0.0:
            return min(a, b), max(a, b)
        a = b
    flow = (there + target.cardiac_output / target.response) / LITRE_PER_MINUTE
    message = f"the pump does not reach it: with {a:.4g} times its record the loop gives {flow:.4g} l/min"
    raise _error(case, message, "target.cardiac_output", target.cardiac_output)


def _with(case: Case, chosen: Chosen) -> Case:
    """Return a case with what was chosen."""
    if case.target is None:
        return case
    circuits = []
    for circuit in case.circuit:
        start = chosen.start.get(circuit.name, circuit.start)
        if circuit.name == chosen.inlet:
            new = {key: getattr(chosen, key) for key in ("amplitude", "period", "record_period")}
            pump = circuit.pump.model_copy(update=new)
            circuit = circuit.model_copy(update={"pump": pump, "start": dict(start)})
        elif circuit.name == chosen.outlet:
            new = {RESISTANCE: chosen.resistance, "target_pressure": case.target.mean_aortic_pressure}
            circuit = circuit.model_copy(update={**new, "start": dict(start)})
        circuits.append(circuit)
    time = case.time.model_copy(update={"t_end": end_of(case)})
    return case.model_copy(update={"circuit": tuple(circuits), "time": time})
