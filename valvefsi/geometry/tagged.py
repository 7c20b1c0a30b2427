"""Tagged facets of a mesh, gathered on all ranks: the faces and edges that a user names on leaflets of his own."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.runtime import dolfinx_compat  # noqa: F401  (before dolfinx)

# isort: split
from dolfinx import mesh as meshes

from valvefsi.errors import CaseError

if TYPE_CHECKING:
    from valvefsi.geometry.mesh import SolidMesh
    from valvefsi.types import Array, Indices

AROUND = {3: [0, 1, 2], 4: [0, 1, 3, 2]}
"""Corners of a facet one after the other, of those in DOLFINx' order."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TaggedSurfaces:
    """Facets of a mesh by the name of what they are, the same on all ranks.

    Attributes:
        points: Their corners, ``(num_points, 3)`` [cm].
        faces: Numbers of the corners of each facet, one after the other around it, ``(num_facets, 3 or 4)``.
    """

    points: Array
    faces: dict[str, Indices]


def find_tags(mesh: SolidMesh, name: str, tags: Sequence[str]) -> list[int]:
    """Return the numbers of tags of facets.

    Raises:
        CaseError: There is no such tag, or it is not one of facets; the key is ``name``, the value the tag.
    """
    known = [tag for tag, (dim, _) in mesh.names.items() if dim == mesh.dim - 1]
    for tag in tags:
        if tag in known:
            continue
        listed = ", ".join(f'"{each}"' for each in known) or "none"
        if tag in mesh.names:
            message = f"this tag of {mesh.source} is one of cells, expected one of facets: {listed}"
        else:
            near = difflib.get_close_matches(tag, known, n=1)
            hint = f' (did you mean "{near[0]}"?)' if near else ""
            message = f"{mesh.source} has no such tag{hint}; its facets have {listed}"
        raise CaseError(message, key=name, value=tag)
    return [mesh.names[tag][1] for tag in tags]


def gather_surfaces(mesh: SolidMesh, tags: Mapping[str, Sequence[str]]) -> TaggedSurfaces:
    """Gather the facets of tags.

    Args:
        mesh: The mesh.
        tags: Tags of facets by the name of what they are together, such as ``{"free": ["surface_3"]}``.

    Raises:
        CaseError: A tag is missing, is one of cells or no outer facet has it; on all ranks, with the name as key.

    Note:
        Collective. Numbers and order do not depend on how the mesh is divided among ranks.
    """
    domain = mesh.mesh
    numbers = {name: find_tags(mesh, name, given) for name, given in tags.items()}
    dim = domain.topology.dim - 1
    domain.topology.create_connectivity(dim, dim + 1)
    domain.topology.create_connectivity(dim + 1, dim)
    outer = meshes.exterior_facet_indices(domain.topology)
    here = {}
    for name, found in numbers.items():
        assert mesh.facet_tags is not None  # or no tag of facets would have been found
        facets = np.intersect1d(np.concatenate([mesh.facet_tags.find(n) for n in found]), outer)
        here[name] = _corners(mesh, dim, facets.astype(np.int32))
    parts = domain.comm.allgather((domain.geometry.x[: len(_ids(mesh))], _ids(mesh), here))
    faces = {name: np.concatenate([part[2][name] for part in parts]) for name in tags}
    for name, corners in faces.items():
        if not len(corners):
            message = f"no outer facet of {mesh.source} has this tag"
            raise CaseError(message, key=name, value=", ".join(tags[name]))
    ids = np.concatenate([part[1] for part in parts])
    places = np.concatenate([part[0] for part in parts])
    return _numbered(faces, ids, places)


def _ids(mesh: SolidMesh) -> Indices:
    """Return the numbers in the whole mesh of this rank's nodes and ghosts."""
    index_map = mesh.mesh.geometry.index_map()
    count = index_map.size_local + index_map.num_ghosts
    return np.asarray(index_map.local_to_global(np.arange(count, dtype=np.int32)), dtype=np.int64)


def _corners(mesh: SolidMesh, dim: int, facets: Indices) -> Indices:
    """Return the corners of facets of this rank, by their numbers in the whole mesh."""
    kind = mesh.mesh.topology.cell_type
    count = 4 if kind == meshes.CellType.hexahedron else 3
    if not len(facets):
        return np.zeros((0, count), dtype=np.int64)
    local = np.asarray(meshes.entities_to_geometry(mesh.mesh, dim, facets))[:, :count]
    return _ids(mesh)[local[:, AROUND[count]]]


def _numbered(faces: Mapping[str, Indices], ids: Indices, places: Array) -> TaggedSurfaces:
    """Number the corners by their places, and order the facets by their corners."""
    used = np.unique(np.concatenate([corners.ravel() for corners in faces.values()]))
    _, first = np.unique(ids, return_index=True)
    order = np.searchsorted(ids[first], used)
    points = places[first][order]
    size = max(float(np.ptp(points, axis=0).max()), 1e-300)
    by_place = np.lexsort(np.round(points / (1e-9 * size)).T)
    number = np.empty(len(used), dtype=np.int64)
    number[by_place] = np.arange(len(used))
    numbered = {name: number[np.searchsorted(used, corners)] for name, corners in faces.items()}
    ordered = {
        name: corners[np.lexsort(np.sort(corners, axis=1).T[::-1])] for name, corners in numbered.items()
    }
    return TaggedSurfaces(points=points[by_place], faces=ordered)
