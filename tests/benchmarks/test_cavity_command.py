"""The cavity as a command: difference to the table, what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.benchmarks.cavity import GHIA, run
from valvefsi.errors import CaseError, ConvergenceError

WORLD = MPI.COMM_WORLD


def test_the_tables_of_the_command_and_of_the_tests_are_one():
    path = Path(__file__).parents[1] / "reference" / "ghia1982_cavity_re100.csv"
    lines = [line.split(",") for line in path.read_text().splitlines() if line[:2] in ("u,", "v,")]
    for name in "uv":
        rows = [(float(at), float(value)) for component, at, value in lines if component == name]
        np.testing.assert_allclose(GHIA[100][name], rows)


def test_a_coarse_cavity_is_within_two_per_cent_of_the_lid_speed(shared_tmp):
    result = run(cells=32, out=shared_tmp, overrides=["steady=1e-3"])
    assert max(result["quantities"]["u_gap"], result["quantities"]["v_gap"]) < 0.02
    if WORLD.rank == 0:
        assert json.loads((shared_tmp / "result.json").read_text())["benchmark"] == "cavity"
        assert (shared_tmp / "profiles.png").stat().st_size > 10000


def test_what_cannot_be_is_refused(shared_tmp):
    with pytest.raises(CaseError, match="expected one of 100, 1000"):
        run(reynolds=300, out=shared_tmp)
    with pytest.raises(ConvergenceError, match=r"still changes by .* at t = 0\.\d+; try a larger t_max"):
        run(cells=8, out=shared_tmp, overrides=["t_max=0.5"])
