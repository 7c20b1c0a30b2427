"""Static equilibrium of an exactly incompressible body, displacement and pressure: the reference answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from valvefsi import dolfinx_compat as compat

# isort: split
import basix.ufl
import ufl
from dolfinx import fem, geometry

from valvefsi.errors import CaseError, ConvergenceError
from valvefsi.solid.kinematics import Kinematics
from valvefsi.solid.newton import Newton

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from valvefsi.solid.loads import DeadLoad
    from valvefsi.solid.materials import Material

    Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Fixed:
    """Prescribed displacement of tagged facets.

    Args:
        on: Names of the facet tags.
        components: The axes it acts along, of "x", "y", "z"; empty for all of them.
        value: ``value(X, s)`` gives the displacement ``(n, 3)`` [cm] at reference positions ``(n, 3)`` and
            load factor s; None for zero.
    """

    on: tuple[str, ...]
    components: tuple[str, ...] = ()
    value: Callable[[Array, float], Array] | None = None

    def __post_init__(self) -> None:
        if not self.on or not set(self.components) <= set("xyz"):
            message = 'expected tags, and components of "x", "y", "z"'
            raise CaseError(message, key="fixed", value=[self.on, self.components])


@dataclass(frozen=True, kw_only=True)
class SolverOptions:
    """How the equilibrium is sought.

    Args:
        first_increment: First increment of the load factor, which goes from 0 to 1.
        smallest_increment: Give up below this one.
        max_iterations: Newton iterations of a load step before its increment is halved.
        relative_tolerance: Of the residual in each load step.
        quadrature_degree: Degree of the quadrature of all forms.
    """

    first_increment: float = 0.25
    smallest_increment: float = 1e-3
    max_iterations: int = 20
    relative_tolerance: float = 1e-9
    quadrature_degree: int = 5

    def __post_init__(self) -> None:
        if not 0 < self.smallest_increment <= self.first_increment <= 1:
            message = "expected 0 < smallest_increment <= first_increment <= 1"
            raise CaseError(message, key="first_increment", value=self.first_increment)


@dataclass(frozen=True)
class LoadStep:
    """One attempted load step: the load factor aimed at, Newton iterations, whether it converged."""

    factor: float
    iterations: int
    converged: bool


@dataclass(frozen=True, kw_only=True)
class StaticSolution:
    """Equilibrium of an incompressible body.

    Args:
        displacement: Second-degree function with ``dim`` components [cm].
        pressure: First-degree function, positive in compression [dyn/cm^2].
        load_steps: What was tried on the way.
    """

    displacement: fem.Function
    pressure: fem.Function
    load_steps: tuple[LoadStep, ...]

    def displacement_at(self, X: Sequence[float] | Array) -> Array:
        """Return the displacement at reference positions.

        Args:
            X: One position ``(dim,)`` or several ``(m, dim)`` [cm].

        Returns:
            ``(dim,)`` or ``(m, dim)`` [cm], on all ranks.

        Raises:
            CaseError: A position lies outside the body.

        Note:
            Collective.
        """
        return evaluate_at(self.displacement, X)

    def pressure_at(self, X: Sequence[float] | Array) -> Array:
        """Return the pressure at reference positions, ``(1,)`` or ``(m, 1)`` [dyn/cm^2] (collective)."""
        return evaluate_at(self.pressure, X)

    def volume_ratio(self) -> float:
        """Return current over reference volume, 1 up to the solver's tolerance (collective)."""
        space = self.displacement.function_space
        dX = ufl.dx(domain=space.mesh, degree=2 * space.mesh.geometry.dim)
        J = ufl.det(ufl.Identity(space.mesh.geometry.dim) + ufl.grad(self.displacement))
        one = fem.Constant(space.mesh, 1.0)
        volumes = [fem.assemble_scalar(compat.compile_form(value * dX)) for value in (J, one)]
        current, reference = space.mesh.comm.allreduce(np.array(volumes))
        return float(current / reference)


def solve(
    mesh: object,
    material: Material,
    *,
    fixed: Sequence[Fixed],
    loads: Sequence[DeadLoad] = (),
    options: SolverOptions = SolverOptions(),
) -> StaticSolution:
    """Find the equilibrium of an exactly incompressible body under dead loads and prescribed displacements.

    Stationary point of

        Pi(u, p) = integral W(F) - p (J - 1) dX - s integral t . u dA,    F = I + grad u,

    with Taylor-Hood elements (P2-P1 on simplices, Q2-Q1 on quadrilaterals and hexahedra), the load factor s
    going from 0 to 1 in steps that are halved where Newton's method fails and doubled where it is fast.

    Args:
        mesh: A ``SolidMesh``; two dimensions are plane strain.
        material: Isochoric energy W.
        fixed: Prescribed displacements.
        loads: Dead loads; their ramps in time are ignored.
        options: Load steps, tolerance, quadrature.

    Raises:
        CaseError: A tag is unknown, or a support or load names cells.
        ConvergenceError: The smallest load increment did not converge.

    Note:
        Collective. Linear systems are solved by MUMPS.
    """
    problem = _Problem(mesh, material, fixed, loads, options)
    steps = _follow_load(problem, options)
    displacement, pressure = (problem.state.sub(i).collapse() for i in range(2))
    displacement.name, pressure.name = "displacement", "pressure"
    return StaticSolution(displacement=displacement, pressure=pressure, load_steps=tuple(steps))


def evaluate_at(function: fem.Function, X: Sequence[float] | Array) -> Array:
    """Evaluate a continuous function at positions ``(m, dim)`` or ``(dim,)``, on all ranks (collective)."""
    mesh = function.function_space.mesh
    given = np.asarray(X, dtype=np.float64)
    points = np.zeros((np.atleast_2d(given).shape[0], 3))
    points[:, : mesh.geometry.dim] = np.atleast_2d(given)[:, : mesh.geometry.dim]
    tree = geometry.bb_tree(mesh, mesh.topology.dim, padding=1e-10)
    near = geometry.compute_collisions_points(tree, points)
    cells = geometry.compute_colliding_cells(mesh, near, points)
    found = np.array([i for i in range(len(points)) if len(cells.links(i))], dtype=np.int64)
    size = function.function_space.dofmap.index_map_bs
    sums = np.zeros((len(points), size + 1))
    if len(found):
        first = np.array([cells.links(i)[0] for i in found], dtype=np.int32)
        sums[found, :size] = function.eval(points[found], first).reshape(len(found), size)
        sums[found, size] = 1.0
    sums = mesh.comm.allreduce(sums)
    if np.any(sums[:, size] == 0):
        outside = points[sums[:, size] == 0][0, : mesh.geometry.dim]
        raise CaseError("this position lies outside the body", key="X", value=outside.tolist())
    values = sums[:, :size] / sums[:, size:]
    return values if given.ndim == 2 else values[0]


class _Problem:
    """Forms, prescribed displacements and state of the mixed problem."""

    def __init__(
        self,
        mesh: object,
        material: Material,
        fixed: Sequence[Fixed],
        loads: Sequence[DeadLoad],
        options: SolverOptions,
    ) -> None:
        domain = mesh.mesh
        dim = domain.geometry.dim
        cell = domain.basix_cell()
        vector = basix.ufl.element("Lagrange", cell, 2, shape=(dim,))
        scalar = basix.ufl.element("Lagrange", cell, 1)
        self.space = fem.functionspace(domain, basix.ufl.mixed_element([vector, scalar]))
        self.state = fem.Function(self.space)
        self.factor = fem.Constant(domain, 0.0)
        u, p = ufl.split(self.state)
        kinematics = Kinematics(ufl.Identity(dim) + ufl.grad(u))
        dX = ufl.dx(domain=domain, degree=options.quadrature_degree)
        energy = (material.energy(kinematics) - p * (kinematics.J - 1)) * dX
        for load in loads:
            energy -= self.factor * _work(mesh, load, u, options.quadrature_degree)
        self._prescribed = []
        conditions = [bc for support in fixed for bc in self._fix(mesh, support)]
        self.newton = Newton(self.state, ufl.derivative(energy, self.state), conditions)
        size = domain.comm.allreduce(np.ptp(domain.geometry.x, axis=0).max(initial=0.0))
        self.newton.set_tolerances(
            options.relative_tolerance,
            1e-13 * material.shear_modulus * size ** (dim - 1),
            options.max_iterations,
        )

    def _fix(self, mesh: object, support: Fixed) -> list[fem.DirichletBC]:
        """Make the conditions of one support, one for each component."""
        domain = mesh.mesh
        facet_dim = domain.topology.dim - 1
        domain.topology.create_connectivity(facet_dim, facet_dim + 1)
        facets = np.concatenate([mesh.facet_tags.find(tag) for tag in _facet_tags(mesh, support.on)])
        if domain.comm.allreduce(len(facets)) == 0:
            raise CaseError("no facet carries this tag", file=mesh.source, key="on", value=list(support.on))
        conditions = []
        for axis in range(domain.geometry.dim):
            if support.components and "xyz"[axis] not in support.components:
                continue
            sub = self.space.sub(0).sub(axis)
            collapsed, _ = sub.collapse()
            value = fem.Function(collapsed)
            dofs = fem.locate_dofs_topological((sub, collapsed), facet_dim, facets)
            self._prescribed.append((support.value, axis, value))
            conditions.append(fem.dirichletbc(value, dofs, sub))
        return conditions

    def set_factor(self, s: float) -> None:
        """Set the load factor of loads and prescribed displacements."""
        self.factor.value = s
        for function, axis, value in self._prescribed:
            if function is not None:
                value.interpolate(lambda x, f=function, i=axis: np.asarray(f(x.T, s))[:, i])


def _facet_tags(mesh: object, names: Sequence[str]) -> list[int]:
    """Return the numbers of facet tags; refuse tags of cells."""
    tags = [mesh.tag(name) for name in names]
    if any(dim != mesh.mesh.topology.dim - 1 for dim, _ in tags):
        raise CaseError("expected tags of facets", file=mesh.source, key="on", value=list(names))
    return [tag for _, tag in tags]


def _work(mesh: object, load: DeadLoad, u: object, degree: int) -> ufl.Form:
    """Return the work of a dead load, integral t . u dA."""
    dim = mesh.mesh.geometry.dim
    traction = fem.Constant(mesh.mesh, np.array(load.traction[:dim], dtype=np.float64))
    ds = ufl.Measure(
        "ds",
        domain=mesh.mesh,
        subdomain_data=mesh.facet_tags,
        metadata={"quadrature_degree": degree},
    )
    return ufl.inner(traction, u) * ds(tuple(_facet_tags(mesh, load.on)))


def _follow_load(problem: _Problem, options: SolverOptions) -> list[LoadStep]:
    """Raise the load factor from 0 to 1 in steps that adapt to Newton's method."""
    factor, increment = 0.0, options.first_increment
    steps: list[LoadStep] = []
    while factor < 1:
        target = min(factor + increment, 1.0)
        if target > 1 - 1e-12:
            target = 1.0
        problem.set_factor(target)
        converged, iterations = problem.newton.solve()
        steps.append(LoadStep(target, iterations, converged))
        if converged:
            factor = target
            increment *= 2 if iterations <= options.max_iterations // 3 else 1
        else:
            increment = (target - factor) / 2
        if increment < options.smallest_increment:
            raise ConvergenceError(
                f"statics: no equilibrium beyond {factor:.4g} of the load, increments down to {increment:.2g}"
                " failed; check the supports, refine the mesh or lower the load"
            )
    return steps
