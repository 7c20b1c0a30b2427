"""The speed benchmark reports what it measures; no test asserts a time."""

from __future__ import annotations

from pathlib import Path

import pytest

from valvefsi.benchmarks.studies.speed import Speed
from valvefsi.errors import CaseError

BLOCK = Path(__file__).parents[3] / "demos" / "compressed_block.toml"


def test_phases_add_up_to_the_step_and_the_ratio_is_of_the_same_run(shared_tmp):
    result = Speed(sizes=(16, 24), steps=3).run(out=shared_tmp)
    assert [grid["cells"] for grid in result["grids"]] == [16**3, 24**3]
    for grid in result["grids"]:
        assert grid["pairs_per_step"] == pytest.approx(grid["step_ms"] / grid["dct_pair_ms"])
        assert grid["cell_steps_per_s"] == pytest.approx(1e3 * grid["cells"] / grid["step_ms"])
        assert all(value >= 0 for value in grid["phases_ms"].values())
        low, high = grid["step_ms_range"]
        assert sum(grid["phases_ms"].values()) <= 1.05 * high
        assert low <= grid["step_ms"] <= high


@pytest.mark.parametrize("override", ["cfll=0.1", "cfl=fast", "advection=upwind", "viscous=half"])
def test_a_wrong_parameter_is_an_error(override):
    with pytest.raises(CaseError, match=override.partition("=")[0]):
        Speed(overrides=[override])


def test_a_step_of_a_case_is_told_by_its_parts(shared_tmp):
    result = Speed(case=str(BLOCK), overrides=["grid.cells=[32, 32]"], steps=3).run(out=shared_tmp)
    step = result["case"]
    assert tuple(step["cells"]) == (32, 32, 1)
    assert step["parts_ms"].keys() == {"advection", "fluid solve", "block", "all else"}
    low, high = step["step_ms_range"]
    assert low <= step["step_ms"] <= high
    assert all(0.0 < part <= high for part in step["parts_ms"].values())
    assert sum(step["parts_ms"].values()) <= 3.0 * high
    assert step["pairs_per_step"] == pytest.approx(step["step_ms"] / step["dct_pair_ms"])
    lines = {line["quantity"]: line["computed"] for line in result["table"]}
    assert lines["step, 32 x 32 x 1 cells"] == step["step_ms"]
    assert lines["block"] == step["parts_ms"]["block"]


def test_a_state_is_that_of_a_case(shared_tmp):
    with pytest.raises(CaseError, match="--case"):
        Speed(state=str(shared_tmp))
    with pytest.raises(CaseError, match="no whole checkpoint"):
        Speed(case=str(BLOCK), state=str(shared_tmp)).run(out=shared_tmp)
