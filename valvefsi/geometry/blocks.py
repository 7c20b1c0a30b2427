"""Meshes of quadrilaterals or hexahedra from structured blocks of points: rings, disks and balls, all the way round."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.runtime import dolfinx_compat as compat  # noqa: F401  (loads MPI and DOLFINx in the right order)

# isort: split
import basix.ufl
from dolfinx import mesh as meshes

from valvefsi.errors import CaseError
from valvefsi.geometry.mesh import SolidMesh

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mpi4py import MPI

    from valvefsi.types import Array


def ring(
    comm: MPI.Comm, *, centre: Sequence[float], radii: tuple[float, float], elements: tuple[int, int]
) -> SolidMesh:
    """Mesh a ring with quadrilaterals, ``elements`` around and through the wall (collective)."""
    if not 0 < radii[0] < radii[1]:
        raise CaseError("expected 0 < inner < outer", key="radii", value=list(radii))
    angle = 2 * math.pi * np.arange(elements[0] + 1) / elements[0]
    r = np.linspace(*radii, elements[1] + 1)
    block = np.stack([np.outer(np.cos(angle), r), np.outer(np.sin(angle), r)], axis=-1)
    return from_blocks(comm, [block + np.asarray(centre, dtype=float)], source="ring")


def ball(comm: MPI.Comm, *, centre: Sequence[float], radius: float, elements: int) -> SolidMesh:
    """Mesh a disk with 5, or a ball with 7, blocks of ``elements`` along each edge (collective).

    The middle block is a cube with bulging faces, half as large as the body; the others go from it to the surface.
    """
    dim = len(centre)
    s = np.linspace(-1.0, 1.0, elements + 1)
    cube = np.stack(np.meshgrid(*[s] * dim, indexing="ij"), axis=-1)
    blocks = [_bulged(cube)]
    outward = np.linspace(0.0, 1.0, elements + 1)
    for axis in range(dim):
        for end in (-1.0, 1.0):
            face = np.moveaxis(cube, axis, 0)[0 if end < 0 else -1]
            inner, outer = _bulged(face), _even(face)
            t = outward.reshape(-1, *[1] * dim)
            blocks.append((1 - t) * inner + t * outer)
    shift = np.asarray(centre, dtype=float)
    return from_blocks(
        comm, [shift + radius * block for block in blocks], source="disk" if dim == 2 else "ball"
    )


def _even(face: Array) -> Array:
    """Put the points of a cube's face on the unit sphere at equal angles."""
    tangents = np.tan(0.25 * math.pi * face)
    return tangents / np.linalg.norm(tangents, axis=-1, keepdims=True)


def _bulged(cube: Array) -> Array:
    """Return the middle block: the cube shrunk to half the radius, halfway to the sphere of that size."""
    size = np.abs(cube).max(axis=-1, keepdims=True)
    tangents = np.tan(0.25 * math.pi * cube / np.where(size > 0, size, 1.0))
    length = np.linalg.norm(tangents, axis=-1, keepdims=True)
    round_ = size * tangents / np.where(length > 0, length, 1.0)
    flat = cube / math.sqrt(cube.shape[-1])
    return 0.25 * (round_ + flat)


def from_blocks(comm: MPI.Comm, blocks: Sequence[Array], *, source: str) -> SolidMesh:
    """Join structured blocks of points, ``(n0, n1[, n2], dim)`` each, where their points coincide.

    Args:
        comm: Communicator the mesh is distributed on.
        blocks: The same on every rank.
        source: Name of the mesh for messages.

    Note:
        Collective.
    """
    dim = blocks[0].shape[-1]
    points = np.concatenate([block.reshape(-1, dim) for block in blocks])
    size = np.ptp(points, axis=0).max()
    grades = np.rint((points - points.min(axis=0)) / (1e-7 * size)).astype(np.int64)
    _, first, number = np.unique(grades, axis=0, return_index=True, return_inverse=True)
    number, cells, start = number.ravel(), [], 0
    for block in blocks:
        shape = block.shape[:-1]
        numbers = number[start : start + math.prod(shape)].reshape(shape)
        start += math.prod(shape)
        corners = [
            numbers[tuple(slice(o, n - 1 + o) for o, n in zip(offset, shape, strict=True))].ravel()
            for offset in np.ndindex(*(2,) * dim)
        ]
        cells.append(np.stack(corners, axis=1))
    kind = "quadrilateral" if dim == 2 else "hexahedron"
    element = basix.ufl.element("Lagrange", kind, 1, shape=(dim,))
    mine = comm.rank == 0
    topology = np.concatenate(cells).astype(np.int64)
    mesh = meshes.create_mesh(
        comm,
        cells=topology if mine else topology[:0],
        x=points[first] if mine else points[:0],
        e=element,
    )
    return SolidMesh(mesh=mesh, cell_tags=None, facet_tags=None, source=source)
