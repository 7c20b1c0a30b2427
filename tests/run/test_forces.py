"""Forces of the fluid on bodies in the history: against the balance of a box, through a restart, in cases."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from tests.coupled_case import STEPS, block_model, simulation
from valvefsi import fsi
from valvefsi.bodies.rigid import RigidSurface
from valvefsi.coupling.kernel_properties import largest_square_sum
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import CaseError
from valvefsi.fluid.boundary import Boundary, FreeSlip, Open, Wall
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.grid import MacGrid
from valvefsi.io.history import read_history
from valvefsi.run.forces import ForceMeter, ForceOutput

WORLD = MPI.COMM_WORLD
H, DT, MU = 0.125, 0.02, 0.1
BOX = ((-1.5, -1.5), (2.5, 1.5))


def cylinder():
    """A cylinder of diameter 1 in a stream of speed 1 at Re 10, between planes that slip."""
    grid = MacGrid([-4.0, -4.0], [6.0, 4.0], [80, 64], [False, False], WORLD)
    sides = {"x_lower": Wall(velocity=(1.0, 0.0)), "x_upper": Open()}
    sides |= {"y_lower": FreeSlip(), "y_upper": FreeSlip()}
    fluid = NavierStokes(grid, Boundary(grid, sides), rho=1.0, mu=MU, advection="xsppm7")
    n = math.ceil(math.pi / (0.5 * H))
    angle = 2.0 * np.pi * np.arange(n) / n
    points = np.stack([0.5 * np.cos(angle), 0.5 * np.sin(angle), np.full(n, 0.5)], axis=1)
    share = 0.5 * H / largest_square_sum("bspline3")
    ring = RigidSurface(
        points,
        np.full(n, math.pi / n),
        Coupling(grid, "bspline3"),
        name="cylinder",
        stiffness=share / DT**2,
        damping=share / DT,
        slip=0.02 / DT,
    )
    return fsi.Model(grid=grid, fluid=fluid, bodies=(ring,))


def test_the_force_on_a_cylinder_is_what_flows_through_the_sides_of_a_box_around_it():
    model = cylinder()
    u = model.grid.zero_faces()
    u[0][...] = 1.0
    state = fsi.initial_state(model, DT, u)
    meter = ForceMeter(model, (ForceOutput(name="c", bodies=(0,), box=BOX),))
    assert all(np.isnan(value) for value in meter.row(state).values()), "no force before the first row"
    for _ in range(6):
        meter.keep()
        for _ in range(50):
            state = fsi.step(model, state, DT)
        row = meter.row(state)
    force, balance = row["force_x_c_dyn_per_cm"], row["force_balance_x_c_dyn_per_cm"]
    assert 1.2 < force < 2.2, "half of a drag coefficient of about 3 at Re 10"
    assert balance == pytest.approx(force, rel=0.01)
    assert abs(row["force_y_c_dyn_per_cm"]) < 1e-3 * force


def test_the_mean_force_of_an_interval_is_that_of_its_parts():
    model, forces = cylinder(), (ForceOutput(name="c", bodies=(0,)),)
    u = model.grid.zero_faces()
    u[0][...] = 1.0
    state = fsi.initial_state(model, DT, u)
    every, whole, parts = ForceMeter(model, forces), ForceMeter(model, forces), []
    for meter in (every, whole):
        meter.row(state)
        meter.keep()
    for _ in range(12):
        state = fsi.step(model, state, DT)
        parts.append(every.row(state)["force_x_c_dyn_per_cm"])
        every.keep()
    assert np.ptp(parts) > 0.1 * np.mean(parts), "it changes"
    assert whole.row(state)["force_x_c_dyn_per_cm"] == pytest.approx(np.mean(parts), rel=1e-9)


def test_the_balance_of_a_box_gives_the_force_on_a_body_that_swings():
    """The momentum of the body counts: it is a large part of the force."""
    model, dt = block_model(load=0.0, tether=50.0, damping=0.0), 2e-3
    state = fsi.initial_state(model, dt)
    q = state.bodies[0]
    state = replace(state, bodies=({**q, "chi": q["chi"] + (0.8, 0.0, 0.0)},))
    meter = ForceMeter(model, (ForceOutput(name="b", bodies=(0,), box=((5.0, 10.0), (35.0, 30.0))),))
    force, balance, rate = [], [], []  # of each step
    meter.row(state)
    meter.keep()
    for _ in range(200):
        before = meter.last.momentum[0, 0]
        state = fsi.step(model, state, dt)
        row = meter.row(state)
        meter.keep()
        force.append(row["force_x_b_dyn_per_cm"])
        balance.append(row["force_balance_x_b_dyn_per_cm"])
        rate.append((meter.last.momentum[0, 0] - before) / dt)
    scale = np.abs(force[5:]).max()
    assert np.abs(rate[5:]).max() > 0.1 * scale
    np.testing.assert_allclose(balance[5:], force[5:], atol=0.01 * scale)


class Cut(Exception):
    """Ends a run on all ranks at once."""


def cut(step, *_):
    if step == 18:
        raise Cut


def test_a_restart_between_two_rows_gives_the_same_forces(shared_tmp):
    forces = (ForceOutput(name="block", bodies=(0,), box=((5.0, 10.0), (35.0, 30.0))),)
    options = {"forces": forces, "checkpoint_every": 7}
    simulation(shared_tmp / "whole", **options).run()
    with pytest.raises(Cut):
        simulation(shared_tmp / "parts", **options).run(progress=cut)
    outcome = simulation(shared_tmp / "parts", **options).run(resume=True)
    assert outcome.steps == STEPS - 14
    ours, theirs = (read_history(shared_tmp / name / "history.csv") for name in ("parts", "whole"))
    columns = [name for name in theirs if name.startswith("force_")]
    assert len(columns) == 4
    for name in columns:
        np.testing.assert_array_equal(ours[name], theirs[name])
        assert np.isfinite(theirs[name][1:]).all()


def test_a_box_too_near_to_a_side_is_refused():
    model = block_model()
    with pytest.raises(ValueError, match="one cell away from the sides"):
        ForceMeter(model, (ForceOutput(name="block", bodies=(0,), box=((0.0, 0.0), (35.0, 30.0))),))


def test_a_case_names_the_bodies_of_a_force(shared_tmp):
    from pathlib import Path

    from valvefsi.case import load_case
    from valvefsi.case.build import build

    file = Path(__file__).parents[2] / "demos" / "compressed_block.toml"
    force = 'output.force=[{name="drag", body=["block"], lower=["5 cm", "10 cm"], upper=["35 cm", "30 cm"]}]'
    output = build(load_case(file, [force]), shared_tmp).output
    assert output.forces == (ForceOutput(name="drag", bodies=(0,), box=((5.0, 10.0), (35.0, 30.0))),)
    with pytest.raises(CaseError, match=r"output\.force\.0\.body = \['blok'\]: expected names of block"):
        build(load_case(file, [force.replace("block", "blok")]), shared_tmp)
