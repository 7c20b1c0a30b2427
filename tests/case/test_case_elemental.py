"""Elemental coupling asked for in a case file: it is built, it runs on any ranks, and it is not the nodal one."""

from __future__ import annotations

from pathlib import Path

import pytest

from valvefsi.case import load_case
from valvefsi.case.build import build, run_case
from valvefsi.coupling.elemental import ElementalCoupling
from valvefsi.coupling.transfer import Coupling
from valvefsi.io.history import read_history

DEMO = Path(__file__).parents[2] / "demos" / "compressed_block.toml"
SHORT = ("time.t_end='1.5 s'", "output.frames=0", "output.history_every=10")


def sink(folder: Path, *overrides: str) -> float:
    """How far the loaded top has gone down."""
    run_case(load_case(DEMO, [*SHORT, *overrides]), out=folder)
    history = read_history(folder / "history.csv")
    return history["u_y_top_centre_cm"][-1]


def test_the_coupling_of_a_case_is_the_one_it_names(shared_tmp):
    kinds = {"nodal": Coupling, "elemental": ElementalCoupling}
    for name, kind in kinds.items():
        simulation = build(load_case(DEMO, [f"solid.block.coupling={name}"]), shared_tmp)
        assert isinstance(simulation.model.bodies[0].coupling, kind)


def test_both_couplings_sink_alike_but_not_the_same(shared_tmp):
    nodal = sink(shared_tmp / "nodal")
    elemental = sink(shared_tmp / "elemental", "solid.block.coupling=elemental")
    assert nodal < -1e-3
    assert elemental == pytest.approx(nodal, rel=0.05)
    assert elemental != pytest.approx(nodal, rel=1e-6)


def test_the_gap_between_points_is_taken_from_the_case(shared_tmp):
    points = []
    for gap in (0.25, 1.0):
        overrides = ["solid.block.coupling=elemental", f"solid.block.point_gap={gap}"]
        model = build(load_case(DEMO, overrides), shared_tmp).model
        solid, coupling = model.bodies[0].solid, model.bodies[0].coupling
        rule = coupling.points.refined(solid.X, gap * model.grid.spacing[0])
        count = model.grid.comm.allreduce(len(rule.x))
        assert count == model.grid.comm.allreduce(len(coupling.at(solid.X).rule.x))
        points.append(count)
    assert points[0] > 2 * points[1]
