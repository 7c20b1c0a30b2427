"""The balance of energy: closed forms of a decaying vortex and of a channel, bodies, restart."""

from __future__ import annotations

from dataclasses import replace
from math import factorial

import numpy as np
import pytest
from mpi4py import MPI

from tests.coupled_case import STEPS, block_model, simulation
from valvefsi import fsi
from valvefsi.fluid.boundary import Boundary, Open, Wall
from valvefsi.fluid.navier_stokes import ExplicitViscosity, NavierStokes
from valvefsi.grid import MacGrid
from valvefsi.io.history import read_history
from valvefsi.run.energy import EnergyMeter, balance

WORLD = MPI.COMM_WORLD


def march(model, state, dt, steps, every=1):
    """The balance after so many steps."""
    meter = EnergyMeter(model, True)
    meter.row(state)
    meter.keep()
    for k in range(steps):
        state = fsi.step(model, state, dt)
        if (k + 1) % every == 0:
            row = meter.row(state)
            meter.keep()
    return {name.removeprefix("energy_").removesuffix("_erg"): value for name, value in row.items()}, state


@pytest.mark.parametrize("kind", [NavierStokes, ExplicitViscosity])
@pytest.mark.parametrize("advection", ["centred", "xsppm7"])
def test_a_decaying_vortex_loses_what_viscosity_takes(advection, kind):
    """Taylor-Green in the plane: E = E_0 exp(-4 nu k^2 t); its advection term is a gradient and does no work."""
    n, nu, k, dt, steps = 32, 0.02, 2.0 * np.pi, 2e-3, 100
    grid = MacGrid([0, 0], [1, 1], [n, n], [True, True])
    model = fsi.Model(grid=grid, fluid=kind(grid, Boundary(grid), rho=1.0, mu=nu, advection=advection))
    u = grid.zero_faces()
    x, y, _ = grid.points(0)
    u[0][...] = np.sin(k * x) * np.cos(k * y)
    x, y, _ = grid.points(1)
    u[1][...] = -np.cos(k * x) * np.sin(k * y)
    terms, _ = march(model, fsi.initial_state(model, dt, u), dt, steps, every=4)
    lost = 0.25 * (1.0 - np.exp(-4.0 * nu * k**2 * dt * steps))
    assert terms["kinetic"] == pytest.approx(-lost, rel=0.01)
    assert terms["viscosity"] == pytest.approx(lost, rel=0.01)
    assert abs(terms["scheme"]) < 2e-3 * lost
    assert abs(terms["residual"]) < 2e-3 * lost


def test_an_upwind_scheme_takes_energy_from_what_the_grid_cannot_hold_and_a_centred_one_does_not():
    """Without viscosity the kinetic energy changes by what the scheme takes, and by nothing else."""
    losses = {}
    for advection in ("centred", "xsppm7"):
        grid = MacGrid([0, 0], [1, 1], [24, 24], [True, True], process_grid=(WORLD.size, 1))
        model = fsi.Model(
            grid=grid, fluid=NavierStokes(grid, Boundary(grid), rho=1.0, mu=0.0, advection=advection)
        )
        u = grid.zero_faces()
        _, y, _ = grid.points(0)
        u[0][...] = np.tanh(20.0 * (0.25 - np.abs(y - 0.5)))
        x, _, _ = grid.points(1)
        u[1][...] = 0.05 * np.sin(2.0 * np.pi * x)
        terms, state = march(model, fsi.initial_state(model, 2e-3, u), 2e-3, 400)
        losses[advection] = terms["scheme"]
        assert terms["kinetic"] == pytest.approx(-terms["scheme"], abs=2e-5)
        assert terms["viscosity"] == 0.0
        assert abs(terms["residual"]) < 2e-5, "the scheme's part counts"
        assert np.isfinite(state.u[0]).all()
    assert losses["xsppm7"] > 5e-4
    assert abs(losses["centred"]) < 1e-2 * losses["xsppm7"]


def test_in_a_steady_channel_the_pressures_do_what_viscosity_takes():
    """Poiseuille between open sides: dp Q = (dp/L)^2 H^3 L / (12 mu)."""
    length, height, drop, mu = 2.0, 1.0, 0.3, 0.5
    grid = MacGrid([0, 0], [length, height], [16, 16], [False, False])
    sides = {"x_lower": Open(pressure=drop), "x_upper": Open()}
    model = fsi.Model(grid=grid, fluid=NavierStokes(grid, Boundary(grid, sides), rho=1.0, mu=mu))
    u = grid.zero_faces()
    _, y, _ = grid.points(0)
    u[0][...] = drop / length / (2.0 * mu) * y * (height - y)
    dt, steps = 0.01, 200
    terms, _ = march(model, fsi.initial_state(model, dt, u), dt, steps, every=10)
    power = drop**2 / length * height**3 / (12.0 * mu)
    assert terms["pressures"] == pytest.approx(power * dt * steps, rel=0.01)
    assert terms["viscosity"] == pytest.approx(power * dt * steps, rel=0.01)
    assert abs(terms["inflow"]) < 1e-3 * terms["pressures"], "what flows in flows out"
    assert abs(terms["residual"]) < 0.01 * terms["pressures"]


def test_a_stream_that_becomes_a_parabola_brings_in_more_than_it_takes_out():
    """In with u = 30 y^2 (1 - y)^2, out with Poiseuille's: rho/2 (int u_in^3 - int u_out^3) dy = (2.24775 - 54/35)/2.

    A profile that slides along the walls would do work on them, as a lid does: it is in no term.
    """
    grid = MacGrid([0, 0], [3, 1], [60, 20], [False, False])
    sides = {
        "x_lower": Wall(velocity=lambda x, y, z, t: (30.0 * (y * (1.0 - y)) ** 2, 0.0)),
        "x_upper": Open(),
    }
    model = fsi.Model(grid=grid, fluid=NavierStokes(grid, Boundary(grid, sides), rho=1.0, mu=0.05))
    u = grid.zero_faces()
    u[0][...] = 1.0
    state, dt = fsi.initial_state(model, 0.01, u), 0.01
    for _ in range(400):
        state = fsi.step(model, state, dt)
    terms, _ = march(model, state, dt, 100, every=5)
    assert terms["inflow"] == pytest.approx(
        0.5 * (27000.0 * factorial(6) ** 2 / factorial(13) - 54.0 / 35.0), rel=0.03
    )
    assert terms["pressures"] > 2.0 * abs(terms["inflow"])
    assert abs(terms["residual"]) < 0.02 * terms["pressures"]


def test_a_swinging_block_gives_the_fluid_what_it_no_longer_stores():
    """Without load and dampers: work on the fluid is what the block stored, and nothing is lost in the block."""
    model = block_model(load=0.0, tether=50.0, damping=0.0)
    dt, state = 2e-3, fsi.initial_state(model, 2e-3)
    q = state.bodies[0]
    chi = q["chi"] + 0.2 * np.sin(0.15 * q["chi"][:, ::-1]) * (1, 1, 0)
    state = replace(state, bodies=({**q, "chi": chi},))
    before = model.bodies[0].stored(state.bodies[0])
    terms, _ = march(model, state, dt, 300)
    assert terms["bodies"] > 0.1 * before
    assert terms["stored_block"] == pytest.approx(-terms["bodies"], rel=2e-3)
    assert abs(terms["lost_block"]) < 2e-3 * terms["bodies"]
    assert abs(terms["residual"]) < 0.02 * terms["bodies"]


def test_a_restart_between_two_rows_gives_the_same_balance(shared_tmp):
    class Cut(Exception):
        pass

    def cut(step, *_):
        if step == 18:
            raise Cut

    options = {"energy": True, "checkpoint_every": 7}
    simulation(shared_tmp / "whole", **options).run()
    with pytest.raises(Cut):
        simulation(shared_tmp / "parts", **options).run(progress=cut)
    assert simulation(shared_tmp / "parts", **options).run(resume=True).steps == STEPS - 14
    ours, theirs = (read_history(shared_tmp / name / "history.csv") for name in ("parts", "whole"))
    columns = [name for name in theirs if name.startswith("energy_")]
    assert len(columns) == 9
    for name in columns:
        np.testing.assert_array_equal(ours[name], theirs[name])
    terms = balance(theirs, 0.0, theirs["t_s"][-1])
    assert terms["lost_block_erg"] < 0.0, "its load does more work than its dampers take"
