"""The aortic test section of a pulse duplicator: inflow tract, three sinuses, outflow tract.

The housing is a surface r(phi, z) about the z axis. With s = (z - annulus) / sinus_height between 0 and 1,

    r = R + (R_out - R) (3 s^2 - 2 s^3) + depth (16 s^2 (1 - s)^2) (1 + cos 3 phi) / 2,

R below, R_out above: smooth, with a sinus behind the middle of each leaflet. The stent is `valvefsi.geometry.stent`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.errors import CaseError

SPACING = 0.5
"""Largest distance of neighbouring points in grid spacings; the piecewise linear kernel is tight at that."""

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from valvefsi.types import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class PointSurface:
    """A surface as points with areas, the same on all ranks.

    Attributes:
        points: Points, ``(n, 3)`` [cm].
        areas: Area of each, ``(n,)`` [cm^2].
        normals: Unit normals, away from the axis or along it, ``(n, 3)``.
        faces: Corners of quadrilaterals for pictures, ``(m, 4)``.
    """

    points: Array
    areas: Array
    normals: Array
    faces: NDArray[np.int64]

    def moved(self, distance: Array) -> PointSurface:
        """Return the surface with each point moved along its normal, ``(n,)`` [cm]."""
        return replace(self, points=self.points + distance[:, None] * self.normals)


@dataclass(frozen=True, kw_only=True)
class AorticSection:
    """Dimensions of the housing; lengths in cm, z along the flow.

    Attributes:
        inlet_radius: R, of the inflow tract and of the valve's orifice.
        outlet_radius: R_out, of the outflow tract.
        annulus: z at which the sinuses begin.
        sinus_height: Length of the sinuses along z.
        sinus_depth: How far they go out at their deepest.
    """

    inlet_radius: float = 1.25
    outlet_radius: float = 1.4
    annulus: float = 0.0
    sinus_height: float = 2.2
    sinus_depth: float = 0.5

    def __post_init__(self) -> None:
        for name in ("inlet_radius", "outlet_radius", "sinus_height"):
            value = getattr(self, name)
            if not 0.0 < value < math.inf:
                raise CaseError("expected a positive length", key=name, value=value)
        if not 0.0 <= self.sinus_depth < math.inf:
            raise CaseError(
                "expected a length that is not negative", key="sinus_depth", value=self.sinus_depth
            )

    @property
    def widest(self) -> float:
        """Largest distance of the housing from the axis [cm]."""
        phi, z = np.zeros(1001), self.annulus + self.sinus_height * np.linspace(0.0, 1.0, 1001)
        return float(self.radius(phi, z).max())

    def radius(self, phi: Array, z: Array) -> Array:
        """Return r(phi, z), same shape [cm]."""
        s = np.clip((z - self.annulus) / self.sinus_height, 0.0, 1.0)
        change = (self.outlet_radius - self.inlet_radius) * s**2 * (3.0 - 2.0 * s)
        return (
            self.inlet_radius + change + 8.0 * self.sinus_depth * (s * (1.0 - s)) ** 2 * (1 + np.cos(3 * phi))
        )

    def housing(self, h: float, bounds: tuple[float, float]) -> PointSurface:
        """Return the housing between two planes as points at most half a spacing apart.

        Args:
            h: Grid spacing [cm].
            bounds: z of the planes [cm].
        """
        z = np.linspace(*bounds, 2001)
        steepest = max(
            float(np.hypot(np.gradient(self.radius(np.full_like(z, phi), z), z), 1.0).max())
            for phi in np.linspace(0.0, math.pi / 3.0, 7)
        )
        rows = math.ceil((bounds[1] - bounds[0]) * steepest / (SPACING * h)) + 1
        around = math.ceil(2.0 * math.pi * self._longest_round() / (SPACING * h))
        return _surface(self.radius, np.linspace(*bounds, rows), around)

    def _longest_round(self) -> float:
        """Largest of ds/dphi along circles of constant z [cm]."""
        phi = np.linspace(0.0, 2.0 * math.pi, 721)
        longest = max(self.inlet_radius, self.outlet_radius)
        for s in np.linspace(0.0, 1.0, 51):
            r = self.radius(phi, np.full_like(phi, self.annulus + s * self.sinus_height))
            longest = max(longest, float(np.hypot(r, np.gradient(r, phi)).max()))
        return longest


def closing_plate(radius: float, z: float, h: float) -> PointSurface:
    """Return a disk that closes a tube, in rings of points; for tests of leaks."""
    rings = math.ceil(radius / (SPACING * h))
    step = radius / rings
    points, areas = [np.array([[0.0, 0.0, z]])], [np.array([math.pi * (0.5 * step) ** 2])]
    for k in range(1, rings + 1):
        r = step * k
        n = math.ceil(2.0 * math.pi * r / (SPACING * h))
        phi = 2.0 * math.pi * np.arange(n) / n
        points.append(np.stack([r * np.cos(phi), r * np.sin(phi), np.full(n, z)], axis=1))
        inner, outer = r - 0.5 * step, min(r + 0.5 * step, radius)
        areas.append(np.full(n, math.pi * (outer**2 - inner**2) / n))
    places = np.concatenate(points)
    return PointSurface(
        points=places,
        areas=np.concatenate(areas),
        normals=np.tile([0.0, 0.0, 1.0], (len(places), 1)),
        faces=np.zeros((0, 4), np.int64),
    )


def joined(*surfaces: PointSurface) -> PointSurface:
    """Return several surfaces as one."""
    shift = np.cumsum([0] + [len(s.points) for s in surfaces[:-1]])
    return PointSurface(
        points=np.concatenate([s.points for s in surfaces]),
        areas=np.concatenate([s.areas for s in surfaces]),
        normals=np.concatenate([s.normals for s in surfaces]),
        faces=np.concatenate([s.faces + k for s, k in zip(surfaces, shift, strict=True)]),
    )


def _surface(radius: Callable[[Array, Array], Array], z: Array, around: int) -> PointSurface:
    """Return a surface r(phi, z) as rows of points, every other row turned by half a step."""
    rows, step = len(z), 2.0 * math.pi / around
    phi = step * (np.arange(around)[None, :] + 0.5 * (np.arange(rows)[:, None] % 2))
    Z = np.broadcast_to(z[:, None], phi.shape)
    points = _place(radius, phi, Z)
    e = 1e-5
    along = (_place(radius, phi + e, Z) - _place(radius, phi - e, Z)) / (2 * e)
    up = (_place(radius, phi, Z + e) - _place(radius, phi, Z - e)) / (2 * e)
    normals = np.cross(along, up)
    areas = np.linalg.norm(normals, axis=-1)
    normals /= areas[..., None]
    areas *= step * (z[1] - z[0])
    areas[[0, -1]] *= 0.5
    index = np.arange(rows * around).reshape(rows, around)
    turned = np.roll(index, -1, axis=1)
    faces = np.stack([index[:-1], turned[:-1], turned[1:], index[1:]], axis=-1).reshape(-1, 4)
    return PointSurface(
        points=points.reshape(-1, 3), areas=areas.ravel(), normals=normals.reshape(-1, 3), faces=faces
    )


def _place(radius: Callable[[Array, Array], Array], phi: Array, z: Array) -> Array:
    r = radius(phi, z)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=-1)
