"""Rigid surfaces in the coupled step: leaks through a closed tube, forces, ranks."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.bodies.patches import PatchedSurface
from valvefsi.bodies.rigid import RigidSurface, explicit_springs
from valvefsi.coupling.kernel_properties import largest_square_sum
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import StabilityError
from valvefsi.fluid.boundary import Boundary, Disk, Mixed, Open
from valvefsi.fluid.navier_stokes import ExplicitViscosity, NavierStokes
from valvefsi.geometry.aortic_section import AorticSection, closing_plate, joined
from valvefsi.geometry.patches import SINGLE, patch_labels
from valvefsi.grid import MacGrid
from valvefsi.run.checkpoints import load_state, memory_of, save_state
from valvefsi.run.recording import Output
from valvefsi.units import MMHG

RADIUS, LENGTH, H, DT = 0.6, 1.0, 0.1, 5e-5


def model(comm, pressure, *, closed=True, patched=False):
    """A tube from side to side of a box, with or without a plate that shuts it, under a pressure difference.

    In patches it is longer, as points near the plate and the sides are held one by one, and the fluid is a valve's.
    """
    length, cells = (1.6, 16) if patched else (LENGTH, 10)
    grid = MacGrid([-1.0, -1.0, 0.0], [1.0, 1.0, length], (20, 20, cells), [False] * 3, comm)
    ends = {"z_lower": (0.0, pressure), "z_upper": (length, 0.0)}
    sides = {
        name: Mixed(open=Open(pressure=p), where=Disk(centre=(0.0, 0.0, z), radius=RADIUS))
        for name, (z, p) in ends.items()
    }
    kind, advection = (ExplicitViscosity, "xsppm7") if patched else (NavierStokes, "centred")
    fluid = kind(grid, Boundary(grid, sides), rho=1.0, mu=0.04, advection=advection)
    section = AorticSection(inlet_radius=RADIUS, outlet_radius=RADIUS, sinus_depth=0.0)
    ends = (0.5 * H, length - 0.5 * H)
    surfaces = [section.housing(H, ends), closing_plate(RADIUS, 0.5 * length, H)][: 2 if closed else 1]
    surface, kernel = joined(*surfaces), "composite_bspline32" if patched else "piecewise_linear"
    coupling, share = Coupling(grid, kernel), 0.25 * H / largest_square_sum(kernel)
    springs = {"name": "tube", "stiffness": share / DT**2, "damping": share / DT}
    if patched:
        labels = patch_labels(surfaces, H, ends)
        labels[len(surfaces[0].points) :] = SINGLE
        assert (labels != SINGLE).mean() > 0.25
        rigid = PatchedSurface(surface, labels, coupling, **springs)
    else:
        rigid = RigidSurface(surface.points, surface.areas, coupling, **springs)
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


@pytest.mark.parametrize("patched", [False, True])
def test_a_closed_tube_does_not_leak(patched):
    _, flows = run(model(MPI.COMM_WORLD, 100.0 * MMHG, patched=patched), 2400)
    leak = abs(flows[1800:].mean())
    assert leak < 0.1  # ml/s at 100 mmHg and h = 1 mm, what is asked of the aortic test section
    assert np.abs(flows).max() > 1.0  # the pressure does push: the springs give before they hold


def test_an_open_tube_lets_the_fluid_through():
    pressure, steps = 10.0, 100
    _, flows = run(model(MPI.COMM_WORLD, pressure, closed=False), steps)
    t = steps * DT
    inertial = math.pi * RADIUS**2 * pressure * t / LENGTH  # rho L dU/dt = p while friction is small
    assert 0.5 * inertial < flows[-1] < 1.1 * inertial


@pytest.mark.parametrize("patched", [False, True])
def test_every_point_belongs_to_one_rank_and_the_flow_does_not_depend_on_ranks(patched):
    together, alone = (model(comm, 50.0 * MMHG, patched=patched) for comm in (MPI.COMM_WORLD, MPI.COMM_SELF))
    ids = np.concatenate(MPI.COMM_WORLD.allgather(together.bodies[0].ids))
    assert np.array_equal(np.sort(ids), np.arange(together.bodies[0].num_points))
    (state, flows), (_, expected) = run(together, 20), run(alone, 20)
    assert flows == pytest.approx(expected, rel=1e-9, abs=1e-12)
    assert len(state.bodies[0]["d"]) == len(together.bodies[0].X)


@pytest.mark.parametrize("patched", [False, True])
def test_the_velocity_that_a_surface_keeps_is_the_fluids(patched):
    """Steps of unequal length: it is twice the one at their middle less the one before."""
    tube = model(MPI.COMM_WORLD, 50.0 * MMHG, patched=patched)
    state, surface = fsi.initial_state(tube, DT), tube.bodies[0]
    for k in range(12):
        state = fsi.step(tube, state, DT * (1.0 if k % 3 else 0.7))
    U = surface.felt(state.u)
    largest = MPI.COMM_WORLD.allreduce(float(np.abs(U).max(initial=0.0)), op=MPI.MAX)
    assert largest > 0.1
    np.testing.assert_allclose(state.bodies[0]["U"], U, atol=1e-12 * largest)


def test_a_checkpoint_without_that_velocity_is_gone_on_from(shared_tmp):
    tube = model(MPI.COMM_WORLD, 50.0 * MMHG, patched=True)
    state, _ = run(tube, 4)
    output = Output(directory=shared_tmp)
    old = replace(state, bodies=({"d": state.bodies[0]["d"]},))
    save_state(tube, old, output, memory_of(tube, output))
    found = load_state(tube, output, memory_of(tube, output))
    largest = MPI.COMM_WORLD.allreduce(float(np.abs(state.bodies[0]["U"]).max(initial=0.0)), op=MPI.MAX)
    for key, values in state.bodies[0].items():
        np.testing.assert_allclose(found.bodies[0][key], values, atol=1e-12 * largest, err_msg=key)


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


def test_slip_may_differ_by_point_and_direction():
    slip = np.array([[[0.0, 0.0, 0.0], [0.0, 20.0, -10.0], [0.0, -10.0, 20.0]]])
    surface = one_point(stiffness=3.0, damping=4.0, slip=slip)
    q = {"d": np.array([[1.0, 2.0, 3.0]]), "U": np.zeros((1, 3))}
    half = surface.half(q, surface_at_rest(), 0.0, 0.01, 0.01)
    np.testing.assert_allclose(half.whole(np.zeros((1, 3)))["d"], [[1.0, 1.9, 2.6]], rtol=1e-14)


def surface_at_rest():
    """A velocity of zero on the grid of `one_point`, ghosts included."""
    return MacGrid([0.0] * 3, [1.0] * 3, (8, 8, 8), [False] * 3, MPI.COMM_SELF).zero_faces()


def test_a_point_too_near_to_a_side_is_refused():
    grid = MacGrid([0.0] * 3, [1.0] * 3, (10, 10, 10), [False] * 3, MPI.COMM_SELF)
    coupling = Coupling(grid, "piecewise_linear")
    coupling.stay(np.array([[0.5, 0.5, 0.05]]))
    with pytest.raises(StabilityError, match=r"0\.04"):
        coupling.stay(np.array([[0.5, 0.5, 0.04]]))


def test_half_a_spacing_from_a_side_a_composite_kernel_meets_nothing_beyond_it():
    grid = MacGrid([0.0] * 3, [1.0] * 3, (10, 10, 10), [False] * 3, MPI.COMM_SELF)
    coupling = Coupling(grid, "composite_bspline32")
    with pytest.raises(StabilityError, match=r"0\.04"):
        coupling.stay(np.array([[0.5, 0.5, 0.04]]))
    for place in (0.05, 0.95):
        u = tuple(np.full(grid.shape, 1e30) for _ in range(3))
        for d in range(3):
            u[d][grid.owned_faces(d)] = 1.0
        for axis in range(3):
            X = np.full((1, 3), 0.43)
            X[0, axis] = place
            assert coupling.stay(X).interpolate(u) == pytest.approx(np.ones((1, 3)))


@pytest.mark.parametrize(
    ("stiffness", "damping", "slip"),
    [(0.0, 1.0, 0.0), (-1.0, 1.0, 0.0), (1.0, -1.0, 0.0), (math.nan, 1.0, 0.0), (1.0, 1.0, -1.0)]
    + [(1.0, 1.0, np.array([[[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]]))],
)
def test_springs_that_cannot_hold_are_refused(stiffness, damping, slip):
    with pytest.raises(ValueError, match="expected stiffness > 0, damping >= 0 and slip >= 0"):
        one_point(stiffness=stiffness, damping=damping, slip=slip)


@pytest.mark.parametrize(("kernel", "squares"), [("piecewise_linear", 1.0), ("ib4", 3.0 / 8.0)])
def test_springs_of_a_surface_are_a_part_of_what_the_fluid_its_kernel_moves_bears(kernel, squares):
    """A damper on every point of a plane stops rho h / sum of squares per area, its worst shift, within a step."""
    held = explicit_springs(kernel, 0.1, 1e-3, 0.5, rho=2.0)
    assert held["damping"] == pytest.approx(0.5 * 2.0 * 0.1 / squares / 1e-3)
    assert held["stiffness"] == pytest.approx(0.5 * 2.0 * 0.1 / squares / 1e-6)
