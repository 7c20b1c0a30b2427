"""``valvefsi compare``: what it prints and writes, and how it ends."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from tests.case.test_valve_runs import run_folder
from tests.cli.test_cli import MAIN, RUNNER, python
from tests.valve_waves import PERIOD, waves
from valvefsi import cli
from valvefsi.errors import CaseError
from valvefsi.post.plots import valve_comparison as plots

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts processes of its own")
OWN = Path(__file__).parents[2] / "calibration" / "valve_beat.csv"
LOOP = OWN.with_name("porcine_loop.csv")


def called(*words):
    """The command in this process; what it printed."""
    answer = RUNNER.invoke(cli.app, ["compare", *map(str, words)])
    if answer.exception is not None and not isinstance(answer.exception, SystemExit):
        raise answer.exception
    return answer.stdout


def test_a_run_and_a_record_are_compared(tmp_path):
    run = run_folder(tmp_path / "run", 2.0)
    shown = called(run, OWN, "--start", "20 ms")
    found = json.loads((run / "comparison.json").read_text())
    assert (run / "comparison.png").stat().st_size > 20_000
    assert [found[side]["kind"] for side in "ab"] == ["run", "record"]
    assert list(found["quantities"]) == ["p_lv", "p_ao", "q_ao", "q_ao_without_offset", "pdva"]
    assert found["start_s"] == 0.02
    assert abs(found["shift_ms"]) <= 7.0
    assert found["quantities"]["p_lv"]["repeatability_l2_percent"]["a"] is None
    assert found["quantities"]["p_lv"]["repeatability_l2_percent"]["b"] > 0.0
    assert "case" not in found
    for text in (
        "A less B over B",
        "numbers of the valve",
        "shift: all of A",
        "offset: flow of B",
        "results in",
    ):
        assert text in shown
    assert f"{found['quantities']['pdva']['as_they_are']['l2_percent']:.4g}" in shown


def test_two_runs_are_compared_with_their_cases(tmp_path):
    a = run_folder(tmp_path / "a", phase=0.003)
    b = run_folder(tmp_path / "b", overrides=["fluid.viscosity='2 cP'"])
    shown = called(a, b, "--out", tmp_path / "out")
    found = json.loads((tmp_path / "out" / "comparison.json").read_text())
    assert found["case"]["fluid.viscosity"]["b"] == 0.02
    assert list(found["case"]) == ["fluid.viscosity"]
    assert "fluid.viscosity" in shown
    assert found["shift_ms"] == pytest.approx(3.0, abs=0.1), "A is ahead"
    assert not (a / "comparison.json").exists()
    called(a, b, "--out", tmp_path / "still", "--shift-max", "0")
    assert json.loads((tmp_path / "still" / "comparison.json").read_text())["shift_ms"] == 0.0


def test_the_picture_shows_what_was_compared(tmp_path, monkeypatch):
    """A, 3 ms ahead, lies on B where it is shifted; the band is that of B."""
    a = run_folder(tmp_path / "a", phase=0.003)
    b = run_folder(tmp_path / "b")
    drawn = []
    monkeypatch.setattr(plots, "valve_comparison", lambda path, t, overlays, *_, **__: drawn.append(overlays))
    called(a, b)
    for each in drawn.pop():
        assert np.abs(each.shifted - each.b).mean() < 0.1 * np.abs(each.a - each.b).mean()
    called(b, OWN)
    assert all(each.deviation is not None and each.deviation.max() > 0 for each in drawn.pop())
    called(OWN, b, "--out", tmp_path / "out")
    assert all(each.deviation is None for each in drawn.pop())


def test_a_time_without_a_unit_is_in_seconds(tmp_path):
    called(OWN, OWN, "--start", "0.25", "--shift-max", "0.004", "--out", tmp_path)
    found = json.loads((tmp_path / "comparison.json").read_text())
    assert (found["start_s"], found["shift_max_ms"]) == (0.25, pytest.approx(4.0))


def test_two_records_are_compared_beside_the_work(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    called(LOOP, OWN, "--start", "85.7 ms")
    found = json.loads(Path("results/compare-porcine_loop/comparison.json").read_text())
    assert found["a"]["mean_of_cycles"] == 3
    assert found["quantities"]["p_lv"]["as_they_are"]["l2_percent"] < 5, "both are one loop with two valves"
    assert "pdva" not in found["quantities"]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["{tmp}/none", "{own}"], "{tmp}/none: no such folder of a run, and no such record"),
        (["{tmp}", "{own}"], "{tmp}: there is no run of a valve here, case.toml is missing"),
        (
            ["{own}", "{own}", "--start", "2 s"],
            "start = 2.0: expected 0 or more and less than 0.857143 s",
        ),
        (["{own}", "{own}", "--start", "3 mm"], "start = '3 mm'"),
        (["{own}", "{own}", "--start=-1"], "start = '-1': expected a time of 0 or more"),
        (
            ["{own}", "{own}", "--shift-max", "1 s"],
            "shift-max = 1.0: expected a time in 0 ... 0.2143 s",
        ),
        (["{own}", "{own}", "--period", "0"], "period = '0': expected a positive time"),
        (["{own}", "{own}", "--period", "2 s"], "{own}: no whole cycle of 2 s (as given)"),
        (["{own}", "{tmp}/short.csv"], "period: the periods differ by"),
        (["{own}", "{tmp}/other.csv"], "{tmp}/other.csv: missing columns: expected any of p_lv_mmHg"),
    ],
)
def test_what_cannot_be_compared_ends_with_one_line_and_nothing_written(tmp_path, words, text):
    rows = [f"{k * PERIOD / 100:.6f},{waves(k * PERIOD / 100)['q']:.4f}" for k in range(90)]
    (tmp_path / "short.csv").write_text("\n".join(["t_s,q_ao_ml_s", *rows]) + "\n")
    (tmp_path / "other.csv").write_text("\n".join(["t_s,q_lv_ml_s", *rows]) + "\n")
    names, out = {"tmp": tmp_path, "own": OWN}, tmp_path / "out"
    with pytest.raises(CaseError) as caught:
        called(*(word.format(**names) for word in words), "--out", out)
    assert str(caught.value).startswith(text.format(**names))
    assert "\n" not in str(caught.value)
    assert not out.exists()


def test_what_cannot_be_compared_ends_with_2_and_no_traceback(tmp_path):
    answer = python(MAIN, "compare", tmp_path, OWN, "--out", tmp_path / "out")
    assert answer.returncode == 2
    assert answer.stderr == f"error: {tmp_path}: there is no run of a valve here, case.toml is missing\n"
    assert not (tmp_path / "out").exists()
