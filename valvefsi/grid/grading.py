"""Edges of cells along a graded axis, from spacings wanted at a few positions.

Between two positions with one spacing the cells are equal; elsewhere their widths form a smooth sequence,
close to geometric, so that the scheme keeps its second order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from valvefsi.types import Array

LARGEST_RATIO = 1.1
"""Largest ratio of neighbouring widths."""

GROWTH = 0.07
"""Largest growth from cell to cell beside a core."""


def graded_edges(points: Sequence[tuple[float, float]]) -> Array:
    """Return the edges of the cells along an axis.

    Args:
        points: Increasing positions and the spacing wanted there, at least two pairs [cm].

    Returns:
        Edges from the first position to the last, ``(cells + 1,)`` [cm]. Stretches with equal spacing at both ends
        hold a whole number of equal cells, so their spacing differs a little from the one wanted.

    Raises:
        ValueError: Positions do not increase, a spacing is not positive, or neighbouring widths differ by more than
            `LARGEST_RATIO`.
    """
    if len(points) < 2:
        raise ValueError("a graded axis needs at least two positions with their spacings")
    x, h = (np.array(column, dtype=float) for column in zip(*points, strict=True))
    if not np.all(np.diff(x) > 0.0) or not np.all(h > 0.0):
        raise ValueError("positions must increase and spacings be positive")
    equal = np.isclose(h[:-1], h[1:], rtol=1e-9, atol=0.0)
    counts = np.maximum(1, np.round(np.diff(x) / h[:-1])).astype(int)
    ends = np.stack([h[:-1], h[1:]], axis=1)
    for k in np.flatnonzero(equal):  # what the neighbours have to join
        ends[k] = np.diff(x)[k] / counts[k]
        if k > 0 and not equal[k - 1]:
            ends[k - 1, 1] = ends[k, 0]
        if k + 1 < len(equal) and not equal[k + 1]:
            ends[k + 1, 0] = ends[k, 0]
    widths = np.concatenate(
        [
            np.full(n, end[0]) if same else _growing(length, *end)
            for n, end, same, length in zip(counts, ends, equal, np.diff(x), strict=True)
        ]
    )
    _check(x[0], widths)
    edges = x[0] + np.concatenate([[0.0], np.cumsum(widths)])
    edges[-1] = x[-1]
    return edges


def core_edges(lower: float, first: float, last: float, upper: float, h: float) -> Array:
    """Return the edges of cells of one width in a core and growing ones beside it.

    Args:
        lower: Lower end of the axis [cm].
        first: Lower end of the core [cm].
        last: Upper end of the core [cm].
        upper: Upper end of the axis [cm].
        h: Width in the core; the core is widened to a whole number of cells on sides where there is room [cm].

    Raises:
        ValueError: The core is the whole axis and no whole number of cells, or what is beside it is too short.
    """
    count = math.ceil((last - first) / h - 1e-6)
    lack = count * h - (last - first)
    open_ends = [lower < first, last < upper]
    if lack > 1e-6 * h and not any(open_ends):
        raise ValueError(f"an axis of {last - first:g} cm is not a whole number of cells of {h:g} cm")
    if not any(open_ends):  # all cells alike, though h has been written with few digits
        return np.linspace(lower, upper, count + 1)
    if lack > 1e-6 * h:
        first -= lack * open_ends[0] / sum(open_ends)
        last += lack * open_ends[1] / sum(open_ends)
    parts = [first + h * np.arange(count + 1)]
    if open_ends[0]:
        parts.insert(0, first - _beside(first - lower, h)[::-1])
    if open_ends[1]:
        parts.append(last + _beside(upper - last, h))
    edges = np.concatenate(parts)
    edges[[0, -1]] = lower, upper
    _check(lower, np.diff(edges))
    return edges


def nearest_spacing(lengths: Sequence[float], h: float) -> float | None:
    """Return the spacing nearest to h of which each of some lengths is a whole number; None where none is near.

    Args:
        lengths: Lengths of the axes, at least one [cm].
        h: The spacing wanted, by no more than a quarter of which the one returned differs [cm].
    """
    first, least = lengths[0], max(1, math.ceil(0.8 * lengths[0] / h))
    near = [first / n for n in range(least, math.floor(lengths[0] / h / 0.75) + 1)]
    for spacing in sorted(near, key=lambda each: abs(each - h)):
        if all(
            abs(length / spacing - round(length / spacing)) < 1e-9 * length / spacing for length in lengths
        ):
            return spacing
    return None


def _beside(length: float, h: float) -> Array:
    """Distances from a core's end of edges of cells that grow by one ratio, the last of them the length."""
    if length < h * (1.0 - 1e-9):
        raise ValueError(f"a stretch of {length:.4g} cm beside the core is too short for cells of {h:g} cm")

    def ends(ratio: float, n: int) -> Array:
        return h * np.cumsum(ratio ** np.arange(1, n + 1))

    n = 1
    while ends(1.0 + GROWTH, n)[-1] < length * (1.0 - 1e-9):
        n += 1
    if n * h > length * (1.0 + 1e-9):
        raise ValueError(
            f"a stretch of {length:.4g} cm beside the core is not filled by cells that grow from {h:g} cm; "
            f"{n * h:.4g} cm would do"
        )
    low, high = 1.0, 1.0 + GROWTH
    for _ in range(60):  # the sum grows with the ratio
        middle = 0.5 * (low + high)
        low, high = (middle, high) if ends(middle, n)[-1] < length else (low, middle)
    return ends(high, n)


def _growing(length: float, first: float, last: float) -> Array:
    """Widths that grow (or shrink) from one spacing to another and add up to a length."""

    def widths(n: int) -> Array:
        s = np.arange(1, n + 1) / (n + 1)
        return first * (last / first) ** s

    n = max(1, math.floor(length / max(first, last)))
    while widths(n).sum() < length:
        n += 1
    if n > 1 and widths(n).sum() - length > length - widths(n - 1).sum():
        n -= 1
    w = widths(n)
    bump = w * np.sin(np.pi * np.arange(1, n + 1) / (n + 1)) ** 2  # leaves the ends as they are
    return w + bump * (length - w.sum()) / bump.sum()


def _check(start: float, widths: Array) -> None:
    if not np.all(widths > 0.0):
        raise ValueError("a stretch is too short for the spacings at its ends")
    if len(widths) < 2:
        return
    ratios = np.maximum(widths[1:] / widths[:-1], widths[:-1] / widths[1:])
    worst = int(np.argmax(ratios))
    if ratios[worst] > LARGEST_RATIO:
        place = start + widths[: worst + 1].sum()
        raise ValueError(
            f"neighbouring cells at {place:.4g} cm have widths {widths[worst]:.4g} and {widths[worst + 1]:.4g} cm, "
            f"a ratio of {ratios[worst]:.3f}; at most {LARGEST_RATIO} is smooth enough: use a longer stretch or "
            "closer spacings"
        )
