"""A run that has ended already: nothing is computed again, and its files stay."""

from __future__ import annotations

import pytest
from mpi4py import MPI

from tests.case.test_resuming import case_with
from valvefsi.case.build import run_case

SELF = MPI.COMM_SELF

pytestmark = pytest.mark.serial


def test_a_finished_run_that_is_resumed_says_so_and_keeps_its_summary(tmp_path):
    out = tmp_path / "run"
    first = run_case(case_with(), out=out, comm=SELF)
    before = (out / "summary.json").read_bytes()
    again = run_case(case_with(), out=out, resume=True, comm=SELF)
    assert again["finished"] is True
    assert (again["last"], again["timing"]["steps"]) == (first["last"], 40)
    assert (out / "summary.json").read_bytes() == before
    (out / "summary.json").unlink()  # killed before it was written: it is made up for
    assert "finished" not in run_case(case_with(), out=out, resume=True, comm=SELF)
    assert (out / "summary.json").exists()
