"""Orders of accuracy, divergence and rank invariance of the fluid step."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from tests.ordering import assert_order
from valvefsi.fluid.boundary import Boundary, Wall
from valvefsi.fluid.navier_stokes import ExplicitViscosity, NavierStokes, stable_fluid
from valvefsi.grid import MacGrid

PI = np.pi


def march(fluid, u, p, force, dt, steps):
    """Advance from t = 0 and return velocity and pressure."""
    N_old = fluid.advection(u)
    for n in range(steps):
        t = n * dt
        N = fluid.advection(u)
        f = force(t + 0.5 * dt) if force else fluid.grid.zero_faces()
        u, p = fluid.step(u, p, (N, N_old, 1.0), f, t, dt)
        N_old = N
    return u, p


def sample(grid, function, t):
    """Evaluate a velocity function on all faces, ghosts included."""
    return tuple(
        np.ascontiguousarray(np.broadcast_to(function(*grid.points(d), t)[d], grid.shape)).astype(float)
        for d in range(grid.dim)
    )


def largest_error(grid, u, exact, t):
    local = max(
        np.abs((a - b)[grid.owned_faces(d)]).max()
        for d, (a, b) in enumerate(zip(u, sample(grid, exact, t), strict=True))
    )
    return grid.comm.allreduce(local, op=MPI.MAX)


def largest_divergence(fluid, u):
    return fluid.grid.comm.allreduce(np.abs(fluid.divergence(u)[fluid.grid.owned]).max(), op=MPI.MAX)


def taylor_green(mu):
    def velocity(x, y, z, t):
        decay = np.exp(-8 * PI**2 * mu * t)
        return (
            1 + decay * np.sin(2 * PI * (x - t)) * np.cos(2 * PI * (y - t)),
            1 - decay * np.cos(2 * PI * (x - t)) * np.sin(2 * PI * (y - t)),
        )

    def pressure(x, y, z, t):
        return 0.25 * np.exp(-16 * PI**2 * mu * t) * (np.cos(4 * PI * (x - t)) + np.cos(4 * PI * (y - t)))

    return velocity, pressure


def beltrami(mu):
    """Travelling ABC vortex, an exact solution in three dimensions (Arnold 1965): the curl of w is 2 pi w."""
    k = 2 * PI

    def field(x, y, z):
        return (
            np.sin(k * z) + np.cos(k * y),
            np.sin(k * x) + np.cos(k * z),
            np.sin(k * y) + np.cos(k * x),
        )

    def velocity(x, y, z, t):
        decay = np.exp(-(k**2) * mu * t)
        return tuple(1 + decay * c for c in field(x - t, y - t, z - t))

    def pressure(x, y, z, t):
        w = field(x - t, y - t, z - t)
        return -0.5 * np.exp(-2 * k**2 * mu * t) * sum(c * c for c in w)

    return velocity, pressure


def run_vortex(dim, n, comm=MPI.COMM_WORLD, mu=0.01, t_end=0.2, quantity="u"):
    velocity, pressure = (taylor_green if dim == 2 else beltrami)(mu)
    grid = MacGrid([0] * dim, [1] * dim, [n] * dim, [True] * dim, comm)
    fluid = NavierStokes(grid, Boundary(grid), rho=1.0, mu=mu)
    steps = int(np.ceil(t_end * n / 0.5))
    dt = t_end / steps
    p = np.ascontiguousarray(np.broadcast_to(pressure(*grid.points(), -0.5 * dt), grid.shape))
    u, p = march(fluid, fluid.fill(sample(grid, velocity, 0.0), 0.0), p, None, dt, steps)
    assert largest_divergence(fluid, u) < 1e-11 * n
    if quantity == "u":
        return largest_error(grid, u, velocity, t_end)
    exact = np.broadcast_to(pressure(*grid.points(), t_end - 0.5 * dt), grid.shape)[grid.owned]
    gap = p[grid.owned] - exact
    mean = comm.allreduce(gap.sum()) / n**dim
    return comm.allreduce(np.abs(gap - mean).max(), op=MPI.MAX)


@pytest.mark.parametrize(("quantity", "below"), [("u", 2.6e-3), ("p", 4e-3)])
def test_taylor_green_vortex_converges_with_order_two(quantity, below):
    assert_order(lambda n: run_vortex(2, n, quantity=quantity), (32, 64, 128), order=1.95, below=below)


@pytest.mark.parametrize(("quantity", "below"), [("u", 2e-2), ("p", 4e-2)])
def test_travelling_abc_vortex_converges_with_order_two_in_three_dimensions(quantity, below):
    assert_order(lambda n: run_vortex(3, n, quantity=quantity), (12, 24, 48), order=1.9, below=below)


def manufactured(mu, dim=2):
    """Solenoidal velocity that moves on the walls, in tangential and normal direction, with its force."""
    a, w = PI, 3.0

    def velocity(x, y, z, t):
        c = np.cos(w * t)
        zero = 0.0 * z
        return (
            c * np.sin(a * x) * np.cos(a * y),
            -c * np.cos(a * x) * np.sin(a * y) + 0.3 * np.sin(w * t) * x**2,
            zero,
        )

    def force(x, y, z, t):
        c, s = np.cos(w * t), np.sin(w * t)
        sx, cx, sy, cy = np.sin(a * x), np.cos(a * x), np.sin(a * y), np.cos(a * y)
        u, v = c * sx * cy, -c * cx * sy + 0.3 * s * x**2
        u_x, u_y = a * c * cx * cy, -a * c * sx * sy
        v_x, v_y = a * c * sx * sy + 0.6 * s * x, -a * c * cx * cy
        u_t, v_t = -w * s * sx * cy, w * s * cx * sy + 0.3 * w * c * x**2
        p_x, p_y = 2 * c * np.cos(2 * x + y), c * np.cos(2 * x + y)
        lap_u, lap_v = -2 * a * a * c * sx * cy, 2 * a * a * c * cx * sy + 0.6 * s
        zero = 0.0 * x * y * z
        return (
            u_t + u * u_x + v * u_y + p_x - mu * lap_u + zero,
            v_t + u * v_x + v * v_y + p_y - mu * lap_v + zero,
            zero,
        )

    def pressure(x, y, z, t):
        return np.cos(w * t) * np.sin(2 * x + y) + 0.0 * z

    return velocity, force, pressure


def run_manufactured(n, dt, dim=2, t_end=0.5, mu=0.05):
    """Return grid, velocity and pressure at the end, and the end of the last step's first half."""
    velocity, force, pressure = manufactured(mu)
    lower, upper = (0.25, 0.1, 0.0)[:dim], (1.25, 1.1, 1.0)[:dim]
    grid = MacGrid(lower, upper, [n] * dim, [False] * dim)
    sides = [f"{axis}_{side}" for axis in "xyz"[:dim] for side in ("lower", "upper")]
    boundary = Boundary(grid, {side: Wall(velocity=velocity) for side in sides})
    fluid = NavierStokes(grid, boundary, rho=1.0, mu=mu)
    steps = max(2, round(t_end / dt))
    dt = t_end / steps
    p = np.ascontiguousarray(np.broadcast_to(pressure(*grid.points(), -0.5 * dt), grid.shape))
    u = fluid.fill(sample(grid, velocity, 0.0), 0.0)
    u, p = march(fluid, u, p, lambda t: sample(grid, force, t), dt, steps)
    return grid, u, p, t_end - 0.5 * dt


def manufactured_error(n, dt, **options):
    grid, u, *_ = run_manufactured(n, dt, **options)
    velocity = manufactured(0.05)[0]
    return largest_error(grid, u, velocity, 0.5)


def test_moving_walls_converge_with_order_two_in_space_and_time():
    assert_order(lambda n: manufactured_error(n, 0.4 / n), (16, 32, 64), order=1.9, below=1e-3)


def test_moving_walls_converge_with_order_two_in_three_dimensions():
    assert_order(lambda n: manufactured_error(n, 0.4 / n, dim=3), (8, 16, 32), order=1.8, below=4e-3)


def test_pressure_between_moving_walls_converges_with_order_two_in_the_mean():
    """In the root mean square; the largest error sits in the corners and is of first order."""

    def gap(n):
        grid, _, p, t = run_manufactured(n, 0.4 / n)
        exact = np.broadcast_to(manufactured(0.05)[2](*grid.points(), t), grid.shape)
        error = (p - exact)[grid.owned]
        mean = grid.comm.allreduce(error.sum()) / n**2
        return np.sqrt(grid.comm.allreduce(np.square(error - mean).sum()) / n**2)

    assert_order(gap, (16, 32, 64), order=1.88, below=9e-5)


def test_moving_walls_converge_with_order_two_in_time_alone():
    """Differences between runs at one grid and halved steps carry no error of the grid."""
    grid, finest, *_ = run_manufactured(32, 0.5 / 512)

    def gap(steps):
        u = run_manufactured(32, 0.5 / steps)[1]
        local = max(
            np.abs((a - b)[grid.owned_faces(d)]).max() for d, (a, b) in enumerate(zip(u, finest, strict=True))
        )
        return grid.comm.allreduce(local, op=MPI.MAX)

    assert_order(gap, (32, 64, 128), order=1.9, below=1e-3)


@pytest.mark.parametrize(
    "periodic", [(True, False, False), (False, True, False), (False, False, True), (True,) * 3]
)
@pytest.mark.parametrize("cells", [(9, 11, 13), (16, 7, 1)])
def test_divergence_is_round_off_after_a_step_for_every_pair_of_sides(periodic, cells):
    dim = 2 if cells[2] == 1 else 3
    grid = MacGrid([0] * dim, [c / 10 for c in cells[:dim]], cells[:dim], periodic[:dim])
    walls = {
        f"{axis}_upper": Wall(velocity=tuple(float(axis != other) for other in "xyz"))
        for axis, wraps in zip("xyz"[:dim], periodic, strict=False)
        if not wraps
    }
    fluid = NavierStokes(grid, Boundary(grid, walls), rho=1.3, mu=0.2)
    rng = np.random.default_rng(3)
    whole = [rng.standard_normal(grid.face_shape(d)) for d in range(dim)]
    f = grid.zero_faces()
    for d in range(dim):
        part = tuple(slice(s, s + n) for s, n in zip(grid.start, grid.size, strict=True))
        f[d][grid.owned] = whole[d][part]
    u = fluid.fill(grid.zero_faces(), 0.0)
    u, _ = march(fluid, u, grid.zeros(), lambda t: f, 0.01, 3)
    speed = grid.comm.allreduce(max(np.abs(c[grid.owned]).max() for c in u), op=MPI.MAX)
    assert speed > 1e-2
    assert largest_divergence(fluid, u) < 1e-11


def test_the_answer_does_not_depend_on_the_number_of_ranks(comm):
    alone = run_vortex(3, 12, MPI.COMM_SELF)
    assert abs(alone - run_vortex(3, 12, comm)) < 1e-13


@pytest.mark.parametrize(("part", "kind"), [(0.49, ExplicitViscosity), (0.51, NavierStokes)])
def test_viscosity_is_explicit_up_to_half_of_the_step_that_it_allows(comm, part, kind):
    grid = MacGrid([0.0, 0.0], [1.0, 2.0], [10, 10], [True, True], comm)
    limit = 1.3 / (0.2 * (4.0 / 0.1**2 + 4.0 / 0.2**2))
    fluid = stable_fluid(grid, Boundary(grid), part * limit, rho=1.3, mu=0.2, advection="xsppm7")
    assert type(fluid) is kind
    assert fluid.rho == 1.3
