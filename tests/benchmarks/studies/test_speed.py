"""The speed benchmark reports what it measures; no test asserts a time."""

from __future__ import annotations

import pytest

from valvefsi.benchmarks.studies.speed import Speed
from valvefsi.errors import CaseError


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
