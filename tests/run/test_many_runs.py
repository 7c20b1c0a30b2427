"""Many runs in one process: what each leaves behind is freed, so that MPI does not run out of communicators."""

from __future__ import annotations

import gc
import weakref

import pytest
from mpi4py import MPI

from tests.coupled_case import block_model, simulation
from valvefsi.case import parse_case
from valvefsi.case.build import run_case
from valvefsi.runtime.memory import KEPT_RUNS

BLOCK = {
    "grid": {"lower": [0, 0], "upper": [1, 1], "cells": [16, 16]},
    "fluid": {"viscosity": 0.1, "sides": {"y_upper": {"velocity": [1.0, 0.0]}}},
    "time": {"dt": "2 ms", "t_end": "4 ms"},
    "output": {"frames": 0},
    "solid": [
        {
            "name": "block",
            "mesh": {
                "shape": "rectangle",
                "lower": [0.375, 0.375],
                "size": [0.25, 0.25],
                "elements": [4, 4],
            },
            "material": {"model": "neo_hookean", "c1": 10.0},
        }
    ],
}


@pytest.fixture
def without_collector():
    gc.disable()
    yield
    gc.enable()


def test_runs_that_are_held_by_cycles_are_freed(shared_tmp, without_collector):
    model, alive = block_model(), []
    for _ in range(3 * KEPT_RUNS):
        run = simulation(shared_tmp, model=model)
        run.itself = run
        alive.append(weakref.ref(run))
        del run
    assert sum(each() is not None for each in alive) <= KEPT_RUNS


def free_communicators():
    """Number of communicators that can still be made."""
    before, made = MPI.COMM_SELF.Get_errhandler(), []
    MPI.COMM_SELF.Set_errhandler(MPI.ERRORS_RETURN)
    try:
        while len(made) < 4096:
            made.append(MPI.COMM_SELF.Dup())
    except MPI.Exception:
        pass
    for each in made:
        each.Free()
    MPI.COMM_SELF.Set_errhandler(before)
    return len(made)


@pytest.mark.slow
@pytest.mark.serial
def test_two_hundred_runs_leave_most_communicators(tmp_path):
    """Of some two thousand; each of these runs, with its pictures, held eight of them in a cycle."""
    first = free_communicators()
    for number in range(200):
        run_case(parse_case(BLOCK), out=tmp_path / str(number), comm=MPI.COMM_WORLD)
    assert free_communicators() > first - 20 * KEPT_RUNS
