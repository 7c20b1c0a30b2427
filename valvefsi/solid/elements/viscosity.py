"""Viscous nodal forces of a body: the dashpot of a Kelvin-Voigt solid beside its elastic energy."""

from __future__ import annotations

from typing import TYPE_CHECKING

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import ufl
from dolfinx import fem, la

from valvefsi.solid.elements.packing import PackedFunctions

if TYPE_CHECKING:
    from valvefsi.types import Array


class Viscosity:
    """Viscous nodal forces of a body that deforms.

        F_k = -integral P_v : grad(phi_k) dX,    P_v = J sigma_v F^-T,    sigma_v = 2 eta sym(grad U F^-1)

    with the gradients in the reference state, so that sigma_v is Newton's stress of the rate of deformation d: a rigid
    motion makes none, and the power is 2 eta d : d per deformed volume. It comes on top of the fluid's own viscosity,
    which the immersed body has too (S11).

    Args:
        space: Vector Lagrange space of the position, ``dim`` components.
        eta: Viscosity, positive [dyn s/cm^2].
        quadrature_degree: Degree of the quadrature.
    """

    def __init__(self, space: fem.FunctionSpace, eta: float, quadrature_degree: int) -> None:
        self.eta = eta
        self.dim = space.mesh.geometry.dim
        self._position, self._velocity = fem.Function(space, name="chi"), fem.Function(space, name="U")
        F = ufl.grad(self._position)
        inverse, test = ufl.inv(F), ufl.TestFunction(space)
        d = ufl.sym(ufl.grad(self._velocity) * inverse)
        dX = ufl.dx(domain=space.mesh, degree=quadrature_degree)
        power = 2.0 * eta * ufl.det(F) * ufl.inner(d, ufl.grad(test) * inverse) * dX
        self._form = compat.compile_form(-power)
        self._constants = compat.pack_constants(self._form)
        self._coefficients = PackedFunctions(self._form, self._position, self._velocity)
        self._residual = la.vector(space.dofmap.index_map, space.dofmap.index_map_bs)
        self._num_owned = space.dofmap.index_map.size_local
        self._parallel = space.mesh.comm.size > 1

    def force(self, chi: Array, U: Array) -> Array:
        """Return the viscous nodal forces.

        Args:
            chi: Position of the owned nodes, ``(n, 3)`` [cm].
            U: Their velocity, ``(n, 3)`` [cm/s].

        Returns:
            F_k of the owned nodes, ``(n, dim)`` [dyn]; a view that the next call overwrites.

        Note:
            Collective.
        """
        n, dim = self._num_owned, self.dim
        for function, values in ((self._position, chi), (self._velocity, U)):
            function.x.array[: n * dim].reshape(n, dim)[:] = values[:, :dim]
            if self._parallel:
                function.x.scatter_forward()
        array = self._residual.array
        array[:] = 0.0
        fem.assemble_vector(array, self._form, self._constants, self._coefficients())
        if self._parallel:
            self._residual.scatter_reverse(la.InsertMode.add)
        return array[: n * dim].reshape(n, dim)
