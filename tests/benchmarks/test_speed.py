"""The speed benchmark reports what it measures; no test asserts a time."""

from __future__ import annotations

import json

import pytest
from mpi4py import MPI

from valvefsi.benchmarks.speed import run
from valvefsi.errors import CaseError


def test_phases_add_up_to_the_step_and_the_ratio_is_of_the_same_run(shared_tmp):
    result = run(sizes=(16, 24), dim=3, steps=3, out=shared_tmp)
    assert [grid["cells"] for grid in result["grids"]] == [16**3, 24**3]
    for grid in result["grids"]:
        assert grid["pairs_per_step"] == pytest.approx(grid["step_ms"] / grid["dct_pair_ms"])
        assert grid["cell_steps_per_s"] == pytest.approx(1e3 * grid["cells"] / grid["step_ms"])
        assert all(value >= 0 for value in grid["phases_ms"].values())
        low, high = grid["step_ms_range"]
        assert sum(grid["phases_ms"].values()) <= 1.05 * high
        assert low <= grid["step_ms"] <= high
    assert json.loads((shared_tmp / "result.json").read_text())["environment"]["ranks"] == MPI.COMM_WORLD.size
    assert (shared_tmp / "speed.png").stat().st_size > 0


@pytest.mark.parametrize("override", ["cfll=0.1", "cfl=fast", "advection=upwind", "viscous=half"])
def test_a_wrong_parameter_is_an_error(override, shared_tmp):
    with pytest.raises(CaseError, match=override.partition("=")[0]):
        run(sizes=(16,), overrides=[override], out=shared_tmp)
