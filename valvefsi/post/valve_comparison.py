"""How far two beats of a valve are apart: norms with and without one shift in time, and the numbers of both.

Both are taken on the clock of the second, B, which is the reference; the period of the first, A, is stretched to B's.

    L2, Linf:  ||A - B||_{L^q(0, T)} / ||B||_{L^q(0, T)}          (Lee2020, S24, S25)
    NRMSE:     (1/T int (A - B)^2 dt)^(1/2) / (max B - min B)
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from valvefsi.errors import CaseError
from valvefsi.post.valve_beat import QUANTITIES, Beat
from valvefsi.types import Array
from valvefsi.verification.norms import normalised_difference, time_norm

PERIODS_APART = 0.01
"""Part by which the two periods may differ."""
FLOW, FLOW_LESS_OFFSET, AREA = "q_ao", "q_ao_without_offset", "pdva"
Comparison = dict[str, Any]
"""A comparison as ``comparison.json`` holds it."""
NUMBERS = (
    "peak_flow_ml_per_s",
    "forward_volume_ml",
    "mean_pressure_difference_mmHg",
    "effective_orifice_area_cm2",
    "peak_pdva_cm2",
    "open_over_10_percent_ms",
    "regurgitant_fraction_percent",
)
DEFINITIONS = {
    "l2_percent": "100 ||A - B|| / ||B|| over the cycle in L2",
    "linf_percent": "100 max |A - B| / max |B|",
    "nrmse_percent": "100 root mean square of A - B over max B - min B",
    "shift_ms": "time by which all of A is moved later; it has the least sum of squares of the "
    "relative L2 norms of pressures and flow",
    "repeatability_l2_percent": "100 root mean square of the standard deviation over that of the mean beat",
    "diastolic_offset": "mean flow while the valve is shut, outside forward flow and closing backflow (the leakage "
    "flow of the valve's numbers, backward negative); taken off measured flows only",
    "open_over_10_percent_ms": "from 10 % of the rise of the area to 10 % of its fall",
}


@dataclass(frozen=True, kw_only=True)
class Pair:
    """Two beats on one clock.

    Attributes:
        a: The first.
        b: The second, the reference.
        start: Time in the cycle of B at which that of A begins [s].
    """

    a: Beat
    b: Beat
    start: float = 0.0

    def __post_init__(self) -> None:
        a, b = self.a, self.b
        if abs(a.period - b.period) > PERIODS_APART * b.period:
            raise CaseError(
                f"the periods differ by {100 * abs(a.period / b.period - 1):.3g} %, more than {100 * PERIODS_APART:g} "
                f"%: {a.period:.6g} s of {a.name}, {b.period:.6g} s of {b.name}",
                key="period",
            )
        if not 0.0 <= self.start < b.period:
            raise CaseError(
                f"expected 0 or more and less than {b.period:.6g} s", key="start", value=self.start
            )
        if not set(a.values) & set(b.values):
            both = (f"{beat.name} has {', '.join(beat.values) or 'nothing'}" for beat in (a, b))
            raise CaseError(f"there is nothing to compare: {'; '.join(both)}")

    @cached_property
    def t(self) -> Array:
        """Even times over the cycle of B, both ends included, at the finer sampling of the two, ``(n,)`` [s]."""
        return (self.a if self.a.spacing < self.b.spacing else self.b).grid * self._to_b

    @property
    def _to_b(self) -> float:
        """Factor of the times of the finer grid."""
        return self.b.period / self.a.period if self.a.spacing < self.b.spacing else 1.0

    @cached_property
    def quantities(self) -> tuple[str, ...]:
        """Names of what both have; the flow without offsets is one of them where a measured one has an offset."""
        both = tuple(q for q in QUANTITIES if q in self.a.values and q in self.b.values)
        if FLOW in both and any(offset is not None for offset in self.offsets):
            place = both.index(FLOW) + 1
            return (*both[:place], FLOW_LESS_OFFSET, *both[place:])
        return both

    @cached_property
    def offsets(self) -> tuple[float | None, float | None]:
        """Diastolic offsets of the measured ones, A's and B's [cm^3/s]."""
        a, b = (beat.diastolic_offset() if beat.measured else None for beat in (self.a, self.b))
        return a, b

    def values(self, quantity: str, shift: float = 0.0) -> tuple[Array, Array]:
        """Return a waveform of A, moved later by ``shift`` [s], and of B, each ``(n,)``."""
        on_a = (self.t - self.start - shift) * (self.a.period / self.b.period)
        if quantity != FLOW_LESS_OFFSET:
            return self.a.at(quantity, on_a), self.b.at(quantity, self.t)
        a, b = (offset or 0.0 for offset in self.offsets)
        return self.a.at(FLOW, on_a) - a, self.b.at(FLOW, self.t) - b

    def norms(self, quantity: str, shift: float = 0.0) -> dict[str, float | None]:
        """Return L2, Linf and NRMSE of a quantity in per cent; None where B is zero or does not change."""
        a, b = self.values(quantity, shift)
        span = float(np.ptp(b))
        rms = time_norm(self.t, a - b) / math.sqrt(self.b.period)
        zero = not np.any(b)
        return {
            "l2_percent": None if zero else 100.0 * normalised_difference(self.t, a, b),
            "linf_percent": None if zero else 100.0 * normalised_difference(self.t, a, b, math.inf),
            "nrmse_percent": 100.0 * rms / span if span > 0 else None,
        }

    def common_shift(self, most: float) -> float:
        """Return the shift of A with the least sum of squares of relative L2 norms of pressures and flow as recorded.

        The open area takes the same shift, and decides it only where nothing else was compared: that of a valve of
        another size is so far off that it would decide alone.

        Args:
            most: Largest size of the shift [s].
        """
        if not (0.0 <= most <= 0.25 * self.b.period):
            raise CaseError(
                f"expected a time in 0 ... {0.25 * self.b.period:.4g} s, a quarter of the cycle",
                key="shift-max",
                value=most,
            )
        names = [q for q in self.quantities if q != FLOW_LESS_OFFSET and np.any(self.b.values[q])]
        names = [q for q in names if q != AREA] or names
        sizes = {q: time_norm(self.t, self.values(q)[1]) for q in names}

        def apart(shift: float) -> float:
            found = (self.values(q, shift) for q in names)
            return sum(
                (time_norm(self.t, a - b) / sizes[q]) ** 2 for q, (a, b) in zip(names, found, strict=True)
            )

        if most == 0.0 or not names:
            return 0.0
        tried = np.linspace(-most, most, 2 * max(math.ceil(2 * most / float(self.t[1])), 4) + 1)
        k = int(np.argmin([apart(float(shift)) for shift in tried]))
        ends = tried[max(k - 1, 0)], tried[min(k + 1, len(tried) - 1)]
        fine = minimize_scalar(apart, bounds=ends, method="bounded", options={"xatol": 1e-9})
        return float(min((float(fine.x), float(tried[k])), key=apart))


def compare_pair(a: Beat, b: Beat, *, start: float = 0.0, shift_max: float) -> tuple[Pair, Comparison]:
    """Return two beats on one clock, and their comparison with and without the best common shift.

    Args:
        a: The first.
        b: The second, the reference.
        start: Time in the cycle of B at which that of A begins [s].
        shift_max: Largest shift of A that is looked for [s].
    """
    pair = Pair(a=a, b=b, start=start)
    return pair, compare_beats(pair, pair.common_shift(shift_max), shift_max)


def compare_beats(pair: Pair, shift: float, shift_max: float) -> Comparison:
    """Return the comparison of two beats as ``comparison.json`` holds it.

    Args:
        pair: The two on one clock.
        shift: The common shift of A [s].
        shift_max: The largest one that was looked for [s].
    """
    return {
        "a": _about(pair.a),
        "b": _about(pair.b),
        "start_s": pair.start,
        "samples": len(pair.t) - 1,
        "shift_ms": 1e3 * shift,
        "shift_max_ms": 1e3 * shift_max,
        "shift_at_its_bound": bool(shift_max > 0 and abs(shift) >= shift_max * (1 - 1e-6)),
        "diastolic_offset_ml_per_s": dict(zip("ab", pair.offsets, strict=True)),
        "quantities": {
            name: {
                "as_they_are": pair.norms(name),
                "shifted": pair.norms(name, shift),
                "repeatability_l2_percent": {"a": _repeats(pair, 0, name), "b": _repeats(pair, 1, name)},
            }
            for name in pair.quantities
        },
        "numbers": _side_by_side(pair),
        "definitions": DEFINITIONS,
    }


def _about(beat: Beat) -> dict[str, Any]:
    return {
        "name": beat.name,
        "kind": "record" if beat.measured else "run",
        "cycle_from_s": beat.start,
        "period_s": beat.period,
        "samples": len(beat.t),
        "mean_of_cycles": beat.cycles,
        "notes": list(beat.notes),
    }


def _repeats(pair: Pair, side: int, quantity: str) -> float | None:
    """Return how far one cycle of a record is from its mean, in L2 [%]; None without standard deviations."""
    beat = (pair.a, pair.b)[side]
    source = FLOW if quantity == FLOW_LESS_OFFSET else quantity
    if source not in beat.deviations:
        return None
    less = (pair.offsets[side] or 0.0) if quantity == FLOW_LESS_OFFSET else 0.0
    size = time_norm(beat.grid, beat.at(source, beat.grid) - less)
    return 100.0 * time_norm(beat.grid, beat.deviation_at(source, beat.grid)) / size if size > 0 else None


def _side_by_side(pair: Pair) -> dict[str, Any]:
    """Return the numbers of both, their difference, and that in per cent of B's."""
    rho = next((beat.test.rho for beat in (pair.a, pair.b) if beat.test is not None), 1.0)
    (a, why_a), (b, why_b) = (_numbers(beat, rho) for beat in (pair.a, pair.b))
    rows: dict[str, Any] = {}
    for name in NUMBERS:
        x, y = a.get(name), b.get(name)
        apart = None if x is None or y is None else x - y
        rows[name] = {
            "a": x,
            "b": y,
            "difference": apart,
            "difference_percent": 100.0 * apart / abs(y) if apart is not None and y else None,
        }
    reasons = {side: why for side, why in (("a", why_a), ("b", why_b)) if why}
    return {"rows": rows, "density_g_per_cm3": rho, **({"missing": reasons} if reasons else {})}


def _numbers(beat: Beat, rho: float) -> tuple[Mapping[str, Any], str]:
    """Return numbers by name and unit, and why some are missing."""
    found, why = beat.numbers(rho)
    if found is None:
        return ({"peak_pdva_cm2": float(beat.values["pdva"].max())} if "pdva" in beat.values else {}), why
    numbers = found.in_lab_units()
    if found.times_from == "pdva" and found.opening_start is not None and found.closing_end is not None:
        numbers["open_over_10_percent_ms"] = 1e3 * (found.closing_end - found.opening_start)
    return numbers, "; ".join(sorted(set(found.reasons.values())))
