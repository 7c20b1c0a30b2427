"""What a step of a beating valve does, counted: none of it depends on the machine, and all of it costs time."""

from __future__ import annotations

import tracemalloc
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.case import load_case
from valvefsi.case.build import build
from valvefsi.coupling import kernels
from valvefsi.fluid.axes import Axis
from valvefsi.fluid.direct_solver import TensorSolver
from valvefsi.fluid.navier_stokes import ExplicitViscosity
from valvefsi.grid import MacGrid
from valvefsi.run.stable_step import stable_step
from valvefsi.solid.structure import Structure

DEMO = Path(__file__).parents[1] / "demos" / "pericardial_valve.toml"
COARSE = (
    "grid.h=2mm",
    "grid.core_lower=['-2.1 cm', '-2.1 cm', '-2 cm']",
    "grid.core_upper=['2.1 cm', '2.1 cm', '6 cm']",
    "solid.leaflets.mesh.valve.ratio=1.5",
    "time.dt_per_h='0.0002 s/cm'",
)
COUNTED = {
    (TensorSolver, "solve"): "solves",
    (Axis, "transform"): "transforms",
    (ExplicitViscosity, "advection"): "advection terms",
    (MacGrid, "zeros"): "cleared arrays",
    (Structure, "force"): "elastic forces",
    (kernels, "spread"): "spreads",
    (kernels, "interpolate"): "interpolations",
}
STEP = {
    "solves": 1,
    "transforms": 6,  # three there and three back
    "advection terms": 1,
    "cleared arrays": 11,  # the force, two of unresolved slip, the pressure and its correction
    "elastic forces": 1,
    "spreads": 4,  # leaflets, housing, and two of unresolved slip
    "interpolations": 5,  # leaflets before and after the fluid's step, housing after it, and two of unresolved slip
    "messages": 6,  # what bodies give, two outflows, the loss of a mean pressure, the sides' values, the total source
}
"""Most of each in a step on one rank."""


class CountedComm(MPI.Intracomm):
    """A communicator that counts what is asked of it."""

    counts: Counter[str] = Counter()


def _counted(name):
    def call(self, *args, **options):
        CountedComm.counts["messages"] += 1
        return getattr(super(CountedComm, self), name)(*args, **options)

    return call


for name in ("allreduce", "Allreduce", "bcast", "Bcast", "Sendrecv", "Alltoallv", "allgather", "barrier"):
    setattr(CountedComm, name, _counted(name))


@pytest.fixture(scope="module")
def valve(tmp_path_factory):
    """The valve on a coarse grid after a first step, on this rank alone."""
    folder = tmp_path_factory.mktemp("valve")
    simulation = build(load_case(DEMO, COARSE), folder, CountedComm(MPI.COMM_SELF))
    model, dt = simulation.model, simulation.schedule.dt
    return model, fsi.step(model, fsi.initial_state(model, dt), dt), dt


@pytest.fixture
def counts(monkeypatch):
    """Counts from now on."""
    found = CountedComm.counts = Counter()

    def count(holder, method, name):
        inner = getattr(holder, method)

        def call(*args, **options):
            found[name] += 1
            return inner(*args, **options)

        monkeypatch.setattr(holder, method, call)

    for (holder, method), name in COUNTED.items():
        count(holder, method, name)
    return found


def test_a_step_does_no_more_than_it_did(valve, counts):
    model, state, dt = valve
    fsi.step(model, state, dt)
    assert counts.keys() == STEP.keys()
    assert {name: count for name, count in counts.items() if count > STEP[name]} == {}


def test_a_step_holds_no_more_memory_than_it_did(valve):
    """In arrays of the grid: the new u, p and N, the force, half steps of the bodies, and what each part works on."""
    model, state, dt = valve
    tracemalloc.start()
    new = fsi.step(model, state, dt)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert new.step == state.step + 1
    assert peak < 21.0 * state.p.nbytes


def test_measuring_the_stable_step_again_costs_two_solves_and_eight_elastic_forces(valve, counts):
    model, state, dt = valve
    first = stable_step(model, state, dt)
    assert counts["solves"] <= 8
    assert counts["elastic forces"] <= 18
    counts.clear()
    again = stable_step(model, replace(state, modes=first.modes, energies=first.energies), dt)
    assert counts["solves"] <= 2
    assert counts["elastic forces"] <= 8
    assert counts["advection terms"] == 0
    assert again.limit == pytest.approx(first.limit, rel=0.03)
