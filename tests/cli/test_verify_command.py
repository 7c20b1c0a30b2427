"""``valvefsi verify``: what it prints, leaves, and how it ends. Members are stand-ins."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
import typer.testing

from tests.studies.conftest import CASE
from valvefsi import cli
from valvefsi.errors import CaseError, StudyError
from valvefsi.studies import runner

pytestmark = pytest.mark.serial
RUNNER = typer.testing.CliRunner()
FAKE = Path(__file__).parents[1] / "studies" / "fake_grids.py"


@pytest.fixture
def verify(tmp_path, monkeypatch):
    """Return a function that calls the command."""
    monkeypatch.setattr(runner, "PROGRAM", (sys.executable, str(FAKE)))
    monkeypatch.setattr(runner, "POLL", 0.02)
    case, folder = tmp_path / "case.toml", tmp_path / "out"
    case.write_text(CASE.replace("50 ms", "10 ms").replace("1 s", "200 ms"))

    def call(*options, grids="0.25,0.125"):
        words = ["verify", str(case), "--grids", grids, "--out", str(folder), *options]
        return RUNNER.invoke(cli.app, words)

    call.folder = folder
    return call


def test_the_cost_is_said_first_and_what_is_done_is_neither_planned_nor_run_again(verify):
    planned = verify("--plan")
    assert planned.exit_code == 0
    assert "2 members, " in planned.stdout
    assert "note: TWO GRIDS: no observed order" in planned.stdout
    assert not verify.folder.exists()
    first = verify("--jobs", "1").stdout
    assert first.index("expected time") < first.index("h=0.25: done in")
    more = verify("--resume", grids="0.25,0.125,0.0625").stdout
    assert "1 members, " in more
    assert more.index("h=0.0625 ") < more.index("2 of 3 members done before")
    assert "OSCILLATING: differences change sign" in " ".join(more.split())
    assert "TWO GRIDS" not in more
    assert "NOT VARIED: --ranks 2 does" in " ".join(more.split())
    assert "block_J_max" not in more, "it has no order"
    assert "order 2.00, index 0.114 %" in " ".join(more.split())
    assert more.splitlines()[-1] == f"results in {verify.folder / 'verification.md'}, verification.png"
    assert (verify.folder / "events").read_text().split() == ["h=0.25", "h=0.125", "h=0.0625"]
    again = verify("--resume", "--style", "paper", grids="0.25,0.125,0.0625").stdout
    assert "expected time" not in again
    assert again.splitlines()[-1].endswith(", verification.pdf")
    assert (verify.folder / "verification.pdf").read_bytes().startswith(b"%PDF")
    assert "slope 2,0.625," in (verify.folder / "verification_data.csv").read_text()


def test_a_member_that_fails_is_named_and_the_rest_is_written(verify):
    verify.folder.mkdir()
    (verify.folder / "broken").write_text("0.125")
    answer = verify()
    assert isinstance(answer.exception, StudyError)
    assert str(answer.exception).startswith("1 of 2 members failed: h=0.125: ConvergenceError: it does not")
    result = json.loads((verify.folder / "verification.json").read_text())
    assert result["failed"] == {"h=0.125": "ConvergenceError: it does not converge"}
    assert [grid["member"] for grid in result["grids"]] == ["h=0.25"]
    assert "FAILED: h=0.125" in (verify.folder / "verification.md").read_text()


def test_a_wrong_option_is_refused_before_anything_starts(verify):
    for options in (("--also", "fluid.viscosity=-1"), ("--steps", "2")):
        assert isinstance(verify(*options).exception, CaseError)
    assert verify("--steps", "a half").exit_code == 2
    assert not verify.folder.exists()
