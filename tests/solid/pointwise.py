"""An energy, its stress and its tangent at a given deformation gradient, without a body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from valvefsi.solid.materials.kinematics import Kinematics

if TYPE_CHECKING:
    from valvefsi.types import Array


class Pointwise:
    """A material at one point, through the same compiler as the solid.

    Args:
        material: Anything with ``energy(kinematics)``.
        dim: 3, or 2 for plane strain.
        fibres: Unit vectors of the fibre fields that the material names, ``(dim,)`` each.
    """

    def __init__(
        self, material: object, dim: int = 3, fibres: Mapping[str, Sequence[float]] | None = None
    ) -> None:
        cell = mesh.create_unit_square if dim == 2 else mesh.create_unit_cube
        self._mesh = cell(MPI.COMM_SELF, *[1] * dim)
        self._F = fem.Constant(self._mesh, np.eye(dim))
        F = ufl.variable(self._F)
        fields = {name: ufl.as_vector([float(v) for v in a]) for name, a in (fibres or {}).items()}
        W = material.energy(Kinematics(F, fields))
        P = ufl.diff(W, F)
        entries = [P[i, j] for i in range(dim) for j in range(dim)]
        self._energy_and_stress = self._compile(ufl.as_vector([W, *entries]))  # one form to compile, not two
        self._tangent, self._P, self._variable = None, P, F

    def _compile(self, part: object) -> fem.Expression:
        return compat.compile_expression(part, np.full((1, len(self._F.value)), 0.25), MPI.COMM_SELF)

    def _evaluate(self, expression: fem.Expression, F: Array) -> Array:
        self._F.value[:] = F
        return compat.evaluate(expression, self._mesh, [0])[0]

    def __call__(self, F: Array) -> tuple[float, Array]:
        """Return W [dyn/cm^2] and P = dW/dF ``(dim, dim)`` [dyn/cm^2] at F ``(dim, dim)``."""
        found = self._evaluate(self._energy_and_stress, F)
        return float(found[0]), found[1:].reshape(self._F.value.shape)

    def tangent(self, F: Array) -> Array:
        """Return dP/dF ``(dim, dim, dim, dim)`` [dyn/cm^2] at F."""
        if self._tangent is None:
            self._tangent = self._compile(ufl.diff(self._P, self._variable))
        return self._evaluate(self._tangent, F).reshape(self._F.value.shape * 2)
