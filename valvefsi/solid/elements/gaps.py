"""Distances between neighbouring nodes of a deformed mesh."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import basix
import numpy as np
from dolfinx import la
from mpi4py import MPI

if TYPE_CHECKING:
    from dolfinx import fem

    from valvefsi.types import Array


class Gaps:
    """The pairs of nodes that follow one another on the edges of the cells.

    Args:
        space: Space of the positions, degree 1 or 2.
    """

    def __init__(self, space: fem.FunctionSpace) -> None:
        mesh = space.mesh
        on = space.element.basix_element.entity_dofs
        local: list[tuple[int, int]] = []
        for number, ends in enumerate(basix.topology(mesh.basix_cell())[1]):
            a, b = (on[0][vertex][0] for vertex in ends)
            chain = [a, *on[1][number], b]
            local += itertools.pairwise(chain)
        cells = mesh.topology.index_map(mesh.topology.dim).size_local
        pairs = np.array(space.dofmap.list[:cells])[:, np.array(local, dtype=np.intp)].reshape(-1, 2)
        self.pairs = np.unique(np.sort(pairs, axis=1), axis=0)
        self.comm = mesh.comm
        index_map = space.dofmap.index_map
        self.owned = index_map.size_local
        self._vector = la.vector(index_map, 3)

    def longest(self, chi: Array) -> float:
        """Return the largest distance at the positions chi ``(num_nodes, 3)`` [cm] (collective)."""
        x = self._vector.array.reshape(-1, 3)
        x[: self.owned] = chi
        self._vector.scatter_forward()
        a, b = self.pairs.T
        square = np.square(x[a] - x[b]).sum(axis=1).max(initial=0.0)
        return float(np.sqrt(self.comm.allreduce(float(square), op=MPI.MAX)))
