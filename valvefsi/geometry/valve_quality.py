"""How good a valve's mesh is, and what its shape measures: angles, volumes, thickness, gap, coaptation."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.geometry.valve import corner_frames, jacobians, surface_volume, volumes

if TYPE_CHECKING:
    from valvefsi.geometry.leaflets import ValveGeometry
    from valvefsi.geometry.valve import ValveMesh
    from valvefsi.types import Array


def quality(geometry: ValveGeometry, mesh: ValveMesh) -> dict[str, float]:
    """Return the numbers of the quality table; the name says the unit.

    The gap is measured between the nodes of neighbouring leaflets. The coaptation length is the length, up the
    leaflet at u = 1/2, over which the two neighbours' middle surfaces are closer than twice their least distance.
    """
    frames = corner_frames(mesh)
    cosines = np.einsum("cknd,cknd->ckn", frames, np.roll(frames, 1, axis=2))
    angles = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    per_leaflet = volumes(mesh).sum() / 3
    exact = surface_volume(geometry)
    line = np.linspace(-1, 1, 2001)
    free = _length(geometry.free_edge(line))
    closed = 2 * math.hypot(geometry.radius, geometry.drop)
    return {
        "leaflets": 3,
        "cells": len(mesh.cells),
        "nodes": len(mesh.points),
        "smallest_angle_deg": float(angles.min()),
        "largest_angle_deg": float(angles.max()),
        "smallest_scaled_jacobian": float(np.linalg.det(frames).min()),
        "smallest_jacobian_cm3": float(jacobians(mesh).min()),
        "leaflet_volume_ml": float(per_leaflet),
        "leaflet_volume_by_quadrature_ml": exact,
        "smallest_thickness_cm": _thickness(geometry).min(),
        "largest_thickness_cm": _thickness(geometry).max(),
        "gap_cm": gap(mesh),
        "coaptation_length_cm": coaptation_length(geometry),
        "free_edge_length_cm": free,
        "free_edge_over_closed": free / closed,
    }


def gap(mesh: ValveMesh) -> float:
    """Return the least distance between nodes of two leaflets [cm]."""
    from scipy.spatial import cKDTree

    one, two, three = mesh.points.reshape(3, -1, 3)
    tree = cKDTree(one)
    return float(min(tree.query(other)[0].min() for other in (two, three)))


def coaptation_length(geometry: ValveGeometry) -> float:
    """Return the length up the leaflet at u = 1/2 closer than 2 d to the plane between the sectors [cm]."""
    v = np.linspace(0, 1, 2001)
    x = geometry.surface(np.full_like(v, 0.5), v)
    distance = (math.sqrt(3) * x[:, 0] - np.abs(x[:, 1])) / 2
    close = distance <= 2 * geometry.offset
    steps = np.linalg.norm(np.diff(x, axis=0), axis=1)
    return float(steps[close[1:]].sum())


def _thickness(geometry: ValveGeometry) -> Array:
    u, v = np.meshgrid(np.linspace(-1, 1, 41), np.linspace(0, 1, 41))
    return geometry.thickness_at(u.ravel(), v.ravel())


def _length(x: Array) -> float:
    return float(np.linalg.norm(np.diff(x, axis=0), axis=1).sum())
