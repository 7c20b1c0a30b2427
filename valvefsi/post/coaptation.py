"""Coaptation of leaflets: where their faces towards the inflow lie against one another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from valvefsi.solid.peaks import percentile
from valvefsi.types import Array, Indices

FACING = -0.5
"""Largest cosine between the normals of two faces that face one another."""


@dataclass(frozen=True, kw_only=True)
class Coaptation:
    """Contact of leaflets.

    Attributes:
        area: Area over which two leaflets face one another within reach, counted once [cm^2].
        height: Area of all leaflets' faces in contact over the length of their free edges [cm].
        gap: Distance between the faces in contact, median by area; None without contact [cm].
    """

    area: float
    height: float
    gap: float | None


def coaptation(points: Array, faces: Indices, owner: Indices, *, edge: float, reach: float) -> Coaptation:
    """Return where leaflets lie against one another.

    A face is in contact where the middle of a face of another leaflet is next to it, turned towards it, no farther
    along the normal than the reach, and sideways than the sizes of both.

    Args:
        points: Positions of the nodes, ``(n, 3)`` [cm].
        faces: Corners of the leaflets' faces towards the inflow, in turn, ``(m, 3 or 4)``.
        owner: Leaflet of each face, ``(m,)``.
        edge: Length of the free edges of all leaflets together [cm].
        reach: Distance within which faces count as in contact [cm].
    """
    corners = points[faces]
    middle = corners.mean(axis=1)
    turned = np.roll(corners, -1, axis=1)
    vector = 0.5 * np.cross(corners - middle[:, None], turned - middle[:, None]).sum(axis=1)
    area = np.linalg.norm(vector, axis=1)
    normal = vector / area[:, None]
    size = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    gap = np.full(len(faces), np.inf)
    for leaflet in np.unique(owner):
        own, others = owner == leaflet, np.flatnonzero(owner != leaflet)
        if not len(others):
            continue
        _, near = cKDTree(middle[others]).query(middle[own])
        other = others[near]
        way = middle[other] - middle[own]
        along = np.abs(np.einsum("ij,ij->i", way, normal[own]))
        aside = np.sqrt(np.maximum((way**2).sum(axis=1) - along**2, 0.0))
        faced = np.einsum("ij,ij->i", normal[own], normal[other]) < FACING
        near_enough = (along <= reach) & (aside <= 0.5 * (size[own] + size[other]))
        gap[own] = np.where(faced & near_enough, along, np.inf)
    touching = np.isfinite(gap)
    whole = float(area[touching].sum())
    median = percentile(gap[touching], area[touching], 0.5) if touching.any() else None
    return Coaptation(area=0.5 * whole, height=whole / edge, gap=median)
