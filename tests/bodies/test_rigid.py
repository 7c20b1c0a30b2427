"""Rigid surfaces in the coupled step: leaks through a closed tube, forces, ranks."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.bodies.rigid import RigidSurface
from valvefsi.coupling.kernel_properties import largest_square_sum
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import StabilityError
from valvefsi.fluid.boundary import Boundary, Disk, Mixed, Open
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.geometry.aortic_section import AorticSection, joined, plug
from valvefsi.grid import MacGrid
from valvefsi.units import MMHG

RADIUS, LENGTH, H, DT = 0.6, 1.0, 0.1, 5e-5


def model(comm, pressure, *, closed=True):
    """A tube from side to side of a box, with or without a plug, under a pressure difference."""
    grid = MacGrid([-1.0, -1.0, 0.0], [1.0, 1.0, LENGTH], (20, 20, 10), [False] * 3, comm)
    ends = {"z_lower": (0.0, pressure), "z_upper": (LENGTH, 0.0)}
    sides = {
        name: Mixed(open=Open(pressure=p), where=Disk(centre=(0.0, 0.0, z), radius=RADIUS))
        for name, (z, p) in ends.items()
    }
    fluid = NavierStokes(grid, Boundary(grid, sides), rho=1.0, mu=0.04)
    tube = AorticSection(inlet_radius=RADIUS, outlet_radius=RADIUS, sinus_depth=0.0)
    surface = tube.housing(H, (0.5 * H, LENGTH - 0.5 * H))
    if closed:
        surface = joined(surface, plug(RADIUS, 0.5 * LENGTH, H))
    coupling = Coupling(grid, "piecewise_linear")
    share = 0.25 * H / largest_square_sum("piecewise_linear")
    rigid = RigidSurface(
        surface.points,
        surface.areas,
        coupling,
        name="tube",
        stiffness=share / DT**2,
        damping=share / DT,
    )
    return fsi.Model(grid=grid, fluid=fluid, bodies=(rigid,))


def one_point(*, area=1.0, **options):
    """A surface of a single point in the middle of a box."""
    grid = MacGrid([0.0] * 3, [1.0] * 3, (8, 8, 8), [False] * 3, MPI.COMM_SELF)
    coupling = Coupling(grid, "piecewise_linear")
    return RigidSurface(np.full((1, 3), 0.5), np.array([area]), coupling, name="s", **options)


def run(model, steps):
    state, flows = fsi.initial_state(model, DT), []
    for _ in range(steps):
        state = fsi.step(model, state, DT)
        flows.append(model.fluid.boundary.outflow(state.u, "z_upper"))
    return state, np.array(flows)


def test_a_closed_tube_does_not_leak():
    _, flows = run(model(MPI.COMM_WORLD, 100.0 * MMHG), 2400)
    leak = abs(flows[1800:].mean())
    assert leak < 0.1  # ml/s at 100 mmHg and h = 1 mm, what is asked of the aortic test section
    assert np.abs(flows).max() > 1.0  # the pressure does push: the springs give before they hold


def test_an_open_tube_lets_the_fluid_through():
    pressure, steps = 10.0, 100
    _, flows = run(model(MPI.COMM_WORLD, pressure, closed=False), steps)
    t = steps * DT
    inertial = math.pi * RADIUS**2 * pressure * t / LENGTH  # rho L dU/dt = p while friction is small
    assert 0.5 * inertial < flows[-1] < 1.1 * inertial


def test_every_point_belongs_to_one_rank_and_the_flow_does_not_depend_on_ranks():
    together, alone = model(MPI.COMM_WORLD, 50.0 * MMHG), model(MPI.COMM_SELF, 50.0 * MMHG)
    ids = np.concatenate(MPI.COMM_WORLD.allgather(together.bodies[0].ids))
    assert np.array_equal(np.sort(ids), np.arange(together.bodies[0].num_points))
    (state, flows), (_, expected) = run(together, 20), run(alone, 20)
    assert flows == pytest.approx(expected, rel=1e-9, abs=1e-12)
    assert len(state.bodies[0]["d"]) == len(together.bodies[0].X)


def test_the_force_holds_back_what_is_carried_away():
    surface = one_point(stiffness=3.0, damping=4.0, area=2.0)
    force = surface.force(np.array([[0.1, 0.0, -0.2]]), np.array([[1.0, 0.0, 0.0]]))
    assert force == pytest.approx(2.0 * np.array([[-0.3 - 4.0, 0.0, 0.6]]))


def test_points_slip_back_to_their_place():
    """One step from the same displacement: d' = d - slip d + what the flow carries, which both have in common."""
    held = model(MPI.COMM_WORLD, 10.0 * MMHG)
    state, _ = run(held, 20)
    d, slipping = state.bodies[0]["d"], copy(held.bodies[0])
    slipping.slip = 0.3 / DT
    one = fsi.step(held, state, DT).bodies[0]["d"]
    two = fsi.step(replace(held, bodies=(slipping,)), state, DT).bodies[0]["d"]
    assert MPI.COMM_WORLD.allreduce(float(np.abs(d).max(initial=0.0)), op=MPI.MAX) > 1e-9
    np.testing.assert_allclose(one - two, 0.3 * d, rtol=1e-9, atol=1e-15)


def test_a_point_too_near_to_a_side_is_refused():
    grid = MacGrid([0.0] * 3, [1.0] * 3, (10, 10, 10), [False] * 3, MPI.COMM_SELF)
    coupling = Coupling(grid, "piecewise_linear")
    coupling.stay(np.array([[0.5, 0.5, 0.05]]))
    with pytest.raises(StabilityError, match=r"0\.04"):
        coupling.stay(np.array([[0.5, 0.5, 0.04]]))


@pytest.mark.parametrize(
    ("stiffness", "damping", "slip"),
    [(0.0, 1.0, 0.0), (-1.0, 1.0, 0.0), (1.0, -1.0, 0.0), (math.nan, 1.0, 0.0), (1.0, 1.0, -1.0)],
)
def test_springs_that_cannot_hold_are_refused(stiffness, damping, slip):
    with pytest.raises(ValueError, match="expected stiffness > 0, damping >= 0 and slip >= 0"):
        one_point(stiffness=stiffness, damping=damping, slip=slip)
