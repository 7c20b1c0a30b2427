"""The gap between two polygons in the plane, such as the outlines of leaflets."""

from __future__ import annotations

import numpy as np

from valvefsi.types import Array


def gap(a: Array, b: Array) -> float:
    """Return the smallest distance of two polygons, negative where they overlap.

    Args:
        a: Corners in order, ``(n, 2)`` [cm].
        b: The same of the other.

    Returns:
        Distance of the outlines, 0 where only edges cross; where a corner lies inside the other polygon, less the
        largest distance by which one does [cm].
    """
    inside = [(_distances(p, q), _are_inside(p, q)) for p, q in ((a, b), (b, a))]
    if any(within.any() for _, within in inside):
        return -float(max(d[within].max(initial=0.0) for d, within in inside))
    return 0.0 if _cross(a, b) else float(min(d.min() for d, _ in inside))


def _cross(a: Array, b: Array) -> bool:
    """Whether an edge of one polygon crosses an edge of the other."""

    def sides(p: Array, q: Array) -> Array:
        """Side of each edge of p that each corner of q lies on."""
        along, to = np.roll(p, -1, axis=0) - p, q - p[:, None]
        return along[:, None, 0] * to[..., 1] - along[:, None, 1] * to[..., 0]

    one, other = sides(a, b), sides(b, a)
    apart = (one * np.roll(one, -1, axis=1) < 0.0) & (other * np.roll(other, -1, axis=1) < 0.0).T
    return bool(apart.any())


def _distances(points: Array, polygon: Array) -> Array:
    """Distance of each point from the outline of a polygon."""
    start, along = polygon, np.roll(polygon, -1, axis=0) - polygon
    from_start = points[:, None] - start
    share = (from_start * along).sum(axis=2) / np.square(along).sum(axis=1)
    nearest = from_start - np.clip(share, 0.0, 1.0)[..., None] * along
    return np.linalg.norm(nearest, axis=2).min(axis=1)


def _are_inside(points: Array, polygon: Array) -> Array:
    """Whether each point lies inside a polygon: a ray from it crosses the outline an odd number of times."""
    x, y = points[:, :1], points[:, 1:]
    (x0, y0), (x1, y1) = polygon.T, np.roll(polygon, -1, axis=0).T
    crosses = (y0 > y) != (y1 > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = x0 + (y - y0) * (x1 - x0) / (y1 - y0)
    return (crosses & (x < at)).sum(axis=1) % 2 == 1
