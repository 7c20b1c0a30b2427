"""The fluid behind a wall, held still: which faces, forces and velocities there, what flows, ranks."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.bodies.filling import Filling
from valvefsi.coupling.transfer import Coupling
from valvefsi.fluid.boundary import Boundary
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.geometry.aortic_section import AorticSection
from valvefsi.grid import MacGrid

H, R, DT = 0.25, 0.7, 1e-3
TUBE = AorticSection(inlet_radius=R, outlet_radius=R, sinus_depth=0.0)


def model(comm, hold=0.25):
    """Periodic along the axis of a tube, walls around."""
    grid = MacGrid([-1.5, -1.5, 0], [1.5, 1.5, 1.0], [12, 12, 4], [False, False, True], comm)
    fluid = NavierStokes(grid, Boundary(grid), rho=2.0, mu=0.01)
    held = {"stiffness": 2.0 * hold / DT**2, "damping": 2.0 * hold / DT}
    filling = Filling(TUBE.housing(0.5 * H, (0.0, 1.0)), Coupling(grid, "bspline3"), name="filling", **held)
    return fsi.Model(grid=grid, fluid=fluid, bodies=(filling,))


def behind(grid, d):
    """How far behind the wall the local faces of component d lie, in spacings."""
    x, y, z = grid.points(d)
    return ((np.hypot(x, y) - R) / H + 0.0 * z)[grid.owned_faces(d)]


def streaming(comm, steps=60):
    """A uniform stream along the axis that the filling has stopped outside of the tube."""
    it = model(comm)
    u = it.grid.zero_faces()
    u[2][...] = 1.0
    state = fsi.initial_state(it, DT, u=u)
    for _ in range(steps):
        state = fsi.step(it, state, DT)
    return it, state


def test_the_fluid_stops_behind_the_wall_and_not_before_it(comm):
    it, state = streaming(comm)
    w, depth = state.u[2][it.grid.owned_faces(2)], behind(it.grid, 2)
    assert np.abs(w[depth > 0.55]).max(initial=0.0) < 1e-3
    assert w[depth < -0.5].min(initial=1.0) > 0.9


def test_the_springs_take_over_what_the_dampers_began(comm):
    """In a stream that is driven for long the fluid behind the wall comes back to rest, however it is pushed."""
    it, state = streaming(comm, 400)
    w = state.u[2][it.grid.owned_faces(2)][behind(it.grid, 2) > 0.55]
    assert np.abs(w).max(initial=0.0) < 1e-5
    assert it.bodies[0].stored(state.bodies[0]) > 0.0


def test_forces_and_velocities_are_those_of_the_faces_behind_the_wall(comm):
    it = model(comm)
    filling, grid = it.bodies[0], it.grid
    u = tuple(np.random.default_rng(comm.rank + d).standard_normal(grid.shape) for d in range(3))
    F = np.random.default_rng(7 + comm.rank).standard_normal(filling.X.shape)
    f, U = filling.transfer.spread(F), filling.transfer.interpolate(u)
    inside = [(f[d] * u[d] * grid.volumes(d))[grid.owned_faces(d)].sum() for d in range(3)]
    assert sum(inside) == pytest.approx((F * U).sum(), rel=1e-12)
    for d in range(3):
        reached = f[d][grid.owned_faces(d)] != 0.0
        depth = behind(grid, d)
        unknown = np.zeros(grid.shape, dtype=bool)
        unknown[grid.unknown_faces(d)] = True
        assert not reached[depth < 0.45].any()
        assert reached[(depth > 0.55) & unknown[grid.owned_faces(d)]].all()


def test_the_memory_it_tells_of_is_what_a_step_holds_at_its_peak():
    tracemalloc.start()
    it = model(MPI.COMM_SELF)
    filling, u = it.bodies[0], it.grid.zero_faces()
    before, _ = tracemalloc.get_traced_memory()
    tracemalloc.reset_peak()
    half = filling.half(filling.start(u), u, 0.0, DT, DT)
    half.whole(half.velocity(u))
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    held = sum(a.nbytes for a in (filling.X, filling.points, filling.weights, filling.ids))
    transfer = filling.transfer
    held += transfer.cells.nbytes + transfer.volumes.nbytes
    assert filling.memory() == pytest.approx(held + most - before, rel=0.2)


def test_forces_are_added_to_those_of_other_bodies(comm):
    it = model(comm)
    transfer, grid = it.bodies[0].transfer, it.grid
    F = np.random.default_rng(5 + comm.rank).standard_normal(it.bodies[0].X.shape)
    others = tuple(np.full(grid.shape, 2.0 + d) for d in range(3))
    for d, (both, alone) in enumerate(zip(transfer.spread(F, others), transfer.spread(F), strict=True)):
        np.testing.assert_allclose(both, alone + 2.0 + d, rtol=1e-12)


def test_it_does_not_depend_on_the_number_of_ranks():
    norms = []
    for comm in (MPI.COMM_WORLD, MPI.COMM_SELF):
        it, state = streaming(comm, 10)
        here = sum(float((c[it.grid.owned_faces(d)] ** 2).sum()) for d, c in enumerate(state.u))
        norms.append(comm.allreduce(here))
    assert norms[0] == pytest.approx(norms[1], rel=1e-12)
