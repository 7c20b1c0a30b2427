"""Every demo of a valve: its plan, twenty steps of it on a coarse grid, and where its table is from."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from tests.case.test_case_valve import COARSE
from valvefsi.case import load_case
from valvefsi.case.build import build, plan_case, run_case
from valvefsi.case.expressions import read_table
from valvefsi.io.history import read_history

DEMOS = sorted((Path(__file__).parents[2] / "demos").glob("*.toml"))
VALVES = [path for path in DEMOS if "_valve" in path.stem]
LOOP = DEMOS[0].parent / "pericardial_valve_loop.csv"
STEPS = 20


def stem(path):
    return path.stem


@pytest.mark.parametrize("demo", DEMOS, ids=stem)
def test_every_demo_has_a_plan(demo):
    coarse = COARSE if demo in VALVES else ()
    told = {entry.quantity: entry for entry in plan_case(load_case(demo, coarse))["plan"]}
    assert {"cells", "steps", "time step", "expected time"} <= set(told)


@pytest.mark.parametrize("demo", VALVES, ids=stem)
def test_twenty_steps_of_a_valve(demo, shared_tmp):
    case = load_case(demo, [*COARSE, f"time.t_end='{40 * STEPS} us'"])
    run_case(case, out=shared_tmp / "run")
    history = read_history(shared_tmp / "run" / "history.csv")
    assert history["step"][-1] == STEPS
    assert np.isfinite([history[name] for name in history]).all()
    assert min(history["leaflets_J_min"]) > 0.9
    assert history["kinetic_energy_erg"][-1] > 0.0


def test_the_steady_demo_lets_in_the_flow_of_its_table(shared_tmp):
    demo = LOOP.parent / "pericardial_valve_steady.toml"
    for name, flow in (("flow", 350.0), ("half", 175.0)):
        table = f"pericardial_valve_steady_{name}.csv"
        case = load_case(demo, [*COARSE, f"fluid.sides.z_lower.table='{table}'"])
        assert read_table(demo.parent / table).at(0.025)["q_ml_s"] == pytest.approx(0.5 * flow, rel=1e-3)
        fluid = build(case, shared_tmp).model.fluid
        u = fluid.fill(tuple(fluid.grid.zeros() for _ in range(3)), 1.0)
        # Two millimetres to the cell, and a profile that falls from nearly all to nothing in two of them.
        assert -fluid.boundary.outflow(u, "z_lower") == pytest.approx(flow, rel=0.02)


def test_the_table_of_the_demos_is_of_the_loop_that_its_head_names():
    folder = LOOP.parents[1] / "calibration"
    sys.path.insert(0, str(folder))
    try:
        import bovine_loop
        import loop_model
    finally:
        sys.path.remove(str(folder))
    circuits = (
        bovine_loop.UpstreamBovine(**bovine_loop.UPSTREAM),
        bovine_loop.Downstream(**bovine_loop.DOWNSTREAM),
    )
    found, table = loop_model.run_loop(*circuits, bovine_loop.drive, 2), read_table(LOOP)
    start = found["t"][np.argmin(np.abs(found["t"] - 0.1))]
    for name, unit in (("q_pump", "ml_s"), ("p_la", "mmHg"), ("p_lv", "mmHg"), ("p_ao", "mmHg")):
        expected = np.interp(start + table.t, found["t"], found[name])
        np.testing.assert_allclose(table.columns[f"{name}_{unit}"], expected, atol=2e-3)
