"""A rigid wall from a file: the triangles of an STL file, or tagged facets of a mesh, as points with areas and normals.

The normals point away from the z axis, and must be the wall's own everywhere: facets whose neighbours run around the
other way are refused.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from valvefsi.errors import CaseError
from valvefsi.geometry.aortic_section import SPACING, PointSurface
from valvefsi.runtime.mesh_files import read_mesh_file

if TYPE_CHECKING:
    from valvefsi.types import Array, Indices

FACETS = {"triangle": [[0, 1, 2]], "quad": [[0, 1, 2], [0, 2, 3]]}
"""Triangles of each kind of facet, by meshio's name."""


def read_wall(path: Path, *, scale: float, tags: Sequence[str] = ()) -> tuple[Array, Indices]:
    """Read corners and triangles of a wall, those of one place made one.

    Args:
        path: STL file, or mesh that meshio reads.
        scale: Length of the file's unit [cm].
        tags: Names of the facets that are the wall; all facets if there are none.

    Returns:
        Corners ``(num_points, 3)`` [cm] and triangles ``(num_triangles, 3)``, normals away from the z axis.

    Raises:
        CaseError: The file cannot be read, has no such tag or no facets, or they are not oriented alike.
    """
    mesh = read_mesh_file(path)
    known = {name: int(tag) for name, (tag, dim) in mesh.field_data.items() if dim == 2}
    for tag in tags:
        if tag not in known:
            near = difflib.get_close_matches(tag, known, n=1)
            listed = ", ".join(f'"{name}"' for name in known) or "none"
            hint = f' (did you mean "{near[0]}"?)' if near else ""
            raise CaseError(
                f"no facets of {path.name} have this tag{hint}; it has {listed}", key="tags", value=tag
            )
    triangles = _triangles(mesh, {known[tag] for tag in tags})
    if not len(triangles):
        raise CaseError(f"{path.name} has no triangles or quadrilaterals", key="file", value=str(path))
    points = np.asarray(mesh.points, dtype=float)
    points = scale * np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    size = max(float(np.ptp(points, axis=0).max()), 1e-300)
    _, first, same = np.unique(
        np.round(points / (1e-9 * size)), axis=0, return_index=True, return_inverse=True
    )
    triangles = same.ravel()[triangles]
    return points[first], _outward(points[first], triangles, path)


def _triangles(mesh: Any, numbers: set[int]) -> Indices:
    """Return the triangles of the facets with some tags, of all without any."""
    found = [np.zeros((0, 3), dtype=np.int64)]
    tagged = mesh.cell_data.get("gmsh:physical")
    for k, block in enumerate(mesh.cells):
        if block.type in FACETS:
            mine = np.isin(tagged[k], list(numbers)) if numbers and tagged is not None else slice(None)
            corners = np.asarray(block.data, dtype=np.int64)[mine]
            found += [corners[:, piece] for piece in FACETS[block.type]]
    return np.concatenate(found)


def _outward(points: Array, triangles: Indices, path: Path) -> Indices:
    """Turn each connected piece of triangles such that its normals point away from the z axis."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    # Points made one leave triangles without an area.
    flat = np.linalg.norm(_normals(points, triangles), axis=1) == 0.0
    triangles = triangles[~flat]
    ways = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2)
    _, count = np.unique(ways, axis=0, return_counts=True)
    if (count > 1).any():
        raise CaseError(
            f"the wall's triangles are not oriented alike: {int((count > 1).sum())} edges have two on one side",
            key="file",
            value=str(path),
        )
    graph = coo_array((np.ones(len(ways)), (ways[:, 0], ways[:, 1])), shape=(len(points),) * 2)
    piece = connected_components(graph, directed=False)[1][triangles[:, 0]]
    normal, middle = _normals(points, triangles), points[triangles].mean(axis=1)
    way = np.bincount(piece, (normal[:, :2] * middle[:, :2]).sum(axis=1))
    inward = way[piece] < 0.0
    return np.where(inward[:, None], triangles[:, ::-1], triangles)


def _normals(points: Array, triangles: Indices) -> Array:
    """Return the normals of triangles, as long as twice their area, ``(n, 3)`` [cm^2]."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def wall_points(points: Array, triangles: Indices, h: float, bounds: tuple[float, float]) -> PointSurface:
    """Return a wall between two planes as points at most half a spacing apart.

    Triangles are cut at the middle of their longest edge until none is longer than sqrt(3) times that; a point
    stands in the middle of each, and the middles of neighbours are half a spacing apart where they are equilateral.

    Args:
        points: Corners, ``(num_points, 3)`` [cm].
        triangles: Triangles, ``(num_triangles, 3)``.
        h: Grid spacing [cm].
        bounds: z of the planes [cm]; points beyond them are left out.

    Raises:
        CaseError: The wall does not reach the planes.
    """
    low, high = float(points[:, 2].min()), float(points[:, 2].max())
    if low > bounds[0] + 0.5 * h or high < bounds[1] - 0.5 * h:
        raise CaseError(
            f"the wall spans z = {low:.4g} ... {high:.4g} cm and must reach both z sides of the box, "
            f"{bounds[0]:.4g} and {bounds[1]:.4g} cm",
            key="file",
        )
    normals = _normals(points, triangles)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    corners, parent = _cut(points[triangles], math.sqrt(3.0) * SPACING * h)
    x = corners.mean(axis=1)
    inside = (x[:, 2] >= bounds[0] - 1e-9) & (x[:, 2] <= bounds[1] + 1e-9)
    corners, parent = corners[inside], parent[inside]
    size = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return PointSurface(
        points=x[inside], areas=0.5 * size, normals=normals[parent], faces=np.zeros((0, 4), np.int64)
    )


def _cut(corners: Array, longest: float) -> tuple[Array, Indices]:
    """Cut triangles ``(n, 3, 3)`` until no edge is longer than this [cm]; return the parts and whose they are."""
    done, parent = [], np.arange(len(corners))
    while len(corners):
        edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        long = edges.max(axis=1) > longest * (1.0 + 1e-9)
        done.append((corners[~long], parent[~long]))
        first = edges[long].argmax(axis=1)[:, None]
        turned = [
            np.take_along_axis(corners[long], (first + k)[..., None] % 3, axis=1)[:, 0] for k in range(3)
        ]
        a, b, c = turned
        middle = 0.5 * (a + b)
        corners = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
        parent = np.tile(parent[long], 2)
    return np.concatenate([part for part, _ in done]), np.concatenate([number for _, number in done])


def radius_at(wall: PointSurface, z: float, phi: Array) -> Array:
    """Return the wall's distance from the z axis at a height, that of its nearest point at each azimuth [cm]."""
    from scipy.spatial import cKDTree

    r = np.hypot(wall.points[:, 0], wall.points[:, 1])
    turn = np.arctan2(wall.points[:, 1], wall.points[:, 0])
    size = float(r.mean())
    tree = cKDTree(np.stack([size * np.cos(turn), size * np.sin(turn), wall.points[:, 2]], axis=1))
    at = np.stack([size * np.cos(phi), size * np.sin(phi), np.full_like(phi, z)], axis=1)
    return r[tree.query(at)[1]]
