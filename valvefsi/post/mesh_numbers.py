"""Size and quality of the mesh of a body without load."""

from __future__ import annotations

import math

import numpy as np

from valvefsi.io.solid_body import CORNERS, FLAT, Body
from valvefsi.types import Array

NEIGHBOURS = {
    (True, 3): ((1, 2), (2, 0), (0, 1)),
    (True, 4): ((1, 3), (2, 0), (3, 1), (0, 2)),
    (False, 4): ((1, 2, 3), (2, 0, 3), (0, 1, 3), (0, 2, 1)),
    (False, 8): ((1, 3, 4), (2, 0, 5), (3, 1, 6), (0, 2, 7), (7, 5, 0), (4, 6, 1), (5, 7, 2), (6, 4, 3)),
}
"""Corners at the other ends of the edges at each corner, in VTK's order, by whether a cell is flat and its corners."""
BEST = {(True, 3): math.sqrt(3) / 2, (True, 4): 1.0, (False, 4): math.sqrt(0.5), (False, 8): 1.0}
"""Jacobian of unit edges at a corner of the regular cell."""


def mesh_numbers(body: Body) -> dict[str, float]:
    """Return numbers of nodes and cells, edges [cm], and the smallest scaled Jacobian of a body's mesh.

    The Jacobian of the unit vectors along the edges at a corner, over that of the regular cell: 1 at best, 0 for a flat
    corner, negative for one turned inside out; of a sheet in space, whose sides are alike, its size.
    """
    points = np.asarray(body.points if body.reference is None else body.reference, dtype=float)
    lengths, quality = [], []
    for kind, block in body.cells.items():
        if len(block):
            shape = int(kind) in FLAT, CORNERS[int(kind)]
            corners = points[np.asarray(block)[:, : shape[1]]]
            frames = corners[:, np.array(NEIGHBOURS[shape])] - corners[:, :, None, :]
            lengths.append(np.linalg.norm(frames, axis=-1).ravel())
            quality.append(_scaled(frames, flat=shape[0]) / BEST[shape])
    edges, worst = np.concatenate(lengths), min(float(q.min()) for q in quality)
    return {
        "nodes": len(points),
        "cells": sum(len(block) for block in body.cells.values()),
        "smallest_edge_cm": float(edges.min()),
        "largest_edge_cm": float(edges.max()),
        "mean_edge_cm": float(edges.mean()),
        "smallest_scaled_jacobian": worst,
    }


def _scaled(frames: Array, *, flat: bool) -> Array:
    """Return the Jacobian of the unit edges at each corner, ``(cells, corners)``."""
    size = np.linalg.norm(frames, axis=-1, keepdims=True)
    unit = np.divide(frames, size, out=np.zeros_like(frames), where=size > 0)
    if not flat:
        return np.linalg.det(unit)
    normal = np.cross(unit[..., 0, :], unit[..., 1, :])
    plane = not np.ptp(frames[..., 2])
    return normal[..., 2] if plane else np.linalg.norm(normal, axis=-1)
