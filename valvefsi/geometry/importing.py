"""Meshes from elsewhere: closed surfaces are filled with tetrahedra, volume meshes are taken as they are.

A closed surface (STL, or triangles in any file meshio reads) is cut into patches where its normal turns by more than an
angle. What comes out is a gmsh file in cm whose body is tagged "body" and whose surface is tagged "surface_1", ... by
patch; tags of a gmsh file are kept instead.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.errors import CaseError
from valvefsi.geometry.mesh import _quiet_gmsh
from valvefsi.runtime.mesh_files import read_mesh_file

if TYPE_CHECKING:
    from valvefsi.types import Array, Gmsh, Indices

VOLUMES = {"tetra": 4, "hexahedron": 5}
"""Cells of volume meshes by meshio's name, and gmsh's number of their type."""
FACES = {
    "tetra": ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)),
    "hexahedron": ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
}
FACET = {3: 2, 4: 3}


def import_mesh(
    path: str | Path, out: str | Path, *, scale: float = 1.0, size: float | None = None, angle: float = 40.0
) -> dict[str, object]:
    """Make a mesh file that a case can use of a surface or volume mesh.

    Args:
        path: Closed surface (.stl, or triangles) or volume mesh (.msh, .vtu, .vtk, .xdmf).
        out: The gmsh file to write, .msh.
        scale: Length of the file's unit [cm].
        size: Largest edge of the tetrahedra that fill a surface, as the surface's triangles if left out [cm].
        angle: Turn of the normal at which patches part [deg].

    Returns:
        Kind of cell, number of cells and nodes, volume [cm^3], extent [cm], and tags.

    Raises:
        CaseError: The file cannot be read, its surface is not closed, or it holds no volume.
    """
    path, out = Path(path), Path(out)
    if out.suffix != ".msh":
        raise CaseError("expected a name that ends in .msh", key="--out", value=str(out))
    if not 0 < scale < math.inf or (size is not None and not 0 < size < math.inf):
        raise CaseError("expected positive lengths", key="scale, size", value=[scale, size])
    points, cells = _read(path)
    points = points * scale
    volume = next((kind for kind in VOLUMES if kind in cells), None)
    with _quiet_gmsh() as gmsh:
        if volume is not None:
            _take(gmsh, points, volume, cells[volume], angle)
        elif "triangle" in cells:
            _fill(gmsh, points, cells["triangle"], size, angle, path)
        else:
            raise CaseError(f"expected triangles, tetrahedra or hexahedra, not {', '.join(cells)}", file=path)
        gmsh.write(str(out))
        return _numbers(gmsh)


def _read(path: Path) -> tuple[Array, dict[str, Indices]]:
    """Read points and cells, points at one place made one."""
    mesh = read_mesh_file(path)
    points = np.asarray(mesh.points, dtype=float)
    points = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    extent = float(np.ptp(points, axis=0).max(initial=0.0))
    _, first, same = np.unique(
        np.round(points / max(1e-9 * extent, 1e-300)), axis=0, return_index=True, return_inverse=True
    )
    cells: dict[str, list[Indices]] = {}
    for block in mesh.cells:
        cells.setdefault(block.type, []).append(same.ravel()[block.data])
    return points[first], {kind: np.concatenate(blocks) for kind, blocks in cells.items()}


def _fill(
    gmsh: Gmsh, points: Array, triangles: Indices, size: float | None, angle: float, path: Path
) -> None:
    """Fill a closed surface with tetrahedra."""
    import meshio

    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    if (count != 2).any():
        open_edges = int((count != 2).sum())
        raise CaseError(f"the surface is not closed: {open_edges} edges do not have two triangles", file=path)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "surface.stl"
        meshio.Mesh(points, [("triangle", triangles)]).write(file, binary=True)
        gmsh.merge(str(file))
    gmsh.model.mesh.classifySurfaces(math.radians(angle), True, True, math.pi)
    gmsh.model.mesh.createGeometry()
    surfaces = [tag for _, tag in gmsh.model.getEntities(2)]
    body = gmsh.model.geo.addVolume([gmsh.model.geo.addSurfaceLoop(surfaces)])
    gmsh.model.geo.synchronize()
    long = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    gmsh.option.setNumber("Mesh.MeshSizeMax", size if size is not None else float(np.median(long)))
    gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 0)
    for number, tags in enumerate(_in_patches(gmsh, points, triangles, angle), start=1):
        gmsh.model.addPhysicalGroup(2, tags, name=f"surface_{number}")
    gmsh.model.addPhysicalGroup(3, [body], name="body")
    try:
        gmsh.model.mesh.generate(3)
    except Exception as error:  # gmsh raises nothing narrower
        raise CaseError(f"gmsh cannot fill this surface: {error}", file=path) from None


def _in_patches(gmsh: Gmsh, points: Array, triangles: Indices, angle: float) -> list[list[int]]:
    """Gather gmsh's surfaces by patch: it cuts patches further, such that each can be laid flat."""
    from scipy.spatial import cKDTree

    patch = _patches(points, triangles, angle)
    centres = cKDTree(points[triangles].mean(axis=1))
    found: list[list[int]] = [[] for _ in range(patch.max() + 1)]
    for _, tag in gmsh.model.getEntities(2):
        corners = gmsh.model.mesh.getElements(2, tag)[2][0][:3]
        centre = np.mean([gmsh.model.mesh.getNode(node)[0] for node in corners], axis=0)
        found[patch[centres.query(centre)[1]]].append(tag)
    return [tags for tags in found if tags]


def _take(gmsh: Gmsh, points: Array, kind: str, cells: Indices, angle: float) -> None:
    """Take a volume mesh, with its surface in patches."""
    used, numbers = np.unique(cells, return_inverse=True)
    points, cells = points[used], numbers.reshape(-1, {"tetra": 4, "hexahedron": 8}[kind])
    faces = cells[:, FACES[kind]].reshape(-1, len(FACES[kind][0]))
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    outer = faces[np.sort(first[count == 1])]
    patch = _patches(points, outer, angle)
    model = gmsh.model
    for number in range(patch.max() + 1):
        model.addDiscreteEntity(2, number + 1)
    model.addDiscreteEntity(3, 1)
    model.mesh.addNodes(3, 1, np.arange(1, len(points) + 1), points.ravel())
    start = 1
    for number in range(patch.max() + 1):
        corners = outer[patch == number]
        tags = np.arange(start, start + len(corners))
        model.mesh.addElementsByType(number + 1, FACET[corners.shape[1]], tags, (corners + 1).ravel())
        model.addPhysicalGroup(2, [number + 1], name=f"surface_{number + 1}")
        start += len(corners)
    tags = np.arange(start, start + len(cells))
    model.mesh.addElementsByType(1, VOLUMES[kind], tags, (cells + 1).ravel())
    model.addPhysicalGroup(3, [1], name="body")


def _patches(points: Array, faces: Indices, angle: float) -> Indices:
    """Number the patches of a surface that part where its normal turns by more than an angle, ``(num_faces,)``."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    corners = points[faces]
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, -1] - corners[:, 1])
    if faces.shape[1] == 3:
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    k = faces.shape[1]
    edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(len(faces)), k)
    order = np.lexsort(edges.T)
    edges, owner = edges[order], owner[order]
    same = (edges[1:] == edges[:-1]).all(axis=1)
    a, b = owner[:-1][same], owner[1:][same]
    smooth = np.einsum("ni,ni->n", normal[a], normal[b]) > math.cos(math.radians(angle))
    graph = coo_matrix((np.ones(smooth.sum()), (a[smooth], b[smooth])), shape=(len(faces), len(faces)))
    return connected_components(graph, directed=False)[1]


def _numbers(gmsh: Gmsh) -> dict[str, object]:
    types, elements, _ = gmsh.model.mesh.getElements(3)
    tags, points, _ = gmsh.model.mesh.getNodes()
    x = np.asarray(points).reshape(-1, 3)
    volumes = gmsh.model.mesh.getElementQualities(elements[0], "volume")
    groups = [gmsh.model.getPhysicalName(dim, tag) for dim, tag in gmsh.model.getPhysicalGroups()]
    return {
        "cell": "hexahedron" if types[0] == VOLUMES["hexahedron"] else "tetrahedron",
        "cells": len(elements[0]),
        "nodes": len(tags),
        "volume_cm3": float(np.sum(volumes)),
        "extent_cm": [float(v) for v in np.ptp(x, axis=0)],
        "tags": groups,
    }
