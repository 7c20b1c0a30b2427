"""A run that has ended already: nothing is computed again, and its files stay."""

from __future__ import annotations

import shutil

import pytest
from mpi4py import MPI
from typer.testing import CliRunner

from tests.case.test_resuming import case_with
from valvefsi.case.build import run_case
from valvefsi.cli import app
from valvefsi.errors import CaseError

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


def test_the_command_refuses_a_folder_with_a_finished_run_before_it_builds_anything(tmp_path):
    out, file = tmp_path / "run", tmp_path / "block.toml"
    run_case(case_with("time.t_end='6 ms'"), out=out, comm=SELF)
    shutil.copy(out / "case.toml", file)
    said = CliRunner().invoke(app, ["run", str(file), "--out", str(out)])
    assert isinstance(said.exception, CaseError)
    assert "holds a finished run; --overwrite replaces it" in str(said.exception)
    assert "building it" not in said.output
