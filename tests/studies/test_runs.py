"""Runs of a validation: beat by beat until two are alike, gone on with where they stopped; commands and exit codes."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from tests.studies import made_up_beat as made
from tests.studies.test_validation import ROOT, study_in
from valvefsi.case import load_case
from valvefsi.case.build import run_case
from valvefsi.case.study_tables import Targets, load_study
from valvefsi.case.writing import to_toml
from valvefsi.errors import CaseError, Stopped, SurroundingsError, ValvefsiError
from valvefsi.io.history import read_history
from valvefsi.runtime import surroundings
from valvefsi.studies.beats import RunPart, launch
from valvefsi.studies.comparison import advice, checks_of
from valvefsi.studies.validation import How, validation_stages

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts processes of its own")
GRIDS = "grids=['1 mm', '0.5 mm']"


class Runs:
    """Stands in for `valvefsi run`: the beat of the record, whose flow comes to its size beat by beat.

    On a grid of spacing h pressures are too large by a part ``off`` h/mm.
    """

    def __init__(self, settles=0.2, off=0.01):
        self.parts, self.settles, self.off, self.failure = [], settles, off, None

    def __call__(self, part):
        self.parts.append(part)
        if self.failure:
            raise self.failure
        case = load_case(part.case, part.changes)
        t = np.arange(0.0, case.time.t_end + 1e-9, made.PERIOD / 400)
        at, p_lv, p_ao, q = made.beat()
        size = 1.0 + self.settles ** (1 + t // made.PERIOD)
        larger = 1.0 + self.off * case.grid.spacing / 0.1
        columns = [np.interp(t + made.OPEN, at, y, period=made.PERIOD) for y in (p_lv, p_ao, q)]
        table = [
            t,
            larger * columns[0],
            larger * columns[1],
            size * columns[2],
            np.clip(columns[2] / 200.0, 0, 2),
        ]
        head = "t_s,p_z_lower_mmHg,p_z_upper_mmHg,q_z_upper_ml_s,pdva_cm2"
        (part.out / "checkpoints").mkdir(parents=True, exist_ok=True)
        (part.out / "checkpoints" / "step_7.vfc").touch()
        np.savetxt(part.out / "history.csv", np.transpose(table), delimiter=",", header=head, comments="")
        (part.out / "case.toml").write_text(to_toml(case))

    def done(self, part):
        """Beats that a part was asked for, and how."""
        end = next(change for change in part.changes if change.startswith("time.t_end="))
        beats = float(end.partition("=")[2].split()[0]) / made.PERIOD
        assert not part.trust
        return part.out.name, round(beats, 6), part.fresh


@pytest.fixture(scope="module")
def loop(tmp_path_factory):
    """The folder of a study up to its case and the loop with the orifice."""
    folder = tmp_path_factory.mktemp("loop")
    stages = validation_stages(study_in(folder, changes=["tolerance=0.02"]), folder / "out")
    stages.make(["downstream", "upstream", "case", "orifice"])
    return folder


@pytest.fixture
def folder(loop, tmp_path):
    """A copy of it."""
    shutil.copytree(loop, tmp_path / "study")
    return tmp_path / "study"


def made_in(folder, runs, changes=(GRIDS,), only="run", **how):
    """What making the runs says."""
    lines = []
    study = study_in(folder, changes=["tolerance=0.02", *changes])
    stages = validation_stages(study, folder / "out", How(say=lines.append, launcher=runs, **how))
    stages.make(stages.chosen(only) if only else None)
    return stages, lines


def asked(runs):
    found = [runs.done(part) for part in runs.parts]
    runs.parts.clear()
    return found


def test_each_grid_is_run_until_two_beats_are_alike_and_not_again(folder):
    """The flow is 20, 4, 0.8, 0.16 % too large: the third beat is 3.1 % from the second, the fourth 0.6 %."""
    runs = Runs()
    stages, _ = made_in(folder, runs)
    assert asked(runs) == [(f"run-{h}mm", k, k == 1) for h in (1, 0.5) for k in (1, 2, 3, 4)]
    found = stages.record("run-1mm")["result"]
    assert (found["beats"], found["periodic"]) == (4, True)
    assert found["last_two_apart_l2_percent"]["q_ao"] == pytest.approx(
        100 * (0.008 - 0.0016) / 1.0016, rel=1e-3
    )
    assert load_case(folder / "out" / "run-0.5mm" / "case.toml").grid.spacing == pytest.approx(0.05)
    assert all(line.endswith("unchanged") for line in made_in(folder, runs)[1])
    assert asked(runs) == []


def test_a_run_that_is_not_periodic_goes_on_when_it_may(folder):
    runs = Runs(settles=0.8)
    stages, _ = made_in(folder, runs, ["grids=['1 mm']", "max_beats=2"])
    assert [each[1] for each in asked(runs)] == [1, 2]
    assert not stages.record("run-1mm")["result"]["periodic"]
    said = advice({"run-1mm": stages.record("run-1mm")["result"]}, {}, [], None)
    assert "run-1mm: not periodic after 2 beats (last two 9.76 % apart in q_ao)" in said[0]
    made_in(folder, runs, ["grids=['1 mm']", "max_beats=3"])
    assert asked(runs) == [("run-1mm", 3, False)]


def test_a_run_that_failed_goes_on_from_its_whole_beats(folder):
    runs = Runs()
    made_in(folder, runs, ["grids=['1 mm']", "max_beats=2"])
    asked(runs)
    runs.failure = Stopped("the run was stopped", 15)
    with pytest.raises(Stopped):
        made_in(folder, runs, ["grids=['1 mm']"])
    runs.failure = None
    _, lines = made_in(folder, runs, ["grids=['1 mm']"])
    assert [each[1] for each in asked(runs)] == [3, 3, 4]
    assert "run-1mm: not made yet" in lines


def test_a_run_that_ends_early_is_no_endless_loop(folder):
    runs = Runs()

    def short(part):
        runs(RunPart(case=part.case, out=part.out, changes=("time.t_end=0.9 s",)))

    with pytest.raises(ValvefsiError, match="run-1mm has ended without another whole beat"):
        made_in(folder, short, ["grids=['1 mm']"])


def test_a_run_of_another_case_is_kept_unless_it_may_be_replaced(folder):
    runs, thick = Runs(), "changes=['fluid.viscosity=\"4 cP\"']"
    made_in(folder, runs, ["grids=['1 mm']"])
    asked(runs)
    made_in(folder, runs, ["grids=['1 mm']", thick], only="case")
    history = (folder / "out" / "run-1mm" / "history.csv").read_bytes()
    with pytest.raises(
        CaseError, match=r"run-1mm: fluid.viscosity: the run here was of 0.035, the study now asks for"
    ):
        made_in(folder, runs, ["grids=['1 mm']", thick])
    assert asked(runs) == []
    assert (folder / "out" / "run-1mm" / "history.csv").read_bytes() == history
    made_in(folder, runs, ["grids=['1 mm']", thick], overwrite=True)
    assert [each[1:] for each in asked(runs)] == [(1, True), (2, False), (3, False), (4, False)]
    made_in(folder, runs, ["grids=['1 mm']", thick, "tolerance=1e-9", "max_beats=5"], trust=True)
    assert [(part.trust, part.fresh) for part in runs.parts] == [(True, False)]


def test_the_grids_of_the_case_itself_are_one_run(folder):
    runs = Runs()
    study = study_in(folder)
    text = (folder / "study.toml").read_text().replace("grids = []\n", "")
    assert study.grids == ()
    (folder / "own.toml").write_text(text)
    stages = validation_stages(load_study(folder / "own.toml"), folder / "out", How(launcher=runs))
    assert list(stages.stages)[-3:] == ["run", "orifice", "compare"]
    assert stages.chosen("run") == ("run",)


def test_beats_without_a_checkpoint_are_not_replaced_unasked(folder):
    runs = Runs(settles=0.8)
    made_in(folder, runs, ["grids=['1 mm']", "max_beats=2"])
    (folder / "out" / "run-1mm" / "checkpoints" / "step_7.vfc").unlink()
    with pytest.raises(CaseError, match="run-1mm: 2 beats are here, and no checkpoint to go on from"):
        made_in(folder, runs, ["grids=['1 mm']", "max_beats=3"])


def test_runs_are_held_against_the_record_the_orifice_and_one_another(folder):
    """The finer one is 0.5 % off in the pressures, the coarser 1 %, and 0.4975 % from the finer."""
    made_in(folder, Runs(), only=None)
    verdict = json.loads((folder / "out" / "compare" / "verdict.json").read_text())
    off = {each["a"]["name"]: each["quantities"] for each in verdict["against_record"]}
    assert list(off) == ["run-1mm", "run-0.5mm", "orifice"]
    assert off["run-0.5mm"]["p_ao"]["as_they_are"]["l2_percent"] == pytest.approx(0.5, abs=0.03)
    assert off["run-1mm"]["p_ao"]["as_they_are"]["l2_percent"] == pytest.approx(1.0, abs=0.03)
    (grids,) = verdict["between_grids"]
    assert (grids["a"]["name"], grids["b"]["name"]) == ("run-1mm", "run-0.5mm")
    assert grids["quantities"]["p_ao"]["as_they_are"]["l2_percent"] == pytest.approx(0.4975, abs=0.001)
    assert "pdva" in grids["quantities"]
    checks = [each for each in verdict["checks"] if each["run"] == "run-0.5mm"]
    assert [(each["quantity"], each["against"]) for each in checks] == [
        ("p_ao", "target"),
        ("p_lv", "the orifice in its place"),
        ("q_ao", "the orifice in its place"),
    ]
    assert checks[0]["at_most"] == 1.0
    assert checks[0]["reached"]
    assert checks[1]["at_most"] == off["orifice"]["p_lv"]["as_they_are"]["l2_percent"]
    assert checks[1]["reached"] is False, "the orifice is that of the record here"
    assert any("run-0.5mm: L2 of p_lv is" in line for line in verdict["next"])
    assert (folder / "out" / "compare" / "run-1mm-run-0.5mm" / "comparison.png").exists()


def test_a_target_is_reached_as_it_is_or_shifted():
    """Four norms around a target of 3 %, and a waveform that one of them lacks."""

    def comparison(plain, shifted):
        row = {
            key: {"l2_percent": v, "linf_percent": 2 * v}
            for key, v in (("as_they_are", plain), ("shifted", shifted))
        }
        return {"quantities": dict.fromkeys(("p_lv", "q_ao"), row)}

    results = {"run": comparison(4.0, 2.0), "orifice": comparison(3.5, 3.5)}
    found = checks_of(results, Targets(l2={"p_lv": 3.0, "pdva": 9.0}, linf={"q_ao": 8.0}))
    told = [
        (c["quantity"], c["norm"], c["at_most"], c["found"], c["reached"], c["reached_shifted"])
        for c in found
    ]
    assert told == [
        ("p_lv", "l2_percent", 3.0, 4.0, False, True),
        ("pdva", "l2_percent", 9.0, None, None, None),
        ("q_ao", "linf_percent", 8.0, 8.0, True, True),
        ("p_lv", "l2_percent", 3.5, 4.0, False, True),
        ("q_ao", "l2_percent", 3.5, 4.0, False, True),
    ]
    results = {name: result | {"shift_at_its_bound": name == "run"} for name, result in results.items()}
    assert advice({}, results, found[:1], 1.2) == [
        "run: the shift is at its bound: look for a reason in the pump or the start of the record",
        "run: L2 of p_lv is 4 %, more than 3 % (target); shifted it is not",
    ]
    missed = [{**found[0], "quantity": "p_ao"}]
    assert (
        advice({}, {}, missed, 1.2)[-1]
        == "P_Ao: the circuit alone, driven by the measured flow, is 1.2 % off in L2"
    )


# Processes


def test_the_command_goes_on_with_a_run_or_replaces_it(monkeypatch):
    part = RunPart(case=Path("a.toml"), out=Path("b"), changes=("grid.h=0.1 cm", "time.t_end=2 s"))
    words = [sys.executable, "-m", "valvefsi", "run", "a.toml", "--out", "b"]
    changes = ["--set", "grid.h=0.1 cm", "--set", "time.t_end=2 s"]
    assert part.command() == [*words, "--resume", *changes]
    fresh = RunPart(case=part.case, out=part.out, changes=part.changes, fresh=True, trust=True)
    assert fresh.command() == [*words, "--overwrite", "--trust", *changes]
    monkeypatch.setattr(surroundings.shutil, "which", lambda name, path: f"/somewhere/{name}")
    several = RunPart(case=part.case, out=part.out, changes=part.changes, ranks=3)
    assert several.command() == ["/somewhere/mpirun", "-n", "3", *words, "--resume", *changes]
    monkeypatch.setattr(surroundings.shutil, "which", lambda name, path: None)
    with pytest.raises(SurroundingsError, match="there is no mpirun"):
        several.command()


def test_a_run_is_a_process_that_goes_on_with_a_later_end(tmp_path):
    case = tmp_path / "box.toml"
    case.write_text(
        '[grid]\nlower = [0, 0]\nupper = [1, 1]\ncells = [8, 8]\n[time]\ndt = "0.1 s"\nt_end = "1 s"\n'
        "[output]\nhistory_every = 1\nframes = 0\n"
    )
    run_case(load_case(case), out=tmp_path / "out")
    launch(RunPart(case=case, out=tmp_path / "out", changes=("time.t_end=2 s",)))
    t = read_history(tmp_path / "out" / "history.csv")["t_s"]
    assert np.allclose(np.diff(t), 0.1)
    assert t[-1] == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("code", "kind"),
    [
        ("raise SystemExit(2)", CaseError),
        ("raise SystemExit(3)", ValvefsiError),
        ("raise SystemExit(4)", SurroundingsError),
        ("raise SystemExit(143)", Stopped),
    ],
)
def test_an_exit_code_becomes_the_error_it_stands_for(monkeypatch, code, kind):
    part = RunPart(case=Path("a.toml"), out=Path("b"), changes=())
    monkeypatch.setattr(RunPart, "command", lambda self: [sys.executable, "-S", "-c", code])
    with pytest.raises(kind, match="the run in b ended with") as caught:
        launch(part)
    assert caught.type is kind


def test_a_signal_is_passed_on_to_the_run(monkeypatch):
    """The run, asked to end, ends with the code of a run that has written its checkpoint."""
    code = (
        "import os, signal, sys, time\n"
        "signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))\n"
        "os.kill(os.getppid(), signal.SIGTERM)\n"
        "time.sleep(20)\n"
    )
    monkeypatch.setattr(RunPart, "command", lambda self: [sys.executable, "-S", "-c", code])
    with pytest.raises(Stopped) as caught:
        launch(RunPart(case=Path("a.toml"), out=Path("b"), changes=()))
    assert caught.value.signal == 15


def test_the_study_of_the_calibrations_can_be_read():
    study = load_study(ROOT / "calibration" / "validate_porcine.toml")
    assert study.grids == (0.1,)
    assert Path(study.record.file).name == "valve_beat.csv"
