"""Walls, free slip, open and mixed sides: orders for every pair of them, exact flows, mass balance."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from mpi4py import MPI

from tests.ordering import assert_order
from valvefsi.fluid.boundary import Boundary, Disk, FreeSlip, Mixed, Open, Wall
from valvefsi.fluid.navier_stokes import ExplicitViscosity, NavierStokes
from valvefsi.grid import MacGrid

WORLD = MPI.COMM_WORLD
TYPES = ("wall", "slip", "open")
PHASE = {"slip": 0.0, "open": 0.5 * np.pi, "wall": 0.3, "periodic": 0.2}
W = 3.0


class Manufactured:
    """Stream function g(t) X(x) Y(y), X = sin(a x + b): X = 0 on sides with free slip, X' = 0 on open ones."""

    def __init__(self, sides, mu):
        self.sides, self.mu = sides, mu
        self.waves = [self.wave(*sides[axis]) for axis in (0, 1)]

    @staticmethod
    def wave(lower, upper):
        if lower == "periodic":
            return 2.0 * np.pi, PHASE["periodic"]
        # The phase at either end is the one that its side wants, up to a multiple of pi.
        return PHASE[upper] - PHASE[lower] + np.pi, PHASE[lower]

    def factors(self, x, axis):
        a, b = self.waves[axis]
        s, c = np.sin(a * x + b), np.cos(a * x + b)
        return s, a * c, -a * a * s, -(a**3) * c

    def velocity(self, x, y, z, t):
        X, X1, *_ = self.factors(x, 0)
        Y, Y1, *_ = self.factors(y, 1)
        g = np.cos(W * t)
        return g * X * Y1, -g * X1 * Y, 0.0 * z

    def pressure(self, x, y, z, t):
        return np.cos(W * t) * np.sin(2 * np.pi * (x + 0.1)) * np.cos(2 * np.pi * y) + 0.0 * z

    def force(self, x, y, z, t):
        X, X1, X2, X3 = self.factors(x, 0)
        Y, Y1, Y2, Y3 = self.factors(y, 1)
        g, g1 = np.cos(W * t), -W * np.sin(W * t)
        u, v = g * X * Y1, -g * X1 * Y
        u_x, u_y, v_x, v_y = g * X1 * Y1, g * X * Y2, -g * X2 * Y, -g * X1 * Y1
        lap_u, lap_v = g * (X2 * Y1 + X * Y3), -g * (X3 * Y + X1 * Y2)
        a = 2 * np.pi
        p_x = g * a * np.cos(a * (x + 0.1)) * np.cos(a * y)
        p_y = -g * a * np.sin(a * (x + 0.1)) * np.sin(a * y)
        return (
            g1 * X * Y1 + u * u_x + v * u_y + p_x - self.mu * lap_u + 0.0 * z,
            -g1 * X1 * Y + u * v_x + v * v_y + p_y - self.mu * lap_v + 0.0 * z,
            0.0 * z,
        )

    def side(self, kind):
        return {
            "wall": Wall(velocity=self.velocity),
            "slip": FreeSlip(),
            "open": Open(pressure=self.pressure, backflow=0.0),
        }[kind]

    def fluid(self, grid, cls=NavierStokes, **options):
        sides = {
            f"{'xy'[axis]}_{end}": self.side(kind)
            for axis in (0, 1)
            for end, kind in zip(("lower", "upper"), self.sides[axis], strict=True)
            if kind != "periodic"
        }
        return cls(grid, Boundary(grid, sides), rho=1.0, mu=self.mu, **options)


def sample(grid, function, t):
    return tuple(function(*grid.points(d), t)[d] + grid.zeros() for d in range(grid.dim))


def march(fluid, u, p, force, dt, steps, **options):
    """Steps of one length from t = 0."""
    u = fluid.fill(u, 0.0)
    N_old = fluid.advection(u)
    for k in range(steps):
        N = fluid.advection(u)
        u, p = fluid.step(u, p, (N, N_old, 1.0), force((k + 0.5) * dt), k * dt, dt, **options)
        N_old = N
    return u, p


def run(problem, grid, dt, t_end=0.15, **options):
    steps = max(2, round(t_end / dt))
    dt = t_end / steps
    fluid = problem.fluid(grid, **options)
    p = problem.pressure(*grid.points(), -0.5 * dt) + grid.zeros()
    u, p = march(
        fluid, sample(grid, problem.velocity, 0.0), p, lambda t: sample(grid, problem.force, t), dt, steps
    )
    return fluid, u, p, steps * dt


def relative_error(problem, grid, dt, **options):
    fluid, u, _, t = run(problem, grid, dt, **options)
    exact = sample(grid, problem.velocity, t)
    own = [grid.owned_faces(d) for d in range(grid.dim)]
    gap = max(np.abs(a[o] - b[o]).max() for a, b, o in zip(u, exact, own, strict=True))
    if any(
        "open" in pair for pair in problem.sides
    ):  # else the flow through moving walls need not sum up to zero
        assert WORLD.allreduce(np.abs(fluid.divergence(u)[grid.owned]).max(), op=MPI.MAX) < 1e-10
    speed = max(np.abs(c[o]).max() for c, o in zip(exact, own, strict=True))
    return WORLD.allreduce(gap, op=MPI.MAX) / WORLD.allreduce(speed, op=MPI.MAX)


def square(n, sides):
    return MacGrid([0, 0], [1, 1], [n, n], [sides[axis][0] == "periodic" for axis in (0, 1)])


PAIRS = [((a, b), (b, a)) for a, b in itertools.combinations_with_replacement(TYPES, 2)]
PAIRS += [(("periodic",) * 2, (a, b)) for a, b in itertools.product(TYPES, TYPES)]


@pytest.mark.parametrize("sides", PAIRS, ids=lambda s: "-".join((*s[0], *s[1])))
def test_every_pair_of_sides_facing_or_in_a_corner_keeps_the_second_order(sides):
    problem = Manufactured(sides, mu=0.05)
    assert_order(
        lambda n: relative_error(problem, square(n, sides), 0.08 / n), (12, 24, 48), order=1.8, below=6e-3
    )


@pytest.mark.parametrize(
    "sides", [(("wall", "open"), ("slip", "wall")), (("periodic",) * 2, ("open", "slip"))]
)
def test_explicit_viscosity_keeps_the_second_order(sides):
    problem = Manufactured(sides, mu=0.02)

    def error(n):
        dt = 1.5 / n**2
        grid = square(n, sides)
        fluid = problem.fluid(grid, ExplicitViscosity)
        assert dt < fluid.dt_limit
        return relative_error(problem, grid, dt, cls=ExplicitViscosity)

    assert_order(error, (12, 24, 48), order=1.8, below=6e-3)


def test_the_limit_of_explicit_viscosity_is_where_it_blows_up():
    """Just below, a field of the highest frequency decays; just above, it grows."""
    grid = MacGrid([0, 0], [1, 1], [8, 8], [True, True])
    fluid = ExplicitViscosity(grid, Boundary(grid), rho=2.0, mu=0.1)
    assert fluid.dt_limit == pytest.approx(2.0 / 0.1 / (8 * 64))
    sizes = {}
    for factor in (0.98, 1.02):
        x, y, _ = grid.points(0)
        u = (
            1e-6 * np.cos(8 * np.pi * x) * np.cos(8 * np.pi * (y - 1 / 16)) + 0.0 * grid.zeros(),
            grid.zeros(),
        )
        u = (u[0], 1e-6 * np.cos(8 * np.pi * (x - 1 / 16)) * np.cos(8 * np.pi * y) + grid.zeros())
        start = sum(float(np.abs(c[grid.owned]).max()) for c in u)
        u, _ = march(fluid, u, grid.zeros(), lambda _: grid.zero_faces(), factor * fluid.dt_limit, 200)
        sizes[factor] = WORLD.allreduce(
            sum(float(np.abs(c[grid.owned]).max()) for c in u) / start, op=MPI.MAX
        )
    assert sizes[0.98] < 0.1
    assert sizes[1.02] > 1.0


def channel(dim, n, cls=NavierStokes, *, length=2.0):
    """Flow between two open sides along x, walls across; pressures 8 and 0."""
    cells = (2 * n, n) if dim == 2 else (n, n, n)
    grid = MacGrid([0] * dim, [length, 1, 1][:dim], cells, [False] * dim)
    sides = {"x_lower": Open(pressure=8.0, backflow=0.0), "x_upper": Open(pressure=0.0, backflow=0.0)}
    return grid, cls(grid, Boundary(grid, sides), rho=1.0, mu=0.5)


def duct(y, z, G, mu, terms=60):
    """Velocity in a square duct of edge 1 under the pressure gradient G (series of White, Viscous Fluid Flow)."""
    u = 0.0
    for k in range(1, 2 * terms, 2):
        shape = np.cosh(k * np.pi * (z - 0.5)) / np.cosh(0.5 * k * np.pi)
        u = u + 4 * G / (mu * np.pi**3 * k**3) * (1 - shape) * np.sin(k * np.pi * y)
    return u


@pytest.mark.parametrize("dim", [2, 3])
def test_poiseuille_flow_between_open_sides(dim):
    """The profile of the closed form; in the plane the discrete parabola to the tolerance of coming to rest."""

    def error(n):
        grid, fluid = channel(dim, n)
        u, p = march(fluid, grid.zero_faces(), grid.zeros(), lambda _: grid.zero_faces(), 0.05, 130)
        _, y, z = grid.points(0)
        exact = 4.0 / (2 * 0.5) * y * (1 - y) if dim == 2 else duct(y, z, 4.0, 0.5)
        own = grid.owned_faces(0)
        if dim == 2:  # the wall half a cell off shifts the discrete parabola by G h^2 / (8 mu)
            exact = exact + 4.0 / (8 * 0.5) / n**2
            pressure = np.broadcast_to(8.0 - 4.0 * (grid.points()[0]), grid.shape)
            assert WORLD.allreduce(np.abs(p - pressure)[grid.owned].max(), op=MPI.MAX) < 1e-8
        gap = np.abs(u[0] - np.broadcast_to(exact, grid.shape))[own].max()
        return WORLD.allreduce(gap, op=MPI.MAX)

    if dim == 2:
        assert error(8) < 1e-8
    else:
        assert_order(error, (8, 16), order=1.8, below=0.02)


def test_a_mode_between_open_ends_decays_as_its_closed_form():
    """u = sin(pi y) exp(-mu pi^2 t) along x, p = 0 on both open ends."""

    def error(n):
        grid = MacGrid([0, 0], [1, 1], [n, n], [False, False])
        ends = {"x_lower": Open(backflow=0.0), "x_upper": Open(backflow=0.0)}
        fluid = NavierStokes(grid, Boundary(grid, ends), rho=1.0, mu=0.1)
        u = (np.sin(np.pi * grid.points(0)[1]) + grid.zeros(), grid.zeros())
        steps = 4 * n
        u, _ = march(fluid, u, grid.zeros(), lambda _: grid.zero_faces(), 1.0 / steps, steps)
        exact = np.sin(np.pi * grid.points(0)[1]) * np.exp(-0.1 * np.pi**2) + grid.zeros()
        return WORLD.allreduce(np.abs(u[0] - exact)[grid.owned_faces(0)].max(), op=MPI.MAX)

    assert_order(error, (8, 16, 32), order=1.9, below=1e-3)


def test_pressure_on_an_open_side_is_lowered_by_what_flows_in_and_only_there():
    grid = MacGrid([0, 0], [1, 1], [8, 8], [False, True])
    boundary = Boundary(grid, {"x_lower": Open(pressure=3.0, backflow=0.5), "x_upper": Open(pressure=1.0)})
    u, p = grid.zero_faces(), grid.zeros() + 5.0
    u[0][...] = 2.0
    boundary.fill_pressure(p, u, 1.5, 0.0)
    g = grid.ghosts[0]
    if grid.is_first[0]:
        np.testing.assert_allclose(0.5 * (p[g - 1] + p[g]), 3.0 - 0.5 * 0.5 * 1.5 * 4.0)
    if grid.is_last[0]:
        np.testing.assert_allclose(0.5 * (p[g + grid.size[0] - 1] + p[g + grid.size[0]]), 1.0)
    assert boundary.outflow(u, "x_upper") == pytest.approx(2.0)
    assert boundary.outflow(u, "x_lower") == pytest.approx(-2.0)


def test_a_mean_pressure_takes_from_fast_streams_what_it_gives_to_slow_ones():
    """Inflow 2 over a quarter of a side and outflow over the rest, on a graded grid: p - rho/2 u^2 + its mean."""
    edges = np.concatenate([np.linspace(0.0, 0.25, 5), np.linspace(0.25, 1.0, 7)[1:]])
    grid = MacGrid.graded([np.linspace(0.0, 1.0, 9), edges], [False, False])
    sides = {
        "x_lower": Open(pressure=3.0, mean_pressure=True),
        "x_upper": Open(pressure=1.0, mean_pressure=True),
    }
    boundary = Boundary(grid, sides)
    u, p = grid.zero_faces(), grid.zeros() + 5.0
    u[0][...] = np.where(grid.points(0)[1] < 0.25, 2.0, -0.5)
    boundary.fill_pressure(p, u, 1.5, 0.0)
    g, own = grid.ghosts[0], grid.owned[1]
    lost = 0.5 * 1.5 * 4.0 * (grid.points()[1][0, own, 0] < 0.25)
    if grid.is_first[0]:
        np.testing.assert_allclose((0.5 * (p[g - 1] + p[g]))[own, 0], 3.0 - lost + 0.25 * 3.0)
    lost = 0.5 * 1.5 * 0.25 * (grid.points()[1][0, own, 0] > 0.25)
    if grid.is_last[0]:
        at = g + grid.size[0]
        np.testing.assert_allclose((0.5 * (p[at - 1] + p[at]))[own, 0], 1.0 - lost + 0.75 * 0.1875)


def test_an_even_inflow_feels_the_mean_pressure_itself():
    grid = MacGrid([0, 0], [1, 1], [8, 8], [False, True])

    def speed(**options):
        ends = {"x_lower": Open(pressure=8.0, **options), "x_upper": Open(backflow=0.0)}
        fluid = NavierStokes(grid, Boundary(grid, ends), rho=2.0, mu=0.1)
        u, p = fluid.fill((1.0 + grid.zeros(), grid.zeros()), 0.0), grid.zeros()
        N = fluid.advection(u)
        for k in range(20):
            u, p = fluid.step(u, p, (N, N, 1.0), grid.zero_faces(), 0.01 * k, 0.01)
        return u[0][grid.owned]

    np.testing.assert_allclose(speed(mean_pressure=True), 1.0 + 8.0 / 2.0 * 0.2, rtol=1e-10)
    assert np.all(speed() < 1.75)


def energy_of_a_vortex_leaving(backflow, mean=False):
    """Kinetic energy at t = 0.5 of a vortex between two open sides; infinite where it has grown a hundredfold."""
    n, t, k, last = 32, 0.0, 0, None
    grid = MacGrid([0, 0], [1, 1], [n, n], [False, False])
    ends = {end: Open(backflow=backflow, mean_pressure=mean) for end in ("x_lower", "x_upper")}
    fluid = NavierStokes(grid, Boundary(grid, ends), rho=1.0, mu=1e-3)
    u = tuple(5.0 * np.sin(2 * np.pi * grid.points(d)[1 - d]) + grid.zeros() for d in (0, 1))
    u, p = fluid.fill(u, 0.0), grid.zeros()
    N_old = fluid.advection(u)
    while t < 0.5:
        speed, energy = (
            WORLD.allreduce(max(np.abs(c[grid.owned]).max() for c in u), op=MPI.MAX),
            WORLD.allreduce(sum(float(np.square(c[grid.owned]).sum()) for c in u)) / n**2,
        )
        if not energy < 2500.0:
            return np.inf
        dt, N = 0.2 / n / speed, fluid.advection(u)
        u, p = fluid.step(u, p, (N, N_old, dt / (last or dt)), grid.zero_faces(), t, dt)
        N_old, last, t, k = N, dt, t + dt, k + 1
    return energy


def test_backflow_stabilisation_keeps_a_flow_that_blows_up_without_it():
    assert energy_of_a_vortex_leaving(0.0) == np.inf
    assert energy_of_a_vortex_leaving(1.0) < 25.0
    assert energy_of_a_vortex_leaving(1.0, mean=True) < 25.0


@pytest.mark.parametrize(
    ("sides", "message"),
    [
        ({"x_lower": Open()}, "x_lower is periodic"),
        ({"w_lower": Open()}, "unknown side 'w_lower'"),
        (
            {"y_lower": Mixed(open=Open(), where=Disk(centre=(9, 9, 9), radius=0.1))},
            "no face of side y_lower is open",
        ),
    ],
)
def test_sides_that_cannot_be_are_refused(sides, message):
    grid = MacGrid([0, 0, 0], [1, 1, 1], [8, 8, 8], [True, False, False])
    with pytest.raises(ValueError, match=message):
        Boundary(grid, sides)


def test_a_pressure_that_changes_in_time_leaves_no_layer_at_its_side():
    """Between walls at rest the flow that an oscillating pressure drives is the same all along the channel."""
    grid = MacGrid([0, 0], [2, 1], [8, 8], [False, False])
    ends = {
        "x_lower": Open(pressure=lambda x, y, z, t: 2.0 * np.cos(5.0 * t), backflow=0.0),
        "x_upper": Open(backflow=0.0),
    }
    fluid = NavierStokes(grid, Boundary(grid, ends), rho=1.0, mu=0.5)
    u, _ = march(fluid, grid.zero_faces(), grid.zeros(), lambda _: grid.zero_faces(), 0.01, 60)
    own = grid.owned_faces(0)
    everywhere = WORLD.allgather(u[0][own])
    along = np.concatenate(everywhere, axis=0)
    assert np.abs(along).max() > 0.05
    assert np.ptp(along, axis=0).max() < 1e-11
    assert WORLD.allreduce(np.abs(u[1][grid.owned_faces(1)]).max(), op=MPI.MAX) < 1e-11
