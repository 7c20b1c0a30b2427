"""The cylinder: read-off numbers of a known signal, forces on a held ring, what the command writes."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.benchmarks.flows.cylinder import Cylinder, Forces, build, numbers, stream
from valvefsi.benchmarks.frame import Job
from valvefsi.benchmarks.options import defaults
from valvefsi.errors import CaseError

WORLD = MPI.COMM_WORLD


def test_drag_lift_and_frequency_of_a_known_signal_are_read_off():
    t = np.linspace(0.0, 100.0, 20001)
    found = numbers(
        Forces(t, 1.3 + 0.01 * np.cos(4 * np.pi * 0.17 * t), 0.02 + 0.33 * np.sin(2 * np.pi * 0.17 * t))
    )
    assert found["drag"] == pytest.approx(1.3, abs=1e-4)
    assert found["lift"] == pytest.approx(0.33, abs=1e-4)
    assert found["strouhal"] == pytest.approx(0.17, rel=1e-5)


def test_the_amplitude_of_an_irregular_lift_is_the_mean_over_its_periods():
    t = np.linspace(0.0, 300.0, 60001)
    swell = 1.0 + 0.1 * np.sin(2 * np.pi * 0.17 / 17 * t)
    found = numbers(Forces(t, np.ones_like(t), 0.33 * swell * np.sin(2 * np.pi * 0.17 * t)))
    assert found["lift"] == pytest.approx(0.33, rel=5e-3)


def test_a_ring_in_a_flow_feels_drag_and_hardly_any_lift_at_first(shared_tmp):
    """Coarse and early: the drag has the size of that of a bluff body."""
    benchmark = Cylinder(cells=8, overrides=["t_end=2", "width=12"])
    record = benchmark.one(8, Job(folder=shared_tmp, comm=WORLD))
    f = record["_forces"]
    assert len(f.t) == record["steps"]
    late = f.t > 1.0
    assert 1.0 < f.drag[late].mean() < 4.0
    assert np.abs(f.lift[late]).max() < f.drag[late].mean()


def test_points_stay_at_their_places_though_the_kernel_does_not_feel_them_stray():
    model, dt = build(8, defaults(Cylinder.parameters) | {"width": 12.0}, WORLD)
    strayed = []
    for slip in (model.bodies[0].slip, 0.0):
        ring = copy(model.bodies[0])
        ring.slip = slip
        held = replace(model, bodies=(ring,))
        state = fsi.initial_state(held, dt, stream(held.grid))
        for _ in range(round(10.0 / dt)):
            state = fsi.step(held, state, dt)
        farthest = float(np.abs(state.bodies[0]["d"]).max(initial=0.0))
        strayed.append(WORLD.allreduce(farthest, op=MPI.MAX))
    assert strayed[0] < 0.05 / 8
    assert strayed[1] > 0.2 / 8, "without slip they stray, and go on"


def test_the_answer_on_a_mesh_that_fits_is_compared_with_in_its_box_alone():
    record = {
        "quantities": {"drag": 1.0, "lift": 1.0, "strouhal": 1.0},
        "grid": {},
        "steps": 1,
        "cells": 1,
        "wall_s": 1,
    }
    table = Cylinder(overrides=["reynolds=200"]).report([record], None).table
    assert [entry["reference"] for entry in table[3:]] == [1.3371, 0.6798, 0.19654]
    assert {entry["source"] for entry in Cylinder(overrides=["width=12"]).report([record], None).table} == {
        "PetIBM; Liu et al. 1998"
    }
    other = Cylinder(overrides=["reynolds=150"]).report([record], None).table
    assert [entry["reference"] for entry in other] == [None] * 3


def test_points_lie_inside_the_circle_by_the_kernels_offset():
    parameters = defaults(Cylinder.parameters) | {"width": 12.0}
    radii = []
    for draw_in in (0.0, 1.0):
        model, _ = build(16, parameters | {"draw_in": draw_in}, WORLD)
        ring = model.bodies[0]
        r = np.hypot(ring.points[:, 0], ring.points[:, 1])
        assert np.ptp(r) < 1e-12
        length = WORLD.allreduce(ring.weights.sum())
        assert length == pytest.approx(2 * np.pi * r[0])
        radii.append(r[0])
    assert radii == pytest.approx([0.5, 0.5 - 7 / 30 / 16])


@pytest.mark.parametrize("override", ["draw_in=-1", "draw_in=3", "width=0", "kernle=ib4"])
def test_parameters_out_of_range_are_refused(override):
    key = override.partition("=")[0]
    with pytest.raises(CaseError, match=key):
        Cylinder(overrides=[override])
