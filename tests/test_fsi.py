"""The coupled step: second order in time, energy, momentum, free motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from tests.ordering import assert_order
from valvefsi import fsi
from valvefsi.bodies.elastic import Elastic
from valvefsi.coupling.transfer import Coupling
from valvefsi.fluid.boundary import Boundary
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.fsi import Model
from valvefsi.geometry.shapes import box, rectangle
from valvefsi.grid import MacGrid
from valvefsi.post import diagnostics
from valvefsi.solid.loads import DeadLoad, Ramp
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.structure import Structure

WORLD = MPI.COMM_WORLD


def soft_square(mu=0.05, c1=4.0, loads=(), comm=WORLD):
    """A soft square in a periodic box of fluid, one edge length 0.4 in a box of 1."""
    mesh = rectangle(comm, lower=(0.3, 0.3), size=(0.4, 0.4), elements=(8, 8))
    solid = Structure(mesh, NeoHookean(c1=c1), nu_stab=0.4, loads=loads)
    grid = MacGrid([0, 0], [1, 1], [20, 20], [True, True], comm)
    fluid = NavierStokes(grid, Boundary(grid), rho=1.0, mu=mu)
    return Model(grid=grid, fluid=fluid, bodies=(Elastic(solid, Coupling(grid, "bspline4")),))


def swirl(grid, speed=1.0):
    """Taylor-Green vortex on the faces, discretely solenoidal."""
    faces = grid.zero_faces()
    for d in range(2):
        x, y, _ = grid.points(d)
        a, b = 2 * np.pi * x, 2 * np.pi * y
        faces[d][...] = speed * (np.sin(a) * np.cos(b) if d == 0 else -np.cos(a) * np.sin(b))
    return faces


def march(model, dt, steps, u=None):
    state = fsi.initial_state(model, dt, u=u)
    states = [state]
    for _ in range(steps):
        states.append(fsi.step(model, states[-1], dt))
    return states


def test_positions_converge_with_order_two_in_time():
    """Differences to a much finer run carry no error of grid or mesh; the load moves in time."""
    load = DeadLoad(on=("x_upper",), traction=(0.0, 0.3), ramp=Ramp(duration=0.25, shape="smooth"))
    model = soft_square(loads=(load,))

    def end(steps):
        return march(model, 0.2 / steps, steps, swirl(model.grid))[-1].bodies[0]["chi"]

    finest = end(640)

    def gap(steps):
        return WORLD.allreduce(np.abs(end(steps) - finest).max(initial=0.0), op=MPI.MAX)

    assert_order(gap, (20, 40, 80), order=1.85, below=2e-5)


def test_energy_of_fluid_and_solid_only_decays_and_by_viscosity_alone():
    """Kinetic plus elastic energy: conserved without viscosity to the error of the time step, lost with it."""

    def energies(mu, dt):
        model = soft_square(mu=mu)
        states = march(model, dt, round(0.2 / dt), swirl(model.grid, 0.5))
        solid = model.bodies[0].solid
        return np.array(
            [
                diagnostics.kinetic_energy(model.grid, s.u, 1.0) + solid.energy(s.bodies[0]["chi"])
                for s in states
            ]
        )

    coarse, fine = (energies(0.0, dt) for dt in (2e-3, 1e-3))
    drift = [abs(e[-1] / e[0] - 1) for e in (coarse, fine)]
    assert drift[1] < 2e-3
    assert drift[1] < 0.4 * drift[0], f"the drift must fall like the square of the step: {drift}"
    viscous = energies(0.05, 1e-3)
    assert np.all(np.diff(viscous) < 0)
    assert viscous[-1] < 0.9 * viscous[0]


def test_momentum_is_conserved_in_a_periodic_box():
    model = soft_square()
    states = march(model, 2e-3, 40, swirl(model.grid))

    def momentum(state):
        return [WORLD.allreduce(float(c[model.grid.owned].sum())) for c in state.u]

    np.testing.assert_allclose(momentum(states[-1]), momentum(states[0]), atol=1e-9)


def test_a_stress_free_solid_drifts_with_the_stream():
    model = soft_square(mu=0.0)
    u = tuple(np.full(model.grid.shape, v) for v in (0.7, -0.2))
    state = march(model, 0.02, 100, u)[-1]
    X = model.bodies[0].solid.X
    np.testing.assert_allclose(state.bodies[0]["chi"], X + 2.0 * np.array([0.7, -0.2, 0.0]), atol=1e-11)
    assert abs(state.t - 2.0) < 1e-12


@pytest.mark.parametrize("ratio", [0.5, 2.0])
def test_a_step_of_another_length_stays_second_order(ratio):
    """Adams-Bashforth takes the ratio of the steps: the error of a pair of unequal steps falls like dt^3."""
    model = soft_square(c1=0.1)

    def end(dt, substeps):
        state = fsi.initial_state(model, dt, u=swirl(model.grid))
        state = fsi.step(model, state, dt)
        for _ in range(substeps):
            state = fsi.step(model, state, ratio * dt / substeps)
        return state

    def gap(n):
        dt = 0.04 / n
        one, many = end(dt, 1), end(dt, 64)
        local = max(np.abs(a - b)[model.grid.owned].max() for a, b in zip(one.u, many.u, strict=True))
        return WORLD.allreduce(local, op=MPI.MAX)

    assert_order(gap, (1, 2, 4), order=2.5, below=1e-3)


def test_the_state_that_goes_in_is_not_changed():
    model = soft_square()
    state = march(model, 2e-3, 3, swirl(model.grid))[-1]
    copy = replace(
        state,
        u=tuple(c.copy() for c in state.u),
        N=tuple(c.copy() for c in state.N),
        p=state.p.copy(),
        bodies=tuple({k: v.copy() for k, v in q.items()} for q in state.bodies),
    )
    first = fsi.step(model, state, 2e-3)
    for before, after in zip(
        (*copy.u, *copy.N, copy.p, copy.bodies[0]["chi"]),
        (*state.u, *state.N, state.p, state.bodies[0]["chi"]),
        strict=True,
    ):
        np.testing.assert_array_equal(before, after)
    again = fsi.step(model, state, 2e-3)
    np.testing.assert_array_equal(first.bodies[0]["chi"], again.bodies[0]["chi"])


def soft_cube(c1=4.0, mu=0.05):
    """A soft cube of hexahedra in a periodic box, three dimensions."""
    mesh = box(WORLD, lower=(0.3,) * 3, size=(0.4,) * 3, elements=(4,) * 3)
    solid = Structure(mesh, NeoHookean(c1=c1), name="cube", nu_stab=0.4)
    grid = MacGrid([0] * 3, [1] * 3, [12] * 3, [True] * 3)
    fluid = NavierStokes(grid, Boundary(grid), rho=1.0, mu=mu)
    return Model(grid=grid, fluid=fluid, bodies=(Elastic(solid, Coupling(grid, "bspline3")),))


def test_a_stress_free_cube_drifts_with_the_stream():
    model = soft_cube()
    u = tuple(np.full(model.grid.shape, v) for v in (0.7, -0.2, 0.4))
    state = march(model, 0.02, 50, u)[-1]
    np.testing.assert_allclose(
        state.bodies[0]["chi"], model.bodies[0].solid.X + np.array([0.7, -0.2, 0.4]), atol=1e-11
    )


def test_energy_decays_and_volume_is_kept_in_three_dimensions():
    model = soft_cube()
    u = model.grid.zero_faces()
    for d, (a, b) in enumerate(((1, 2), (2, 0), (0, 1))):
        points = model.grid.points(d)
        u[d][...] = 0.5 * (np.sin(2 * np.pi * points[a]) + np.cos(2 * np.pi * points[b]))
    states = march(model, 4e-3, 50, u)
    solid = model.bodies[0].solid
    energy = [
        diagnostics.kinetic_energy(model.grid, s.u, 1.0) + solid.energy(s.bodies[0]["chi"]) for s in states
    ]
    assert np.all(np.diff(energy) < 0)
    assert WORLD.allreduce(np.abs(states[-1].bodies[0]["chi"] - solid.X).max(initial=0.0), op=MPI.MAX) > 0.02
    assert abs(solid.volume(states[-1].bodies[0]["chi"]) / solid.reference_volume - 1) < 5e-3
