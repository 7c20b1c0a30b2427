"""The compressed block on a series of grids: the runs are those of the single benchmark, table, picture, bad input."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from valvefsi.benchmarks.compression import Setup, compression_case
from valvefsi.benchmarks.compression_study import Series, case_of, run, study
from valvefsi.benchmarks.immersed import Numerics
from valvefsi.benchmarks.parameters import read_parameters
from valvefsi.case.writing import to_toml
from valvefsi.errors import CaseError

REFERENCE = -3.9212  # cm, see tests/reference/compression_statics.csv


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
    values = read_parameters(study(overrides).parameters, [text for text in overrides if "." not in text])
    numerics = Numerics(grid=32, ratio=0.5, kernel="ib4", nu_stab=None)
    single = Setup(elements=32, grid=32, kernel="ib4", nu_stab=None, overrides=overrides)
    assert to_toml(case_of(numerics, values)) == to_toml(compression_case(single))


def test_the_series_comes_closer_with_the_grid_and_keeps_more_of_its_area(shared_tmp, comm):
    result = run(Series(grid=8, refine=1, overrides=["t_end=2"]), out=shared_tmp, comm=comm)
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
    if comm.rank == 0:
        assert (shared_tmp / "compression.png").stat().st_size > 3e4
        assert json.loads((shared_tmp / "result.json").read_text())["quantities"] == result["quantities"]


@pytest.mark.parametrize(
    ("series", "message"),
    [
        (Series(elements=10), "multiple of 4"),
        (Series(grid=6), "multiple of 4"),
        (Series(refine=9), "refine"),
        (Series(overrides=["tractoin=3"]), "did you mean 'traction'"),
        (Series(overrides=["solid.block.kernle=ib4"]), "did you mean 'kernel'"),
    ],
)
def test_bad_input_is_one_clear_error(series, message, shared_tmp):
    with pytest.raises(CaseError, match=message) as caught:
        run(series, out=shared_tmp)
    assert "\n" not in str(caught.value)
    assert not list(shared_tmp.glob("*.json"))


def test_the_command_refuses_a_plan_of_a_series():
    from valvefsi.cli import app

    done = CliRunner().invoke(app, ["bench", "compression", "--refine", "1", "--plan"])
    assert done.exit_code != 0
    assert "one run" in str(done.exception) + done.output
