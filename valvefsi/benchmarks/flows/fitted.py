"""Incompressible flow on a mesh that fits a body at rest: a reference that shares nothing with the staggered grid.

Taylor-Hood elements and backward differences of second order; the advection is extrapolated from the last two steps,
so that the matrix stays and is factorised once:

    rho [(3 u - 4 u1 + u2) / (2 dt) + 2 (u1 . grad) u1 - (u2 . grad) u2] = -grad p + div(2 mu e(u)),   div u = 0

Sides of which nothing is said bear no traction; where there are none the pressure is zero at one node.

The force on a part of the boundary is the reaction at its nodes, the
residual of the momentum equation there, which is more accurate than the integral of the traction.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import basix.ufl
import dolfinx
import ufl
from dolfinx import fem
from dolfinx.fem import petsc
from dolfinx.mesh import exterior_facet_indices
from petsc4py import PETSc

from valvefsi.errors import StabilityError
from valvefsi.types import Array, Indices

Velocity = Sequence[Callable[[Array], Array] | float | None]
"""Both components, each a number, a function of the points ``(3, n)``, or None where it is free [cm/s]."""
DEGREE = 6
"""Of the quadrature: u . grad(u) . v is of degree five on straight cells."""


class FittedFlow:
    """Flow on a mesh of triangles, from what is given at its sides (collective).

    Args:
        mesh: DOLFINx mesh of triangles in the plane [cm].
        sides: Facets of this rank, ``(n,)``, and velocity of each side by name; where two meet the later one counts.
        rho: Density [g/cm^3].
        mu: Dynamic viscosity [dyn s/cm^2].
        dt: Length of a step [s].

    Attributes:
        t: Time [s].
        velocity: Velocity [cm/s], a function of the mixed space whose first part it is.
    """

    def __init__(
        self,
        mesh: dolfinx.mesh.Mesh,
        sides: Mapping[str, tuple[Indices, Velocity]],
        *,
        rho: float,
        mu: float,
        dt: float,
    ) -> None:
        self.comm, self.dt, self.t = mesh.comm, dt, 0.0
        vector = basix.ufl.element("Lagrange", "triangle", 2, shape=(2,))
        scalar = basix.ufl.element("Lagrange", "triangle", 1)
        self.space = fem.functionspace(mesh, basix.ufl.mixed_element([vector, scalar]))
        self.velocity, self.before = fem.Function(self.space), fem.Function(self.space)
        self._set_up_forms(rho, mu)
        self.nodes, self.values, self.fixed = self._prescribed(sides)
        # PETSc keeps what is dropped on several ranks: a step makes no vectors.
        self.lifted, self.old, self.x, self.residual = (self.values.duplicate() for _ in range(4))
        self.right = compat.create_vector(self.space)
        self.matrix.mult(self.values, self.lifted)
        self.solver = self._factorise()

    def _set_up_forms(self, rho: float, mu: float) -> None:
        W, mesh = self.space, self.space.mesh
        (u, p), (v, q) = ufl.TrialFunctions(W), ufl.TestFunctions(W)
        u1, u2 = ufl.split(self.velocity)[0], ufl.split(self.before)[0]
        dx = ufl.Measure("dx", mesh, metadata={"quadrature_degree": DEGREE})
        density, viscosity, rate = (fem.Constant(mesh, c) for c in (rho, mu, 0.5 / self.dt))
        bilinear = 3.0 * rate * density * ufl.inner(u, v) * dx
        bilinear += 2.0 * viscosity * ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) * dx
        bilinear -= (p * ufl.div(v) + q * ufl.div(u)) * dx
        advection = 2.0 * ufl.dot(ufl.grad(u1), u1) - ufl.dot(ufl.grad(u2), u2)
        old = density * (rate * (4.0 * u1 - u2) - advection)
        self.form = compat.compile_form(ufl.inner(old, v) * dx)
        self.matrix = petsc.assemble_matrix(compat.compile_form(bilinear))
        self.matrix.assemble()

    def _components(self, facets: Indices) -> list[tuple[Indices, Array]]:
        """This rank's unknowns on facets, whoever has these, and their points ``(3, n)``, of both components."""
        parts = []
        for d in range(2):
            space, to_parent = self.space.sub(0).sub(d).collapse()
            here = np.unique(fem.locate_dofs_topological(space, 1, facets))
            own = here[here < space.dofmap.index_map.size_local]
            parts.append((np.ravel(to_parent)[own], space.tabulate_dof_coordinates()[own].T))
        return parts

    @property
    def _owned(self) -> int:
        return self.space.dofmap.index_map.size_local * self.space.dofmap.index_map_bs

    def _prescribed(
        self, sides: Mapping[str, tuple[Indices, Velocity]]
    ) -> tuple[dict[str, list[Indices]], PETSc.Vec, Indices]:
        """Return the unknowns of each side by component, what is given as a vector, and those it is given for."""
        self.space.mesh.topology.create_connectivity(1, 2)
        values, fixed = compat.create_vector(self.space), []
        nodes: dict[str, list[Indices]] = {}
        for name, (facets, velocity) in sides.items():
            nodes[name] = []
            for (unknowns, x), value in zip(self._components(facets), velocity, strict=True):
                nodes[name].append(unknowns)
                if value is not None:
                    values.array[unknowns] = value(x) if callable(value) else value
                    fixed.append(unknowns)
        pressures = np.ravel(self.space.sub(1).collapse()[1])
        if self._closed([facets for facets, _ in sides.values()]) and self.comm.rank == 0:
            fixed.append(pressures[:1])
        return nodes, values, np.unique(np.concatenate([np.zeros(0, np.int32), *fixed]))

    def _closed(self, facets: list[Indices]) -> bool:
        """Whether something is given on every side (collective)."""
        outside = exterior_facet_indices(self.space.mesh.topology)
        return not self.comm.allreduce(len(np.setdiff1d(outside, np.concatenate(facets))))

    def _factorise(self) -> PETSc.KSP:
        first = self.space.dofmap.index_map.local_range[0] * self.space.dofmap.index_map_bs
        matrix = self.matrix.copy()
        matrix.zeroRowsColumns((self.fixed + first).astype(PETSc.IntType), diag=1.0)
        solver = PETSc.KSP().create(self.comm)
        solver.setOperators(matrix)
        solver.setType("preonly")
        solver.getPC().setType("lu")
        solver.getPC().setFactorSolverType("mumps")
        solver.setUp()
        return solver

    def start(
        self, velocity: Callable[[Array], Array], before: Callable[[Array], Array] | None = None
    ) -> None:
        """Begin with a velocity, and that a step before.

        Args:
            velocity: Velocity ``(2, n)`` at points ``(3, n)`` [cm/s].
            before: Velocity a step before; the same if left out, which costs the first step its order.
        """
        for function, value in ((self.velocity, velocity), (self.before, before or velocity)):
            function.x.array[:] = 0.0
            function.sub(0).interpolate(value)

    def step(self) -> dict[str, Array]:
        """Advance by a step and return the force on every side, ``(2,)`` [dyn per cm] (collective).

        Raises:
            StabilityError: The velocity is not finite; the step was too long.
        """
        right, old, x, residual = self.right, self.old, self.x, self.residual
        with right.localForm() as local:
            local.set(0.0)
        petsc.assemble_vector(right, self.form)
        right.ghostUpdate(addv=PETSc.InsertMode.ADD_VALUES, mode=PETSc.ScatterMode.REVERSE)
        right.copy(old)
        right.axpy(-1.0, self.lifted)
        right.array[self.fixed] = self.values.array[self.fixed]
        self.solver.solve(right, x)
        self.matrix.mult(x, residual)
        residual.axpy(-1.0, old)
        self.before.x.array[:] = self.velocity.x.array
        self.velocity.x.array[: self._owned] = x.array
        self.velocity.x.scatter_forward()
        self.t += self.dt
        forces = np.array([[-residual.array[part].sum() for part in both] for both in self.nodes.values()])
        forces = self.comm.allreduce(forces)
        if not np.all(np.isfinite(forces)):
            raise StabilityError(f"the velocity is not finite at t = {self.t:.4g} s; try a shorter step")
        return dict(zip(self.nodes, forces, strict=True))

    def destroy(self) -> None:
        """Free PETSc's objects, which nothing else does on several ranks (collective)."""
        factorised, _ = self.solver.getOperators()
        vectors = (self.values, self.lifted, self.old, self.x, self.residual, self.right)
        for thing in (self.solver, factorised, self.matrix, *vectors):
            thing.destroy()
