"""Places of a leaflet, belly, free edge, commissure and attached edge, and largest values there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial import cKDTree

from valvefsi.solid.peaks import percentile
from valvefsi.types import Array, Indices

PLACES = ("belly", "free_edge", "commissure", "attached_edge")
"""Places by number: within reach of no edge, of the free edge, of both, of the attached edge."""
CUTS = {4: ((0, 1, 2, 3),), 8: ((0, 1, 3, 4), (1, 2, 3, 6), (1, 4, 5, 6), (3, 4, 6, 7), (1, 3, 4, 6))}
"""Tetrahedra of a cell by its number of corners, in VTK's order."""


def places(reference: Array, free: Sequence[Array], attached: Sequence[Array], reach: float) -> Indices:
    """Return the place of each node, an index of `PLACES`, ``(n,)``.

    Args:
        reference: Reference positions of the nodes, ``(n, 3)`` [cm].
        free: Points along each free edge, there, ``(k, 3)`` [cm].
        attached: The same of each attached edge.
        reach: How far from an edge it counts as there [cm].
    """
    free_edge, attached_edge = (_near(reference, np.concatenate(lines), reach) for lines in (free, attached))
    return free_edge + 3 * attached_edge - 2 * (free_edge * attached_edge)


def _near(points: Array, line: Array, reach: float) -> Indices:
    """1 where points are within reach of a line, else 0."""
    return np.asarray(cKDTree(line).query(points)[0] <= reach, dtype=np.int64)


def node_volumes(points: Array, cells: Indices) -> Array:
    """Return the volume that each node stands for, an equal part of its cells', ``(n,)`` [cm^3].

    Args:
        points: Positions, ``(n, 3)`` [cm].
        cells: Corners of the cells in VTK's order, ``(m, 4 or 8)``; cells of more nodes begin with their corners.
    """
    corners = 4 if cells.shape[1] in (4, 10) else 8
    x = points[cells]
    volume = np.zeros(len(cells))
    for a, b, c, d in CUTS[corners]:
        edges = np.stack([x[:, b] - x[:, a], x[:, c] - x[:, a], x[:, d] - x[:, a]], axis=1)
        volume += np.abs(np.linalg.det(edges)) / 6.0
    each = np.repeat(volume / cells.shape[1], cells.shape[1])
    return np.bincount(cells.ravel(), each, minlength=len(points))


def largest(
    values: Mapping[str, Array], volumes: Array, place: Indices
) -> dict[str, dict[str, tuple[float, float]]]:
    """Return the 99th percentile by volume and the maximum of nodal values, by place and name.

    Args:
        values: Values of the nodes by name, ``(n,)``.
        volumes: Volume of each node, ``(n,)`` [cm^3].
        place: Place of each node, ``(n,)``.
    """
    found: dict[str, dict[str, tuple[float, float]]] = {}
    for number, name in enumerate(PLACES):
        here = place == number
        if here.any():
            found[name] = {
                key: (percentile(x[here], volumes[here]), float(x[here].max())) for key, x in values.items()
            }
    return found
