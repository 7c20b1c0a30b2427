"""Points of surfaces in patches of some spacings: what of a surface is held as one, and what point by point."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from valvefsi.geometry.aortic_section import PointSurface
from valvefsi.types import Array, Indices

APART = 1.5
"""Least distance of the middles of two patches, in spacings: a patch is then about two spacings across."""
SEAM = 2.0
"""Points within so many spacings of another surface, or of the end of their own, are held one by one."""
SINGLE = -1
"""Label of a point that is in no patch."""


def patch_labels(
    surfaces: Sequence[PointSurface],
    h: float,
    bounds: tuple[float, float] | None = None,
    seam: Array | None = None,
) -> Indices:
    """Return the patch of each point of the surfaces one after the other, `SINGLE` for points held one by one.

    Pressures differ across the line where surfaces meet, on both sides of which a patch would have one traction.

    Args:
        surfaces: The surfaces.
        h: Grid spacing [cm].
        bounds: z at which the surfaces end at a side of the box [cm]; None where they do not.
        seam: Points of a line at which something else is attached to them, ``(m, 3)`` [cm].

    Returns:
        Labels, ``(n,)``, the same on all ranks; no patch has points of two surfaces.
    """
    labels, first = [], 0
    for k, surface in enumerate(surfaces):
        own = _patches(surface.points, APART * h)
        own += first
        first = int(own.max(initial=first - 1)) + 1
        near = np.zeros(len(own), dtype=bool)
        others = [other.points for j, other in enumerate(surfaces) if j != k]
        others += [] if seam is None else [seam]
        if others:
            near |= cKDTree(np.concatenate(others)).query(surface.points)[0] < SEAM * h
        if bounds is not None:
            z = surface.points[:, 2]
            near |= (z - bounds[0] < SEAM * h) | (bounds[1] - z < SEAM * h)
        labels.append(np.where(near, SINGLE, own))
    return np.concatenate(labels)


def _patches(points: Array, apart: float) -> Indices:
    """Return for each point the nearest of middles that are at least so far apart, chosen in the points' order."""
    tree, free, middles = cKDTree(points), np.ones(len(points), dtype=bool), []
    for i in range(len(points)):
        if free[i]:
            middles.append(i)
            free[tree.query_ball_point(points[i], apart)] = False
    return cKDTree(points[middles]).query(points)[1].astype(np.int64)
