"""``valvefsi sweep``: what it prints, leaves, and how it ends. Members are stand-ins but for the last test."""

from __future__ import annotations

import csv
import io
import json
import os
import re
import signal
import subprocess
import sys
import time
import types
from pathlib import Path

import pytest
import typer.testing
from rich.console import Console

from tests.studies.conftest import CASE, PROGRAM, Study
from valvefsi import cli
from valvefsi.cli import study_progress
from valvefsi.errors import CaseError, StudyError
from valvefsi.io.history import read_history
from valvefsi.studies import runner
from valvefsi.studies.members import Member, Outcome
from valvefsi.studies.runner import Tally, run_members

pytestmark = pytest.mark.serial
RUNNER = typer.testing.CliRunner()
FAKE = f"""
from valvefsi.studies import runner
runner.PROGRAM, runner.POLL = {PROGRAM!r}, 0.02
from valvefsi.cli import main
main()
"""
MAIN = "from valvefsi.cli import main; main()"


@pytest.fixture
def study(tmp_path, monkeypatch):
    """Return a study of stand-ins."""
    monkeypatch.setattr(runner, "PROGRAM", PROGRAM)
    monkeypatch.setattr(runner, "POLL", 0.02)
    return Study(tmp_path)


def sweep(study, *options, over="fluid.viscosity=1,2"):
    return RUNNER.invoke(
        cli.app, ["sweep", str(study.case), "--over", over, "--out", str(study.folder), *options]
    )


def process(program, study, *options, over):
    command = [
        sys.executable,
        "-c",
        program,
        "sweep",
        study.case,
        "--over",
        over,
        "--out",
        study.folder,
        *options,
    ]
    return subprocess.Popen(
        [str(word) for word in command],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        process_group=0,
    )


def until(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_a_sweep_leaves_a_table_a_picture_and_says_where(study):
    answer = sweep(study, "--set", "time.t_end=2")
    assert answer.exit_code == 0
    assert answer.stdout.splitlines()[-1] == f"results in {study.folder / 'sweep.csv'}, sweep.png"
    assert "viscosity=1: done in" in answer.stdout
    with (study.folder / "sweep.csv").open() as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        last = json.loads((study.folder / row["member"] / "summary.json").read_text())["last"]
        assert {name: float(row[f"last.{name}"]) for name in last} == last
    assert [(row["member"], row["viscosity"], row["last.t_s"]) for row in rows] == [
        ("viscosity=1", "1.0", "2.0"),
        ("viscosity=2", "2.0", "2.0"),
    ]
    assert (study.folder / "sweep.png").stat().st_size > 10_000
    again = sweep(study, "--set", "time.t_end=2", "--resume")
    assert again.stdout.startswith("2 of 2 members done before\n")
    paper = sweep(study, "--set", "time.t_end=2", "--resume", "--style", "paper")
    assert paper.stdout.splitlines()[-1].endswith(", sweep.pdf")
    assert (study.folder / "sweep.pdf").read_bytes().startswith(b"%PDF")
    assert len(study.begun()) == len(study.events) / 2 == 2


def test_a_member_that_fails_is_named_with_its_log_and_the_command_fails(study, monkeypatch, capsys):
    answer = sweep(study, over="fluid.viscosity=1,7")
    log = study.folder / "viscosity=7" / "run.log"
    assert isinstance(answer.exception, StudyError)
    said = f"viscosity=7: ConvergenceError: it does not converge ({log})"
    assert str(answer.exception) == f"1 of 2 members failed: {said}"
    assert f"viscosity=7: failed, ConvergenceError: it does not converge ({log})" in answer.stdout
    result = json.loads((study.folder / "sweep.json").read_text())
    assert [m["state"] for m in result["members"]] == ["done", "failed"]
    words = ["sweep", study.case, "--over", "fluid.viscosity=1,7", "--out", study.folder, "--resume"]
    monkeypatch.setattr(sys, "argv", ["valvefsi", *map(str, words)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 3
    assert capsys.readouterr().err == f"StudyError: 1 of 2 members failed: {said}\n"


@pytest.mark.parametrize(
    ("over", "said"),
    [
        (
            "fluid.viscosty=1,2",
            r"member viscosty=1: fluid.viscosty = 1: unknown key; did you mean 'viscosity'\?",
        ),
        (
            "fluid.viscosity=1,2 mm",
            r"member viscosity=2mm: fluid.viscosity = '2 mm': .* mm measures something else",
        ),
        ("fluid.viscosity", "--over: fluid.viscosity: expected key=value,value"),
    ],
)
def test_what_cannot_be_used_is_refused_before_anything_runs(study, over, said):
    answer = sweep(study, over=over)
    assert isinstance(answer.exception, CaseError)
    assert re.search(said, str(answer.exception))
    assert study.events == []


def test_several_ranks_are_refused(study, monkeypatch):
    world = types.SimpleNamespace(COMM_WORLD=types.SimpleNamespace(size=2, rank=0))
    monkeypatch.setattr(runner, "MPI", world)
    with pytest.raises(CaseError, match="without mpirun"):
        run_members(study.case, [], study.folder)


@pytest.mark.parametrize("times", [1, 2])
def test_ctrl_c_stops_the_members_with_checkpoints_and_resume_goes_on(study, times):
    """The signal goes to the group of the command, as from a terminal; a second one does not wait for the members."""
    over = "fluid.viscosity=5,1"
    place = study.folder / "viscosity=5"
    if times == 2:
        (study.folder / "checkpoint.vfc").unlink()
        (study.folder / "deaf").touch()
    with process(FAKE, study, "--jobs", "1", over=over) as stopped:
        until(
            lambda: (place / "history.csv").exists() and (place / "history.csv").read_text().count("\n") > 5
        )
        os.killpg(stopped.pid, signal.SIGINT)
        if times == 2:
            until(lambda: "stopping" in stopped.stdout.readline())
            os.killpg(stopped.pid, signal.SIGINT)
        out, err = stopped.communicate(timeout=60)
    assert stopped.returncode == 130
    begun = 2 - times
    said = f"stopped; 0 of 2 members are done, {begun} more have a checkpoint, --resume goes on from there\n"
    assert err == said
    assert len(list(place.glob("checkpoints/*.vfc"))) == begun
    if times == 1:
        assert "stopping: 1 member running" in out
        (study.folder / "go").touch()
        assert "100.0 %  2 of 2 done" in sweep(study, "--resume", over=over).stdout
        assert study.begun() == {"viscosity=5": True, "viscosity=1": False}


def test_a_plan_lists_the_members_and_runs_none(study):
    answer = sweep(study, "--plan", "--jobs", "1", over="time.dt=50 ms,25 ms")
    rows = [line.split() for line in answer.stdout.splitlines() if line.startswith("  dt=")]
    assert [row[:4] for row in rows] == [["dt=50ms", "256", "20", "0.05"], ["dt=25ms", "256", "40", "0.025"]]
    assert re.search(
        r"^2 members, 1 at once: .* s, without start-up and output$", answer.stdout, re.MULTILINE
    )
    assert not list(study.folder.glob("dt=*"))
    adaptive = sweep(study, "--plan", "--set", "time.control=adaptive", over="time.dt=50 ms")
    assert ">= 20" in adaptive.stdout


def tally(done=0, kept=0, failed=0, running=None, share=0.0, left=None, **more):
    return Tally(
        total=4, kept=kept, done=done, failed=failed, running=running or {}, share=share, left_s=left, **more
    )


def ended(state, message=""):
    return Outcome(member=Member("a=1"), folder=Path("f/a=1"), state=state, message=message, wall_s=61.0)


STEPS = [
    tally(kept=1, share=0.25),
    tally(kept=1, running={"a=1": 0.0, "a=2": 0.0}, share=0.25),
    tally(kept=1, running={"a=1": 0.5, "a=2": 0.5}, share=0.5, left=130.0),
    tally(kept=1, running={"a=1": 0.5, "a=2": 0.5}, share=0.5, left=129.0),
    tally(kept=1, running={"a=1": 0.5, "a=2": 0.5}, share=0.5, left=128.0),
    tally(kept=1, done=1, running={"a=2": 0.5}, share=0.625, left=20.0, ended=(ended("done"),)),
    tally(kept=1, done=1, failed=1, share=1.0, left=0.0, ended=(ended("failed", "why"),), stopping=True),
]


def shown(monkeypatch, terminal):
    clock = iter(range(0, 1000, 3))
    monkeypatch.setattr(study_progress.time, "perf_counter", lambda: float(next(clock)))
    console = Console(file=io.StringIO(), force_terminal=terminal, width=100)
    with study_progress.StudyProgress("case", console) as progress:
        for step in STEPS:
            progress(step)
    return console.file.getvalue()


def test_without_a_terminal_progress_is_lines_where_something_has_changed(monkeypatch):
    assert shown(monkeypatch, terminal=False).splitlines() == [
        "1 of 4 members done before",
        " 25.0 %  1 of 4 done, 0 running",
        " 50.0 %  1 of 4 done, 2 running, 2 min 10 s left",
        "a=1: done in 1 min 01 s",
        " 62.5 %  2 of 4 done, 1 running, 20 s left",
        "a=1: failed, why (f/a=1/run.log)",
        "stopping: 0 members running; once more ends them without a checkpoint",
        "100.0 %  2 of 4 done, 0 running, 1 failed",
    ]


def test_on_a_terminal_it_is_a_bar(monkeypatch):
    text = shown(monkeypatch, terminal=True)
    assert "\x1b[" in text
    assert "a=1: done in 1 min 01 s" in text
    assert "2 of 4 done, 0 running, 1 failed" in text
    assert "0.0 s left" in text


BLOCK = """
[output]
history_every = 10
[[solid]]
name = "block"
mesh = { shape = "rectangle", lower = [0.375, 0.375], size = [0.25, 0.25], elements = [4, 4] }
material = { model = "neo_hookean", c1 = 10.0 }
"""


@pytest.mark.slow
def test_a_sweep_of_runs_that_is_stopped_and_goes_on_ends_as_one_that_is_not(study):
    """Real members: two blocks, stopped on their way, one of them started later."""
    study.case.write_text(CASE.replace('dt = "50 ms"', 'dt = "0.5 ms"\ncontrol = "adaptive"') + BLOCK)
    over = "solid.block.material.c1=1 Pa,2 Pa"
    whole = Study.__new__(Study)
    whole.case, whole.folder = study.case, study.folder.with_name("whole")
    with process(MAIN, study, "--jobs", "1", over=over) as stopped:
        place = study.folder / "c1=1Pa" / "history.csv"
        until(
            lambda: stopped.poll() is not None or (place.exists() and place.read_text().count("\n") > 20), 300
        )
        os.killpg(stopped.pid, signal.SIGINT)
        err = stopped.communicate(timeout=300)[1]
    assert stopped.returncode == 130
    assert "0 of 2 members are done, 1 more have a checkpoint" in err
    for made, options in ((study, ["--resume"]), (whole, [])):
        with process(MAIN, made, *options, over=over) as done:
            assert "results in" in done.communicate(timeout=600)[0]
        assert done.returncode == 0
    assert "--resume" in (study.folder / "c1=1Pa" / "run.log").read_text()
    for name in ("c1=1Pa", "c1=2Pa"):
        histories = [read_history(made.folder / name / "history.csv") for made in (study, whole)]
        assert histories[0] == histories[1]
        assert histories[0]["t_s"][-1] == pytest.approx(1.0)
