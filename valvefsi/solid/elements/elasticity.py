"""Nodal elastic forces of a hyperelastic body: the weak form of S13 with a stated quadrature degree."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import basix
import ufl
from dolfinx import fem, la

from valvefsi.solid.elements.packing import PackedFunctions
from valvefsi.solid.materials.kinematics import Kinematics

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from valvefsi.solid.materials import Material, Volumetric
    from valvefsi.types import Array


class Elasticity:
    """Elastic nodal forces, energy and volume ratio of a body at a given position.

        F_k = -integral P : grad(phi_k) dX,    P = dW/dF + dU/dF          (weak form of S13, with S20-S23)

    Args:
        space: Vector Lagrange space of the position, ``dim`` components.
        material: Isochoric energy W.
        volumetric: Volumetric energies U(J), each with the degree of its quadrature; a modulus of 0 leaves one out.
            A reduced degree (1 for linear hexahedra: J of the midpoint) frees bending from volumetric locking
            (Malkus and Hughes 1978).
        quadrature_degree: Degree of the quadrature of W, and of the points at which J is told.
        fibres: Fibre fields of the mesh by name.
    """

    def __init__(
        self,
        space: fem.FunctionSpace,
        material: Material,
        volumetric: Sequence[tuple[Volumetric, int]],
        quadrature_degree: int,
        fibres: Mapping[str, fem.Function] | None = None,
    ) -> None:
        self.space = space
        self.mesh = space.mesh
        self.dim = self.mesh.geometry.dim
        self.position = fem.Function(space, name="chi")
        self._num_cells = self.mesh.topology.index_map(self.mesh.topology.dim).size_local
        F = ufl.variable(ufl.grad(self.position))
        kinematics = Kinematics(F, fibres)
        # Where the integrand is constant in each cell one point is exact, and costs less than half.
        points = 1 if _is_constant_in_cells(space, fibres) else quadrature_degree
        energies = {points: material.energy(kinematics)}
        for U, degree in volumetric:
            if U.kappa > 0:
                energies[min(degree, points)] = energies.get(min(degree, points), 0.0) + U.energy(kinematics)
        parts = [(W, ufl.dx(domain=self.mesh, degree=degree)) for degree, W in energies.items()]
        test = ufl.TestFunction(space)
        power = sum(ufl.inner(ufl.diff(W, F), ufl.grad(test)) * dX for W, dX in parts)
        self._force_form = compat.compile_form(-power)
        self._constants = compat.pack_constants(self._force_form)
        self._coefficients = PackedFunctions(self._force_form, self.position)
        self._energy_form = compat.compile_form(sum(W * dX for W, dX in parts))
        self._residual = la.vector(space.dofmap.index_map, space.dofmap.index_map_bs)
        self._num_owned = space.dofmap.index_map.size_local
        self._parallel = self.mesh.comm.size > 1
        self._compile_volume(quadrature_degree)

    def _compile_volume(self, quadrature_degree: int) -> None:
        """Compile J at the quadrature points, and its exact integral."""
        J = ufl.det(ufl.grad(self.position))
        degree = self.space.ufl_element().degree
        points, _ = basix.make_quadrature(self.mesh.basix_cell(), quadrature_degree)
        self._J = compat.compile_expression(J, points, self.mesh.comm)
        exact = ufl.dx(domain=self.mesh, degree=self.dim * degree)
        self._volume_form = compat.compile_form(J * exact)

    def set_position(self, chi: Array) -> None:
        """Take ``chi`` ``(n, 3)`` [cm] of the owned nodes as the current position (collective)."""
        n, dim = self._num_owned, self.dim
        array = self.position.x.array
        array[: n * dim].reshape(n, dim)[:] = chi[:, :dim]
        if self._parallel:
            self.position.x.scatter_forward()

    def force(self, chi: Array) -> Array:
        """Return the elastic nodal forces at ``chi``.

        Args:
            chi: Position of the owned nodes, ``(n, 3)`` [cm].

        Returns:
            F_k of the owned nodes, ``(n, dim)`` [dyn]; a view that the next call overwrites.

        Note:
            Collective. An inverted cell (J <= 0) makes the forces of its nodes NaN.
        """
        self.set_position(chi)
        array = self._residual.array
        array[:] = 0.0
        fem.assemble_vector(array, self._force_form, self._constants, self._coefficients())
        if self._parallel:
            self._residual.scatter_reverse(la.InsertMode.add)
        return array[: self._num_owned * self.dim].reshape(self._num_owned, self.dim)

    def energy(self, chi: Array) -> float:
        """Return the elastic energy, integral of W + U dX, at ``chi`` ``(n, 3)`` [erg] (collective)."""
        self.set_position(chi)
        return self.mesh.comm.allreduce(fem.assemble_scalar(self._energy_form))

    def jacobian(self, chi: Array) -> Array:
        """Return J at the quadrature points of owned cells, ``(num_cells, num_points)`` (collective)."""
        self.set_position(chi)
        return compat.evaluate(self._J, self.mesh, np.arange(self._num_cells, dtype=np.int32))

    def volume(self, chi: Array) -> float:
        """Return the volume, the exact integral of J dX [cm^3; cm^2 in two dimensions] (collective)."""
        self.set_position(chi)
        return self.mesh.comm.allreduce(fem.assemble_scalar(self._volume_form))


def _is_constant_in_cells(space: fem.FunctionSpace, fibres: Mapping[str, fem.Function] | None) -> bool:
    """Whether F and the fibres are constant in each cell: linear simplices, straight, fibres of degree 0."""
    simplices = space.mesh.basix_cell().name in ("triangle", "tetrahedron")
    straight = space.mesh.ufl_domain().ufl_coordinate_element().degree == 1
    even = all(field.function_space.ufl_element().degree == 0 for field in (fibres or {}).values())
    return simplices and straight and even and space.ufl_element().degree == 1
