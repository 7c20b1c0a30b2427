"""What three grids or more say of a quantity, in numbers and in words, and what one change of a run does to it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from valvefsi.verification.convergence import (
    ROUND_OFF,
    SAFETY,
    GridConvergence,
    grid_convergence,
    order_of_differences,
)

Kind = Literal[
    "monotone", "oscillating", "slow", "diverging", "unchanged", "two grids", "one grid", "no order"
]
"""How a quantity goes with the grid. Monotone and oscillating ones converge."""
WIDE_SAFETY = 3.0
"""Safety factor of the index of two grids (Roache 1994), and where the order is not the expected one."""
NEAR = 0.1
"""Part of the expected order by which an observed one may differ (Oberkampf and Roy 2010)."""
LOWEST = 0.5
"""Smallest order that an uncertainty is taken with (Oberkampf and Roy 2010)."""


@dataclass(frozen=True, kw_only=True)
class Refinement:
    """A quantity on several grids.

    Attributes:
        kind: How it goes.
        order: Observed order p of the last three; negative where the differences grow, None where they say nothing.
        extrapolated: Richardson's value; None where it does not converge from one side.
        index: Fine-grid convergence index after Celik et al. (2008), relative; None where it does not converge.
        uncertainty: Of the finest value, with the expected order, in the quantity's unit; see `uncertainty_of`. Of an
            oscillating one no less than half of its range (Stern et al. 2001).
        text: All that in words.
    """

    kind: Kind
    order: float | None
    extrapolated: float | None
    index: float | None
    uncertainty: float | None
    text: str


def refinement(values: Sequence[float], ratios: Sequence[float], expected: float) -> Refinement:
    """Return what the grids say of a quantity; the last three count.

    Args:
        values: From the coarsest grid on.
        ratios: Between successive grids, each above one.
        expected: Expected order of accuracy.

    Raises:
        ValueError: A ratio is not above one, or their number is wrong.
    """
    if len(ratios) != len(values) - 1 or not all(r > 1.0 for r in ratios):
        raise ValueError(f"expected a ratio above 1 between each two of {len(values)} values, found {ratios}")
    if len(values) < 3:
        return _of_few(values, ratios, expected)
    (r32, r21), last = ratios[-2:], values[-3:]
    coarse, fine = last[1] - last[0], last[2] - last[1]
    size = ROUND_OFF * max(map(abs, last))
    if abs(fine) <= size:
        return Refinement(
            kind="unchanged",
            order=None,
            extrapolated=values[-1],
            index=0.0,
            uncertainty=0.0,
            text="the same on the last grids, to round-off: no order",
        )
    p = order_of_differences(coarse, fine, r32, r21) if abs(coarse) > size else -math.inf
    bound = uncertainty_of(last, r21, p, expected)
    found = grid_convergence(values, ratios)
    return _without_order(last, p, bound) if found is None else _with_order(last, found, bound, expected)


def _without_order(values: Sequence[float], p: float, bound: float) -> Refinement:
    """Return what there is of values that are not extrapolated."""
    kind: Kind = "slow" if p > 0.0 else "diverging"
    if p > 0.0:
        why = (
            "the finest value is 0, nothing is relative to it"
            if values[-1] == 0.0
            else "too slow to extrapolate from"
        )
        text = f"order {p:.2f}: {why}"
    else:
        text = "DIVERGING: differences grow on finer grids" + ("" if math.isinf(p) else f" (order {p:.2f})")
    return Refinement(
        kind=kind,
        order=None if math.isinf(p) else p,
        extrapolated=None,
        index=None,
        uncertainty=bound,
        text=f"{text}; the values spread over {_spread(values):.4g}",
    )


def _with_order(values: Sequence[float], found: GridConvergence, bound: float, expected: float) -> Refinement:
    """Return what there is of values that converge, from one side or from both."""
    text = f"order {found.order:.2f}, index {100 * found.index:.3g} %"
    if found.order > (1 + NEAR) * expected:
        text += f"; above the expected {expected:g}: the index flatters, the uncertainty does not"
    if found.oscillating:
        text = f"OSCILLATING: differences change sign, nothing is extrapolated; {text}"
        bound = max(bound, _spread(values) / 2)
    return Refinement(
        kind="oscillating" if found.oscillating else "monotone",
        order=found.order,
        extrapolated=None if found.oscillating else found.extrapolated,
        index=found.index,
        uncertainty=bound,
        text=text,
    )


def uncertainty_of(values: Sequence[float], ratio: float, order: float, expected: float) -> float:
    """Return the uncertainty of the finest of three values (Oberkampf and Roy 2010, section 8.6).

        F |v1 - v2| / (r^q - 1):  F = 1.25, q = p_f where the observed order p is within 10 % of the expected p_f,
        else F = 3, q = min(max(p, 0.5), p_f)

    Where the differences grow there is no theory; it is then three times the largest difference, if that is more.

    Args:
        values: From the coarsest on, three.
        ratio: Refinement between the finer grids.
        order: Observed order.
        expected: Expected order.
    """
    near = abs(order - expected) <= NEAR * expected
    safety, q = (SAFETY, expected) if near else (WIDE_SAFETY, min(max(order, LOWEST), expected))
    bound = safety * abs(values[-1] - values[-2]) / (ratio**q - 1.0)
    return max(bound, WIDE_SAFETY * _spread(values)) if order <= 0.0 else bound


def two_grid_error(change: float, ratio: float, expected: float) -> float:
    """Return the uncertainty of the finer of two values, 3 |v1 - v2| / (r^p_f - 1) (Roache 1994).

    Args:
        change: Their difference.
        ratio: Refinement between them.
        expected: Expected order, which two values cannot show.
    """
    return WIDE_SAFETY * abs(change) / (ratio**expected - 1.0)


def without_order(values: Sequence[float], why: str) -> Refinement:
    """Return what there is of a quantity for which an order means nothing: its range over the grids, no uncertainty.

    Args:
        values: From the coarsest grid on.
        why: Why it means nothing.
    """
    return Refinement(
        kind="no order",
        order=None,
        extrapolated=None,
        index=None,
        uncertainty=None,
        text=f"no order: {why}; it ranges over {_spread(values):.4g}",
    )


def _of_few(values: Sequence[float], ratios: Sequence[float], expected: float) -> Refinement:
    if len(values) == 1:
        nothing = "one grid says nothing of convergence"
        return Refinement(
            kind="one grid", order=None, extrapolated=None, index=None, uncertainty=None, text=nothing
        )
    bound = two_grid_error(values[1] - values[0], ratios[0], expected)
    text = f"two grids show no order; uncertainty with order {expected:g} and a factor of {WIDE_SAFETY:g}"
    return Refinement(
        kind="two grids", order=None, extrapolated=None, index=None, uncertainty=bound, text=text
    )


def _spread(values: Sequence[float]) -> float:
    return max(values) - min(values)
