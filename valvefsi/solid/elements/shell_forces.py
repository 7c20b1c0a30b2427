"""Forces of solid-shell elements from the derivative of their energy: by DOLFINx, or point by point."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import basix.ufl
import ufl
from dolfinx import fem

from valvefsi.solid.elements import shell_force_kernels
from valvefsi.solid.elements.packing import PackedFunctions
from valvefsi.solid.elements.shell_kinematics import KnownRatio, PointKinematics

if TYPE_CHECKING:
    from ufl.core.expr import Expr

    from valvefsi.types import Array


class AssembledForces:
    """Forces that DOLFINx assembles, -dE/dm.

    Args:
        form: Their form.
        m: Monomials of the position.
    """

    def __init__(self, form: ufl.Form, m: fem.Function) -> None:
        self._form, self._shape = compat.compile_form(form), (-1, *m.function_space.element.value_shape)
        self._coefficients = PackedFunctions(self._form, m)
        self._out = np.zeros(len(m.x.array))

    def __call__(self) -> Array:
        """Return the forces at the present monomials; the next call overwrites them."""
        self._out[:] = 0.0
        constants = compat.pack_constants(self._form)
        fem.assemble_vector(self._out, self._form, constants, self._coefficients())
        return self._out.reshape(self._shape)


class Energies(NamedTuple):
    """Energy W of a material by its kinematics, U_1 and U_2 by the volume ratio or None, and a factor of U_2."""

    material: Callable[[PointKinematics], Expr]
    columns: Callable[[KnownRatio], Expr] | None
    mean: Callable[[KnownRatio], Expr] | None
    factor: fem.Constant


class PointForces:
    """Forces of an incompressible body: the derivatives of its energies compiled for a point, the rest written out.

    Measured with the leaflets of the demos on one core: 0.4 of the time that DOLFINx takes to assemble them.

    Args:
        energies: What the forces derive from.
        m: Monomials of the position.
        fibres: Unit vectors of each cell by name.
        rest: G^1, G^2, G^3, V and what c_13 and c_23 are short of at each point, ``(num_cells, 4 points, 12)``.
        volumes: V in the middle of each column, ``(num_cells, 4)``.
        rule: Places of the points through the thickness, and the weights of all points.
    """

    def __init__(
        self,
        energies: Energies,
        m: fem.Function,
        fibres: Mapping[str, fem.Function],
        *,
        rest: Array,
        volumes: Array,
        rule: tuple[Array, Array],
    ) -> None:
        self._domain, self._m = m.function_space.mesh.ufl_domain(), m.x.array.reshape(-1, 7, 3)
        self._factor, (self._places, weights) = energies.factor, rule
        metric, dual = self._symbol(6), self._symbol(3, 3)
        vectors = {name: self._symbol(3) for name in fibres}
        kinematics = PointKinematics(metric, dual, vectors)
        energy = compat.compile_at_point(kinematics.gradient(energies.material(kinematics)))
        volumetric = [self._pressure(U) for U in energies[1:3]]
        self._modules = [made.module for made in (energy, *volumetric) if made is not None]
        values = {dual: rest[..., :9]}
        for name, vector in vectors.items():
            given = fibres[name].x.array.reshape(-1, 1, 3)
            values[vector] = np.broadcast_to(given, (*rest.shape[:2], 3))
        others = [values[symbol] for symbol in energy.inputs if symbol is not metric]
        self._inputs = np.concatenate([np.zeros((*rest.shape[:2], 6)), *others], axis=2).ravel()
        self._first = 6 * (
            metric not in energy.inputs
        )  # a linear energy's derivative does not ask for the metric
        V, short = rest[..., 9:10], rest[..., 10:]
        of_rest = np.concatenate([V**2, weights[:, None] * np.abs(V), short], axis=2)
        self._rest = of_rest.reshape(len(rest), 4, len(self._places), 4)
        self._volumes = np.ascontiguousarray(volumes)
        functions = (energy, *volumetric)
        self._functions = tuple(np.uint64(made.address if made else 0) for made in functions)
        self._constants = tuple(made.constants if made else np.zeros(0) for made in functions)
        self._out = np.zeros(self._m.shape)

    def _symbol(self, *shape: int) -> ufl.Coefficient:
        """Return a coefficient that is constant in a cell."""
        element = basix.ufl.element("DG", "tetrahedron", 0, shape=shape)
        return ufl.Coefficient(ufl.FunctionSpace(self._domain, element))

    def _pressure(self, U: Callable[[KnownRatio], Expr] | None) -> compat.PointFunction | None:
        """Compile the derivative of a volumetric energy."""
        if U is None:
            return None
        J = ufl.variable(self._symbol(1)[0])
        return compat.compile_at_point(ufl.diff(U(KnownRatio(J)), J))

    def __call__(self) -> Array:
        """Return the forces at the present monomials, ``(num_cells, 7, 3)``; the next call overwrites them."""
        shell_force_kernels.forces(
            self._out,
            self._m,
            self._inputs,
            self._first,
            self._rest,
            self._volumes,
            self._places,
            self._functions,
            self._constants,
            float(self._factor.value),
        )
        return self._out
