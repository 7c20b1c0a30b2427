"""The compressed block, immersed, against the incompressible reference (Lee2020, E.1)."""

from __future__ import annotations

import pytest
from mpi4py import MPI

from valvefsi.benchmarks.immersed.compression import BlockSeries, Compression
from valvefsi.benchmarks.immersed.study import Numerics
from valvefsi.benchmarks.statics.solids import block_displacement
from valvefsi.case.writing import to_toml
from valvefsi.errors import CaseError
from valvefsi.io.history import read_history

REFERENCE = block_displacement()
COARSE = {"elements": 16, "grid": 32}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return MPI.COMM_WORLD.bcast(tmp_path_factory.mktemp("compression"), root=0)


@pytest.fixture(scope="module")
def coarse(folder):
    """The coarsest grid of the study, stabilised."""
    return Compression(**COARSE).run(out=folder / "coarse")


def test_the_coarse_grid_is_within_three_per_cent_of_the_incompressible_reference(coarse):
    u_y = coarse["quantities"]["u_y_top_centre_cm"]
    assert abs(u_y - REFERENCE) < 0.03 * abs(REFERENCE)
    assert coarse["relative_error"] == pytest.approx(
        (u_y - coarse["reference"]["u_y_top_centre_cm"]) / abs(coarse["reference"]["u_y_top_centre_cm"])
    )


def test_the_reference_of_the_run_is_the_converged_one(coarse):
    assert coarse["reference"]["u_y_top_centre_cm"] == pytest.approx(REFERENCE, rel=5e-4)


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
    """At every time of the load's rise."""
    Compression(**COARSE, nu_stab=None, overrides=["time.t_end='10 s'"]).run(out=folder / "free")
    free, held = (read_history(folder / name / "history.csv") for name in ("free", "coarse"))
    loaded = [k for k, t in enumerate(free["t_s"]) if t > 1.0]
    assert free["t_s"][loaded[-1]] == pytest.approx(10.0)
    for k in loaded:
        assert held["t_s"][k] == free["t_s"][k]
        assert (
            held["block_J_max"][k] - held["block_J_min"][k] < free["block_J_max"][k] - free["block_J_min"][k]
        )


def test_the_answer_does_not_depend_on_the_viscosity_beyond_two_tenths_of_a_per_cent(coarse, folder):
    thick = Compression(**COARSE, overrides=["mu=0.16"]).run(out=folder / "thick")["quantities"]
    thin = coarse["quantities"]
    assert abs(thick["u_y_top_centre_cm"] / thin["u_y_top_centre_cm"] - 1) < 2e-3


@pytest.mark.slow
@pytest.mark.parametrize(("elements", "bound"), [(32, 0.02), (64, 0.012)])
def test_finer_grids_come_closer(elements, bound, coarse, folder):
    finer = Compression(elements=elements, grid=2 * elements).run(out=folder / f"M{elements}")
    error = abs(finer["quantities"]["u_y_top_centre_cm"] / REFERENCE - 1)
    assert error < bound
    assert error < abs(coarse["quantities"]["u_y_top_centre_cm"] / REFERENCE - 1)


def test_short_names_reach_the_case_with_units():
    overrides = ["traction=30 Pa", "c1=100", "mu=1 cP", "t_end=2", "tether_stiffness=2e4", "time.cfl_max=0.2"]
    case = Compression(**COARSE, kernel="ib4", nu_stab=None, overrides=overrides).case()
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
    for series in ({}, {"refine": 1}):
        with pytest.raises(CaseError, match=message) as caught:
            Compression(overrides=[override], **series)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "overrides",
    [
        [],
        ["c1=100", "t_end=2", "mu=1 cP"],
        ["damping=3", "time.cfl_max=0.2", "solid.block.coupling=elemental"],
        ["fluid.viscosity='2 cP'"],
    ],
)
def test_a_run_of_the_series_has_the_case_of_the_single_run(overrides):
    numerics = Numerics(grid=32, ratio=0.5, kernel="ib4", nu_stab=None)
    single = Compression(elements=32, grid=32, kernel="ib4", nu_stab=None, overrides=overrides)
    assert to_toml(BlockSeries(overrides=overrides).case_of(numerics)) == to_toml(single.case())


def test_the_series_comes_closer_with_the_grid_and_keeps_more_of_its_area(shared_tmp, comm):
    result = Compression(grid=8, refine=1, overrides=["t_end=2"]).run(out=shared_tmp)
    found = list(result["quantities"].values())
    assert [(r["numerics"]["grid"], r["numerics"]["nu_stab"]) for r in result["runs"]] == [
        (8, 0.4),
        (16, 0.4),
        (8, None),
        (16, None),
    ]
    assert set(result["reference"]["same_mesh"]) == {8, 16}
    assert result["reference"]["same_mesh"][16] == pytest.approx(REFERENCE, rel=1e-3)
    for coarse, fine in (found[:2], found[2:]):
        assert fine["change_percent"] < 0.5 * coarse["change_percent"]
        assert fine["change_percent"] <= fine["largest_change_percent"]
        errors = [abs(q["u_y_top_centre_cm"] - REFERENCE) for q in (coarse, fine)]
        assert errors[1] < 0.5 * errors[0]
    labels = [line["quantity"] for line in result["table"]]
    assert labels.count("  the most during the run") == 4
    assert "observed order, area change, stabilised" in labels
    assert "u_y of the top centre, N = 16, not stabilised" in labels


@pytest.mark.parametrize("options", [{"elements": 10}, {"grid": 6}])
def test_a_series_whose_load_would_end_between_nodes_is_refused(options):
    with pytest.raises(CaseError, match="multiple of 4"):
        Compression(refine=1, **options)
