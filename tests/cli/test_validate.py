"""``valvefsi validate``: what it prints and writes, a stage alone, and how it ends."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from mpi4py import MPI

from tests.cli.test_cli import MAIN, RUNNER, python
from tests.studies.test_validation import study_in
from valvefsi import cli
from valvefsi.cli.fit_output import console
from valvefsi.cli.validate import show_verdict
from valvefsi.errors import CaseError

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts processes of its own")
CALIBRATION = Path(__file__).parents[2] / "calibration"


def called(*words):
    """The command in this process; what it printed."""
    answer = RUNNER.invoke(cli.app, ["validate", *map(str, words)])
    if answer.exception is not None and not isinstance(answer.exception, SystemExit):
        raise answer.exception
    return answer.stdout


def test_a_study_is_made_and_its_verdict_shown(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    study_in(tmp_path)
    shown = called("study.toml")
    verdict = json.loads(Path("results/study/compare/verdict.json").read_text())
    (row,) = verdict["against_record"]
    for text in (
        "downstream: not made yet",
        "downstream: made in",
        "downstream: parameters_mmHg_ml_s.R_c 0.04",
        "less the record, over it",
        "orifice: P_LV",
        f"{row['quantities']['q_ao']['as_they_are']['linf_percent']:.4g}",
        "next: there is no run in three dimensions yet: name grids",
        "results in results/study/compare",
    ):
        assert text in shown
    assert "targets" not in shown
    again = called("study.toml", "--stage", "compare")
    assert again.splitlines()[0] == "compare: unchanged"
    assert "less the record, over it" in again


def test_a_stage_alone_says_what_came_of_it(tmp_path):
    study_in(tmp_path)
    words = (tmp_path / "study.toml", "--out", tmp_path / "out", "--stage", "upstream")
    shown = called(*words)
    assert '"parameters_mmHg_ml_s": {"R_1": 0.1' in shown
    assert f"results in {tmp_path / 'out' / 'upstream'}" in shown
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["upstream"]
    assert called(*words).startswith("upstream: unchanged\n")
    assert called(*words, "--again").startswith("upstream: asked for again\n")
    assert called(*words, "--set", "upstream.smooth=0.01").startswith("upstream: changed: smooth\n")


def test_targets_are_answered(tmp_path, capsys):
    check = {"run": "run-1mm", "quantity": "p_lv", "norm": "l2_percent", "at_most": 3.4, "against": "target"}
    check |= {"found": 3.52, "found_shifted": 3.31, "reached": False, "reached_shifted": True}
    empty = {"stages": {}, "against_record": [], "between_grids": [], "next": ["sleep"]}
    show_verdict(console(), empty | {"checks": [check]})
    shown = capsys.readouterr().out
    line = next(line for line in shown.splitlines() if "run-1mm" in line)
    assert line.split() == ["run-1mm:", "L2", "of", "P_LV", "3.4", "3.52", "3.31", "no", "yes", "target"]
    assert "next: sleep" in shown


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["--stage", "runs"],
            "stage = 'runs': no such stage, expected one of downstream, upstream, case, orif",
        ),
        (["--stage", "case"], "stage = 'case': it reads the files of downstream, which was not made"),
        (["--set", "grid=1"], "--set: grid = 1: unknown key; did you mean 'grids'?"),
    ],
)
def test_what_cannot_be_made_is_one_line(tmp_path, words, said):
    study_in(tmp_path)
    with pytest.raises(CaseError) as caught:
        called(tmp_path / "study.toml", "--out", tmp_path / "out", *words)
    assert str(caught.value).startswith(said)
    assert not (tmp_path / "out").exists()


def test_a_study_that_is_not_there_ends_with_2_and_no_traceback(tmp_path):
    (tmp_path / "study.toml").touch()
    answer = python(MAIN, "validate", tmp_path / "studi.toml")
    assert answer.returncode == 2
    assert answer.stderr == f"error: {tmp_path}/studi.toml: no such study; did you mean 'study.toml'?\n"


def test_it_is_not_for_mpirun(tmp_path, monkeypatch):
    study_in(tmp_path)
    monkeypatch.setattr(MPI, "COMM_WORLD", type("Two", (), {"size": 2, "rank": 0}))
    with pytest.raises(CaseError, match="call it without mpirun: ranks in the study starts runs on several"):
        called(tmp_path / "study.toml")


@pytest.mark.slow
def test_the_chain_of_the_calibrations_finds_what_its_record_was_made_with(tmp_path, monkeypatch):
    """The leak of the valve, 5 ml/s, and the probe's offset, 3 ml/s, make R_p too large; all else is near."""
    monkeypatch.setattr(sys, "path", [str(CALIBRATION), *sys.path])
    import validate_porcine

    found = validate_porcine.study(tmp_path / "out")
    off = {name: value / truth - 1 for name, (value, truth) in found.items()}
    assert 0.0 < off.pop("R_p") < 0.06
    assert max(map(abs, off.values())) < 0.02
