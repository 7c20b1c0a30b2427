"""Which way the thickness of a body of hexahedra runs, from how its elements lie behind one another, or from tags."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from valvefsi.errors import CaseError
from valvefsi.runtime import dolfinx_compat as compat

# isort: split
from dolfinx import mesh as meshes

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from valvefsi.types import Array, Mesh

BITS = np.arange(8)[:, None] >> np.arange(3) & 1
"""Place of each corner along the three axes of the reference cell, ``(8, 3)``."""


def thickness_axes(mesh: Mesh, faces: tuple[Sequence[str], Sequence[str]] | None = None) -> NDArray[np.int64]:
    """Return the axis of the reference cell that runs through the thickness, of this rank's cells.

    It is the one along which the elements behind one another lead from one face of the body to the other. Where the
    faces are not named, it is the one along which elements behind one another are shortest together: a sheet is thinner
    than its rows are long, however many layers it has.

    Args:
        mesh: A ``SolidMesh`` of hexahedra.
        faces: Tags of the facets on both sides of the body.

    Raises:
        CaseError: The cells are no hexahedra, or the thickness cannot be found.

    Note:
        Collective; every rank looks at all cells.
    """
    domain = mesh.mesh
    if domain.basix_cell().name != "hexahedron":
        raise CaseError("solid-shell elements are hexahedra", file=mesh.source, key="element")
    rows = compat.geometry_nodes(domain)[:, :8]
    points = domain.geometry.x[rows]
    lengths = np.stack([_edges_along(points, axis) for axis in range(3)], axis=1)
    corners = domain.geometry.index_map().local_to_global(rows.ravel()).reshape(-1, 8)
    tagged = [_facets(mesh, tags) for tags in faces or ()]
    parts = domain.comm.allgather((corners, lengths, *tagged))
    corners, lengths, *tagged = (np.concatenate([part[k] for part in parts]) for k in range(2 + len(tagged)))
    face = _face_numbers(corners, tagged)
    stack = _stacks(face[: 6 * len(corners)].reshape(3, 2, -1))
    if faces is None:
        axes = _shortest(stack, lengths)
    else:
        first = face[6 * len(corners) :][: len(tagged[0])]
        axes = _between(stack, face, (first, face[6 * len(corners) + len(tagged[0]) :]), mesh.source)
    _check_layers(corners, axes, mesh.source)
    start = sum(len(part[0]) for part in parts[: domain.comm.rank])
    return axes[start : start + len(rows)]


def through_last(nodes: NDArray[np.int32], axes: NDArray[np.int64]) -> NDArray[np.int32]:
    """Return the corners ``(num_cells, 8)`` of hexahedra turned so that their last axis is the one of ``axes``."""
    i, j, k = BITS.T
    turned = np.stack([k + 2 * i + 4 * j, j + 2 * k + 4 * i, i + 2 * j + 4 * k])
    return np.ascontiguousarray(np.take_along_axis(nodes, turned[axes], axis=1))


def slants(points: Array) -> Array:
    """Return the angle between thickness and normal of each element, ``(num_cells,)`` [deg].

    Args:
        points: Corners with the thickness along the last axis, see `through_last`, ``(num_cells, 8, 3)``.
    """
    i, j, k = ((2 * BITS - 1) / 4.0).T
    first, second, through = (np.einsum("ncx,c->nx", points, sign) for sign in (i, j, k))
    normal = np.cross(first, second)
    across = np.abs((normal * through).sum(axis=1))
    along = np.linalg.norm(np.cross(normal, through), axis=1)
    return np.degrees(np.arctan2(along, across))


def _edges_along(points: Array, axis: int) -> Array:
    """Return the mean length of the four edges of each cell along an axis."""
    lower, upper = (np.flatnonzero(BITS[:, axis] == end) for end in (0, 1))
    return np.linalg.norm(points[:, upper] - points[:, lower], axis=2).mean(axis=1)


def _facets(mesh: Mesh, tags: Sequence[str]) -> NDArray[np.int64]:
    """Return the corners of this rank's facets with some tags, by their numbers in the whole mesh, ``(n, 4)``."""
    domain = mesh.mesh
    numbers = [mesh.tag(tag) for tag in tags]
    if any(dim != 2 for dim, _ in numbers) or mesh.facet_tags is None:
        raise CaseError("expected tags of facets", file=mesh.source, key="faces", value=list(tags))
    facets = np.unique(np.concatenate([mesh.facet_tags.find(number) for _, number in numbers]))
    if not len(facets):
        return np.zeros((0, 4), dtype=np.int64)
    domain.topology.create_connectivity(2, 3)
    domain.topology.create_connectivity(3, 2)
    local = np.asarray(meshes.entities_to_geometry(domain, 2, facets.astype(np.int32)))[:, :4]
    return domain.geometry.index_map().local_to_global(local.ravel()).reshape(-1, 4)


def _face_numbers(corners: NDArray[np.int64], tagged: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Number the faces of the cells, axis by axis, both ends, cell by cell, and then those of tagged facets."""
    sides = [corners[:, BITS[:, axis] == end] for axis in range(3) for end in (0, 1)]
    _, face = np.unique(np.sort(np.concatenate([*sides, *tagged]), axis=1), axis=0, return_inverse=True)
    return face.ravel()


def _stacks(face: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return for each axis of each cell the number of the row of cells behind one another along it, ``(3, count)``."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = face.shape[2]
    row = np.arange(count) + count * np.arange(3)[:, None]  # a cell along an axis
    ends = np.broadcast_to(row[:, None], face.shape).ravel()
    size = 3 * count + int(face.max(initial=-1)) + 1
    graph = coo_array(
        (np.ones(len(ends), dtype=np.int8), (ends, 3 * count + face.ravel())), shape=(size, size)
    )
    _, which = connected_components(graph, directed=False)
    return which[: 3 * count].reshape(3, count)


def _shortest(stack: NDArray[np.int64], lengths: Array) -> NDArray[np.int64]:
    """Return the axis of each cell along which the cells behind one another are shortest together."""
    extent = np.bincount(stack.ravel(), lengths.T.ravel())[stack] if stack.size else np.zeros(stack.shape)
    return extent.argmin(axis=0)


def _between(
    stack: NDArray[np.int64],
    face: NDArray[np.int64],
    tagged: tuple[NDArray[np.int64], NDArray[np.int64]],
    source: str,
) -> NDArray[np.int64]:
    """Return the axis of each cell along which the cells behind one another lead from one tagged side to the other."""
    count = stack.shape[1]
    owner = np.repeat(stack, 2, axis=0).ravel()  # of each face of each cell, the row through it
    leads = np.ones(stack.shape, dtype=bool)
    for numbers in tagged:
        reached = np.unique(owner[np.isin(face[: 6 * count], numbers)])
        leads &= np.isin(stack, reached)
    wrong = int(np.count_nonzero(leads.sum(axis=0) != 1))
    if wrong:
        message = f"{wrong} of {count} elements do not lie in one row between the facets of these tags"
        raise CaseError(message, file=source, key="faces")
    return leads.argmax(axis=0)


def _check_layers(corners: NDArray[np.int64], axes: NDArray[np.int64], source: str) -> None:
    """Refuse elements of which one has its thickness along an edge that lies in the layer of its neighbour."""
    ends = [corners[:, np.flatnonzero(BITS[:, axis] == end)] for axis in range(3) for end in (0, 1)]
    edges = np.stack([np.stack(ends[::2]), np.stack(ends[1::2])], axis=-1)  # (3, count, 4, 2)
    through = np.broadcast_to((np.arange(3)[:, None] == axes)[:, :, None], edges.shape[:3]).ravel()
    _, edge = np.unique(np.sort(edges.reshape(-1, 2), axis=1), axis=0, return_inverse=True)
    cells, thick = np.bincount(edge.ravel()), np.bincount(edge.ravel(), through)
    wrong = int(np.count_nonzero((thick > 0) & (thick < cells)))
    if wrong:
        message = (
            f"the thickness direction of solid-shell elements cannot be found: at {wrong} edges it is that of one "
            "element and not of its neighbour; name the two faces of the body by their tags, faces = [...]"
        )
        raise CaseError(message, file=source, key="faces")
