"""The posts of a stent as cantilevers: where they stand, and the shape in which they bend towards the axis.

A post bends as a uniform bar that is clamped at its foot and loaded at its tip: with s = (z - foot) / (tip - foot),

    phi(s) = s^2 (3 - s) / 2,    0 <= s <= 1,    k = 3 E I / L^3 = force over displacement of the tip,    phi(1) = 1.

Every place of the stent above the foot belongs to the post that is nearest to it around the axis, and moves with it by
q phi(s), horizontally, along the line from the middle of the post to the axis: q is how far the tip is inwards.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.errors import CaseError
from valvefsi.geometry.stent import StentEdge, knee_heights

if TYPE_CHECKING:
    from valvefsi.types import Array, Indices, Mask

SAMPLES = 1440
"""Azimuths at which the edge is looked at."""
MEAN_SHAPE = 0.375
"""Integral of phi over s."""


@dataclass(frozen=True, kw_only=True)
class StentPosts:
    """Where the posts of a stent stand.

    Attributes:
        azimuths: Of the middle of each about the z axis, in ascending order, ``(m,)`` [rad].
        tips: z of their upper ends, ``(m,)`` [cm].
        radii: Distances of their upper ends from the axis, ``(m,)`` [cm].
        foot: z at which they are clamped [cm].
    """

    azimuths: Array
    tips: Array
    radii: Array
    foot: float

    @property
    def lengths(self) -> Array:
        """Length of each from foot to tip, ``(m,)`` [cm]."""
        return self.tips - self.foot

    def nearest(self, X: Array) -> Indices:
        """Return the post that each place belongs to, ``(n,)``."""
        apart = np.arctan2(X[:, 1], X[:, 0])[:, None] - self.azimuths[None, :]
        return np.cos(apart).argmax(axis=1).astype(np.int64)

    def shape(self, X: Array) -> Array:
        """Return how places on the stent move as the tip of their post moves inwards, ``(n, 3)`` [cm/cm]."""
        post = self.nearest(X)
        phi = cantilever_shape((X[:, 2] - self.foot) / self.lengths[post])
        angle = self.azimuths[post]
        return -phi[:, None] * np.stack([np.cos(angle), np.sin(angle), np.zeros(len(X))], axis=1)


def cantilever_shape(s: Array) -> Array:
    """Return phi(s), the displacement of a bar loaded at its tip over that of the tip; 0 below the foot, ``(n,)``."""
    s = np.clip(s, 0.0, 1.0)
    phi: Array = 0.5 * s**2 * (3.0 - s)
    return phi


def stent_posts(edge: StentEdge, length: float | None = None) -> StentPosts:
    """Return the posts below the tops of a stent's edge.

    Args:
        edge: The upper edge of the stent.
        length: Of the posts, from the highest top down to the foot [cm]; None for the foot where the edge begins to
            rise steeply, see `valvefsi.geometry.stent`.

    Raises:
        CaseError: The edge rises nowhere steeply, the posts are longer than the edge is high.
    """
    phi = 2.0 * math.pi * np.arange(SAMPLES) / SAMPLES
    R, Z = edge.at(phi)
    foot = _foot(edge, phi, Z) if length is None else float(Z.max()) - length
    if not foot > edge.lowest:
        message = f"the attached edge is only {float(Z.max()) - edge.lowest:.4g} cm high; expected less"
        raise CaseError(message, key="length", value=length)
    tops = [_top(run, phi, Z) for run in _runs(foot < Z)]
    order = np.argsort([azimuth for azimuth, _ in tops])
    at = np.array([tops[k][1] for k in order])
    azimuths = np.array([tops[k][0] for k in order])
    return StentPosts(azimuths=azimuths, tips=Z[at], radii=R[at], foot=foot)


def _foot(edge: StentEdge, phi: Array, Z: Array) -> float:
    """Return the lowest z from which on the edge rises steeply."""
    knee = knee_heights(edge, phi)
    steep = Z - knee > 1e-6 * np.ptp(Z)
    if not steep.any():
        message = "the attached edge rises nowhere steeply, so that no posts are seen; give their length"
        raise CaseError(message, key="length")
    return float(knee[steep].min())


def _runs(inside: Mask) -> list[Indices]:
    """Return the numbers of azimuths that follow one another inside, around the circle, one array for each run."""
    n, first = len(inside), int(np.argmin(inside))
    order = (first + np.arange(n)) % n
    cuts = np.flatnonzero(np.diff(inside[order].astype(np.int8)) != 0) + 1
    return [part for part in np.split(order, cuts) if inside[part[0]]]


def _top(run: Indices, phi: Array, Z: Array) -> tuple[float, int]:
    """Return the azimuth of the middle of the highest part of a run, and the sample there."""
    high = run[Z[run] > Z[run].max() - 1e-6]
    mean = math.atan2(np.sin(phi[high]).mean(), np.cos(phi[high]).mean()) % (2.0 * math.pi)
    return mean, int(high[len(high) // 2])
