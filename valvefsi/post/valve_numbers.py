"""The numbers that a heart-valve laboratory reports, from waveforms of a pulse duplicator.

Terms are those of ISO 5840-1:2021 and ISO 5840-2:2021. Where the standard leaves a choice, this is taken:

- A cycle is [start + k T, start + (k + 1) T]; ``start`` must lie in the closed phase.
- Forward flow: from the last zero of q before its peak to the first one after it. Where q has crept above zero
  in the closed phase long before it rises, from where the line through its rise from ``backflow_floor`` of the
  peak flow to twice that meets zero; so too where it is above zero at the start of the cycle, by no more than that.
- Positive pressure difference: the part of the forward flow over which the integral of p_lv - p_ao is
  largest. Where the difference changes sign once, this is where it is positive; noise about a zero neither
  cuts nor stretches it. Mean pressure difference, and the flow in the effective orifice area, are over it.
- Closing: from the end of forward flow until the backflow, after its largest value (looked for in a tenth of
  the cycle), is back at the leakage but for ``backflow_floor`` of the peak flow. The leakage is the median of
  q outside forward flow, or zero if that is positive.
- Leakage is what flows back in the rest of the cycle, so forward = net + closing + leakage to round-off.
- Energy losses are integrals of (p_lv - p_ao) q over the same three parts of the cycle.
- Opening and closing from the valve's area (PDVA) where it is given: from one level of its rise to another,
  10 % and 90 % unless told, and back over those of its fall, which may end at another area. Without it, the
  flow stands in: start of forward flow, first and last time at the upper level of the peak flow, end of closing.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

import numpy as np

from valvefsi.post.diagnostics.speeds import reynolds_number
from valvefsi.post.valve_record import (
    ValveRecord,
    ValveTest,
    crossing,
    cut,
    fault,
    first_closed,
    integral,
    integral_of_product,
    integral_of_square,
    part_of,
)
from valvefsi.post.valve_times import add_area, add_times, closed_at
from valvefsi.types import Array
from valvefsi.units import LITRE_PER_MINUTE, MMHG

MILLIJOULE = 1.0e4
"""[erg]"""

LONG = 5.0
"""How long before its rise flow may be above zero, by the time that it takes from one floor to two."""

VOLUMES = ("closing_volume", "leakage_volume", "leakage_flow", "regurgitant_volume", "regurgitant_fraction")
LOSSES = ("forward_energy_loss", "closing_energy_loss", "leakage_energy_loss", "energy_loss")
PRESSURES = (
    "pressure_start",
    "pressure_end",
    "mean_pressure_difference",
    "peak_pressure_difference",
    "rms_flow",
    "effective_orifice_area",
)
FORWARD = ("forward_volume", "rms_forward_flow", "forward_start", "forward_end", "forward_duration")


@dataclass(frozen=True, kw_only=True)
class CycleNumbers:
    """The numbers of one cycle; None where a number cannot be given, `reasons` then says why.

    Times count from the start of the cycle. Backward volumes are positive.

    Attributes:
        cycle: Number of the cycle, from 0.
        start: When it starts [s].
        repeated: Whether it was repeated and cut where the valve is shut, as its edge cuts forward flow.
        forward_volume: Forward stroke volume, integral of q over forward flow [cm^3].
        net_volume: Net stroke volume, integral of q over the cycle [cm^3].
        cardiac_output: Net volume over the cycle's length [cm^3/s].
        peak_flow: Largest flow [cm^3/s].
        rms_forward_flow: Root mean square of q over forward flow [cm^3/s].
        rms_flow: Root mean square of q from pressure_start to pressure_end [cm^3/s].
        forward_start: Start of forward flow [s].
        forward_end: End of forward flow [s].
        forward_duration: Length of forward flow [s].
        pressure_start: Start of the positive pressure difference [s].
        pressure_end: End of the positive pressure difference [s].
        mean_pressure_difference: Mean of p_lv - p_ao from pressure_start to pressure_end [dyn/cm^2].
        peak_pressure_difference: Largest p_lv - p_ao in that time [dyn/cm^2].
        peak_to_peak_difference: Largest p_lv less largest p_ao, at whatever times [dyn/cm^2].
        effective_orifice_area: rms_flow/(51.6 sqrt(mean_pressure_difference/density)), both from pressure_start to
            pressure_end (ISO 5840-1:2021; ml/s, mmHg, g/cm^3) [cm^2].
        closing_volume: Backward volume from forward_end until the valve is closed by its flow [cm^3].
        leakage_volume: Backward volume in the rest of the cycle, while it is shut [cm^3].
        leakage_flow: Mean backward flow while it is shut [cm^3/s].
        regurgitant_volume: Closing and leakage volume [cm^3].
        regurgitant_fraction: Regurgitant volume over forward volume.
        forward_energy_loss: Integral of (p_lv - p_ao) q over forward flow [erg].
        closing_energy_loss: Integral of (p_lv - p_ao) q over the time of closing_volume [erg].
        leakage_energy_loss: Integral of (p_lv - p_ao) q while the valve is shut [erg].
        energy_loss: Integral of (p_lv - p_ao) q over the cycle, the sum of the three [erg].
        opening_start: When the valve starts to open, 10 % of the area's rise [s].
        opening_half: When it is half open, 50 % of the rise [s].
        opening_end: When it is open, 90 % of the rise [s].
        closing_start: When it starts to close, 90 % of the fall's height [s].
        closing_half: When it is half closed, 50 % of the fall's height [s].
        closing_end: When it is closed, 10 % of the fall's height [s].
        opening_duration: From opening_start to opening_end [s].
        open_duration: From opening_end to closing_start [s].
        closing_duration: From closing_start to closing_end [s].
        open_time: From opening_start to closing_end [s].
        times_from: What the opening and closing times are read off, ``pdva`` or ``flow``.
        peak_pdva: Largest projected dynamic valve area [cm^2].
        mean_pdva: Mean projected dynamic valve area over forward flow, systole [cm^2].
        peak_reynolds: Reynolds number of the peak flow, 4 rho q/(pi D mu).
        mean_aortic_pressure: Mean of p_ao over the cycle [dyn/cm^2].
        reasons: Why a number is None, by its name.
    """

    cycle: int
    start: float
    repeated: bool = False
    forward_volume: float | None = None
    net_volume: float | None = None
    cardiac_output: float | None = None
    peak_flow: float | None = None
    rms_forward_flow: float | None = None
    rms_flow: float | None = None
    forward_start: float | None = None
    forward_end: float | None = None
    forward_duration: float | None = None
    pressure_start: float | None = None
    pressure_end: float | None = None
    mean_pressure_difference: float | None = None
    peak_pressure_difference: float | None = None
    peak_to_peak_difference: float | None = None
    effective_orifice_area: float | None = None
    closing_volume: float | None = None
    leakage_volume: float | None = None
    leakage_flow: float | None = None
    regurgitant_volume: float | None = None
    regurgitant_fraction: float | None = None
    forward_energy_loss: float | None = None
    closing_energy_loss: float | None = None
    leakage_energy_loss: float | None = None
    energy_loss: float | None = None
    opening_start: float | None = None
    opening_half: float | None = None
    opening_end: float | None = None
    closing_start: float | None = None
    closing_half: float | None = None
    closing_end: float | None = None
    opening_duration: float | None = None
    open_duration: float | None = None
    closing_duration: float | None = None
    open_time: float | None = None
    times_from: str | None = None
    peak_pdva: float | None = None
    mean_pdva: float | None = None
    peak_reynolds: float | None = None
    mean_aortic_pressure: float | None = None
    reasons: Mapping[str, str] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """All numbers by name, in CGS units."""
        return asdict(self)

    def in_lab_units(self) -> dict[str, object]:
        """All numbers by name and unit: mmHg, ml, ml/s, l/min, cm^2, ms, per cent."""
        told = (item for item in self.as_dict().items() if item[0] != "reasons")
        return dict(_in_lab_unit(name, value) for name, value in told)


NUMBERS = tuple(
    f.name for f in fields(CycleNumbers) if f.name not in ("cycle", "start", "repeated", "reasons")
)


def number_meanings() -> dict[str, str]:
    """Return what each number of a cycle means, by its name, as its documentation says it."""
    text = (inspect.getdoc(CycleNumbers) or "").partition("Attributes:")[2]
    entries = re.findall(r"^ {4}(\w+): (.*(?:\n {8}.*)*)", text, re.MULTILINE)
    told = {name: re.sub(r" \[[^]]*\]\.?$", "", " ".join(words.split())) for name, words in entries}
    return {name: words.rstrip(".") for name, words in told.items() if name in (*NUMBERS, "repeated")}


def _unit(name: str) -> tuple[str, float]:
    """Ending of a number's name in a lab's unit, and that unit in CGS."""
    endings = {
        ("cardiac_output",): ("_l_per_min", LITRE_PER_MINUTE),
        ("regurgitant_fraction",): ("_percent", 0.01),
        ("energy_loss",): ("_mJ", MILLIJOULE),
        ("_volume",): ("_ml", 1.0),
        ("_flow",): ("_ml_per_s", 1.0),
        ("_area", "_pdva"): ("_cm2", 1.0),
        ("_difference", "_aortic_pressure"): ("_mmHg", MMHG),
        ("_start", "_half", "_end", "_duration", "_time"): ("_ms", 1.0e-3),
        ("start",): ("_s", 1.0),
    }
    return next((unit for ends, unit in endings.items() if name.endswith(ends)), ("", 1.0))


def lab_name(name: str) -> str:
    """Return the name of a number with its unit in a lab."""
    return name + _unit(name)[0]


def _in_lab_unit(name: str, value: Any) -> tuple[str, Any]:
    """Name with its unit, and the value in it."""
    return lab_name(name), value / _unit(name)[1] if isinstance(value, float) else value


def effective_orifice_area(rms_flow: float, mean_difference: float, rho: float) -> float:
    """Effective orifice area.

        EOA = q_rms/(51.6 sqrt(dp/rho))          (ISO 5840-1:2021; q ml/s, dp mmHg, rho g/cm^3, EOA cm^2)

    51.6 is sqrt(2 x 1333.22) rounded, so that EOA is 1.0007 times the area of q = A sqrt(2 dp/rho).

    Args:
        rms_flow: Root mean square flow over the positive pressure difference [cm^3/s].
        mean_difference: Mean pressure difference over the same time, positive [dyn/cm^2].
        rho: Density [g/cm^3].

    Returns:
        The area [cm^2].
    """
    if not mean_difference > 0:
        raise ValueError(f"mean_difference: expected a positive pressure, found {mean_difference}")
    return float(rms_flow / (51.6 * np.sqrt(mean_difference / MMHG / rho)))


def valve_numbers(record: ValveRecord, test: ValveTest) -> list[CycleNumbers]:
    """The numbers of every cycle that the record begins; an incomplete one has reasons in their place."""
    return [cycle_numbers(record, test, k) for k in range(record.num_cycles)]


def cycle_numbers(record: ValveRecord, test: ValveTest, cycle: int = -1) -> CycleNumbers:
    """The numbers of one cycle.

    Args:
        record: The waveforms.
        test: The fluid and the valve.
        cycle: Number of the cycle, from 0; negative from the last one begun.

    Raises:
        IndexError: The record has no such cycle.
    """
    k = cycle + record.num_cycles if cycle < 0 else cycle
    if not 0 <= k < record.num_cycles:
        raise IndexError(f"cycle {cycle}: the record begins {record.num_cycles}")
    start = record.first + k * record.period
    if reason := fault(record, k):
        return CycleNumbers(cycle=k, start=start, reasons=dict.fromkeys(NUMBERS, reason))
    x = cut(record, k)
    found, reasons = _whole_cycle(x, record.period, test), dict[str, str]()
    for part in (_forward, _pressure, _backward, add_area, add_times):
        part(x, test, found, reasons)
    return CycleNumbers(cycle=k, start=start, reasons=reasons, **found)


def cycle_change(record: ValveRecord) -> tuple[dict[str, float | None], dict[str, str]]:
    """Change from the last but one complete cycle to the last, |x - x_before|/|x| in L2 over the cycle.

    Returns:
        The change by name of the waveform, and why it is None.
    """
    complete = [k for k in range(record.num_cycles) if not fault(record, k)]
    if len(complete) < 2 or complete[-1] != complete[-2] + 1:
        reason = f"two complete cycles in a row are needed, the record has {len(complete)} complete"
        return dict.fromkeys(record.signals), dict.fromkeys(record.signals, reason)
    last, before = cut(record, complete[-1]), cut(record, complete[-2])
    change, reasons = {}, {}
    for name in record.signals:
        size = integral_of_square(last["t"], last[name])
        # On the times of both, so that the difference is piecewise linear and the integral exact.
        t = np.union1d(last["t"], before["t"])
        x, y = np.interp(t, last["t"], last[name]), np.interp(t, before["t"], before[name])
        change[name] = float(np.sqrt(integral_of_square(t, x - y) / size)) if size > 0 else None
        if size == 0:
            reasons[name] = "zero throughout the last cycle"
    return change, reasons


def repeated_cycle(record: ValveRecord, test: ValveTest, cycle: int) -> CycleNumbers | None:
    """Return the numbers of a whole cycle that is repeated and cut where the valve is shut; None where it never is.

    For a cycle whose edge cuts forward flow. Between its end and its start, which differ where a run is not periodic,
    waveforms are linear.
    """
    x = cut(record, cycle)
    t = np.concatenate([x["t"][:-1], x["t"] + record.period])
    waves: dict[str, Any] = {name: np.concatenate([x[name][:-1], x[name]]) for name in record.signals}
    twice = replace(record, t=t, start=None, **waves)
    start = first_closed(twice)
    if start is None:
        return None
    found = cycle_numbers(replace(twice, start=start), test, 0)
    return replace(found, cycle=cycle, start=record.first + cycle * record.period + start, repeated=True)


def _whole_cycle(x: dict[str, Array], period: float, test: ValveTest) -> dict[str, Any]:
    """Numbers that need no interval."""
    peak, net = float(x["q"].max()), integral(x["t"], x["q"])
    return {
        "net_volume": net,
        "cardiac_output": net / period,
        "peak_flow": peak,
        "peak_reynolds": float(reynolds_number(peak, test.diameter, test.rho, test.mu)),
        "peak_to_peak_difference": float(x["p_lv"].max() - x["p_ao"].max()),
        "mean_aortic_pressure": integral(x["t"], x["p_ao"]) / period,
    }


def _forward(x: dict[str, Array], test: ValveTest, found: dict[str, Any], reasons: dict[str, str]) -> None:
    """Forward flow: the interval about the peak in which q is positive."""
    t, q = x["t"], x["q"]
    peak = int(np.argmax(q))
    # Round-off of a waveform that starts at zero is no flow.
    still = q <= 1e-9 * max(q[peak], 0.0)
    before, after = np.flatnonzero(still[:peak]), np.flatnonzero(still[peak:])
    if q[peak] <= 0:
        reason = "no forward flow"
    elif not (len(before) or q[0] <= test.backflow_floor * q[peak]) or not len(after):
        reason = "forward flow is cut by the cycle's edge; start the cycle in the closed phase"
    else:
        zero = crossing(t, q, before[-1], 0.0) if len(before) else float(t[0])
        start = _rise(t, q, peak, test.backflow_floor, zero)
        end = crossing(t, q, peak + after[0] - 1, 0.0)
        nodes, flow = part_of(t, q, start, end)
        rms = np.sqrt(integral_of_square(nodes, flow) / (end - start))
        found |= dict(zip(FORWARD, (integral(nodes, flow), float(rms), start, end, end - start), strict=True))
        return
    reasons |= dict.fromkeys(FORWARD, reason)


def _rise(t: Array, q: Array, peak: int, floor: float, zero: float) -> float:
    """Start of forward flow: the last zero of q, or later where q has crept above zero long before it rises."""
    low, high = (
        crossing(t, q, int(np.flatnonzero(q[:peak] <= part * q[peak])[-1]), part * q[peak])
        for part in (floor, 2.0 * floor)
    )
    line = low - (high - low)
    return line if zero < line - LONG * (high - low) else zero


def _pressure(x: dict[str, Array], test: ValveTest, found: dict[str, Any], reasons: dict[str, str]) -> None:
    """Positive pressure difference in forward flow: the part with the largest integral of p_lv - p_ao."""
    if "forward_start" not in found:
        reasons |= dict.fromkeys(PRESSURES, reasons["forward_start"])
        return
    t, dp = part_of(x["t"], x["p_lv"] - x["p_ao"], found["forward_start"], found["forward_end"])
    changes = np.flatnonzero(dp[1:] * dp[:-1] < 0)
    nodes = np.sort(np.concatenate([t, [crossing(t, dp, int(i), 0.0) for i in changes]]))
    t, dp = nodes, np.interp(nodes, t, dp)
    impulse = np.concatenate([[0.0], np.cumsum(0.5 * (dp[1:] + dp[:-1]) * np.diff(t))])
    last = int(np.argmax(impulse - np.minimum.accumulate(impulse)))
    # The last of equal minima: no difference at all is not a positive one.
    first = last - int(np.argmin(impulse[last::-1]))
    gained = impulse[last] - impulse[first]
    if gained <= 0:
        reasons |= dict.fromkeys(PRESSURES, "p_lv never exceeds p_ao during forward flow")
        return
    start, end = float(t[first]), float(t[last])
    rms = float(np.sqrt(integral_of_square(*part_of(x["t"], x["q"], start, end)) / (end - start)))
    mean = float(gained / (end - start))
    area = effective_orifice_area(rms, mean, test.rho)
    peak = float(dp[first : last + 1].max())
    found |= dict(zip(PRESSURES, (start, end, mean, peak, rms, area), strict=True))


def _backward(x: dict[str, Array], test: ValveTest, found: dict[str, Any], reasons: dict[str, str]) -> None:
    """Closing, leakage and regurgitant volume."""
    if "forward_start" not in found:
        reasons |= dict.fromkeys((*VOLUMES, *LOSSES), reasons["forward_start"])
        return
    forward = found["forward_volume"]
    found["regurgitant_volume"] = forward - found["net_volume"]
    found["regurgitant_fraction"] = found["regurgitant_volume"] / forward
    end = closed_at(x, test, found)
    if end is None:
        reason = "the valve is not closed when the cycle ends; start the cycle in the closed phase"
        unknown = ("closing_volume", "leakage_volume", "leakage_flow", *LOSSES)
        reasons |= dict.fromkeys(unknown, reason)
        return
    found["closing_volume"] = -integral(*part_of(x["t"], x["q"], found["forward_end"], end))
    found["leakage_volume"] = found["regurgitant_volume"] - found["closing_volume"]
    found["leakage_flow"] = float(found["leakage_volume"] / (x["t"][-1] - (end - found["forward_start"])))
    found |= _losses(x, found["forward_start"], found["forward_end"], end)


def _losses(x: dict[str, Array], start: float, forward_end: float, end: float) -> dict[str, float]:
    """Energy that the flow loses over the valve: in forward flow, while it closes, while it is shut, in all."""
    dp = x["p_lv"] - x["p_ao"]

    def lost(first: float, last: float) -> float:
        t, pressure = part_of(x["t"], dp, first, last)
        return integral_of_product(t, pressure, part_of(x["t"], x["q"], first, last)[1])

    forward, closing, whole = lost(start, forward_end), lost(forward_end, end), lost(0.0, float(x["t"][-1]))
    return dict(zip(LOSSES, (forward, closing, whole - forward - closing, whole), strict=True))
