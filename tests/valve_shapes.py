"""Sheets, rings and leaflets whose open area is known, and turns of them."""

from __future__ import annotations

import numpy as np

UP = {"axis": (0, 0, 1), "centre": (0, 0, 0)}


def rectangle(x0, x1, y0, y1, z=0.0):
    points = np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]], dtype=float)
    return points, np.array([[0, 1, 2], [0, 2, 3]])


def together(*meshes):
    shift = np.cumsum([0, *(len(points) for points, _ in meshes)])
    return (
        np.concatenate([points for points, _ in meshes]),
        np.concatenate([triangles + k for (_, triangles), k in zip(meshes, shift, strict=False)]),
    )


def ring(inner, outer, corners=120):
    """A flat ring (a disc where ``inner`` is 0) and the area of its polygon."""
    angle = 2 * np.pi * np.arange(corners) / corners
    unit = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    a, b = np.arange(corners), (np.arange(corners) + 1) % corners
    outside, next_outside = a + corners, b + corners
    triangles = np.concatenate(
        [np.stack([a, outside, next_outside], axis=1), np.stack([a, next_outside, b], axis=1)]
    )
    area = 0.5 * corners * np.sin(2 * np.pi / corners) * (outer**2 - inner**2)
    return np.concatenate([inner * unit, outer * unit]), triangles, area


def turn(axis, angle):
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def leaflets(opening, radius=1.25, along=24, across=10):
    """Three leaflets between closed, their free edges a Y, and open, 90 % of the radius.

    Returns:
        Nodes, triangles, leaflet of each triangle, pieces of the free edges, and the open area.
    """
    part, fall = np.linspace(-1, 1, along + 1), np.linspace(0, 1, across + 1)
    meshes, owners, edges = [], [], []
    for k in range(3):
        angle = 2 * np.pi * k / 3 + np.pi / 3 * part
        ends = np.array([[np.cos(angle[i]), np.sin(angle[i])] for i in (0, -1)])
        wide = 0.9 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        shut = 0.9 * np.where(part[:, None] < 0, -part[:, None] * ends[0], part[:, None] * ends[1])
        wall = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        free = (1 - opening) * shut + opening * wide
        flat = radius * ((1 - fall)[:, None, None] * wall + fall[:, None, None] * free)
        z = np.broadcast_to((0.9 * np.sin(np.pi / 2 * fall))[:, None, None], (*flat.shape[:2], 1))
        node = np.arange(flat.shape[0] * flat.shape[1]).reshape(flat.shape[:2])
        a, b, c, d = (x.ravel() for x in (node[:-1, :-1], node[:-1, 1:], node[1:, 1:], node[1:, :-1]))
        triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
        edges.append(np.stack([node[-1, :-1], node[-1, 1:]], axis=1) + k * node.size)
        meshes.append((np.concatenate([flat, z], axis=2).reshape(-1, 3), triangles))
        owners.append(np.full(len(triangles), k))
    points, triangles = together(*meshes)
    edges = np.concatenate(edges)
    p, r = points[edges[:, 0]], points[edges[:, 1]]
    # Between the wall's polygon and the circle slivers are open.
    area = 0.5 * np.sum(p[:, 0] * r[:, 1] - p[:, 1] * r[:, 0])
    area += radius**2 * (np.pi - 1.5 * along * np.sin(2 * np.pi / (3 * along)))
    return points, triangles, np.concatenate(owners), edges, area
