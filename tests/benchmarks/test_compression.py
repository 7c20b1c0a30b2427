"""The compressed block, immersed, against the incompressible reference (Lee2020, E.1)."""

from __future__ import annotations

import json

import pytest
from mpi4py import MPI

from valvefsi.benchmarks.compression import Setup, compression_case, run
from valvefsi.errors import CaseError

REFERENCE = -3.9212  # cm, see tests/reference/compression_statics.csv
COARSE = {"elements": 16, "grid": 32}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return MPI.COMM_WORLD.bcast(tmp_path_factory.mktemp("compression"), root=0)


@pytest.fixture(scope="module")
def coarse(folder):
    """The coarsest grid of the study, stabilised."""
    return run(Setup(**COARSE), out=folder / "coarse")


def test_the_coarse_grid_is_within_three_per_cent_of_the_incompressible_reference(coarse):
    u_y = coarse["quantities"]["u_y_top_centre_cm"]
    assert abs(u_y - REFERENCE) < 0.03 * abs(REFERENCE)
    assert coarse["relative_error"] == pytest.approx(
        (u_y - coarse["reference"]["u_y_top_centre_cm"]) / abs(coarse["reference"]["u_y_top_centre_cm"])
    )


def test_the_reference_of_the_run_is_the_converged_one(coarse):
    assert coarse["reference"]["u_y_top_centre_cm"] == pytest.approx(REFERENCE, rel=5e-4)


def test_result_json_holds_what_it_promises(coarse, folder):
    stored = json.loads((folder / "coarse" / "result.json").read_text())
    assert {
        "benchmark",
        "parameters",
        "quantities",
        "reference",
        "relative_error",
        "timing",
        "environment",
    } <= set(stored)
    assert {"u_y_top_centre_cm", "area_change_percent", "J_min", "J_max"} <= set(stored["quantities"])
    assert {"steps", "cells", "wall_s", "cell_steps_per_s", "phases"} <= set(stored["timing"])
    assert stored["quantities"] == coarse["quantities"]
    assert stored["timing"]["cells"] == 32 * 32
    assert stored["environment"]["ranks"] == MPI.COMM_WORLD.size


def test_pictures_case_history_and_series_are_left_behind(coarse, folder):
    for name in (
        "flow.png",
        "histories.png",
        "case.toml",
        "history.csv",
        "paraview/fluid.pvd",
        "paraview/block.pvd",
    ):
        assert (folder / "coarse" / name).stat().st_size > 0, name


def test_stabilisation_narrows_the_range_of_J(coarse, folder):
    free = run(Setup(**COARSE, nu_stab=None), out=folder / "free")["quantities"]
    held = coarse["quantities"]
    assert held["J_max"] - held["J_min"] < free["J_max"] - free["J_min"]


def test_the_answer_does_not_depend_on_the_viscosity_beyond_two_tenths_of_a_per_cent(coarse, folder):
    thick = run(Setup(**COARSE, overrides=["mu=0.16"]), out=folder / "thick")["quantities"]
    thin = coarse["quantities"]
    assert abs(thick["u_y_top_centre_cm"] / thin["u_y_top_centre_cm"] - 1) < 2e-3


@pytest.mark.slow
@pytest.mark.parametrize(("elements", "bound"), [(32, 0.02), (64, 0.012)])
def test_finer_grids_come_closer(elements, bound, coarse, folder):
    finer = run(Setup(elements=elements, grid=2 * elements), out=folder / f"M{elements}")
    error = abs(finer["quantities"]["u_y_top_centre_cm"] / REFERENCE - 1)
    assert error < bound
    assert error < abs(coarse["quantities"]["u_y_top_centre_cm"] / REFERENCE - 1)


def test_short_names_reach_the_case_with_units():
    overrides = ["traction=30 Pa", "c1=100", "mu=1 cP", "t_end=2", "tether_stiffness=2e4", "time.cfl_max=0.2"]
    case = compression_case(Setup(**COARSE, kernel="ib4", nu_stab=None, overrides=overrides))
    solid = case.solid[0]
    assert solid.load[0].traction == (0.0, -300.0)
    assert solid.load[0].ramp == pytest.approx(0.4 * 2)
    assert solid.material.parameters["c1"] == 100.0
    assert solid.damping == pytest.approx(0.05 * 100)
    assert case.fluid.viscosity == pytest.approx(0.01)
    assert {tether.stiffness for tether in solid.tether} == {2e4}
    assert case.time.cfl_max == 0.2
    assert solid.nu_stab is None
    assert solid.kernel == "ib4"


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("tractoin=3", "did you mean 'traction'"),
        ("mu=3 cm", "expected a quantity in dyn"),
        ("c1=-1", "c1"),
        ("solid.block.kernle=ib4", "did you mean 'kernel'"),
        ("t_end=-1", "t_end"),
    ],
)
def test_a_wrong_parameter_is_one_clear_error(override, message):
    with pytest.raises(CaseError, match=message) as caught:
        compression_case(Setup(**COARSE, overrides=[override]))
    assert "\n" not in str(caught.value)
