"""Waveforms of a pulse duplicator, cut into cycles and intervals, and the valve that they were taken at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from valvefsi.types import Array

LARGEST_GAP = 0.05
"""Longest time between two samples, as a part of the cycle."""
CLOSED_AREA, CLOSED_FLOW, CLOSED_TIME = 0.25, 0.05, 0.02
"""A closed valve: parts of the range of its area and of its largest flow that it does not exceed, and of the cycle
for which it does not."""


@dataclass(frozen=True, kw_only=True)
class ValveRecord:
    """Waveforms of one or several cycles.

    Attributes:
        t: Times, ascending, ``(n,)`` [s].
        p_lv: Pressure upstream of the valve, ``(n,)`` [dyn/cm^2].
        p_ao: Pressure downstream, ``(n,)`` [dyn/cm^2].
        q: Flow through the valve, positive forward, ``(n,)`` [cm^3/s].
        period: Length of a cycle, T [s].
        start: Start of the first cycle, in the closed phase; the first time unless given [s].
        pdva: Projected dynamic valve area, ``(n,)`` [cm^2].
    """

    t: Array
    p_lv: Array
    p_ao: Array
    q: Array
    period: float
    start: float | None = None
    pdva: Array | None = None

    def __post_init__(self) -> None:
        for name in ("t", *self.signals):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=float))
            if getattr(self, name).shape != (np.size(self.t),):
                raise ValueError(
                    f"{name}: expected the shape ({np.size(self.t)},) of t, found {getattr(self, name).shape}"
                )
        if len(self.t) < 2 or not np.isfinite(self.t).all() or np.any(np.diff(self.t) <= 0):
            raise ValueError("t: expected two or more finite times in ascending order")
        if not (np.isfinite(self.period) and self.period > 0):
            raise ValueError(f"period: expected a positive time, found {self.period}")
        if self.first < self.t[0] - self.slack:
            raise ValueError(f"start: expected {self.t[0]} or later, the first time, found {self.start}")

    @property
    def first(self) -> float:
        """Start of the first cycle [s]."""
        return float(self.t[0] if self.start is None else self.start)

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the waveforms that are given."""
        return ("p_lv", "p_ao", "q", *(() if self.pdva is None else ("pdva",)))

    @property
    def slack(self) -> float:
        """What may be missing at the end of a cycle, one and a half samples [s]."""
        return 1.5 * float(np.median(np.diff(self.t)))

    @property
    def num_cycles(self) -> int:
        """Cycles begun, the last of them perhaps incomplete."""
        return max(int(np.ceil((self.t[-1] - self.first - self.slack) / self.period)), 0)


@dataclass(frozen=True, kw_only=True)
class ValveTest:
    """The fluid and the valve under test, and levels that definitions need.

    Attributes:
        rho: Density of the fluid [g/cm^3].
        mu: Viscosity of the fluid [dyn s/cm^2].
        diameter: Diameter of the orifice, D [cm].
        levels: Parts of the valve's range between which it counts as opening or closing.
        backflow_floor: Part of the peak flow to which closing backflow falls before the valve is closed.
    """

    rho: float
    mu: float
    diameter: float
    levels: tuple[float, float] = (0.1, 0.9)
    backflow_floor: float = 0.02

    def __post_init__(self) -> None:
        for name in ("rho", "mu", "diameter", "backflow_floor"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise ValueError(f"{name}: expected a positive number, found {getattr(self, name)}")
        if not 0 < self.levels[0] < self.levels[1] < 1:
            raise ValueError(f"levels: expected 0 < lower < upper < 1, found {self.levels}")


def first_closed(record: ValveRecord) -> float | None:
    """When the valve has been closed for a while first, or the start of a record that begins with that.

    Closed is a valve of little area, where that is given, that lets little through in either direction. None where
    it never is, or no whole cycle follows.
    """
    size = np.nanmax(np.abs(record.q), initial=0.0)
    if not size > 0.0:
        return None
    closed = np.abs(record.q) <= CLOSED_FLOW * size
    if record.pdva is not None:
        low, high = np.nanmin(record.pdva), np.nanmax(record.pdva)
        closed &= record.pdva <= low + CLOSED_AREA * (high - low)
    ends, least = np.append(record.t[~closed], np.inf), CLOSED_TIME * record.period
    since = record.t[closed & (record.t >= record.first)]
    lasting = since[ends[np.searchsorted(ends, since)] - since >= least]
    if not len(lasting):
        return None
    start = record.first if lasting[0] <= record.first + record.slack else float(lasting[0]) + least
    return start if record.t[-1] - start >= record.period - record.slack else None


def fault(record: ValveRecord, k: int) -> str:
    """Why cycle ``k`` cannot be used; empty if it can."""
    start = record.first + k * record.period
    end = start + record.period
    if (missing := end - record.t[-1]) > record.slack:
        return f"incomplete: the record ends {missing:.4g} s before the cycle does"
    here = (record.t > start - record.slack) & (record.t < end + record.slack)
    for name in record.signals:
        wrong = here & ~np.isfinite(getattr(record, name))
        if wrong.any():
            return f"{name} is not finite at t = {record.t[wrong][0]:.6g} s"
    inside = record.t[(record.t > start) & (record.t < end)]
    gaps = np.diff(np.concatenate([[start], inside, [end]]))
    if gaps.max() > LARGEST_GAP * record.period:
        return f"two samples are {gaps.max():.4g} s apart, more than {LARGEST_GAP:g} of the cycle"
    return ""


def cut(record: ValveRecord, k: int) -> dict[str, Array]:
    """Time from the start of cycle ``k``, and the waveforms, with both ends of the cycle put in."""
    start = record.first + k * record.period
    t, length = record.t - start, record.period
    inside = t[(t > 1e-9 * length) & (t < (1 - 1e-9) * length)]
    nodes = np.concatenate([[0.0], inside, [length]])
    return {"t": nodes} | {name: np.interp(nodes, t, getattr(record, name)) for name in record.signals}


def part_of(t: Array, x: Array, start: float, end: float) -> tuple[Array, Array]:
    """A waveform from ``start`` to ``end``, both put in."""
    inside = (t > start) & (t < end)
    nodes = np.concatenate([[start], t[inside], [end]])
    return nodes, np.interp(nodes, t, x)


def integral(t: Array, x: Array) -> float:
    """Integral of a piecewise linear waveform, exact."""
    return float(0.5 * np.sum((x[1:] + x[:-1]) * np.diff(t)))


def integral_of_square(t: Array, x: Array) -> float:
    """Integral of the square of a piecewise linear waveform, exact."""
    return integral_of_product(t, x, x)


def integral_of_product(t: Array, x: Array, y: Array) -> float:
    """Integral of the product of two piecewise linear waveforms, exact."""
    ends, middle = x[1:] * y[1:] + x[:-1] * y[:-1], (x[1:] + x[:-1]) * (y[1:] + y[:-1])
    return float(np.sum((ends + middle) * np.diff(t)) / 6)


def crossing(t: Array, x: Array, i: int, level: float) -> float:
    """When the waveform passes ``level`` between samples i and i + 1."""
    rise = x[i + 1] - x[i]
    return float(t[i] + np.clip((level - x[i]) / rise if rise else 0.0, 0, 1) * (t[i + 1] - t[i]))
