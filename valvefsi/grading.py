"""Edges of cells along a graded axis, from spacings wanted at a few positions.

Between two positions with one spacing the cells are equal; elsewhere their widths form a smooth sequence,
close to geometric, so that the scheme keeps its second order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

Array = np.ndarray

LARGEST_RATIO = 1.1
"""Largest ratio of neighbouring widths."""


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
