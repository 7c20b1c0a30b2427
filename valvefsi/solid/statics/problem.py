"""Static equilibrium of a body, exactly incompressible or nearly so: the reference answers."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import ufl
from dolfinx import fem, geometry

from valvefsi.errors import CaseError, ConvergenceError
from valvefsi.solid.newton import Newton
from valvefsi.solid.statics.contact import Contact
from valvefsi.solid.statics.equilibrium import SOLVERS, Body
from valvefsi.solid.statics.formulations import TaylorHood
from valvefsi.solid.statics.shell import ShellProblem, SolidShell
from valvefsi.solid.statics.supports import Fixed, Symmetry

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from ufl.core.expr import Expr

    from valvefsi.solid.loads import DeadLoad, PointLoad, Pressure, Tether
    from valvefsi.solid.materials import Material
    from valvefsi.solid.statics.equilibrium import Problem
    from valvefsi.solid.statics.formulations import DisplacementFormulation, Formulation
    from valvefsi.types import Array, Mesh

__all__ = ["TAYLOR_HOOD", "LoadStep", "SolverOptions", "StaticSolution", "evaluate_at", "solve"]


TAYLOR_HOOD = TaylorHood()


@dataclass(frozen=True, kw_only=True)
class SolverOptions:
    """How the equilibrium is sought.

    Args:
        first_increment: First increment of the load factor, which goes from 0 to 1.
        smallest_increment: Give up below this one.
        max_iterations: Newton iterations of a load step before its increment is halved.
        relative_tolerance: Of the residual in each load step.
        quadrature_degree: Degree of the quadrature of all forms.
        solver: "direct" (MUMPS), or "fieldsplit" (FGMRES, multigrid) for large bodies with a pressure.
        stops: Load factors that the path meets exactly, increasing, each above 0 and at most 1.
    """

    first_increment: float = 0.25
    smallest_increment: float = 1e-3
    max_iterations: int = 20
    relative_tolerance: float = 1e-9
    quadrature_degree: int = 5
    solver: str = "direct"
    stops: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not 0 < self.smallest_increment <= self.first_increment <= 1:
            message = "expected 0 < smallest_increment <= first_increment <= 1"
            raise CaseError(message, key="first_increment", value=self.first_increment)
        if self.solver not in SOLVERS:
            raise CaseError(f"expected one of {', '.join(SOLVERS)}", key="solver", value=self.solver)
        if (
            not all(a < b for a, b in itertools.pairwise((0.0, *self.stops)))
            or max(self.stops, default=0) > 1
        ):
            raise CaseError(
                "expected increasing load factors, 0 < s <= 1", key="stops", value=list(self.stops)
            )


@dataclass(frozen=True)
class LoadStep:
    """One attempted load step: the load factor aimed at, Newton iterations, whether it converged."""

    factor: float
    iterations: int
    converged: bool


@dataclass(frozen=True, kw_only=True)
class StaticSolution:
    """Equilibrium of a body.

    Args:
        displacement: Function with ``dim`` components [cm].
        pressure: First-degree function, positive in compression [dyn/cm^2]; of a formulation without pressure the
            projection of -dU/dJ.
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
    mesh: Mesh,
    material: Material,
    *,
    fixed: Sequence[Fixed | Symmetry | Contact],
    loads: Sequence[DeadLoad | Pressure | PointLoad] = (),
    tethers: Sequence[Tether] = (),
    formulation: Formulation | SolidShell = TAYLOR_HOOD,
    options: SolverOptions = SolverOptions(),
    on_stop: Callable[[float, StaticSolution], None] | None = None,
) -> StaticSolution:
    """Find the equilibrium of a body, exactly incompressible unless the formulation says otherwise.

    Stationary point, with the virtual work of follower pressures, of

        Pi(u, p) = integral W(F) - p (J - 1) dX - s integral t . u dA + springs,    F = I + grad u,

    with Taylor-Hood elements (P2-P1 on simplices, Q2-Q1 on quadrilaterals and hexahedra), the load factor s
    going from 0 to 1 in steps that are halved where Newton's method fails and doubled where it is fast.

    Args:
        mesh: A ``SolidMesh``; two dimensions are plane strain.
        material: Isochoric energy W.
        fixed: Prescribed displacements, planes of symmetry, planes that may be touched.
        loads: Dead loads, follower pressures and forces on nodes; their ramps in time are ignored.
        tethers: Springs to the reference position; their damping is ignored.
        formulation: `TaylorHood`, `NearlyIncompressible`, `EqualOrder` or `SolidShell`.
        options: Load steps, tolerance, quadrature, linear solver.
        on_stop: ``on_stop(s, solution)`` is called at each of the ``options.stops``, on all ranks; the solution is
            good until it returns.

    Raises:
        CaseError: A tag is unknown or empty, a support or load names cells, or a fibre field cannot be used.
        ConvergenceError: The smallest load increment did not converge.

    Note:
        Collective.
    """
    body = Body(
        mesh=mesh,
        material=material,
        supports=fixed,
        loads=loads,
        tethers=tethers,
        quadrature_degree=options.quadrature_degree,
    )
    problem = (
        ShellProblem(body, formulation)
        if isinstance(formulation, SolidShell)
        else SOLVERS[options.solver](body, formulation)
    )
    absolute = 1e-13 * material.shear_modulus * body.size ** (mesh.dim - 1)
    problem.set_tolerances(options.relative_tolerance, absolute, options.max_iterations)
    steps: list[LoadStep] = []

    def solution() -> StaticSolution:
        displacement, pressure = problem.fields()
        if pressure is None:
            alone = cast("DisplacementFormulation", formulation)
            pressure = _project(alone.pressure(mesh, material, displacement), mesh)
        displacement.name, pressure.name = "displacement", "pressure"
        return StaticSolution(displacement=displacement, pressure=pressure, load_steps=tuple(steps))

    try:
        for factor in _follow_load(problem, options, steps):
            if on_stop is not None and factor in options.stops:
                on_stop(factor, solution())
    finally:
        problem.newton.destroy()
    return solution()


def _project(value: Expr, mesh: Mesh) -> fem.Function:
    """Project a scalar onto continuous functions of degree 1 (collective)."""
    space = fem.functionspace(mesh.mesh, ("Lagrange", 1))
    projected = fem.Function(space)
    residual = (projected - value) * ufl.TestFunction(space) * ufl.dx(domain=mesh.mesh, degree=4)
    newton = Newton(projected, residual, [])
    newton.solve()
    newton.destroy()
    return projected


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


def _follow_load(problem: Problem, options: SolverOptions, steps: list[LoadStep]) -> Iterator[float]:
    """Raise the load factor from 0 to 1 in steps that adapt to Newton's method; give each that is reached."""
    factor, increment = 0.0, options.first_increment
    while factor < 1:
        end = next((stop for stop in options.stops if stop > factor), 1.0)
        target = factor + increment
        if target > end - 1e-12:
            target = end
        problem.set_factor(target)
        converged, iterations = problem.solve()
        steps.append(LoadStep(target, iterations, converged))
        if converged:
            factor = target
            yield factor
            increment *= 2 if iterations <= options.max_iterations // 3 else 1
        else:
            increment = (target - factor) / 2
        if increment < options.smallest_increment:
            raise ConvergenceError(
                f"statics: no equilibrium beyond {factor:.4g} of the load, increments down to {increment:.2g}"
                " failed; check the supports, refine the mesh or lower the load"
            )
