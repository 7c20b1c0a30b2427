"""The xsPPM7 reconstruction: order, monotone layers, underresolved shear, agreement of ranks."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from tests.fluid.test_navier_stokes import largest_error, sample, taylor_green
from tests.ordering import assert_order
from valvefsi import diagnostics
from valvefsi.fluid.advection import SCHEMES, edge
from valvefsi.fluid.boundary import Boundary, Wall
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.grid import MacGrid

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


def test_an_unknown_scheme_is_an_error_that_lists_the_known_ones():
    grid = MacGrid([0, 0], [1, 1], [16, 16], [True, True])
    with pytest.raises(ValueError, match="centred, xsppm7"):
        NavierStokes(grid, Boundary(grid), rho=1.0, mu=0.1, advection="upwind")
    assert set(SCHEMES) == {"centred", "xsppm7"}
