"""Meshes from elsewhere: closed surfaces are filled with tetrahedra, volume meshes are taken as they are.

A closed surface (STL, or triangles in any file meshio reads) is cut into patches where its normal turns by more than an
angle. What comes out is a gmsh file in cm whose body is tagged "body" and whose surface is tagged "surface_1", ... by
patch. Tags of a volume mesh in a gmsh file are kept: those of its cells, those of its facets in place of the patches.
Vectors of the cells in any volume mesh stay cell data.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from valvefsi.errors import CaseError
from valvefsi.geometry.mesh import _quiet_gmsh
from valvefsi.geometry.tagged_files import fill_model, write_model
from valvefsi.runtime.mesh_files import read_mesh_file

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from valvefsi.types import Array, Gmsh, Indices, Mask

    Names = NDArray[np.str_]

VOLUMES = {"tetra": 4, "hexahedron": 5}
"""Cells of volume meshes by meshio's name, and gmsh's number of their type."""
FACES = {
    "tetra": ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)),
    "hexahedron": ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
}


def import_mesh(
    path: str | Path, out: str | Path, *, scale: float = 1.0, size: float | None = None, angle: float = 40.0
) -> dict[str, Any]:
    """Make a mesh file that a case can use of a surface or volume mesh.

    Args:
        path: Closed surface (.stl, or triangles) or volume mesh (.msh, .vtu, .vtk, .xdmf).
        out: The gmsh file to write, .msh.
        scale: Length of the file's unit [cm].
        size: Edge aimed at for the tetrahedra that fill a surface, as the surface's triangles if left out [cm]. gmsh
            makes some edges longer, up to about twice as long.
        angle: Turn of the normal at which patches part [deg].

    Returns:
        Kind of cell, number of cells and nodes, volume [cm^3], extent [cm], tags, and for each tag of facets their
        area [cm^2], the middle of it [cm] and their mean normal.

    Raises:
        CaseError: The file cannot be read, its surface is not closed, or it holds no volume.
    """
    path, out = Path(path), Path(out)
    if out.suffix != ".msh":
        raise CaseError("expected a name that ends in .msh", key="--out", value=str(out))
    if not 0 < scale < math.inf or (size is not None and not 0 < size < math.inf):
        raise CaseError("expected positive lengths", key="scale, size", value=[scale, size])
    points, cells, groups = _read(path)
    points = points * scale
    volume = next((kind for kind in VOLUMES if kind in cells), None)
    with _quiet_gmsh() as gmsh:
        if volume is not None:
            data = groups.vectors.get(volume, {})
            num_facets = _take(gmsh, points, volume, cells, groups, angle)
            write_model(gmsh, out, num_facets, data)
            return _numbers(gmsh)
        if "triangle" in cells:
            _fill(gmsh, points, cells["triangle"], size, angle, path)
        else:
            raise CaseError(f"expected triangles, tetrahedra or hexahedra, not {', '.join(cells)}", file=path)
        gmsh.write(str(out))
        return _numbers(gmsh)


@dataclass(frozen=True, kw_only=True)
class Groups:
    """What a mesh file says of its cells, by meshio's name of their kind.

    Attributes:
        names: Name of the physical group of each cell, "" for none, ``(num_cells,)``.
        vectors: Vectors of the cells by name, ``(num_cells, 3)``, those of the facets left out.
    """

    names: dict[str, Names]
    vectors: dict[str, dict[str, Array]]


def _read(path: Path) -> tuple[Array, dict[str, Indices], Groups]:
    """Read points, cells and what is said of them; points at one place are made one."""
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
    return points[first], {kind: np.concatenate(blocks) for kind, blocks in cells.items()}, _groups(mesh)


def _groups(mesh: Any) -> Groups:
    """Return the names of physical groups and the vectors of a mesh that meshio has read."""
    kinds = {block.type for block in mesh.cells}
    tags = mesh.cell_data.get("gmsh:physical")
    named = {(int(tag), int(dim)): name for name, (tag, dim) in mesh.field_data.items()}
    names = {}
    for kind in kinds if tags is not None else ():
        mine = [(tags[k], block.dim) for k, block in enumerate(mesh.cells) if block.type == kind]
        numbers, dim = np.concatenate([part for part, _ in mine]), mine[0][1]
        what = "cells" if dim == 3 else "facets"
        table = {int(n): named.get((int(n), dim), f"{what}_{n}" if n > 0 else "") for n in np.unique(numbers)}
        names[kind] = np.array([table[int(n)] for n in numbers], dtype=str)
    vectors: dict[str, dict[str, Array]] = {}
    for name, blocks in mesh.cell_data.items():
        for kind in kinds & set(VOLUMES):
            parts = [blocks[k] for k, block in enumerate(mesh.cells) if block.type == kind]
            values = np.concatenate(parts)
            if values.ndim == 2 and values.shape[1] == 3:
                vectors.setdefault(kind, {})[name] = values
    return Groups(names=names, vectors=vectors)


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


def _take(
    gmsh: Gmsh, points: Array, kind: str, cells: Mapping[str, Indices], groups: Groups, angle: float
) -> int:
    """Take a volume mesh with its tags, its surface in patches where it has none; return its number of facets."""
    used, numbers = np.unique(cells[kind], return_inverse=True)
    volume = numbers.reshape(-1, {"tetra": 4, "hexahedron": 8}[kind])
    bodies = _by_name(volume, groups.names.get(kind))
    # The cells of gmsh's model stand group by group, and so must their data.
    order = np.concatenate([np.flatnonzero(mine) for mine in bodies.values()])
    for name, values in groups.vectors.get(kind, {}).items():
        groups.vectors[kind][name] = values[order]
    outer = _outer(volume, kind)
    facet = {"tetra": "triangle", "hexahedron": "quad"}[kind]
    facets = {}
    if facet in groups.names and (groups.names[facet] != "").any():
        corners = np.searchsorted(used, cells[facet])
        facets = {
            name: corners[mine] for name, mine in _by_name(corners, groups.names[facet]).items() if name
        }
    else:
        patch = _patches(points[used], outer, angle)
        facets = {f"surface_{n + 1}": outer[patch == n] for n in range(patch.max() + 1)}
    parts = {name or "body": volume[mine] for name, mine in bodies.items()}
    fill_model(gmsh, points[used], facets, parts)
    return sum(map(len, facets.values()))


def _by_name(cells: Indices, names: Names | None) -> dict[str, Mask]:
    """Return which cells are in each group, in the order of the groups' first cells."""
    if names is None:
        return {"": np.ones(len(cells), dtype=bool)}
    _, first = np.unique(names, return_index=True)
    return {str(names[k]): names == names[k] for k in np.sort(first)}


def _outer(cells: Indices, kind: str) -> Indices:
    """Return the faces that belong to one cell alone, outward."""
    faces = cells[:, FACES[kind]].reshape(-1, len(FACES[kind][0]))
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[np.sort(first[count == 1])]


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
        "patches": {
            gmsh.model.getPhysicalName(2, tag): _patch(gmsh, tag, dict(zip(tags, x, strict=True)))
            for dim, tag in gmsh.model.getPhysicalGroups(2)
        },
    }


def _patch(gmsh: Gmsh, tag: int, places: Mapping[int, Array]) -> dict[str, object]:
    """Return area, middle and mean normal of the facets of a tag, of the polygons of their corners."""
    areas, middles = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for surface in gmsh.model.getEntitiesForPhysicalGroup(2, tag):
        for kind, nodes in zip(*gmsh.model.mesh.getElements(2, surface)[::2], strict=True):
            corners = 4 if gmsh.model.mesh.getElementProperties(kind)[0].startswith("Quad") else 3
            each = gmsh.model.mesh.getElementProperties(kind)[3]
            p = np.array([places[node] for node in nodes]).reshape(-1, each, 3)[:, :corners]
            areas.append(0.5 * np.cross(p[:, -2] - p[:, 0], p[:, -1] - p[:, corners - 3]))
            middles.append(p.mean(axis=1))
    vectors, size = np.concatenate(areas), np.linalg.norm(np.concatenate(areas), axis=1)
    mean = vectors.sum(axis=0)
    return {
        "area_cm2": float(size.sum()),
        "centre_cm": (size @ np.concatenate(middles) / size.sum()).tolist(),
        "normal": (mean / max(float(np.linalg.norm(mean)), 1e-300)).tolist(),
    }
