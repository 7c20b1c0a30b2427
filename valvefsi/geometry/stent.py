"""The stent of a valve: a wall from the housing's annulus up to where the leaflets are attached, and the posts.

Where the edge lies at radius R(phi) and height Z(phi), the wall is straight from the housing at the annulus up to a
knee, and from there up to the edge,

    r(phi, z) = R_0(phi) + (R_k(phi) - R_0(phi)) (z - annulus) / (Z_k(phi) - annulus),    annulus <= z <= Z_k,

R_0 the housing's radius there: a cylinder where both are the same. The knee is the edge itself but where that rises
steeply, as at the ends of the posts: Z_k is the highest that nowhere rises by more than `STEEPEST`, and R_k the edge's
radius where the rise begins. A post so stands on the radius of the leaflets' lower attachment beside it, not on a cone
of its own that would leave a slot there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from valvefsi.errors import CaseError
from valvefsi.geometry.aortic_section import SPACING, PointSurface
from valvefsi.geometry.ribbons import around

if TYPE_CHECKING:
    from valvefsi.geometry.leaflets import ValveGeometry
    from valvefsi.types import Array, Indices

LINE = 101
"""Points along each part of a formula's attachment."""
WIDEST_POST = 30.0
"""Largest angle about the axis between the ends of two leaflets' edges that a post closes [deg]."""
STEEPEST = 2.0
"""Largest rise of the knee along the way around; leaflets' attachments below the posts rise by about 1."""


class StentEdge(Protocol):
    """The upper edge of a stent about the z axis."""

    @property
    def radius(self) -> float:
        """Largest distance from the axis [cm]."""
        ...

    @property
    def lowest(self) -> float:
        """Smallest z [cm]."""
        ...

    def at(self, phi: Array) -> tuple[Array, Array]:
        """Return distance from the axis and z at azimuths, ``(n,)`` each [cm]."""
        ...

    def attached(self) -> Sequence[Array]:
        """Return points of the lines at which leaflets are attached, ``(n, 3)`` each [cm]."""
        ...


@dataclass(frozen=True)
class FormulaEdge:
    """The attachment of a parametric valve.

    Attributes:
        valve: The valve.
        height: z of the lowest point of its attachment [cm].
    """

    valve: ValveGeometry
    height: float

    @property
    def radius(self) -> float:
        """Radius of the stent's cylinder [cm]."""
        return self.valve.radius

    @property
    def lowest(self) -> float:
        """Smallest z [cm]."""
        return self.height

    def at(self, phi: Array) -> tuple[Array, Array]:
        """Return distance from the axis and z at azimuths, ``(n,)`` each [cm]."""
        return np.full_like(phi, self.valve.radius), self.height + stent_height(self.valve, phi)

    def attached(self) -> list[Array]:
        """Return points of the three lower attachments with the sides at the posts, ``(n, 3)`` each [cm]."""
        ends, along = np.ones(LINE), np.linspace(0.0, 1.0, LINE)
        sides = [self.valve.surface(end * ends, along) for end in (-1.0, 1.0)]
        line = np.concatenate([sides[0][::-1], self.valve.attachment(2.0 * along - 1.0), sides[1]])
        line[:, 2] += self.height
        turns = [(math.cos(a), math.sin(a)) for a in 2.0 * math.pi / 3.0 * np.arange(3)]
        return [line @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) for c, s in turns]


class LineEdge:
    """The attachment of leaflets of one's own: lines around the axis, with straight posts between their ends.

    Where lines lie above one another the stent goes up to the highest.

    Args:
        lines: Points of each line, counter-clockwise about the z axis, ``(num_points, 3)`` each [cm]; one that ends
            where it begins goes all the way around.

    Raises:
        CaseError: The lines leave an angle open that is wider than a post, a line does not go around the axis.
    """

    def __init__(self, lines: Sequence[Array]) -> None:
        parts = sorted(zip(around(lines), lines, strict=True), key=lambda part: float(part[0][0]))
        phi = [turn for turn, _ in parts]
        rz = [np.stack([np.hypot(x[:, 0], x[:, 1]), x[:, 2]], axis=1) for _, x in parts]
        self._check(phi)
        self._lines = list(lines)
        ends = [(k, (k + 1) % len(parts)) for k in range(len(parts))]
        if len(parts) > 1 or phi[0][-1] - phi[0][0] < 2.0 * math.pi - 1e-9:
            for a, b in ends:
                full = 2.0 * math.pi if b <= a else 0.0
                phi.append(np.array([phi[a][-1], phi[b][0] + full]))
                rz.append(np.stack([rz[a][-1], rz[b][0]]))
        start = np.concatenate([np.stack([p[:-1], p[1:]], axis=1) for p in phi])
        self._phi = start
        self._rz = np.concatenate([np.stack([v[:-1], v[1:]], axis=1) for v in rz])

    @property
    def radius(self) -> float:
        """Largest distance from the axis [cm]."""
        return round(float(self._rz[..., 0].max()), 9)

    @property
    def lowest(self) -> float:
        """Smallest z [cm]."""
        return float(self._rz[..., 1].min())

    @property
    def mean_radius(self) -> float:
        """Mean distance from the axis over the azimuth [cm]."""
        return float(self.at(2.0 * math.pi * np.arange(720) / 720)[0].mean())

    def at(self, phi: Array) -> tuple[Array, Array]:
        """Return distance from the axis and z of the highest place at azimuths, ``(n,)`` each [cm]."""
        low, high = self._phi.min(axis=1)[:, None], self._phi.max(axis=1)[:, None]
        middle = 0.5 * (low + high)
        turn = middle + (phi[None, :] - middle + math.pi) % (2.0 * math.pi) - math.pi
        inside = (turn >= low - 1e-9) & (turn <= high + 1e-9)
        span = self._phi[:, 1:] - self._phi[:, :1]
        flat = np.abs(span) < 1e-9  # a post that goes straight up
        part = np.clip((turn - self._phi[:, :1]) / np.where(flat, 1.0, span), 0.0, 1.0)
        first, last = self._rz[:, None, 0], self._rz[:, None, 1]
        part = np.where(flat, (last[..., 1] > first[..., 1]).astype(float), part)
        rz = first + part[..., None] * (last - first)
        best = np.where(inside, rz[..., 1], -np.inf).argmax(axis=0)
        found = rz[best, np.arange(len(phi))]
        return found[:, 0], found[:, 1]

    def attached(self) -> list[Array]:
        """Return the lines, without the posts, ``(n, 3)`` each [cm]."""
        return self._lines

    @staticmethod
    def _check(phi: Sequence[Array]) -> None:
        """Refuse lines that leave the way around the axis open."""
        for turn in phi:
            if turn[-1] - turn[0] < math.radians(1.0):
                raise CaseError("the curve of these facets does not go around the z axis", key="attached")
        reached = phi[0][0]
        for k, turn in enumerate([*phi[1:], phi[0] + 2.0 * math.pi]):
            reached = max(reached, phi[k].max())
            gap = math.degrees(turn[0] - reached)
            if gap > WIDEST_POST:
                a, b = (math.degrees(x) % 360.0 for x in (reached, turn[0]))
                raise CaseError(
                    f"the stent's curve is open: nothing is attached between azimuths {a:.3g} and {b:.3g} deg, "
                    f"expected gaps of at most {WIDEST_POST:g} deg",
                    key="attached",
                )


def stent_wall(edge: StentEdge, annulus: float, foot: Callable[[Array], Array], h: float) -> PointSurface:
    """Return the stent as points at most half a spacing apart.

    Args:
        edge: Its upper edge.
        annulus: z of its lower end [cm].
        foot: Distance from the axis at the lower end, at azimuths [cm].
        h: Grid spacing [cm].
    """
    columns = 3 * math.ceil(2.0 * math.pi * edge.radius / (3 * SPACING * h))
    phi, step = 2.0 * math.pi * np.arange(columns) / columns, 2.0 * math.pi / columns
    r_of, z_of = _profiles(edge, annulus, foot(phi), phi)
    points, areas, normals = [], [], []
    for k in range(columns):
        length = np.hypot(np.diff(r_of[k]), np.diff(z_of[k])).sum()
        n = max(2, math.ceil(length / (SPACING * h)) + 1)
        z = np.linspace(annulus, z_of[k, -1], n)
        before, r, after = (np.interp(z, z_of[j % columns], r_of[j % columns]) for j in (k - 1, k, k + 1))
        slopes = np.diff(r_of[k]) / np.maximum(np.diff(z_of[k]), 1e-9)
        normal, area = _normal(
            phi[k], (after - before) / (2 * step * r), slopes[(z > z_of[k, 1]).astype(int)]
        )
        points.append(np.stack([r * math.cos(phi[k]), r * math.sin(phi[k]), z], axis=1))
        share = np.full(n, (z[-1] - annulus) / (n - 1))
        share[[0, -1]] *= 0.5
        areas.append(step * r * share * area)
        normals.append(normal)
    return PointSurface(
        points=np.concatenate(points),
        areas=np.concatenate(areas),
        normals=np.concatenate(normals),
        faces=np.zeros((0, 4), np.int64),
    )


def _profiles(edge: StentEdge, annulus: float, foot: Array, phi: Array) -> tuple[Array, Array]:
    """Return distance from the axis and z of the wall's foot, knee and edge at azimuths, ``(n, 3)`` each [cm]."""
    R, Z = edge.at(phi)
    Z = np.maximum(Z, annulus + 1e-9)
    knee, begin = _knees(edge, phi, Z)
    return np.stack([foot, R[begin], R], axis=1), np.stack([np.full_like(Z, annulus), knee, Z], axis=1)


def knee_heights(edge: StentEdge, phi: Array) -> Array:
    """Return z of the knee at azimuths all around, ``(n,)`` [cm]."""
    return _knees(edge, phi, edge.at(phi)[1])[0]


def _knees(edge: StentEdge, phi: Array, Z: Array) -> tuple[Array, Indices]:
    """Return z of the knee at azimuths where the edge lies at Z, and the azimuth where its rise begins."""
    apart = np.abs((phi[:, None] - phi[None, :] + math.pi) % (2.0 * math.pi) - math.pi)
    reached = Z + STEEPEST * edge.radius * apart
    begin = reached.argmin(axis=1)
    return reached[np.arange(len(phi)), begin], begin.astype(np.int64)


def _normal(phi: float, along: Array, up: Array) -> tuple[Array, Array]:
    """Return unit normals away from the axis and areas per dphi dz / r, of the slopes dr/(r dphi) and dr/dz."""
    c, s = math.cos(phi), math.sin(phi)
    n = np.stack([c + s * along, s - c * along, -up], axis=1)
    size = np.linalg.norm(n, axis=1)
    return n / size[:, None], size


def stent_height(valve: ValveGeometry, phi: Array) -> Array:
    """Return the height of the stent above the lowest point of the attachment at angles phi, ``(n,)`` [cm]."""
    angle = (phi + math.pi / 3.0) % (2.0 * math.pi / 3.0) - math.pi / 3.0  # from the middle of the leaflet
    u = angle / valve.half_angle
    attached = valve.attachment(np.clip(u, -1.0, 1.0))[:, 2]
    return np.where(np.abs(u) >= 1.0 - 1e-9, valve.height, attached)


def edge_line(edge: StentEdge, num_points: int) -> Array:
    """Return points of the line where the leaflets meet the stent, ``(num_points, 3)`` [cm].

    Args:
        edge: The upper edge of the stent.
        num_points: Number of points around the axis.
    """
    phi = 2.0 * math.pi * np.arange(num_points) / num_points
    r, z = edge.at(phi)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=1)


def widest_seam(edge: StentEdge, points: Array) -> tuple[float, Array]:
    """Return how far the leaflets' attachment is from the points of walls at most, and where, both [cm].

    Args:
        edge: The upper edge of the stent, with the lines at which leaflets are attached.
        points: Points of the walls at most half a spacing apart, ``(n, 3)`` [cm].
    """
    from scipy.spatial import cKDTree

    line = np.concatenate(edge.attached())
    apart = cKDTree(points).query(line)[0]
    return float(apart.max()), line[apart.argmax()]
