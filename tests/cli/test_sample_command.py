"""``valvefsi sample``: the circuit alone in one go, runs in stages, what it prints and how it ends."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import typer.testing

from tests.studies.conftest import CASE
from tests.studies.test_sampling import PROGRAM, STUDY
from valvefsi import cli
from valvefsi.errors import CaseError, StudyError
from valvefsi.studies import runner

ROOT = Path(__file__).parents[2]
RUNNER = typer.testing.CliRunner()
pytestmark = pytest.mark.serial


@pytest.fixture
def sample(tmp_path, monkeypatch):
    """Return a function that calls the command on a study of stand-ins."""
    monkeypatch.setattr(runner, "PROGRAM", PROGRAM)
    monkeypatch.setattr(runner, "POLL", 0.02)
    (tmp_path / "case.toml").write_text(CASE)
    (tmp_path / "study.toml").write_text(STUDY)

    def call(*options):
        words = ["sample", str(tmp_path / "study.toml"), "--out", str(tmp_path / "out"), *options]
        return RUNNER.invoke(cli.app, words)

    call.folder = tmp_path / "out"
    return call


def test_the_study_of_the_calibration_runs_by_the_circuit_alone(tmp_path):
    words = ["sample", str(ROOT / "calibration" / "sample_loop.toml"), "--out", str(tmp_path)]
    words += ["--set", "design.method=latin-hypercube", "--set", "design.size=24", "--set", "design.degree=1"]
    answer = RUNNER.invoke(cli.app, [*words, "--set", "orifice.steps=300"])
    assert answer.exit_code == 0, answer.output
    assert "24 samples of the circuit alone" in answer.stdout
    assert answer.stdout.splitlines()[-1] == f"results in {tmp_path / 'sample.md'}, sample.png"
    result = json.loads((tmp_path / "sample.json").read_text())
    assert result["outputs"][0]["output"] == "mean_pressure_difference_mmHg"
    assert all(row["surrogate_relative_error"] < 0.05 for row in result["outputs"])
    assert (tmp_path / "sample.png").stat().st_size > 20_000
    paper = RUNNER.invoke(cli.app, [*words, "--set", "orifice.steps=300", "--style", "paper"])
    assert paper.stdout.splitlines()[-1].endswith(", sample.pdf")
    assert (tmp_path / "sample.pdf").read_bytes().startswith(b"%PDF")
    another = [*words, "--set", "orifice.steps=300", "--set", "design.size=25"]
    refused = RUNNER.invoke(cli.app, another)
    assert "this folder holds other samples" in str(refused.exception)
    assert json.loads((tmp_path / "sample.json").read_text())["samples"] == 24
    assert RUNNER.invoke(cli.app, [*another, "--overwrite"]).exit_code == 0
    refused = RUNNER.invoke(cli.app, [*words, "--array"])
    assert isinstance(refused.exception, CaseError)


def test_an_array_is_written_its_tasks_run_and_its_results_collected(sample):
    said = sample("--array", "--jobs", "2").stdout
    assert said.splitlines()[0] == f"sbatch {sample.folder / 'members.sh'}"
    script = (sample.folder / "members.sh").read_text()
    assert "--array=0-7%2" in script
    assert sample("--member", "2").exit_code == 0
    answer = sample("--collect")
    assert isinstance(answer.exception, StudyError)
    assert str(answer.exception).startswith("7 of 8 members failed: s0000: it has not been run")
    assert "7 of 8 samples FAILED" in " ".join(answer.stdout.split())
    for k in (0, 1, 3, 4, 5, 6):
        sample("--member", str(k))
    (sample.folder / "limit").write_text("0")
    failed = sample("--member", "7")
    assert isinstance(failed.exception, StudyError)
    assert "StabilityError: too thick" in str(failed.exception)
    assert isinstance(sample("--member", "8").exception, CaseError)
    answer = sample("--collect")
    assert "1 of 8 members failed: s0007: StabilityError: too thick" in str(answer.exception)
    row = json.loads((sample.folder / "sample.json").read_text())["outputs"][0]
    assert (row["output"], row["count"]) == ("u_cm", 7)
    assert (sample.folder / "events").read_text().split().count("s0002") == 1


def test_all_that_is_left_is_run_at_once(sample):
    sample("--member", "1")
    assert isinstance(sample().exception, CaseError), "the folder holds a study"
    answer = sample("--resume", "--jobs", "2")
    assert answer.exit_code == 0, answer.output
    assert "1 of 8 members done before" in answer.stdout
    assert "u_cm" in answer.stdout
    planned = sample("--plan")
    assert "8 samples of about that size" in planned.stdout
