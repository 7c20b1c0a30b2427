"""The xsPPM7 reconstruction: order, monotone layers, underresolved shear, agreement of ranks."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from tests.fluid.test_navier_stokes import largest_error, sample, taylor_green
from tests.ordering import assert_order
from valvefsi.fluid.advection import SCHEMES, edge
from valvefsi.fluid.boundary import Boundary, Wall
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.grid import MacGrid
from valvefsi.post import diagnostics

WORLD = MPI.COMM_WORLD


def march(fluid, u, p, dt, steps):
    N_old = fluid.advection(u)
    for k in range(steps):
        N = fluid.advection(u)
        u, p = fluid.step(u, p, (N, N_old, 1.0), fluid.grid.zero_faces(), k * dt, dt)
        N_old = N
    return u, p


def vortex_error(n, scheme, cfl=0.1, t_end=0.25, mu=1e-4):
    velocity, pressure = taylor_green(mu)
    grid = MacGrid([0, 0], [1, 1], [n, n], [True, True])
    fluid = NavierStokes(grid, Boundary(grid), rho=1.0, mu=mu, advection=scheme)
    steps = int(np.ceil(t_end * n / cfl))
    dt = t_end / steps
    p = np.ascontiguousarray(np.broadcast_to(pressure(*grid.points(), -0.5 * dt), grid.shape))
    u, _ = march(fluid, fluid.fill(sample(grid, velocity, 0.0), 0.0), p, dt, steps)
    return largest_error(grid, u, velocity, t_end)


def test_xsppm7_is_second_order_on_an_advected_vortex():
    assert_order(lambda n: vortex_error(n, "xsppm7"), (32, 64, 128), order=1.9, below=1e-4)


def test_xsppm7_is_three_times_as_accurate_as_centred_on_an_advected_vortex():
    assert vortex_error(64, "xsppm7") < vortex_error(64, "centred") / 3.0


@pytest.mark.parametrize("power", range(7))
def test_the_edge_value_is_exact_for_the_cell_means_of_polynomials_that_rise(power):
    """Means of x^p over unit cells around 10: monotone, so that no limiter is at work."""
    left = np.arange(10.0 - 3, 10.0 + 4)
    means = ((left + 1) ** (power + 1) - left ** (power + 1)) / (power + 1)
    assert edge(*means) == pytest.approx(11.0**power, rel=1e-12)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_layer_of_one_cell_is_carried_without_overshoot(sign):
    """v is a step in x and u = +-1: v is carried like a scalar, without viscosity."""

    def overshoot(scheme):
        n = 64
        grid = MacGrid([0, 0], [1, 0.25], [n, n // 4], [True, True])
        fluid = NavierStokes(grid, Boundary(grid), rho=1.0, mu=0.0, advection=scheme)
        x = grid.points(1)[0] % 1.0
        u = grid.zero_faces()
        u[0][...] = sign
        u[1][...] = (x > 0.25) & (x < 0.75)
        dt = 0.1 / n
        u, _ = march(fluid, u, grid.zeros(), dt, 320)
        v = u[1][grid.owned]
        return WORLD.allreduce(max(v.max() - 1.0, -v.min()), op=MPI.MAX)

    assert overshoot("xsppm7") < 0.02
    assert overshoot("centred") > 0.2


def test_vorticity_of_an_underresolved_double_shear_layer_obeys_its_maximum_principle():
    """Layers of 1/80 on 64 x 64 cells at Re 10,000: no new extremum of the vorticity, the energy only decays."""
    n, dt = 64, 0.1 / 64

    def run(scheme):
        grid = MacGrid([0, 0], [1, 1], [n, n], [True, True])
        fluid = NavierStokes(grid, Boundary(grid), rho=1.0, mu=1e-4, advection=scheme)
        y, x = grid.points(0)[1] % 1.0, grid.points(1)[0]
        u, p = grid.zero_faces(), grid.zeros()
        u[0][...] = np.where(y < 0.5, np.tanh(80 * (y - 0.25)), np.tanh(80 * (0.75 - y)))
        u[1][...] = 0.05 * np.sin(2 * np.pi * x)
        energy, largest = [diagnostics.kinetic_energy(grid, u, 1.0)], []
        for _ in range(3):
            u, p = march(fluid, u, p, dt, round(0.4 / dt))
            vorticity = n * (u[1] - np.roll(u[1], 1, 0) - u[0] + np.roll(u[0], 1, 1))[grid.owned]
            largest.append(WORLD.allreduce(np.abs(vorticity).max(), op=MPI.MAX))
            energy.append(diagnostics.kinetic_energy(grid, u, 1.0))
        return np.array(energy), max(largest)

    energy, largest = run("xsppm7")
    assert largest < 80.0
    assert np.all(np.diff(energy) < 0)
    assert energy[-1] > 0.9 * energy[0]
    assert run("centred")[1] > 80.0


def test_xsppm7_in_a_box_with_moving_walls_does_not_depend_on_the_number_of_ranks():
    def run(comm):
        grid = MacGrid([0, 0, 0], [1, 1, 1], [16, 14, 12], [False, True, False], comm)
        walls = {"x_upper": Wall(velocity=(0.0, 1.0, 0.5)), "z_lower": Wall(velocity=(1.0, 0.0, 0.0))}
        fluid = NavierStokes(grid, Boundary(grid, walls), rho=1.0, mu=1e-3, advection="xsppm7")
        u, _ = march(fluid, fluid.fill(grid.zero_faces(), 0.0), grid.zeros(), 0.02, 25)
        out = []
        for d in range(3):
            whole = np.zeros(grid.face_shape(d))
            block = u[d][grid.owned_faces(d)]
            whole[tuple(slice(s, s + k) for s, k in zip(grid.start, block.shape, strict=True))] = block
            out.append(comm.allreduce(whole))
        return out

    for together, alone in zip(run(WORLD), run(MPI.COMM_SELF), strict=True):
        np.testing.assert_allclose(together, alone, atol=1e-12)
        assert np.abs(alone).max() > 0.01


def slow_edge(a, b, c, d, e, f, g):
    """The xsPPM7 edge value of arrays, from its definition."""

    def middle(x, y, z):
        return np.sort([x, y, z], axis=0)[1]

    def septic(*cells):
        weights = np.array([-3, 25, -101, 319, 214, -38, 4]) / 420.0
        return sum(w * x for w, x in zip(weights, cells, strict=True))

    upper, lower = septic(a, b, c, d, e, f, g), septic(g, f, e, d, c, b, a)
    monotone = middle(d, middle(d, upper, e), 3 * d - 2 * middle(d, lower, c))
    smooth = [
        13 / 12 * (b - 2 * c + d) ** 2 + 0.25 * (b - 4 * c + 3 * d) ** 2,
        13 / 12 * (c - 2 * d + e) ** 2 + 0.25 * (c - e) ** 2,
        13 / 12 * (d - 2 * e + f) ** 2 + 0.25 * (3 * d - 4 * e + f) ** 2,
    ]
    tiny = 1e-6 * (b**2 + c**2 + d**2 + e**2 + f**2) + 1e-60
    weights = [k / (s + tiny) ** 2 for k, s in zip((0.1, 0.6, 0.3), smooth, strict=True)]
    values = [(2 * b - 7 * c + 11 * d) / 6, (-c + 5 * d + 2 * e) / 6, (2 * d + 5 * e - f) / 6]
    weno = sum(w * v for w, v in zip(weights, values, strict=True)) / sum(weights)
    return np.where(monotone == upper, upper, middle(monotone, weno, upper))


def slow_advection(u, d, scheme, inv_h):
    """Div(u u) of periodic arrays on the faces of component d, from the formula."""
    total = 0.0
    for e in range(len(u)):
        v = 0.5 * (u[e] + np.roll(u[e], 1, d))
        if scheme == "centred":
            value = 0.5 * (u[d] + np.roll(u[d], 1, e))
        else:
            up = slow_edge(*(np.roll(u[d], k, e) for k in (4, 3, 2, 1, 0, -1, -2)))
            down = slow_edge(*(np.roll(u[d], k, e) for k in (-3, -2, -1, 0, 1, 2, 3)))
            value = np.where(v > 0, up, down)
        total = total + inv_h[e] * (np.roll(v * value, -1, e) - v * value)
    return total


@pytest.mark.parametrize("scheme", sorted(SCHEMES))
@pytest.mark.parametrize("cells", [(12, 9), (9, 530), (6, 11, 13), (5, 23, 30), (4, 5, 600), (4, 4, 2060)])
@pytest.mark.serial
def test_compiled_advection_equals_its_formula_on_random_flows(scheme, cells):
    """The sizes take short and long strides, one block and several, so that flows cross the ends of blocks."""
    dim, rng = len(cells), np.random.default_rng(1)
    grid = MacGrid([0] * dim, [1] * dim, cells, [True] * dim, MPI.COMM_SELF)
    fluid = NavierStokes(grid, Boundary(grid), rho=1.0, mu=0.1, advection=scheme)
    whole = [rng.standard_normal(grid.cells) for _ in range(dim)]
    # Constant and smooth parts as well: there the limiter is not at work.
    whole[0][: cells[0] // 2] = 1.0
    whole[1] += np.linspace(0.0, 20.0, cells[-1]).reshape(1, -1, 1) if dim == 2 else 0.0
    u = grid.zero_faces()
    for local, values in zip(u, whole, strict=True):
        local[grid.owned] = values
    grid.exchange(u)
    N = fluid.advection(u)
    for d in range(dim):
        expected = slow_advection(whole, d, scheme, [1.0 / h for h in grid.spacing])
        np.testing.assert_allclose(N[d][grid.owned], expected, atol=1e-12 * np.abs(expected).max())


def test_an_unknown_scheme_is_an_error_that_lists_the_known_ones():
    grid = MacGrid([0, 0], [1, 1], [16, 16], [True, True])
    with pytest.raises(ValueError, match="centred, xsppm7"):
        NavierStokes(grid, Boundary(grid), rho=1.0, mu=0.1, advection="upwind")
    assert set(SCHEMES) == {"centred", "xsppm7"}
