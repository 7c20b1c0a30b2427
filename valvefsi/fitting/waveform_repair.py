"""Outliers, cycles and smoothing of records of a flow loop."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_smoothing_spline

from valvefsi.errors import CaseError
from valvefsi.fitting.waveforms import FEWEST, Waveforms
from valvefsi.types import Array, Indices

REACH = 4
"""Samples to either side that a sample is compared with."""
SPREADS, SHARE = 10.0, 0.25
"""An outlier is this many local spreads, and this part of the record's range, away from its neighbours' median."""
COMPANY = 1
"""An outlier has no more neighbours than this near it: more are a steep part of the record."""
SLIP = 0.1
"""A decimal slip agrees with its neighbours to this part once the point is moved."""
ALIKE = 0.5
"""Autocorrelation that makes a lag a period."""


@dataclass(frozen=True, kw_only=True)
class Outlier:
    """A sample that does not belong to its neighbours.

    Attributes:
        quantity: The quantity.
        sample: Number of the sample, from 0.
        row: Line in the file; 0 without a file.
        t: Time [s].
        value: What was recorded, in the unit of the file.
        instead: What `repair` puts there, in the unit of the file.
        reason: ``10 x``, ``0.1 x`` (a decimal slip) or ``spike``.
        heading: Heading of the column.
    """

    quantity: str
    sample: int
    row: int
    t: float
    value: float
    instead: float
    reason: str
    heading: str

    def line(self) -> str:
        """Return one line about it."""
        return (
            f"row {self.row}, column {self.heading}: {self.value:.6g} at {self.t:.6g} s is an outlier "
            f"({self.reason}), {self.instead:.6g} would fit"
        )


def find_outliers(waves: Waveforms, quantities: Iterable[str] | None = None) -> tuple[Outlier, ...]:
    """Find samples far from all their neighbours.

    A sample is an outlier when it differs from the median of the 8 samples around it by more than 10 times their
    spread (median deviation; the record's own where larger) and by more than a quarter of the record's range, and
    no more than one of them is near it.

    Args:
        waves: The record.
        quantities: Quantities to look at; all if not given.
    """
    faults = []
    for quantity in waves.values if quantities is None else quantities:
        y, scale = waves[quantity], waves.unit_scale(quantity)
        far, middle = _far(y)
        fine = np.ones(len(y), bool)
        fine[far] = False
        for i in far:
            power = _slip(y[i], middle[i])
            instead = y[i] / 10.0**power if power else np.interp(waves.t[i], waves.t[fine], y[fine])
            faults.append(
                Outlier(
                    quantity=quantity,
                    sample=int(i),
                    row=0 if waves.rows is None else int(waves.rows[i]),
                    t=float(waves.t[i]),
                    value=float(y[i] / scale),
                    instead=float(instead / scale),
                    reason=f"{10.0**power:g} x" if power else "spike",
                    heading=waves.heading(quantity),
                )
            )
    return tuple(sorted(faults, key=lambda outlier: outlier.sample))


def repair(waves: Waveforms, outliers: Iterable[Outlier]) -> Waveforms:
    """Return the record with outliers replaced: the point of a decimal slip moved, a spike interpolated."""
    outliers = tuple(outliers)
    changed: dict[str, Array] = {}
    for outlier in outliers:
        y = changed.setdefault(outlier.quantity, waves[outlier.quantity].copy())
        y[outlier.sample] = outlier.instead * waves.unit_scale(outlier.quantity)
    rows = ", ".join(str(outlier.row) for outlier in outliers)
    return waves.with_values(changed, f"outliers replaced in rows {rows}") if outliers else waves


def find_period(t: Array, y: Array) -> float | None:
    """Return the period of a record of more than one and a half cycles; None where nothing repeats [s].

    The lag of the first high peak of the autocorrelation, by a parabola through its top.
    """
    n = len(t)
    if n < 4 * REACH:
        return None
    even = np.linspace(t[0], t[-1], n)
    z = np.interp(even, t, y)
    z = z - z.mean()
    most = int(n / 1.5)
    alike = np.array([_alike(z[: n - lag], z[lag:]) for lag in range(most)])
    below = np.flatnonzero(alike < 0.0)
    if not len(below):
        return None
    if alike[below[0] :].max() < ALIKE:
        return None
    high = below[0] + np.flatnonzero(alike[below[0] :] >= 0.9 * alike[below[0] :].max())
    reached = int(high[0])  # the first peak begins here, and ends before a third more
    k = reached + int(np.argmax(alike[reached : max(reached + 2, int(1.33 * reached))]))
    if not 0 < k < most - 1:
        return None
    near = np.arange(max(k - max(k // 16, 1), 1), min(k + max(k // 16, 1), most - 1) + 1)
    bend, slope, _ = np.polyfit(near - k, alike[near], 2)
    shift = float(np.clip(-slope / (2 * bend), near[0] - k, near[-1] - k)) if bend < 0 else 0.0
    return float((k + shift) * (even[1] - even[0]))


def whole_cycles(waves: Waveforms, period: float) -> tuple[Waveforms, int]:
    """Return the record cut to whole cycles, closed by its first sample, and how many cycles it has.

    Raises:
        CaseError: The record is shorter than a cycle.
    """
    usual = float(np.median(np.diff(waves.t)))
    count = int(np.floor((waves.span + 1.5 * usual) / period))
    if not period > 0 or count < 1:
        raise CaseError(
            f"expected a period in 0 ... {waves.span:.6g} s, the length of the record", key="period"
        )
    end = waves.t[0] + count * period
    rest = np.flatnonzero(waves.t < end - 0.25 * usual)
    if len(rest) < FEWEST:
        raise CaseError("too few samples in a cycle", key="period", value=period)
    cut = waves.picked(np.append(rest, 0))
    t = cut.t.copy()
    t[-1] = end
    rows = None if cut.rows is None else cut.rows
    closed = Waveforms(**{**vars(cut), "t": t, "rows": rows})
    return closed, count


def smooth(waves: Waveforms, quantities: Iterable[str], cutoff: float) -> Waveforms:
    """Return the record with some quantities smoothed by a cubic smoothing spline.

        minimise  sum (y - f)^2 + lambda int f''^2 dt,   lambda = (cutoff / 2 pi)^4 / dt,

    so that an oscillation of period ``cutoff`` is halved, slower ones kept and faster ones removed.

    Args:
        waves: The record.
        quantities: What to smooth.
        cutoff: Period that is halved [s]; 0 leaves the record as it is.
    """
    if cutoff == 0:
        return waves
    if not (np.isfinite(cutoff) and 0 < cutoff < waves.span):
        raise CaseError(f"expected a time in 0 ... {waves.span:.6g} s", key="smooth", value=cutoff)
    weight = (cutoff / (2 * np.pi)) ** 4 / float(np.mean(np.diff(waves.t)))
    names = list(quantities)
    changed = {q: make_smoothing_spline(waves.t, waves[q], lam=weight)(waves.t) for q in names}
    note = f"smoothed by a cubic smoothing spline that halves a period of {cutoff:g} s: {', '.join(names)}"
    return waves.with_values(changed, note)


def _far(y: Array) -> tuple[Indices, Array]:
    """Return the samples far from their neighbours, and the median of the neighbours of each sample."""
    n = len(y)
    if n < 2 * REACH + 1:
        return np.zeros(0, int), y
    first = np.clip(np.arange(n) - REACH, 0, n - 2 * REACH - 1)
    around = first[:, None] + np.arange(2 * REACH)
    around += around >= np.arange(n)[:, None]
    near = y[around]
    middle = np.median(near, axis=1)
    spread = np.median(np.abs(near - middle[:, None]), axis=1)
    reach = np.subtract(*np.percentile(y, [95, 5]))
    away = np.abs(y - middle)
    limit = np.maximum(SPREADS * np.maximum(spread, np.median(away)), SHARE * reach)
    limit = np.maximum(limit, 1e-12 * np.abs(y).max())
    company = np.sum(np.abs(near - y[:, None]) <= limit[:, None], axis=1)
    return np.flatnonzero((away > limit) & (company <= COMPANY)), middle


def _slip(value: float, middle: float) -> int:
    """Return by how many places the decimal point slipped, 0 where it did not."""
    if middle == 0 or value / middle <= 0:
        return 0
    power = round(float(np.log10(value / middle)))
    return power if power and abs(value / 10.0**power - middle) <= SLIP * abs(middle) else 0


def _alike(a: Array, b: Array) -> float:
    """Return the correlation of two parts of a record."""
    size = np.sqrt((a @ a) * (b @ b))
    return float(a @ b / size) if size > 0 else 0.0
