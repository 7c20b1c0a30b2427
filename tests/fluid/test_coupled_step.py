"""The coupled step: what its solution must satisfy, its iterations, and what it shares with the projection."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from tests.fluid.test_sides import Manufactured, relative_error, square
from tests.ordering import assert_order
from valvefsi.errors import ConvergenceError
from valvefsi.fluid.boundary import Boundary, Disk, FreeSlip, Mixed, Open, Wall
from valvefsi.fluid.krylov import CoupledNavierStokes
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.grid import MacGrid

WORLD = MPI.COMM_WORLD
MU, RHO = 0.05, 1.2


def moving(x, y, z, t):
    return (1.0 + t) * np.sin(2.0 * np.pi * x) + 0.0 * z, 0.0 * x, 0.0 * x


def disk(pressure):
    return Mixed(open=Open(pressure=pressure), where=Disk(centre=(0.5, 0.5, 0.5), radius=0.3))


SIDES = {
    "walls": {"y_upper": Wall(velocity=moving)},
    "open": {"x_lower": Open(pressure=3.0), "x_upper": Open(), "y_lower": FreeSlip()},
    "mixed": {"x_lower": disk(3.0), "x_upper": disk(0.0), "y_upper": Wall(velocity=moving)},
}


def make(kind, dim, cls=CoupledNavierStokes, *, comm=WORLD, periodic=False, **options):
    n = (17, 14) if dim == 2 else (11, 12, 9)
    grid = MacGrid([0] * dim, [1] * dim, n, [periodic] * dim, comm)
    sides = {} if periodic else SIDES[kind]
    return grid, cls(grid, Boundary(grid, sides), rho=RHO, mu=MU, **options)


def field(grid, seed):
    """Random numbers on all local entries that do not depend on the number of ranks."""
    whole = np.random.default_rng(seed).standard_normal(
        [n + 2 * g for n, g in zip(grid.cells, grid.ghosts, strict=True)]
    )
    return whole[tuple(slice(s, s + n) for s, n in zip(grid.start, grid.shape, strict=True))].copy()


def one_step(grid, fluid, dt, *, rough=0.1):
    """A step from a solenoidal field with random advection terms and forces, and what went into it."""
    start = fluid.fill(tuple(rough * field(grid, d) for d in range(grid.dim)), 0.0)
    zero = grid.zero_faces()
    projection = NavierStokes(grid, fluid.boundary, rho=RHO, mu=MU)
    u, p = projection.step(start, grid.zeros(), (zero, zero, 1.0), zero, 0.0, dt)
    N, N_old, f = (tuple(rough * field(grid, 10 * k + d) for d in range(grid.dim)) for k in (1, 2, 3))
    given = (u, p, (N, N_old, 0.8), f, dt, dt)
    return given, fluid.step(u, p.copy(), *given[2:])


def laplacian(q, spacing):
    return sum(
        (np.roll(q, 1, axis) - 2.0 * q + np.roll(q, -1, axis)) / h**2 for axis, h in enumerate(spacing)
    )


def norm(grid, parts):
    return np.sqrt(grid.comm.allreduce(sum(float(np.square(part).sum()) for part in parts)))


@pytest.mark.parametrize("viscous", [0.2, 4.0])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("kind", list(SIDES))
def test_a_coupled_step_solves_momentum_and_continuity_within_fifteen_iterations(kind, dim, viscous):
    grid, fluid = make(kind, dim)
    dt = viscous * RHO / MU * float(min(grid.spacing[:dim])) ** 2
    (u, _, (N, N_old, ratio), f, t, _), (u_new, p_new) = one_step(grid, fluid, dt)
    assert 1 <= fluid.iterations <= 15
    p_new = p_new.copy()
    fluid.boundary.fill_pressure(p_new, u, RHO, t + 0.5 * dt)
    left, sizes, unknowns = [], [], 0
    for d in range(dim):
        term = (1.0 + 0.5 * ratio) * N[d] - 0.5 * ratio * N_old[d]
        gradient = (p_new - np.roll(p_new, 1, d)) / grid.spacing[d]
        inertia = RHO * ((u_new[d] - u[d]) / dt + term)
        viscosity = 0.5 * MU * laplacian(u[d] + u_new[d], grid.spacing[:dim])
        free = fluid.unknowns[d]
        unknowns += int(free.sum())
        left.append((inertia + gradient - viscosity - f[d])[free])
        sizes.append((RHO / dt * u_new[d])[free])
    assert norm(grid, left) < 1e-9 * norm(grid, sizes)
    assert grid.comm.allreduce(np.abs(fluid.divergence(u_new)[grid.owned]).max(), op=MPI.MAX) < 1e-11
    # Every face inside is an unknown, and those of open sides and disks.
    inside = sum(np.prod(grid.cells) // n * (n - 1) for n in grid.cells[:dim])
    tangential = grid.cells[1] * grid.cells[2]
    on_sides = {"walls": 0, "open": 2 * tangential}.get(kind)
    if on_sides is None:
        on_sides = sum(int(place.mask.sum()) for place in fluid.boundary.mixed)
    assert grid.comm.allreduce(unknowns) == inside + on_sides


@pytest.mark.parametrize("kind", list(SIDES))
def test_a_coupled_step_forgets_the_pressure_before(kind):
    """No part of its equations holds the old pressure, unlike those of one projection."""
    results = {}
    for cls in (CoupledNavierStokes, NavierStokes):
        grid, fluid = make(kind, 2, cls)
        zero, dt = grid.zero_faces(), 0.02
        f = tuple(field(grid, d) for d in range(2))
        runs = []
        for p in (grid.zeros(), 0.5 * field(grid, 5)):
            grid.exchange((p,))
            u, p = fluid.step(fluid.fill(grid.zero_faces(), 0.0), p, (zero, zero, 1.0), f, 0.0, dt)
            runs.append([*(c[grid.owned] for c in u), p[grid.owned]])
        one, two = runs
        mean = grid.comm.allreduce(float((two[-1] - one[-1]).sum())) / np.prod(grid.cells)
        one[-1] = one[-1] + (
            mean if kind == "walls" else 0.0
        )  # walls alone leave the mean of the pressure open
        results[cls] = norm(grid, [a - b for a, b in zip(one, two, strict=True)]) / norm(grid, one)
    assert results[CoupledNavierStokes] < 1e-8
    assert results[NavierStokes] > 1e-4


@pytest.mark.parametrize("dim", [2, 3])
def test_without_sides_the_projection_is_the_coupled_solve(dim):
    grid, fluid = make("", dim, periodic=True)
    given, (u, p) = one_step(grid, fluid, 0.05)
    assert fluid.iterations == 1
    other = NavierStokes(grid, fluid.boundary, rho=RHO, mu=MU)
    u_other, p_other = other.step(given[0], given[1].copy(), *given[2:])
    for a, b in zip((*u, p), (*u_other, p_other), strict=True):
        np.testing.assert_allclose(a[grid.owned], b[grid.owned], atol=1e-10)


@pytest.mark.parametrize("sides", [(("wall",) * 2,) * 2, (("wall", "open"), ("slip", "wall"))])
def test_a_coupled_step_keeps_the_second_order(sides):
    problem = Manufactured(sides, mu=0.05)
    assert_order(
        lambda n: relative_error(problem, square(n, sides), 0.16 / n, cls=CoupledNavierStokes),
        (12, 24, 48),
        order=1.8,
        below=6e-3,
    )


def test_a_coupled_step_on_a_graded_grid_is_solved_too():
    edges = np.concatenate([[0.0], np.cumsum(1.05 ** np.abs(np.arange(16) - 8.0))])
    grid = MacGrid.graded([edges / edges[-1]] * 2, [False, False])
    fluid = CoupledNavierStokes(grid, Boundary(grid, SIDES["mixed"]), rho=RHO, mu=MU)
    _, (u, _) = one_step(grid, fluid, 0.02)
    assert fluid.iterations <= 15
    assert grid.comm.allreduce(np.abs(fluid.divergence(u)[grid.owned]).max(), op=MPI.MAX) < 1e-11


def test_the_velocity_is_solenoidal_to_round_off_however_loose_the_tolerance():
    """With walls that begin to push the fluid through the box, which a loose solve alone does not follow."""
    grid = MacGrid([0, 0], [1, 1], [12, 12], [False, False])
    push = dict.fromkeys(("x_lower", "x_upper"), Wall(velocity=lambda x, y, z, t: (t + 0 * y, 0.0)))
    fluid = CoupledNavierStokes(grid, Boundary(grid, push), rho=RHO, mu=MU, tolerance=1e-2)
    zero = grid.zero_faces()
    u, _ = fluid.step(grid.zero_faces(), grid.zeros(), (zero, zero, 1.0), zero, 0.0, 0.1)
    assert 1 <= fluid.iterations < 5
    assert grid.comm.allreduce(np.abs(fluid.divergence(u)[grid.owned]).max(), op=MPI.MAX) < 1e-13


def test_a_net_flow_through_walls_is_a_uniform_divergence_as_after_a_projection():
    grid = MacGrid([0, 0], [1, 1], [12, 12], [False, False])
    fluid = CoupledNavierStokes(grid, Boundary(grid, {"y_upper": Wall(velocity=(0.0, 0.1))}), rho=RHO, mu=MU)
    zero = grid.zero_faces()
    u, _ = fluid.step(fluid.fill(grid.zero_faces(), 0.0), grid.zeros(), (zero, zero, 1.0), zero, 0.0, 0.02)
    np.testing.assert_allclose(fluid.divergence(u)[grid.owned], 0.1, rtol=1e-10)


def test_a_steady_flow_stays_and_its_round_off_is_not_iterated_upon():
    grid = MacGrid([0, 0], [1, 1], [12, 12], [False, False])
    fluid = CoupledNavierStokes(grid, Boundary(grid, {"y_upper": Wall(velocity=(1.0, 0.0))}), rho=RHO, mu=MU)
    zero, dt = grid.zero_faces(), 0.25
    u, p = fluid.fill(grid.zero_faces(), 0.0), grid.zeros()
    iterations = []
    for k in range(160):
        u_old = u
        u, p = fluid.step(u, p, (zero, zero, 1.0), zero, k * dt, dt)
        iterations.append(fluid.iterations)
    gap = max(np.abs(a - b).max() for a, b in zip(u, u_old, strict=True))
    assert grid.comm.allreduce(gap, op=MPI.MAX) < 1e-13
    assert iterations[0] > 3
    assert iterations[-1] == 0


def test_a_fluid_at_rest_stays_at_rest_in_no_iteration():
    grid = MacGrid([0, 0], [1, 1], [12, 12], [False, False])
    fluid = CoupledNavierStokes(grid, Boundary(grid), rho=RHO, mu=MU)
    zero = grid.zero_faces()
    u, p = fluid.step(grid.zero_faces(), grid.zeros(), (zero, zero, 1.0), zero, 0.0, 0.1)
    assert fluid.iterations == 0
    assert all(np.all(a == 0.0) for a in (*u, p))


@pytest.mark.skipif(WORLD.size == 1, reason="needs two ranks")
@pytest.mark.parametrize("kind", list(SIDES))
def test_a_coupled_step_does_not_see_the_number_of_ranks(kind):
    runs = []
    for comm in (WORLD, MPI.COMM_SELF):
        grid, fluid = make(kind, 3, comm=comm)
        _, (u, p) = one_step(grid, fluid, 0.02)
        runs.append((grid, [a[grid.owned] for a in (*u, p)]))
    (grid, ours), (_, alone) = runs
    own = tuple(slice(s, s + n) for s, n in zip(grid.start, grid.size, strict=True))
    for a, b in zip(ours, alone, strict=True):
        np.testing.assert_allclose(a, b[own], atol=1e-8 * np.abs(b).max())


def test_a_solve_that_does_not_converge_is_an_error_that_says_when():
    grid, fluid = make("walls", 2, max_iterations=2)
    with pytest.raises(ConvergenceError, match=r"at t = 0\.04 s: .* after 2 iterations"):
        one_step(grid, fluid, 0.02)


def test_a_tolerance_that_cannot_be_is_refused():
    with pytest.raises(ValueError, match=r"0 < tolerance < 1.* got 1\.0"):
        make("walls", 2, tolerance=1.0)
