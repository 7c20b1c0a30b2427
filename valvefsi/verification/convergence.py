"""Refinement: observed order, Richardson's value, grid convergence index.

Values are listed from the coarsest grid on, ``ratios`` between successive grids are above one (cell size of the
coarser over that of the finer); one number stands for all of them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

from scipy.optimize import brentq

ROUND_OFF = 1e-10
"""Differences below this part of the values say nothing about an order."""
LEAST_ORDER = 0.3
"""Observed orders below this are not extrapolated with."""
STEEPEST = 50.0
"""Largest order that is looked for."""
SAFETY = 1.25
"""Safety factor of the index on three grids (Roache 1994)."""


@dataclass(frozen=True, kw_only=True)
class GridConvergence:
    """What three grids say about the finest (Celik et al. 2008).

    Attributes:
        order: Observed order p.
        extrapolated: Value on infinitely fine cells.
        change: |v3 - v2| / |v3|.
        error: |extrapolated - v3| / |extrapolated|.
        index: Fine-grid convergence index, 1.25 |v3 - v2| / |v3| / (r^p - 1).
        oscillating: Whether the two differences have opposite signs.
    """

    order: float
    extrapolated: float
    change: float
    error: float
    index: float
    oscillating: bool


def ratios_of(sizes: Sequence[float]) -> list[float]:
    """Return the refinement ratios of grids with so many cells along an edge, coarsest first."""
    return [fine / coarse for coarse, fine in itertools.pairwise(sizes)]


def observed_order(
    values: Sequence[float], ratios: Sequence[float] | float = 2.0, *, exact: float | None = None
) -> float | None:
    """Return the order of the last refinement, from errors or from successive differences.

    With an exact value p = ln(|v2 - v| / |v3 - v|) / ln r; without one p solves the equation of `order_of_differences`.

    Returns:
        The order; None where there are too few values, or the differences change sign or are at round-off.
    """
    steps = _ratios(values, ratios)
    gaps = (
        [v - exact for v in values] if exact is not None else [b - a for a, b in itertools.pairwise(values)]
    )
    if len(gaps) < 2 or gaps[-1] * gaps[-2] <= 0.0 or abs(gaps[-1]) < ROUND_OFF * abs(values[-1]):
        return None
    if exact is not None:
        return math.log(gaps[-2] / gaps[-1]) / math.log(steps[-1])
    return order_of_differences(gaps[-2], gaps[-1], steps[-2], steps[-1])


def order_of_differences(coarse: float, fine: float, ratio_coarse: float, ratio_fine: float) -> float:
    """Return the order p of two successive differences e32 and e21 (Celik et al. 2008, eq. 3).

        p ln r21 = ln|e32 / e21| + ln((r21^p - s) / (r32^p - s)),    s = sign(e32 / e21)

    It is negative where the differences grow, which the magnitude in the paper hides, and within +-50.

    Args:
        coarse: Difference e32 of the two coarser grids.
        fine: Difference e21 of the two finer grids.
        ratio_coarse: Refinement r32 between the coarser grids.
        ratio_fine: Refinement r21 between the finer grids.
    """
    s, jump = math.copysign(1.0, coarse / fine), math.log(abs(coarse / fine))
    a, b = math.log(ratio_fine), math.log(ratio_coarse)
    if a == b:
        return jump / a

    def miss(p: float) -> float:
        if s > 0.0:
            part = math.log(b / a) if p == 0.0 else math.log(math.expm1(p * b) / math.expm1(p * a))
        else:
            part = math.log((math.exp(p * b) + 1.0) / (math.exp(p * a) + 1.0))
        return p * a + part - jump

    if not miss(-STEEPEST) < 0.0 < miss(STEEPEST):  # steeper than any method: the nearer end says enough
        return -STEEPEST if miss(-STEEPEST) >= 0.0 else STEEPEST
    return float(brentq(miss, -STEEPEST, STEEPEST, xtol=1e-14))


def extrapolated(values: Sequence[float], ratios: Sequence[float] | float = 2.0) -> float | None:
    """Return Richardson's value of the last three with their observed order, None without one of at least 0.3."""
    order = observed_order(values, ratios)
    if order is None or order < LEAST_ORDER:
        return None
    ratio = _ratios(values, ratios)[-1]
    return float(values[-1] + (values[-1] - values[-2]) / (ratio**order - 1.0))


def grid_convergence(
    values: Sequence[float], ratios: Sequence[float] | float = 2.0, *, safety: float = SAFETY
) -> GridConvergence | None:
    """Return order, Richardson's value and grid convergence index of the last three values.

    Returns:
        None with fewer than three values, where a difference is at round-off, or where the order is below 0.3.
    """
    if len(values) < 3:
        return None
    (r32, r21), (v3, v2, v1) = _ratios(values, ratios)[-2:], values[-3:]
    coarse, fine = v2 - v3, v1 - v2
    if min(abs(coarse), abs(fine)) <= ROUND_OFF * abs(v1) or v1 == 0.0:
        return None
    p = order_of_differences(coarse, fine, r32, r21)
    if p < LEAST_ORDER:
        return None
    limit = (r21**p * v1 - v2) / (r21**p - 1.0)
    change = abs(fine / v1)
    return GridConvergence(
        order=p,
        extrapolated=limit,
        change=change,
        error=abs((limit - v1) / limit),
        index=safety * change / (r21**p - 1.0),
        oscillating=coarse * fine < 0.0,
    )


def _ratios(values: Sequence[float], ratios: Sequence[float] | float) -> list[float]:
    steps = [float(ratios)] * (len(values) - 1) if isinstance(ratios, int | float) else list(ratios)
    if len(steps) != max(0, len(values) - 1) or not all(r > 1.0 for r in steps):
        raise ValueError(f"expected a ratio above 1 between each two of {len(values)} values, found {steps}")
    return steps
