"""Static equilibrium of a thin body of solid-shell elements, for `valvefsi.solid.statics.solve`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import ufl
from dolfinx import fem
from petsc4py import PETSc

from valvefsi.solid.elements.shell_cells import MODES
from valvefsi.solid.elements.shell_elasticity import POINTS, ShellElasticity, split
from valvefsi.solid.elements.shell_kinematics import KnownRatio
from valvefsi.solid.elements.shell_layers import BITS
from valvefsi.solid.materials import Volumetric
from valvefsi.solid.materials.constants import adjustable
from valvefsi.solid.newton import Newton
from valvefsi.solid.statics.supports import Prescribed

if TYPE_CHECKING:
    from ufl.core.expr import Expr

    from valvefsi.solid.materials import Material
    from valvefsi.solid.statics.equilibrium import Body
    from valvefsi.types import Array, Mesh

SOFTENING = (0.01, 0.1, 1.0)
"""Parts of the bulk modulus of whole elements with which a load step is solved, one after the other."""


@dataclass(frozen=True, kw_only=True)
class SolidShell:
    """Solid-shell hexahedra, held in volume by the energy that the coupled solid uses.

    Args:
        nu_stab: Numerical Poisson ratio of the stabilisation (S22); None for off.
        kappa: The bulk modulus itself, goes before nu_stab [dyn/cm^2].
        volumetric: See `Volumetric`.
        points: Gauss points through the thickness of an element.
    """

    nu_stab: float | None = 0.4
    kappa: float | None = None
    volumetric: str = "log"
    points: int = POINTS

    degrees = (1,)

    def parts(self, material: Material) -> tuple[Volumetric, Volumetric]:
        """Return the volumetric energies of the columns and of the elements as wholes."""
        return split(material, self.nu_stab, self.kappa, self.volumetric)

    def elements(self, mesh: Mesh, space: fem.FunctionSpace, material: Material) -> ShellElasticity:
        """Return the elements of a body; materials that differ in numbers alone share compiled forms (collective)."""
        columns, mean = (adjustable(part) for part in self.parts(material))
        return ShellElasticity(mesh, space, adjustable(material), columns, mean, self.points)

    def pressure(self, mesh: Mesh, material: Material, u: fem.Function) -> Expr:
        """Return p = -dU/dJ at the volume ratio of each element; 0 of a material with a volumetric part of its own."""
        if hasattr(material, "normal_modulus"):
            return fem.Constant(mesh.mesh, 0.0)
        space = fem.functionspace(mesh.mesh, ("DG", 0))
        ratio, test = fem.Function(space), ufl.TestFunction(space)
        dX = ufl.dx(domain=mesh.mesh, degree=5)
        J = ufl.det(ufl.Identity(3) + ufl.grad(u))
        volumes = [fem.assemble_vector(compat.compile_form(f * test * dX)).array for f in (J, 1.0)]
        ratio.x.array[:] = volumes[0] / volumes[1]
        J = ufl.variable(ratio)
        columns, mean = self.parts(material)
        total = Volumetric(kappa=columns.kappa + mean.kappa, form=self.volumetric)
        return -ufl.diff(total.energy(KnownRatio(J)), J)


class ShellProblem:
    """The nodes' displacement as unknown, one matrix, factorised by MUMPS (collective)."""

    def __init__(self, body: Body, formulation: SolidShell) -> None:
        domain = body.mesh.mesh
        space = fem.functionspace(domain, ("Lagrange", 1, (3,)))
        self.state, test = fem.Function(space), ufl.TestFunction(space)
        self.factor = fem.Constant(domain, 0.0)
        none = fem.Constant(domain, 0.0) * ufl.inner(self.state, test) * body.dX  # room in the matrix
        residual = none + ufl.derivative(body.potential(self.state, self.factor), self.state, test)
        follower = body.follower(self.state, test, self.factor)
        if follower is not None:
            residual += follower
        elements = formulation.elements(body.mesh, space, body.material)
        self.elements = elements
        self.prescribed = Prescribed(body.mesh, space, body.fixed())
        forces = body.point_forces(space)
        self.newton = ShellNewton(self.state, residual, self.prescribed.conditions, elements, forces)
        self.set_tolerances = self.newton.set_tolerances

    def solve(self) -> tuple[bool, int]:
        """Run Newton's method from the present state; where it fails, with a bulk modulus that grows to all of it.

        A linear step lengthens the director of an element that turns, and with it the volume: a large bulk modulus
        makes of that a stress whose geometric stiffness leads the next step astray.
        """
        start, total = self.state.x.array.copy(), 0
        for ladder in ((1.0,), SOFTENING):
            for factor in ladder:
                self.elements.cells.scale_bulk(factor)
                converged, iterations = self.newton.solve()
                total += iterations
                if not converged:
                    self.state.x.array[:] = start
                    break
            self.elements.cells.scale_bulk(1.0)
            if converged:
                break
        return converged, total

    def set_factor(self, s: float) -> None:
        """Set the load factor of loads and prescribed displacements."""
        self.factor.value = self.newton.factor = s
        self.prescribed.set_factor(s)

    def fields(self) -> tuple[fem.Function, None]:
        """Return the displacement, and no pressure."""
        return self.state, None


class ShellNewton(Newton):
    """Newton's method on the loads of a weak form and the forces of solid-shell elements.

    Args:
        state: Displacement; start value in, solution out.
        residual: UFL linear form of the loads.
        conditions: Prescribed values.
        elements: The elements.
        forces: See `Newton`.

    Note:
        Collective.
    """

    def __init__(
        self,
        state: fem.Function,
        residual: ufl.Form,
        conditions: list[fem.DirichletBC],
        elements: ShellElasticity,
        forces: Array | None = None,
    ) -> None:
        super().__init__(state, residual, conditions, forces)
        self._elements, self._extra = elements, self._b.duplicate()
        space = state.function_space
        self._reference = space.tabulate_dof_coordinates().ravel()
        self._dofs = (3 * elements.nodes[:, :, None] + np.arange(3)).reshape(-1, 24)
        held = np.zeros(len(self._reference), dtype=bool)
        for condition in conditions:
            held[condition.dof_indices()[0]] = True
        self._held = held
        signs = _signs()
        self._to_nodes = np.einsum("ak,de->adke", signs, np.eye(3)).reshape(MODES * 3, 24)

    def _search(self) -> bool:
        """Run Newton's method from the vector of unknowns, without what was promised before."""
        self._load(self._x)
        self._elements.set_local(self._state.x.array + self._reference)
        self._elements.cells.start()
        return super()._search()

    def _tangents(self) -> Array:
        """Return dF/du of the elements at the present state, ``(num_cells, 24, 24)``."""
        K = self._elements.cells.tangents()
        return np.einsum("ap,cab,bq->cpq", self._to_nodes, K, self._to_nodes, optimize=True)

    def _assemble_residual(self, snes: PETSc.SNES, x: PETSc.Vec, b: PETSc.Vec) -> None:
        """Assemble the loads and the elements' forces, with x - prescribed value in the rows of the conditions."""
        self._load(x)
        missing = self._missing()
        super()._assemble_residual(snes, x, b)
        elements = self._elements
        elements.set_local(self._state.x.array + self._reference)
        forces = elements.cells.forces().reshape(-1, MODES * 3) @ self._to_nodes
        comm = self._state.function_space.mesh.comm
        if comm.allreduce(float(np.abs(missing).max(initial=0.0))) > 0:
            forces -= np.einsum("cpq,cq->cp", self._tangents(), missing[self._dofs])
        sums = np.zeros(len(self._reference))
        np.add.at(sums, self._dofs, forces)
        sums[self._held] = 0.0
        with self._extra.localForm() as local:
            local.array[:] = -sums
        self._extra.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        b.axpy(1.0, self._extra)

    def _missing(self) -> Array:
        """Return what the state lacks of the prescribed values; 0 where none is prescribed."""
        given = self._state.x.array.copy()
        for condition in self._conditions:
            condition.set(given)
        return given - self._state.x.array

    def _assemble_tangent(self, snes: PETSc.SNES, x: PETSc.Vec, A: PETSc.Mat, P: PETSc.Mat) -> None:
        """Assemble the tangents of the loads and the elements."""
        super()._assemble_tangent(snes, x, A, P)
        self._elements.set_local(self._state.x.array + self._reference)
        K = self._tangents()
        free = ~self._held[self._dofs]
        K *= free[:, :, None] & free[:, None, :]
        for nodes, block in zip(self._elements.nodes, K, strict=True):
            A.setValuesBlockedLocal(nodes, nodes, block.ravel(), PETSc.InsertMode.ADD)
        A.assemble()


def _signs() -> Array:
    """Return the monomials of each corner's shape function, ``(7, 8)``."""
    i, j, k = (2.0 * BITS - 1.0).T
    return np.stack([i, j, k, i * j, i * k, j * k, i * j * k]) / 8
