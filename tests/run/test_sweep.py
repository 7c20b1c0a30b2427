"""Many small runs in one process: an MPI library has only some two thousand communicators, and none may be lost."""

from __future__ import annotations

import gc

import numpy as np
import pytest

from valvefsi.runtime import dolfinx_compat  # noqa: F401

# isort: split
from dolfinx import fem
from mpi4py import MPI

from tests.coupled_case import block_model, coupled, simulation
from valvefsi import fsi
from valvefsi.coupling.elemental import ElementalCoupling
from valvefsi.fluid.boundary import Boundary, Wall
from valvefsi.fluid.krylov import CoupledNavierStokes
from valvefsi.geometry.shapes import box, rectangle
from valvefsi.grid import MacGrid
from valvefsi.solid import statics
from valvefsi.solid.dynamics import GeneralisedAlpha, MovingSolid
from valvefsi.solid.elements.element_points import ElementPoints
from valvefsi.solid.loads import DeadLoad
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.materials.fibres import blend
from valvefsi.solid.stress import Stress

MATERIAL = NeoHookean(c1=50.0)
FIXED = [statics.Fixed(on=("x_lower",))]
LIMIT = 5000
"""Beyond it a library is taken to have no end of them."""


def left():
    """Communicators that this process can still make."""
    made = []
    try:
        while len(made) < LIMIT:
            made.append(MPI.COMM_SELF.Dup())
    except MPI.Exception:
        pass
    for one in made:
        one.Free()
    return len(made)


def static_solution(comm):
    mesh = rectangle(comm, size=(2.0, 1.0), elements=(4, 2))
    load = DeadLoad(on=("x_upper",), traction=(1.0, 0.0))
    return statics.solve(mesh, MATERIAL, fixed=FIXED, loads=[load])


def stress(comm):
    mesh = rectangle(comm, size=(2.0, 1.0), elements=(4, 2)).mesh
    u = fem.Function(fem.functionspace(mesh, ("Lagrange", 1, (2,))))
    return Stress(u, MATERIAL, kappa=170.0).gather("cauchy")


def motion(comm):
    stepper = GeneralisedAlpha(
        MovingSolid(rectangle(comm, size=(2.0, 1.0), elements=(4, 2)), MATERIAL, density=1.0, supports=FIXED),
        1e-3,
    )
    stepper.step()
    stepper.destroy()


def fibres(comm):
    mesh = box(comm, size=(1.0, 1.0, 1.0), elements=(2, 2, 2))
    return blend(mesh, angles={"x_lower": -30.0, "x_upper": 30.0}, axis=(0.0, 0.0, 1.0))


def steps(comm):
    model = block_model(comm, cells=12, elements=(4, 2))
    elemental = ElementalCoupling(model.grid, "bspline3", ElementPoints(model.bodies[0].solid))
    for one in (model, coupled(model, elemental)):
        fsi.step(one, fsi.initial_state(one, 0.01), 0.01)


def coupled_fluid(comm):
    grid = MacGrid((0, 0), (1, 1), (16, 16), (False, False), comm)
    boundary = Boundary(grid, {"y_upper": Wall(velocity=(1.0, 0.0))})
    fluid = CoupledNavierStokes(grid, boundary, rho=1.0, mu=0.1)
    u = fluid.fill(grid.zero_faces(), 0.0)
    N = fluid.advection(u)
    return fluid.step(u, grid.zeros(), (N, N, 1.0), grid.zero_faces(), 0.0, 0.01)


BUILDS = (static_solution, stress, motion, fibres, steps, coupled_fluid)


@pytest.mark.parametrize("build", BUILDS, ids=lambda build: build.__name__)
def test_no_communicator_is_lost(comm, build):
    build(comm)
    gc.collect()
    before = left()
    for _ in range(3):
        build(comm)
    gc.collect()
    assert left() == before


def test_a_run_with_its_files_gives_its_communicators_back(comm, shared_tmp):
    def run(number):
        model = block_model(comm, cells=12, elements=(4, 2))
        simulation(shared_tmp / str(number), comm, steps=2, model=model).run()

    run(0)
    gc.collect()
    before = left()
    for number in (1, 2, 3):
        run(number)
    gc.collect()
    assert left() == before


@pytest.mark.skipif(MPI.COMM_WORLD.size % 2 != 0, reason="one rank has no rows")
def test_grids_on_one_communicator_share_those_of_its_rows_and_columns(comm):
    def make():
        return MacGrid((0, 0, 0), (1, 1, 1), (16, 16, 16), (True, True, True), comm, (comm.size // 2, 2))

    first, before = make(), left()
    second = make()
    assert second.axis_comms == first.axis_comms
    assert left() == before
    np.testing.assert_equal(first.axis_comms[1].size, 2)
