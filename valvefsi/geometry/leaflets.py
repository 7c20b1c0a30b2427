"""The middle surface of a three-leaflet valve, closed but for a gap that its formulas guarantee.

Each leaflet lives in its own sector of 120 degrees; x points to the middle of the sector, z downstream. The two
planes at the sector's sides are where neighbours meet. The middle surface keeps the distance d to both planes,

    d = (gap + thickness) / 2,

so that two leaflets are at least ``gap`` apart wherever they are. The free edge is one branch of a hyperbola
that has these planes, moved by d, as asymptotes, and the attachment lies on the cylinder of the stent, between the
ends of that branch. Every point is a convex combination (a parabola in v) of points of the sector so cut, which is
convex: the surface cannot leave it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from valvefsi.errors import CaseError

if TYPE_CHECKING:
    from valvefsi.types import Array

SAMPLES = 4001
"""Points of a curve that its arc length is taken from."""


@dataclass(frozen=True, kw_only=True)
class ValveGeometry:
    """A valve's unloaded shape; lengths in cm.

    Attributes:
        radius: Radius of the stent's cylinder, where the middle surface is attached.
        height: Of the commissures above the lowest point of the attachment.
        commissure: Length of the straight upper part of the attachment at each post.
        thickness: Of the leaflets at their edges.
        belly_thickness: In the middle of the leaflets; None for the same everywhere.
        gap: Least distance between the surfaces of two leaflets.
        nose: Rounding of the free edge at the axis; the radius of its curve there is three times that.
        drop: How far the middle of the free edge lies below the commissures.
        belly: Height of the belly's control point, as a part of the way from the attachment to the free edge, at
            the middle; 1/2 at the posts.
        fibre_angles: Angles of the fibre families to the circumferential direction [deg].
    """

    radius: float = 1.25
    height: float = 1.75
    commissure: float = 0.8
    thickness: float = 0.04
    belly_thickness: float | None = None
    gap: float = 0.04
    nose: float = 0.05
    drop: float = 0.3
    belly: float = 0.1
    fibre_angles: tuple[float, ...] = (45.0, -45.0)

    def __post_init__(self) -> None:
        for name in ("radius", "height", "commissure", "thickness", "gap", "nose"):
            value = getattr(self, name)
            if not 0 < value < math.inf:
                raise CaseError("expected a positive length", key=name, value=value)
        if self.belly_thickness is not None and not 0 < self.belly_thickness <= self.thickness:
            raise CaseError(
                "expected at most the thickness", key="belly_thickness", value=self.belly_thickness
            )
        if not self.commissure < self.height:
            raise CaseError("expected less than the height", key="commissure", value=self.commissure)
        if not 0 <= self.drop <= 0.5 * self.height or not 0 <= self.belly <= 0.9:
            message = "expected a drop of at most half the height, a belly between 0 and 0.9"
            raise CaseError(message, key="drop, belly", value=[self.drop, self.belly])
        if not self.nose + 2 * self.offset / math.sqrt(3) < 0.5 * self.radius:
            raise CaseError("nose and gap leave no free edge inside the stent", key="gap", value=self.gap)
        if not 3 * self.nose > 0.5 * self.thickness:
            raise CaseError("too sharp for the thickness", key="nose", value=self.nose)

    @property
    def offset(self) -> float:
        """Distance d of the middle surface to the planes between the sectors [cm]."""
        return 0.5 * (self.gap + self.thickness)

    def thickness_at(self, u: Array, v: Array) -> Array:
        """Return the thickness at (u, v), thinnest at u = 0, v = 1/2 [cm]."""
        belly = self.thickness if self.belly_thickness is None else self.belly_thickness
        return self.thickness + (belly - self.thickness) * 4 * v * (1 - v) * (1 - u**2)

    def surface(self, u: Array, v: Array) -> Array:
        """Return points of the middle surface of the leaflet in the sector around x.

            S(u, v) = (1 - v)^2 A(u) + 2 v (1 - v) B(u) + v^2 E(u)

        A is the attachment, E the free edge, and B stands below E, which makes the leaflet leave E straight down.

        Args:
            u: From one commissure, -1, to the other, 1, ``(n,)``.
            v: From the attachment, 0, to the free edge, 1, ``(n,)``.

        Returns:
            ``(n, 3)`` [cm].
        """
        u, v = (np.asarray(part, dtype=np.float64)[:, None] for part in (u, v))
        attached, free = self.attachment(u[:, 0]), self.free_edge(u[:, 0])
        control = free.copy()
        height = self.belly + (0.5 - self.belly) * u[:, 0] ** 2  # straight lines at the posts
        control[:, 2] = attached[:, 2] + height * (free[:, 2] - attached[:, 2])
        return (1 - v) ** 2 * attached + 2 * v * (1 - v) * control + v**2 * free

    def attachment(self, u: Array) -> Array:
        """Return the lower attachment curve: a hyperbola in the unrolled cylinder, ``(n, 3)`` [cm]."""
        phi = u * self.half_angle
        a = 0.35
        rise = (np.sqrt(1 + (u / a) ** 2) - 1) / (math.sqrt(1 + 1 / a**2) - 1)
        z = (self.height - self.commissure) * rise
        return np.stack([self.radius * np.cos(phi), self.radius * np.sin(phi), z], axis=1)

    def free_edge(self, u: Array) -> Array:
        """Return the free edge, u in proportion to its length seen from above, ``(n, 3)`` [cm]."""
        from scipy.interpolate import CubicSpline

        y = (
            np.linspace(0, 1.05, SAMPLES) * self.radius * math.sin(self.half_angle)
        )  # past |u| = 1, for slopes
        length = np.append(0.0, np.cumsum(np.hypot(np.diff(y), np.diff(self._x_of(y)))))
        end = float(CubicSpline(y, length)(y[-1] / 1.05))
        at = np.copysign(CubicSpline(length / end, y)(np.abs(u)), u)
        z = self.height - self.drop * (1 - u**2)
        return np.stack([self._x_of(at), at, z], axis=1)

    def _x_of(self, y: Array) -> Array:
        """Return x of the hyperbola x = 2 d/sqrt(3) + sqrt(y^2/3 + nose^2)."""
        return 2 * self.offset / math.sqrt(3) + np.sqrt(np.square(y) / 3 + self.nose**2)

    @property
    def half_angle(self) -> float:
        """Angle between the middle of a leaflet and its end at the stent, below 60 degrees [rad]."""
        from scipy.optimize import brentq

        def miss(y: float) -> float:
            return math.hypot(float(self._x_of(np.array(y))), y) - self.radius

        y = brentq(miss, 0.0, self.radius, xtol=1e-15, rtol=1e-15)
        return math.asin(y / self.radius)


def pericardial(*, diameter: float = 2.5) -> ValveGeometry:
    """Return a bovine pericardial valve: uniform thickness, two fibre families at 45 degrees.

    Height and thickness are those of published valve models of 2.5 cm, in proportion to the diameter but for the
    thickness; the other lengths are ours.
    """
    return _scaled(diameter, thickness=0.04, belly_thickness=None, fibre_angles=(45.0, -45.0))


def porcine(*, diameter: float = 2.5) -> ValveGeometry:
    """Return a porcine valve: a belly thinner than the edges (the thinning is ours), circumferential fibres."""
    return _scaled(diameter, thickness=0.044, belly_thickness=0.03, fibre_angles=(0.0,))


TYPES = {"pericardial": pericardial, "porcine": porcine}


def _scaled(diameter: float, **parts: Any) -> ValveGeometry:
    """Return the shape of a 2.5 cm valve in proportion to the diameter, the thickness excepted."""
    if not 0 < diameter < math.inf:
        raise CaseError("expected a positive length", key="diameter", value=diameter)
    names = ("radius", "height", "commissure", "nose", "drop")
    lengths = {name: getattr(ValveGeometry, name) * diameter / 2.5 for name in names}
    return ValveGeometry(**lengths, **parts)
