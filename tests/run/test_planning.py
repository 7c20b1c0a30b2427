"""The plan of a run: its limits of the step are where runs go wrong."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from tests.coupled_case import block_model, coupled, moved, simulation
from valvefsi import fsi
from valvefsi.bodies.elastic import Elastic
from valvefsi.coupling.elemental import ElementalCoupling
from valvefsi.coupling.kernel_properties import largest_square_sum
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import StabilityError
from valvefsi.geometry.shapes import rectangle
from valvefsi.grid import MacGrid
from valvefsi.run.planning import plan, step_limits
from valvefsi.solid.elements.element_points import ElementPoints
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.structure import Structure

WORLD = MPI.COMM_WORLD


def largest_speed_after(model, dt, steps=200):
    """March a slightly disturbed block; return the largest speed at the end."""
    state = fsi.initial_state(model, dt)
    phase = 7.0 * model.bodies[0].solid.X
    noise = 1e-3 * np.stack(
        [np.sin(phase[:, 0] + 3 * phase[:, 1]), np.cos(phase[:, 1]), 0 * phase[:, 2]], axis=1
    )
    state = moved(state, chi=state.bodies[0]["chi"] + noise)
    for _ in range(steps):
        state = fsi.step(model, state, dt)
    return max(np.abs(c).max() for c in state.u)


@pytest.mark.parametrize("kernel", ["piecewise_linear", "bspline3", "ib6"])
def test_a_tether_is_stable_up_to_the_planned_step_and_not_far_beyond(kernel):
    model = block_model(load=2.0)
    model = coupled(model, Coupling(model.grid, kernel))
    limit = step_limits(model)["tether, block"]
    assert largest_speed_after(model, 0.95 * limit) < 0.1
    with pytest.raises(StabilityError):
        largest_speed_after(model, 1.3 * limit)


def test_the_elastic_limit_is_on_the_safe_side():
    model = block_model(load=2.0, tether=50.0)
    limits = step_limits(model)
    assert limits["elastic, block"] < 0.3 * limits["tether, block"]
    assert largest_speed_after(model, limits["elastic, block"]) < 0.1
    with pytest.raises(StabilityError):
        largest_speed_after(model, 4.5 * limits["elastic, block"])


def test_the_square_sum_of_ib4_is_three_eighths():
    assert largest_square_sum("ib4") == pytest.approx(3 / 8, abs=1e-12)
    assert largest_square_sum("piecewise_linear") == pytest.approx(1.0)


def test_the_plan_states_sizes_limits_give_and_time(shared_tmp):
    entries = {entry.quantity: entry for entry in plan(simulation(shared_tmp))}
    assert entries["cells"].value == 24 * 24
    assert entries["steps"].value == 40
    assert entries["points of block"].value == 9 * 5
    # 200 dyn/cm^2 on 10 of 20 cm, over 2e4 dyn/cm^3
    assert entries["static displacement of the tether on bottom (y)"].value == pytest.approx(100 / 2e4)
    assert entries["static displacement of the tether on top_loaded, top_outer (x)"].value == 0.0
    assert entries["CFL limit: largest speed"].value == pytest.approx(0.5 * (40 / 24) / 0.02)
    bounds = [e for q, e in entries.items() if q.startswith("step limit, ") and "measured" not in q]
    assert bounds
    for entry in bounds:
        assert entry.note.startswith("a rough lower bound; the step is")
        assert entry.note.endswith("; the measured limit below counts") is (entry.value < 0.02)
    measured = entries["step limit, measured at rest, block"]
    assert measured.value == pytest.approx(
        entries["step limit, tether, block"].value, rel=0.3
    )  # what binds here
    assert "unstable" not in measured.note
    for name in ("memory, all ranks", "time of a step", "expected time", "viscous limit"):
        assert entries[name].value > 0
    assert not (shared_tmp / "history.csv").exists()


@pytest.mark.parametrize(
    ("changes", "warned"),
    [
        ({"cells": 16}, []),
        ({"cells": 24}, ["fluid leaks between points: neighbours are 1.50 h apart"]),
        (
            {"cells": 16, "nu_stab": None},
            ["no volumetric energy", "without volumetric energy nodes 1.00 h apart"],
        ),
        ({"cells": 8, "nu_stab": None}, ["no volumetric energy"]),
        ({"cells": 16, "kernel": "ib4"}, ["ib4 was 3 to 6 % off"]),
        ({"cells": 8, "coupling": "elemental"}, []),
        ({"cells": 24, "coupling": "elemental"}, ["elemental coupling was 5 % and more off"]),
    ],
)
def test_the_plan_warns_where_a_case_leaves_the_safe_range(shared_tmp, changes, warned):
    choices = {"kernel": "bspline3", "coupling": "nodal"} | changes
    kernel, kind = choices.pop("kernel"), choices.pop("coupling")
    model = block_model(**choices)
    if kind == "elemental":
        coupling = ElementalCoupling(model.grid, kernel, ElementPoints(model.bodies[0].solid))
    else:
        coupling = Coupling(model.grid, kernel)
    run = simulation(shared_tmp, model=coupled(model, coupling))
    notes = [entry.note for entry in plan(run) if entry.quantity == "warning, block"]
    assert len(notes) == len(warned)
    for note, start in zip(notes, warned, strict=True):
        assert note.startswith(start)


@pytest.mark.parametrize(
    ("kernel", "height", "warned"),
    [
        ("bspline3", 0.5, []),
        ("bspline3", 0.2, ["it is 0.20 h thick; bending was measured down to 0.25 h"]),
        ("piecewise_linear", 0.5, ["piecewise_linear stiffens thin bodies"]),
        ("composite_bspline32", 0.2, ["it is 0.20 h thick", "composite_bspline32 stiffens thin bodies"]),
        ("piecewise_linear", 3.0, []),
    ],
)
def test_the_plan_warns_of_bodies_that_the_kernel_keeps_from_bending(kernel, height, warned):
    grid = MacGrid([0.0] * 2, [64.0] * 2, [64] * 2, [True] * 2, WORLD)
    mesh = rectangle(WORLD, lower=(2.0, 32.0), size=(60.0, height), elements=(60, 4))
    body = Elastic(Structure(mesh, NeoHookean(c1=1.0), name="strip"), Coupling(grid, kernel))
    notes = [entry.note for entry in body.size(grid) if entry.quantity == "warning, strip"]
    assert len(notes) == len(warned)
    for note, start in zip(notes, warned, strict=True):
        assert note.startswith(start)
