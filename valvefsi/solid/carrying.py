"""Fields of one mesh of a solid at the nodes of another mesh of the same solid."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem, geometry

if TYPE_CHECKING:
    from valvefsi.solid.structure import Structure
    from valvefsi.types import Array


def at_points(solid: Structure, values: Array, points: Array) -> Array:
    """Return a field of nodal values at reference positions, by the shape functions of the cell next to each.

    Args:
        solid: The solid, whole on this rank.
        values: At its nodes, in the order of ``solid.X``, ``(num_nodes, 3)``.
        points: Reference positions, near the solid where they are not in it, ``(n, 3)`` [cm].

    Returns:
        The values there, ``(n, 3)``; those of a two-dimensional solid have no third component.

    Raises:
        ValueError: The solid is distributed over several ranks.
    """
    if solid.comm.size > 1:
        raise ValueError("the solid is distributed over several ranks")
    found = np.zeros((len(points), 3))
    if not len(points):
        return found
    mesh, dim = solid.mesh.mesh, solid.dim
    field = fem.Function(solid.space)
    field.x.array[:] = values[:, :dim].ravel()
    x = points.copy()
    x[:, dim:] = 0.0
    tree = geometry.bb_tree(mesh, dim)
    numbers = np.arange(mesh.topology.index_map(dim).size_local, dtype=np.int32)
    midpoints = geometry.create_midpoint_tree(mesh, dim, numbers)
    cells = geometry.compute_closest_entity(tree, midpoints, mesh, x)
    found[:, :dim] = np.reshape(field.eval(x, cells), (len(x), dim))
    return found
