"""Series of grids: which there are, and what is kept where a finer one stops."""

from __future__ import annotations

import json

import pytest
from mpi4py import MPI

from valvefsi.benchmarks.grid_series import refined, run_series


def test_each_grid_is_so_many_times_as_fine_as_the_one_before():
    assert refined(4, 3, 1.5) == [4, 6, 9, 14]
    assert refined(92, 0, 1.5) == [92]


def test_what_is_computed_is_written_before_the_next_grid_begins(shared_tmp):
    def one(cells):
        if cells > 6:
            raise RuntimeError("stopped")
        return {"cells": cells, "quantities": {"dx": 1.0 / cells}, "wall_s": 2.0}

    def told(runs):
        return {"benchmark": "none", "table": [run["cells"] for run in runs]}

    with pytest.raises(RuntimeError, match="stopped"):
        run_series([4, 6, 9], one, told, out=shared_tmp, comm=MPI.COMM_WORLD)
    kept = json.loads((shared_tmp / "result.json").read_text())
    assert kept["table"] == [4, 6]
    assert kept["quantities"] == {"4": {"dx": 0.25}, "6": {"dx": 1 / 6}}
    assert kept["timing"] == {"wall_s": 4.0}
    assert [run["cells"] for run in kept["runs"]] == [4, 6]
