"""When a valve opens and closes: from its area where there is one, else from the flow."""

from __future__ import annotations

from typing import Any

import numpy as np

from valvefsi.post.valve_record import ValveTest, crossing, integral, part_of
from valvefsi.types import Array

CLOSING_WINDOW = 0.1
"""Time after forward flow in which the closing backflow has its largest value, as a part of the cycle."""

TIMES = ("opening_start", "opening_end", "closing_start", "closing_end")
HALVES = ("opening_half", "closing_half")
DURATIONS = ("opening_duration", "open_duration", "closing_duration", "open_time")
HALF = 0.5
"""Part of the valve's range that lies between opening and open, and between closing and closed."""

NO_AREA = "no valve area in the record"

Times = tuple[float | None, ...]


def closed_at(x: dict[str, Array], test: ValveTest, found: dict[str, Any]) -> float | None:
    """When closing backflow is over; the end of forward flow if there is none, None if it does not end."""
    t, q = part_of(x["t"], x["q"], found["forward_end"], x["t"][-1])
    outside = (x["t"] < found["forward_start"]) | (x["t"] > found["forward_end"])
    floor = min(float(np.median(x["q"][outside])), 0.0) - test.backflow_floor * found["peak_flow"]
    least = int(np.argmin(np.where(t - t[0] <= CLOSING_WINDOW * x["t"][-1], q, np.inf)))
    if q[least] >= floor:
        return found["forward_end"]
    back = np.flatnonzero(q[least:] >= floor)
    return crossing(t, q, least + back[0] - 1, floor) if len(back) else None


def add_times(x: dict[str, Array], test: ValveTest, found: dict[str, Any], reasons: dict[str, str]) -> None:
    """Opening and closing times, from the area where there is one, else from the flow."""
    halves: Times = (None,) * len(HALVES)
    if "pdva" in x:
        found["times_from"] = "pdva"
        times, halves, reason = _times_from_area(x["t"], x["pdva"], test)
    else:
        found["times_from"] = "flow"
        times, reason = _times_from_flow(x, test, found), reasons.get("forward_start", "")
    known: dict[str, float | None] = dict(zip((*TIMES, *HALVES), (*times, *halves), strict=True))
    if known["closing_end"] is None and not reason:
        reason = reasons["closing_volume"]
    a, b, c, d = times
    pairs = zip(DURATIONS, ((a, b), (b, c), (c, d), (a, d)), strict=True)
    for name, (first, last) in pairs:
        known[name] = None if first is None or last is None else last - first
    reasons |= {name: reason or NO_AREA for name, value in known.items() if value is None}
    found |= known


def add_area(x: dict[str, Array], test: ValveTest, found: dict[str, Any], reasons: dict[str, str]) -> None:
    """Largest area, and its mean over forward flow."""
    if "pdva" not in x:
        reasons |= dict.fromkeys(("peak_pdva", "mean_pdva"), NO_AREA)
        return
    found["peak_pdva"] = float(x["pdva"].max())
    if "forward_start" not in found:
        reasons["mean_pdva"] = reasons["forward_start"]
        return
    part = part_of(x["t"], x["pdva"], found["forward_start"], found["forward_end"])
    found["mean_pdva"] = integral(*part) / found["forward_duration"]


def _times_from_area(t: Array, area: Array, test: ValveTest) -> tuple[Times, Times, str]:
    """Where the area passes the two levels of its rise, and those of its fall, which may end at another area.

    Beside them where it passes the half of both, and why there is nothing.
    """
    nothing: tuple[Times, Times] = (None,) * len(TIMES), (None,) * len(HALVES)
    span = np.ptp(area)
    if not span > 0:
        return *nothing, "the valve area does not change"
    top = int(np.argmax(area))
    least = area[: top + 1].min(), area[top:].min()
    if area[top] - max(least) < 0.5 * span:
        return *nothing, "the valve is open at the cycle's edge; start the cycle in the closed phase"
    low, high = test.levels
    (low, half, high), (end_low, end_half, end_high) = (
        [float(x + part * (area[top] - x)) for part in (low, HALF, high)] for x in least
    )
    first, last = np.flatnonzero(area >= high)[0], np.flatnonzero(area >= end_high)[-1]

    def before(level: float) -> float:
        return crossing(t, area, np.flatnonzero(area[:first] <= level)[-1], level)

    def after(level: float) -> float:
        return crossing(t, area, last + np.flatnonzero(area[last:] <= level)[0] - 1, level)

    times = (
        before(low),
        crossing(t, area, first - 1, high),
        crossing(t, area, last, end_high),
        after(end_low),
    )
    return times, (before(half), after(end_half)), ""


def _times_from_flow(x: dict[str, Array], test: ValveTest, found: dict[str, Any]) -> Times:
    """Start of forward flow, first and last time at the upper level of the peak, end of closing."""
    if "forward_start" not in found:
        return (None,) * len(TIMES)
    t, q, high = x["t"], x["q"], test.levels[1] * found["peak_flow"]
    at = np.flatnonzero((q >= high) & (t >= found["forward_start"]) & (t <= found["forward_end"]))
    opened, closing = crossing(t, q, at[0] - 1, high), crossing(t, q, at[-1], high)
    return found["forward_start"], opened, closing, closed_at(x, test, found)
