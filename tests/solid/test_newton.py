"""Newton's method on a small problem."""

from __future__ import annotations

import gc
import weakref

import numpy as np

from valvefsi.runtime import dolfinx_compat  # noqa: F401

# isort: split
import ufl
from dolfinx import fem, mesh

from valvefsi.solid.newton import Newton


def problem(comm):
    """-u'' + u^3 = 8 on a square, u = 2 solves it; prescribed on the boundary."""
    domain = mesh.create_unit_square(comm, 4, 4)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v = fem.Function(space), ufl.TestFunction(space)
    residual = (ufl.inner(ufl.grad(u), ufl.grad(v)) + (u**3 - 8) * v) * ufl.dx(degree=4)
    domain.topology.create_connectivity(1, 2)
    dofs = fem.locate_dofs_topological(space, 1, mesh.exterior_facet_indices(domain.topology))
    value = fem.Function(space)
    value.x.array[:] = 2.0
    return u, Newton(u, residual, [fem.dirichletbc(value, dofs)])


def test_newton_finds_the_solution_with_its_prescribed_values(comm):
    u, newton = problem(comm)
    newton.set_tolerances(1e-12, 1e-14, 30)
    converged, iterations = newton.solve()
    assert converged
    assert 1 <= iterations < 15
    np.testing.assert_allclose(u.x.array, 2.0, rtol=1e-10)


def test_a_failed_solve_leaves_the_state_as_it_was(comm):
    u, newton = problem(comm)
    u.x.array[:] = 0.5
    newton.set_tolerances(1e-12, 1e-14, 1)
    converged, _ = newton.solve()
    assert not converged
    np.testing.assert_array_equal(u.x.array, 0.5)


def test_a_solver_that_nobody_holds_is_gone_and_its_mesh_with_it(comm):
    _, newton = problem(comm)
    newton.set_tolerances(1e-12, 1e-14, 30)
    newton.solve()
    held = weakref.ref(newton)
    del newton
    gc.collect()
    assert held() is None
