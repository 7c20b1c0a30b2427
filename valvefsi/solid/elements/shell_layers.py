"""Which way the thickness of a body of hexahedra runs, from how its elements lie behind one another."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from valvefsi.errors import CaseError
from valvefsi.runtime import dolfinx_compat as compat

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from valvefsi.types import Array, Mesh

BITS = np.arange(8)[:, None] >> np.arange(3) & 1
"""Place of each corner along the three axes of the reference cell, ``(8, 3)``."""


def thickness_axes(mesh: Mesh) -> NDArray[np.int64]:
    """Return the axis of the reference cell that runs through the thickness, of this rank's cells.

    It is the one along which the elements behind one another, from face to opposite face, are shortest together: a
    sheet is thinner than its rows are long, however many layers it has.

    Args:
        mesh: A ``SolidMesh`` of hexahedra.

    Raises:
        CaseError: The cells are no hexahedra.

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
    parts = domain.comm.allgather((corners, lengths))
    corners, lengths = (np.concatenate([part[k] for part in parts]) for k in range(2))
    axes = _axes(corners, lengths)
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


def _axes(corners: NDArray[np.int64], lengths: Array) -> NDArray[np.int64]:
    """Return the axis of each cell along which the cells behind one another are shortest together."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(corners)
    sides = [np.sort(corners[:, BITS[:, axis] == end], axis=1) for axis in range(3) for end in (0, 1)]
    _, face = np.unique(np.concatenate(sides), axis=0, return_inverse=True)
    face = face.reshape(3, 2, count)
    stack = np.arange(count) + count * np.arange(3)[:, None]  # a cell along an axis
    ends = np.broadcast_to(stack[:, None], face.shape).ravel()
    size = 3 * count + int(face.max(initial=-1)) + 1
    graph = coo_array(
        (np.ones(len(ends), dtype=np.int8), (ends, 3 * count + face.ravel())), shape=(size, size)
    )
    _, which = connected_components(graph, directed=False)
    along = which[: 3 * count]
    extent = np.bincount(along, lengths.T.ravel(), minlength=size)[along].reshape(3, count)
    return extent.argmin(axis=0)
