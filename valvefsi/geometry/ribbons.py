"""Middle lines of the edges of a sheet: of the ribbon of facets where a leaflet is attached, or where it is free.

A ribbon is bounded by two curves, one on each face of the sheet. The middle line lies halfway between them, point by
point where both have as many nodes, else at equal parts of their lengths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.errors import CaseError

if TYPE_CHECKING:
    from valvefsi.geometry.tagged import TaggedSurfaces
    from valvefsi.types import Array, Indices

Curve = list[int]


@dataclass(frozen=True, kw_only=True, eq=False)
class MiddleLine:
    """A line whose points are means of nodes, wherever the nodes have gone.

    Attributes:
        nodes: Nodes that each point is a mean of, ``(num_points, 3)``.
        weights: Their weights, ``(num_points, 3)``.
        closed: Whether the line ends where it begins; its last point is its first then.
    """

    nodes: Indices
    weights: Array
    closed: bool

    def at(self, points: Array) -> Array:
        """Return its points where the nodes are at ``points``, ``(num_points, 3)`` [cm]."""
        return np.einsum("kj,kjd->kd", self.weights, points[self.nodes])


def middle_of(line: Array) -> tuple[int, Array]:
    """Return which point of a line has the mean azimuth of all, and the unit vector there from the z axis.

    Args:
        line: Points of the line, ``(n, 2 or 3)`` [cm].
    """
    mean = line[:, :2].mean(axis=0)
    way = mean / np.linalg.norm(mean)
    return int(np.abs(line[:, :2] @ np.array([-way[1], way[0]])).argmin()), way


def middle_lines(
    surfaces: TaggedSurfaces, ribbon: str, faces: tuple[str, str] = ("inflow", "outflow")
) -> list[MiddleLine]:
    """Return the middle line of each piece of a ribbon, counter-clockwise about z, by the azimuth of their middles.

    Args:
        surfaces: The tagged facets.
        ribbon: Name of the ribbon's facets.
        faces: Names of the facets on both sides of the sheet.

    Raises:
        CaseError: The ribbon does not lie between the faces, or a curve branches; the key is the name of the ribbon.
    """
    corners, points = surfaces.faces[ribbon], surfaces.points
    edges = _edges(corners)
    keys, count = np.unique(_keys(edges, len(points)), return_counts=True)
    rim = keys[count == 1]
    piece = _pieces(corners, len(points))
    sides = []
    for face in faces:
        shared = np.intersect1d(rim, _keys(_edges(surfaces.faces[face]), len(points)))
        if not len(shared):
            raise CaseError(f"these facets share no edge with those of {face}", key=ribbon)
        sides.append(_curves(np.stack(np.divmod(shared, len(points)), axis=1), ribbon, face))
    lines = []
    for number in range(piece.max(initial=-1) + 1):
        both = [[curve for curve in curves if piece[curve[0]] == number] for curves in sides]
        if [len(curves) for curves in both] != [1, 1]:
            raise CaseError(
                f"a piece of these facets has {len(both[0])} curves on the side of {faces[0]} and {len(both[1])} on "
                f"that of {faces[1]}, expected one on each: part of the edge has another tag",
                key=ribbon,
            )
        lines.append(_middle(_turned(both[0][0], points), _turned(both[1][0], points), points, ribbon))
    return sorted(lines, key=lambda line: _azimuth(line.at(points).mean(axis=0)))


def _azimuth(x: Array) -> float:
    """Azimuth from 0 to 2 pi, one just below 2 pi as 0 [rad]."""
    return float((np.arctan2(x[1], x[0]) + 1e-6) % (2.0 * np.pi))


def _edges(faces: Indices) -> Indices:
    """Edges of facets, the smaller number first, ``(n, 2)``."""
    return np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)


def _keys(edges: Indices, count: int) -> Indices:
    return edges[:, 0] * count + edges[:, 1]


def _pieces(faces: Indices, count: int) -> Indices:
    """Number the connected pieces of facets from 0, by node; -1 where there is none."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    edges = _edges(faces)
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(count, count))
    _, label = connected_components(graph, directed=False)
    used = np.unique(faces)
    piece = np.full(count, -1, dtype=np.int64)
    piece[used] = np.unique(label[used], return_inverse=True)[1]
    return piece


def _curves(edges: Indices, ribbon: str, face: str) -> list[Curve]:
    """Walk along edges: the nodes of each curve in turn, the first again at the end of a closed one."""
    next_to: dict[int, list[int]] = {}
    for a, b in edges.tolist():
        next_to.setdefault(a, []).append(b)
        next_to.setdefault(b, []).append(a)
    if max(map(len, next_to.values())) > 2:
        raise CaseError(f"their curve on the side of {face} branches", key=ribbon)
    left, curves = set(next_to), []
    for start in sorted(next_to, key=lambda node: (len(next_to[node]), node)):  # ends first
        if start not in left:
            continue
        curve, node = [], start
        while node in left:
            left.discard(node)
            curve.append(node)
            node = next((other for other in next_to[node] if other in left), start)
        if len(next_to[start]) == 2:
            curve.append(start)
        curves.append(curve)
    return curves


def _turned(curve: Curve, points: Array) -> Curve:
    """Return a curve the way around on which the azimuth grows."""
    x = points[curve]
    turn = np.unwrap(np.arctan2(x[:, 1], x[:, 0]))
    return curve if turn[-1] >= turn[0] else curve[::-1]


def _middle(first: Curve, second: Curve, points: Array, ribbon: str) -> MiddleLine:
    """Return the line halfway between two curves."""
    closed = first[0] == first[-1]
    if closed != (second[0] == second[-1]):
        raise CaseError("their curve is closed on one side only", key=ribbon)
    if closed:
        near = int(np.linalg.norm(points[second[:-1]] - points[first[0]], axis=1).argmin())
        second = [*second[near:-1], *second[: near + 1]]
    if len(first) == len(second):
        nodes = np.stack([first, second, second], axis=1)
        return MiddleLine(nodes=nodes, weights=np.tile([0.5, 0.5, 0.0], (len(first), 1)), closed=closed)
    a, b = (_along(points[curve]) for curve in (first, second))
    place = np.clip(np.searchsorted(b, a, side="right") - 1, 0, len(b) - 2)
    part = (a - b[place]) / (b[place + 1] - b[place])
    other = np.asarray(second)
    nodes = np.stack([first, other[place], other[place + 1]], axis=1)
    weights = np.stack([np.full(len(a), 0.5), 0.5 * (1.0 - part), 0.5 * part], axis=1)
    return MiddleLine(nodes=nodes, weights=weights, closed=closed)


def _along(x: Array) -> Array:
    """Return the part of its length at each point of a curve."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(x, axis=0), axis=1))])
    return length / length[-1]


def around(lines: Sequence[Array]) -> list[Array]:
    """Return the azimuths along lines, without jumps, each from where the line begins between 0 and 2 pi [rad]."""
    turned = [np.unwrap(np.arctan2(x[:, 1], x[:, 0])) for x in lines]
    return [phi + (_azimuth(x[0]) - 1e-6 - phi[0]) for phi, x in zip(turned, lines, strict=True)]
