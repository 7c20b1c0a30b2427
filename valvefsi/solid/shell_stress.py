"""Stress and strain of a body of solid-shell elements, those that its energy has."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import basix
import ufl
from mpi4py import MPI

from valvefsi.solid.elements.shell_cells import gauss
from valvefsi.solid.elements.shell_kinematics import (
    assumed_metric,
    base_vectors,
    volume_density,
)
from valvefsi.solid.elements.shell_layers import BITS
from valvefsi.solid.stress import Stress

if TYPE_CHECKING:
    from valvefsi.solid.elements.shell_elasticity import ShellElasticity
    from valvefsi.solid.materials.parameters import Direction
    from valvefsi.types import Array, Indices


class ShellStress(Stress):
    """Stress and strain at the 2 x 2 x 2 Gauss points of solid-shell elements, at their present position.

    The stretch U of the energy, U^2 = C of `ShellCells.kinematics_of`, takes the place of that of the nodes: F = R U
    with R from the nodes' gradient. The stress is dW/dC with the pressure that leaves none through the thickness, and
    on top of it that of the volumetric energies.

    Args:
        elasticity: The elements.
        fibre: The direction whose stretch is "fibre_stretch": a field's name, an angle [deg] or a vector.

    Note:
        Collective.
    """

    def __init__(self, elasticity: ShellElasticity, fibre: Direction | None = None) -> None:
        self.elasticity, self.motion, self.of_position = elasticity, elasticity.position, True
        self.mesh, self.dim, self.has_fibre = elasticity.mesh, 3, fibre is not None
        self.degree = 3
        self.points, self.weights = basix.make_quadrature(basix.CellType.hexahedron, 3)
        self._expression = self._compile(fibre)
        self._place = self._places()

    def _compile(self, fibre: Direction | None) -> object:
        """Compile gradient, C, S, the measure and the fibre at the points, for the separate cells."""
        cells = self.elasticity.cells
        metric = assumed_metric(cells.m, cells.M, cells.at)
        c, normal = cells.stress()
        G = base_vectors(cells.M, cells.at)
        g = base_vectors(cells.m, cells.at)
        kinematics = cells.kinematics_of(metric)
        K = kinematics.dual
        F = sum((ufl.outer(g[i], K[i]) for i in range(1, 3)), ufl.outer(g[0], K[0]))
        S = 2 * sum(
            (a * ufl.outer(v, v) for a, v in zip((c[1], normal), G[1:], strict=True)),
            c[0] * ufl.outer(G[0], G[0]),
        )
        for k, (i, j) in enumerate(((0, 1), (0, 2), (1, 2)), start=2):
            S += c[k] * (ufl.outer(G[i], G[j]) + ufl.outer(G[j], G[i]))
        parts = [A[i, j] for A in (F, kinematics.C, S) for i in range(3) for j in range(3)]
        parts.append(
            8 * abs(volume_density(cells.M, cells.at))
        )  # the reference cell of the mesh has edges of 1
        parts.append(cells.pressure())
        if fibre is not None:
            parts += [kinematics.vector(fibre)[i] for i in range(3)]
        return compat.compile_expression(ufl.as_vector(parts), gauss(2, 2, 2)[0], MPI.COMM_SELF)

    def _places(self) -> Indices:
        """Return which point of the separate cell each point of the mesh's cell is, ``(num_cells, 8)``."""
        at = (self.points > 0.5).astype(int)
        _, position = np.unique(self.elasticity.corners, axis=0, return_inverse=True)
        kinds = np.unique(self.elasticity.corners, axis=0)
        places = np.empty((len(kinds), 8), dtype=np.int64)
        for row, corners in enumerate(kinds):
            for q in range(8):
                corner = int(np.flatnonzero((at[q] == BITS).all(axis=1))[0])
                i, j, k = BITS[int(np.flatnonzero(corners == corner)[0])]
                places[row, q] = 4 * i + 2 * j + k
        return places[position.ravel()]

    def _evaluate(self) -> tuple[Array, Array, Array, Array | None]:
        """Return F, P, the cell's |det dX/dxi| and the fibres at the points of owned cells."""
        cells = self.elasticity.cells
        values = compat.evaluate(self._expression, cells.mesh, np.arange(cells.num_cells))
        values = cells.in_order(values.reshape(cells.num_cells, 8, -1))[: len(self._place)]
        values = np.take_along_axis(values, self._place[:, :, None], axis=1)
        gradient, C, S = (values[..., 9 * k : 9 * k + 9].reshape(*values.shape[:2], 3, 3) for k in range(3))
        left, _, right = np.linalg.svd(gradient)
        stretches, axes = np.linalg.eigh(C)
        U = np.einsum("...ik,...k,...jk->...ij", axes, np.sqrt(stretches), axes)
        F = left @ right @ U
        S = S + values[..., 28, None, None] * np.linalg.inv(C)
        return F, F @ S, values[..., 27], values[..., 29:32] if self.has_fibre else None
