"""Solids heavier than the fluid: momentum, closed forms, order in time, stability, restart."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from scipy.integrate import solve_ivp

from tests.coupled_case import STEPS, block_model, heavy, moved, simulation
from tests.ordering import assert_order
from valvefsi import fsi
from valvefsi.bodies.elastic import Elastic
from valvefsi.case import load_case
from valvefsi.case.build import build
from valvefsi.coupling.elemental import ElementalCoupling
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import CaseError, StabilityError
from valvefsi.fluid.boundary import Boundary
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.fsi import Model
from valvefsi.geometry.shapes import box, rectangle
from valvefsi.grid import MacGrid
from valvefsi.io.history import read_history
from valvefsi.run.forces import ForceMeter, ForceOutput
from valvefsi.run.planning import plan, step_limits
from valvefsi.solid.elements.element_points import ElementPoints
from valvefsi.solid.loads import DeadLoad, Tether
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.structure import Structure

WORLD = MPI.COMM_WORLD
CASE = Path(__file__).parents[2] / "demos" / "compressed_block.toml"
RHO, HEAVY = 1.2, 7.0  # the density that `heavy` takes
WIDTH, LENGTH = 0.25, 1.0
"""Thickness of the slab and length of its box across it [cm]."""


def disk(cells=24, elements=8, kernel="bspline3", elemental=False, c1=20.0, mu=0.02):
    """A soft square in a periodic box of fluid, edge 0.4 in 1."""
    mesh = rectangle(WORLD, lower=(0.3, 0.3), size=(0.4, 0.4), elements=(elements,) * 2)
    solid = Structure(mesh, NeoHookean(c1=c1), name="body")
    grid = MacGrid([0, 0], [1, 1], [cells] * 2, [True] * 2)
    fluid = NavierStokes(grid, Boundary(grid), rho=RHO, mu=mu)
    coupling = ElementalCoupling(grid, kernel, ElementPoints(solid)) if elemental else Coupling(grid, kernel)
    return Model(grid=grid, fluid=fluid, bodies=(Elastic(solid, coupling),))


def slab(cells=16, *, mu=0.0, c1=5.0, loads=(), stiffness=60.0):
    """A slab across a periodic box, held all over by springs; it has no end along y."""
    h = LENGTH / cells
    mesh = rectangle(WORLD, lower=(0.375, 0), size=(WIDTH, 4 * h), elements=(round(WIDTH / h), 4))
    tethers = [Tether(stiffness=stiffness)] if stiffness else []
    solid = Structure(mesh, NeoHookean(c1=c1), name="slab", nu_stab=None, tethers=tethers, loads=loads)
    grid = MacGrid([0, 0], [LENGTH, 4 * h], [cells, 4], [True] * 2)
    fluid = NavierStokes(grid, Boundary(grid), rho=RHO, mu=mu)
    return heavy(Model(grid=grid, fluid=fluid, bodies=(Elastic(solid, Coupling(grid, "bspline3")),)))


def shifted(model, dt, by):
    """At rest, the slab a way off its springs' anchors."""
    state = fsi.initial_state(model, dt)
    q = state.bodies[0]
    return moved(state, chi=q["chi"] + by, Y=q["Y"] + by)


def march(model, state, dt, steps):
    for _ in range(steps):
        state = fsi.step(model, state, dt)
    return state


def momentum(model, state):
    grid = model.grid
    cell = np.prod(grid.spacing[: grid.dim])
    fluid = [model.fluid.rho * cell * c[grid.owned].sum() for c in state.u[: grid.dim]]
    return WORLD.allreduce(np.array(fluid)) + model.bodies[0].excess_momentum(state.bodies[0])[: grid.dim]


def mean_shift(model, state):
    solid = model.bodies[0].solid
    return WORLD.allreduce(solid.weights @ (state.bodies[0]["chi"] - solid.X)) / solid.reference_volume


@pytest.mark.parametrize("elemental", [False, True])
def test_a_heavy_body_thrown_into_fluid_at_rest_shares_its_momentum_with_it(elemental):
    model, dt = heavy(disk(elemental=elemental)), 1e-3
    state = fsi.initial_state(model, dt)
    thrown = np.zeros_like(state.bodies[0]["chi"]) + (0.8, 0.3, 0.0)
    state = moved(state, V=thrown)
    before = (HEAVY - RHO) * 0.16 * np.array([0.8, 0.3])
    np.testing.assert_allclose(momentum(model, state), before, rtol=1e-12)
    state = march(model, state, dt, 300)
    np.testing.assert_allclose(momentum(model, state), before, rtol=1e-10)
    assert mean_shift(model, state)[0] > 0.1, "it flies on"
    assert model.bodies[0].lag(state.bodies[0]) < 1e-3


def test_a_heavy_cube_keeps_the_momentum_of_both_in_three_dimensions():
    mesh = box(WORLD, lower=(0.3,) * 3, size=(0.4,) * 3, elements=(4,) * 3)
    solid = Structure(mesh, NeoHookean(c1=4.0), name="cube")
    grid = MacGrid([0] * 3, [1] * 3, [12] * 3, [True] * 3)
    fluid = NavierStokes(grid, Boundary(grid), rho=RHO, mu=0.05)
    model, dt = Model(grid=grid, fluid=fluid, bodies=(Elastic(solid, Coupling(grid, "bspline3")),)), 4e-3
    model = heavy(model)
    u = grid.zero_faces()
    for d, speed in enumerate((0.3, -0.2, 0.5)):
        u[d][...] = speed
    state = fsi.initial_state(model, dt, u=u)
    before = ((HEAVY - RHO) * 0.4**3 + RHO) * np.array([0.3, -0.2, 0.5])
    np.testing.assert_allclose(momentum(model, state), before, rtol=1e-12)
    x, y, _ = grid.points(2)
    u[2][...] += 0.5 * np.sin(2 * np.pi * x) * np.cos(2 * np.pi * y)
    state = march(model, replace(state, u=fluid.fill(u, 0.0)), dt, 50)
    np.testing.assert_allclose(momentum(model, state), before, rtol=1e-10)
    assert WORLD.allreduce(np.ptp(state.bodies[0]["V"][:, 2]), op=MPI.MAX) > 1e-3, "it is sheared"


def test_a_slab_that_carries_the_fluid_along_swings_at_the_closed_frequency():
    """(rho L + (rho_s - rho) a) X'' = -k a X, of second order in the step."""
    mass = RHO * LENGTH + (HEAVY - RHO) * WIDTH
    omega = np.sqrt(60.0 * WIDTH / mass)
    model, d, end = slab(), 0.02, 1.3

    def gap(steps):
        dt = end / steps
        state = march(model, shifted(model, dt, np.array([d, 0, 0])), dt, steps)
        return np.abs(mean_shift(model, state) - (d * np.cos(omega * end), 0, 0)).max()

    assert_order(gap, (40, 80, 160), order=1.9, below=3e-3 * d)


def test_a_change_of_the_step_gives_no_kick():
    """Under a steady load the slab goes on with the same acceleration in steps a tenth as long."""
    load = DeadLoad(on=("x_lower",), traction=(0.3, 0.0))
    model, dt = slab(loads=(load,), stiffness=0.0, c1=500.0), 0.002
    acceleration = 0.3 / (RHO * LENGTH + (HEAVY - RHO) * WIDTH)
    state = march(model, fsi.initial_state(model, dt), dt, 150)
    for _ in range(10):
        state = march(model, state, 0.1 * dt, 1)
        speed = WORLD.allreduce(state.u[0][model.grid.owned].mean()) / WORLD.size
        assert speed == pytest.approx(acceleration * state.t, rel=1e-4)


def rigid_layer(mu, k, d, end, n=600):
    """Position of a rigid slab that slides along itself in viscous fluid: its springs and the fluid's friction."""
    half = 0.5 * (LENGTH - WIDTH)
    dx = half / n
    nu, total = mu / RHO, HEAVY * WIDTH

    def rate(_, y):
        X, V, u = y[0], y[1], y[2:]
        v = np.concatenate([[V], u, u[-1:]])  # no friction at the plane of symmetry between two images
        friction = 2 * mu * (-(11 / 6) * V + 3 * u[0] - 1.5 * u[1] + u[2] / 3) / dx
        return [V, (friction - k * WIDTH * X) / total, *(nu * np.diff(v, 2) / dx**2)]

    y = solve_ivp(rate, (0, end), np.array([d] + [0.0] * n), method="BDF", rtol=1e-8, atol=1e-11).y
    return y[0, -1]


def test_a_slab_that_slides_feels_the_friction_of_stokes_layers():
    """Against the diffusion equation outside a rigid slab; the kernel blurs its faces by a part of h."""
    mu, k, d, end = 0.15, 250.0, 0.02, 0.7
    exact = rigid_layer(mu, k, d, end)
    assert -0.9 < exact / d < -0.1, "more than half a swing, damped"

    def gap(cells):
        model = slab(cells, mu=mu, c1=600.0, stiffness=k)
        dt = 0.9 * step_limits(model)["elastic, slab"]
        steps = int(np.ceil(end / dt))
        dt = end / steps
        state = march(model, shifted(model, dt, np.array([0, d, 0])), dt, steps)
        return abs(mean_shift(model, state)[1] - exact)

    assert_order(gap, (16, 32, 64), order=0.8, below=0.02 * d)


def test_the_lag_is_what_the_plan_says_and_the_plan_says_the_tie(shared_tmp):
    """Under a steady load the slab and all fluid are accelerated alike."""
    load = DeadLoad(on=("x_lower",), traction=(0.3, 0.0))
    model, dt = slab(loads=(load,), stiffness=0.0), 0.002
    state = march(model, fsi.initial_state(model, dt), dt, 150)
    acceleration = 0.3 / (RHO * LENGTH + (HEAVY - RHO) * WIDTH)
    body, q = model.bodies[0], state.bodies[0]
    lag = (q["chi"] - q["Y"])[:, 0]
    np.testing.assert_allclose(lag.max(), body.lag_of_acceleration(dt) * acceleration, rtol=1e-6)
    entries = {e.quantity: e for e in plan(simulation(shared_tmp, model=model, probes=()))}
    entry = entries["penalty stiffness of the excess mass of slab"]
    assert entry.value == pytest.approx(body.penalty_stiffness(0.02))
    assert entry.note.startswith("density 7 g/cm^3; lag = ")
    assert entry.unit == "dyn/cm"


def test_the_force_on_the_wet_surface_is_that_of_the_fluid_outside_alone():
    """Fluid outside a slab that it follows everywhere pushes it with -rho (L - a) X''."""
    model, dt = slab(), 0.002
    meter = ForceMeter(model, (ForceOutput(name="slab", bodies=(0,)),))
    state = shifted(model, dt, np.array([0.02, 0, 0]))
    assert all(np.isnan(value) for value in meter.row(state).values()), "no row before the first"
    meter.keep()
    for _ in range(50):
        state = fsi.step(model, state, dt)
    found = meter.row(state)
    h = 4 * LENGTH / 16
    speed = WORLD.allreduce(state.u[0][model.grid.owned].mean()) / WORLD.size
    assert abs(speed) > 0.01
    expected = -RHO * (LENGTH - WIDTH) * h * speed / state.t
    assert found["force_x_slab_dyn_per_cm"] == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(("density", "left"), [(1.3, 0.1), (12.0, 0.8), (1200.0, 1.0)])
@pytest.mark.parametrize(("kernel", "elements"), [("piecewise_linear", 8), ("bspline3", 4), ("ib6", 16)])
def test_the_tie_is_stable_at_every_density_kernel_and_mesh(density, left, kernel, elements):
    """Elements from 0.6 to 2.4 h; markers that start off their nodes come back, the heavy ones slowly."""
    model, dt = heavy(disk(cells=24, elements=elements, kernel=kernel, c1=1e-4, mu=0.0), density), 0.01
    state = fsi.initial_state(model, dt)
    body, Y = model.bodies[0], state.bodies[0]["Y"]
    off = 1e-4 * np.cos(37.0 * Y + 11.0 * Y[:, ::-1]) * (1, 1, 0)
    state = moved(state, Y=Y + off)
    first = body.lag(state.bodies[0])
    state = march(model, state, dt, 60)
    assert body.lag(state.bodies[0]) < left * first


def test_the_elastic_limit_of_a_heavy_body_is_on_the_safe_side():
    model = heavy(block_model(load=2.0, tether=50.0), 50.0)
    limits, light = step_limits(model), step_limits(block_model(load=2.0, tether=50.0))
    for cause, limit in limits.items():
        assert 0.5 * light[cause] < limit < light[cause]
    dt = limits["elastic, block"]
    state = fsi.initial_state(model, dt)
    noise = 1e-3 * np.sin(7.0 * state.bodies[0]["chi"]) * (1, 1, 0)
    state = march(model, moved(state, chi=state.bodies[0]["chi"] + noise), dt, 200)
    assert max(np.abs(c).max() for c in state.u) < 0.1
    with pytest.raises(StabilityError):
        march(model, fsi.initial_state(model, 4.5 * dt), 4.5 * dt, 200)


def heavy_run(folder, comm=WORLD, **options):
    return simulation(folder, comm, model=heavy(block_model(comm, lid=2.0), 5.0), **options)


def rows(sim, state):
    """Nodes and markers of a state by their numbers, on all ranks."""
    solid, q = sim.model.bodies[0].solid, state.bodies[0]
    whole = np.zeros((solid.num_nodes, 9))
    whole[solid.ids] = np.hstack([q["chi"], q["Y"], q["V"]])
    return sim.model.grid.comm.allreduce(whole)


class Cut(Exception):
    """Ends a run on all ranks at once."""


def cut(step, *_):
    if step == 18:
        raise Cut


def test_restart_of_a_heavy_body_equals_the_uninterrupted_run(shared_tmp):
    whole = heavy_run(shared_tmp / "whole")
    expected = rows(whole, whole.run().state)
    assert np.abs(expected[:, 6:]).max() > 0.01, "the markers move"
    with pytest.raises(Cut):
        heavy_run(shared_tmp / "parts", checkpoint_every=15).run(progress=cut)
    sim = heavy_run(shared_tmp / "parts")
    outcome = sim.run(resume=True)
    assert outcome.steps == STEPS - 15
    np.testing.assert_array_equal(rows(sim, outcome.state), expected)
    ours, theirs = (read_history(shared_tmp / name / "history.csv") for name in ("parts", "whole"))
    for column in ("block_excess_kinetic_energy_erg", "block_marker_lag_cm"):
        assert ours[column] == theirs[column]
        assert theirs[column][-1] > 0.0


@pytest.mark.skipif(WORLD.size == 1, reason="needs two ranks")
def test_a_heavy_body_does_not_depend_on_the_number_of_ranks_and_restarts_on_another(shared_tmp):
    with pytest.raises(Cut):
        heavy_run(shared_tmp / "parts", checkpoint_every=15).run(progress=cut)
    sim = heavy_run(shared_tmp / "all")
    expected = rows(sim, sim.run().state)
    if WORLD.rank == 0:
        for name, resume in (("one", False), ("parts", True)):
            alone = heavy_run(shared_tmp / name, MPI.COMM_SELF)
            found = rows(alone, alone.run(resume=resume).state)
            np.testing.assert_allclose(found, expected, atol=1e-10)
    WORLD.barrier()


@pytest.mark.parametrize("density", [RHO, 0.5 * RHO, np.nan, np.inf])
def test_excess_mass_needs_a_density_above_the_fluids(density):
    with pytest.raises(CaseError, match=r"density.*more than the fluid's density, 1.2"):
        heavy(disk(), density)


def test_a_case_says_the_density_of_a_solid(shared_tmp):
    plain = build(load_case(CASE), shared_tmp)
    rho = plain.model.fluid.rho
    given = build(load_case(CASE, ["solid.block.density='2500 kg/m^3'"]), shared_tmp).model
    mass = WORLD.allreduce(given.bodies[0].mass.sum())
    assert mass == pytest.approx((2.5 - rho) * given.bodies[0].solid.reference_volume, rel=1e-12)
    same = build(load_case(CASE, [f"solid.block.density='{rho!r} g/cm^3'"]), shared_tmp)
    assert type(plain.model.bodies[0]) is type(same.model.bodies[0]) is Elastic
    dt = plain.schedule.dt
    ends = [march(run.model, fsi.initial_state(run.model, dt), dt, 5) for run in (plain, same)]
    np.testing.assert_array_equal(ends[0].bodies[0]["chi"], ends[1].bodies[0]["chi"])


def test_a_solid_lighter_than_the_fluid_is_refused():
    with pytest.raises(CaseError, match=r"lighter than the fluid is not supported") as caught:
        load_case(CASE, ["solid.block.density='0.9 g/cm^3'"])
    assert "solid.block.density" in str(caught.value)
    assert "0.9" in str(caught.value)
