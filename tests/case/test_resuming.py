"""What a folder of a run allows: one run at a time, the same run again, nothing overwritten by mistake."""

from __future__ import annotations

import errno
import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from tests.campaign.comparison import differences
from valvefsi.case import case_defaults, load_case, parse_case, to_toml
from valvefsi.case.build import build, plan_case, run_case
from valvefsi.case.resuming import FREE, provenance_of, shown_pair
from valvefsi.errors import CaseError, Stopped, SurroundingsError
from valvefsi.io import checkpoint, folder
from valvefsi.io.history import History, read_history
from valvefsi.run import disk, health
from valvefsi.run.disk import disk_needed

pytestmark = pytest.mark.serial
SELF = MPI.COMM_SELF
BLOCK = {
    "name": "block",
    "mesh": {"shape": "rectangle", "lower": [0.375, 0.375], "size": [0.25, 0.25], "elements": [4, 4]},
    "material": {"model": "neo_hookean", "c1": 10.0},
}
RAW = {
    "title": "stirred block",
    "grid": {"lower": [0, 0], "upper": [1, 1], "cells": [16, 16]},
    "fluid": {"viscosity": 0.1, "sides": {"y_upper": {"velocity": [1.0, 0.0]}}},
    "time": {"dt": "2 ms", "t_end": "80 ms"},
    "output": {"frames": 4, "history_every": 5, "checkpoint_every": 8},
    "solid": [BLOCK],
}


def case_with(*overrides):
    return parse_case(RAW, overrides)


def stop_at(step):
    def progress(now, *_):
        if now == step:
            raise Stopped("enough", 15)

    return progress


def broken_off(out, step=20, *overrides):
    with pytest.raises(Stopped):
        run_case(case_with(*overrides), out=out, comm=SELF, progress=stop_at(step))
    return out


def contents(out):
    return {path: path.read_bytes() for path in sorted(Path(out).rglob("*")) if path.is_file()}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    out = tmp_path_factory.mktemp("whole")
    run_case(case_with(), out=out, comm=SELF)
    return out


FIXED_CHANGES = [
    ("grid.upper=[2, 2]", "grid.upper.0: the checkpoint is of a run where this was 1 cm, it is 2 cm"),
    ("grid.cells=[32, 32]", "grid.cells.0: .* was 16, it is 32"),
    ("fluid.density=2", r"fluid.density: .* was 1 g/cm\^3, it is 2 g/cm\^3"),
    ("solid.block.mesh.elements=[5, 5]", "solid.block.mesh.elements.0: .* was 4, it is 5"),
    ("solid.block.coupling='elemental'", 'solid.block.coupling: .* was "nodal", it is "elemental"'),
    ("fluid.sides.x_lower.type='free_slip'", "fluid.sides.x_lower.type"),
    ("solid.block.kernel='ib4'", 'solid.block.kernel: .* was "bspline3", it is "ib4"'),
    ("output.dissipation=true", "output.dissipation: .* was false, it is true"),
]
OPEN_CHANGES = [
    ("time.dt='1 ms'", "time.dt: .* was 2 ms, it is 1 ms"),
    ("fluid.viscosity='20 cP'", "fluid.viscosity: .* was 10 cP, it is 20 cP"),
    ("solid.block.material.c1=20", r"solid.block.material.c1: .* was 10 dyn/cm\^2, it is 20 dyn/cm\^2"),
    ("solid.block.nu_stab=0.3", "solid.block.nu_stab"),
    ("time.control='adaptive'", "time.control"),
]


@pytest.mark.parametrize(("override", "said"), FIXED_CHANGES, ids=[c[0] for c in FIXED_CHANGES])
def test_what_gives_a_state_its_meaning_cannot_change(tmp_path, override, said):
    out = broken_off(tmp_path / "run")
    before = contents(out)
    for allow in (False, True):
        with pytest.raises(CaseError, match=rf"{said}.*; start a new run$") as caught:
            run_case(case_with(override), out=out, resume=True, allow_change=allow, comm=SELF)
        assert "\n" not in str(caught.value)
    assert contents(out) == before


@pytest.mark.parametrize(("override", "said"), OPEN_CHANGES, ids=[c[0] for c in OPEN_CHANGES])
def test_what_changes_the_way_on_is_refused_until_it_is_allowed(tmp_path, override, said):
    out = broken_off(tmp_path / "run")
    before = contents(out)
    with pytest.raises(CaseError, match=rf"{said}.*; --allow-change goes on with it$"):
        run_case(case_with(override), out=out, resume=True, comm=SELF)
    assert contents(out) == before
    result = run_case(case_with(override), out=out, resume=True, allow_change=True, comm=SELF)
    key = override.partition("=")[0]
    (change,) = result["changes"]
    assert change["key"] == key
    assert change["t_s"] == pytest.approx(0.032)
    assert json.loads((out / "summary.json").read_text())["changes"] == [change]
    text, before = (out / "case.toml").read_text(), said.partition("was ")[2].partition(",")[0]
    assert re.match(rf"# t = 0\.032 s: {key} was {before}", text)
    assert provenance_of(parse_case(tomllib.loads(text))) == provenance_of(case_with(override))
    assert result["last"]["t_s"] == pytest.approx(0.08, rel=1e-12)


def test_values_that_differ_little_are_told_apart():
    case = case_with("fluid.viscosity='10 cP'")
    assert shown_pair(case, "fluid.viscosity", 0.1, 0.1 * (1 + 1e-9)) == ("10 cP", "10.00000001 cP")
    assert shown_pair(case, "fluid.viscosity", None, 0.1) == ("not there", "10 cP")
    assert shown_pair(case, "time.dt", 0.002, None) == ("2 ms", "not there")


def test_time_and_not_the_number_of_steps_decides_the_end(tmp_path):
    """Half of the run with 2 ms, half with 4 ms: the end stays where it is."""
    out = broken_off(tmp_path / "run")
    changed = case_with("time.dt='4 ms'")
    result = run_case(changed, out=out, resume=True, allow_change=True, comm=SELF)
    assert result["last"]["t_s"] == pytest.approx(0.08, rel=1e-12)
    assert result["last"]["step"] == 16 + 12
    frames = (out / "paraview" / "fluid.pvd").read_text().count("DataSet ")
    assert frames == 5


def test_the_end_and_the_rhythm_of_output_may_change(tmp_path, whole):
    out = broken_off(tmp_path / "run", 20, "time.t_end='60 ms'", "output.checkpoint_every=4")
    result = run_case(case_with(), out=out, resume=True, comm=SELF)
    assert {c["key"] for c in result["changes"]} == {"time.t_end", "output.checkpoint_every"}
    ours, theirs = read_history(out / "history.csv"), read_history(whole / "history.csv")
    for name, values in theirs.items():
        np.testing.assert_allclose(ours[name], values, rtol=1e-11, atol=1e-13, err_msg=name)


@pytest.mark.parametrize("step", [9, 20, 39])
def test_every_file_of_a_resumed_run_is_that_of_the_uninterrupted_one(step, tmp_path, whole):
    out = broken_off(tmp_path / "run", step)
    run_case(case_with(), out=out, resume=True, comm=SELF)
    assert differences(out, whole) == {}


def test_changes_stay_known_over_several_resumes(tmp_path):
    out = broken_off(tmp_path / "run")
    with pytest.raises(Stopped):
        run_case(
            case_with("fluid.viscosity=0.2"),
            out=out,
            resume=True,
            allow_change=True,
            comm=SELF,
            progress=stop_at(30),
        )
    again = case_with("fluid.viscosity=0.2", "title='more'")
    result = run_case(again, out=out, resume=True, comm=SELF)
    assert [(c["key"], c["t_s"]) for c in result["changes"]] == [
        ("fluid.viscosity", pytest.approx(0.032)),
        ("title", pytest.approx(0.048)),
    ]


def test_a_table_that_was_edited_is_another_case(tmp_path):
    table = tmp_path / "lid.csv"
    table.write_text("t_s,u\n0,1\n1,1\n")
    side = {"velocity_expression": ["u", "0"], "table": str(table)}
    raw = {**RAW, "fluid": {"viscosity": 0.1, "sides": {"y_upper": side}}}
    out = tmp_path / "run"
    with pytest.raises(Stopped):
        run_case(parse_case(raw), out=out, comm=SELF, progress=stop_at(10))
    moved = tmp_path / "moved.csv"
    moved.write_bytes(table.read_bytes())
    table.write_text("t_s,u\n0,1\n1,2\n")
    with pytest.raises(CaseError, match=r'y_upper\.table: .* was "contents .*--allow-change'):
        run_case(parse_case(raw), out=out, resume=True, comm=SELF)
    side["table"] = str(moved)
    run_case(parse_case(raw), out=out, resume=True, comm=SELF)


def test_an_end_that_the_run_has_passed_is_refused_in_one_line(tmp_path):
    out = broken_off(tmp_path / "run")
    before = contents(out)
    said = r"time\.t_end: the checkpoint is of t = 0\.032 s, after this end of 0\.02 s; nothing is run"
    with pytest.raises(CaseError, match=said) as caught:
        run_case(case_with("time.t_end='20 ms'"), out=out, resume=True, comm=SELF)
    assert "\n" not in str(caught.value)
    assert contents(out) == before
    simulation = build(case_with("time.t_end='20 ms'"), out, SELF)
    with pytest.raises(CaseError, match="after this end"):  # without a case too, as in a benchmark
        simulation.run(resume=True)


def test_an_end_at_the_checkpoint_gives_the_last_row(tmp_path, whole):
    out = broken_off(tmp_path / "run")
    within = case_with("time.t_end='32.9 ms'")  # half a step is 1 ms
    for _ in range(2):  # the second time nothing is left to do
        result = run_case(within, out=out, resume=True, comm=SELF)
        assert result["last"]["t_s"] == pytest.approx(0.032)
        assert read_history(out / "history.csv")["step"] == [0, 5, 10, 15, 16]


@pytest.mark.parametrize("finished", [False, True])
def test_a_history_that_is_missing_begins_anew_and_is_said(tmp_path, finished):
    out = tmp_path / "run"
    run_case(case_with(), out=out, comm=SELF) if finished else broken_off(out)
    (out / "history.csv").unlink()
    step, t = (40, 0.08) if finished else (16, 0.032)
    said = rf"history\.csv is missing: its rows up to step {step} are lost, it begins anew there"
    with pytest.warns(UserWarning, match=said) as heard:
        result = run_case(case_with(), out=out, resume=True, comm=SELF)
    assert len(heard) == 1
    rows = read_history(out / "history.csv")
    assert rows["t_s"][0] == pytest.approx(t)
    assert rows["step"] == sorted(set(rows["step"]))
    assert result["last"]["t_s"] == rows["t_s"][-1] == pytest.approx(0.08)


def test_what_a_run_was_warned_of_before_it_was_broken_off_is_in_its_summary(tmp_path, monkeypatch, whole):
    monkeypatch.setattr(health, "LONGEST_GAP", 0.5)
    out, theirs = tmp_path / "run", tmp_path / "whole"
    with pytest.warns(UserWarning, match="fluid may leak"):
        run_case(case_with(), out=theirs, comm=SELF)
    with pytest.warns(UserWarning, match="fluid may leak"):
        broken_off(out)
    monkeypatch.setattr(health, "LONGEST_GAP", 100.0)
    run_case(case_with(), out=out, resume=True, comm=SELF)
    ours, other = (json.loads((f / "summary.json").read_text())["timing"]["warnings"] for f in (out, theirs))
    assert ours == other
    assert ours[0]["t_s"] == 0.0


def test_a_killed_run_leaves_nothing_that_it_only_began(tmp_path, whole):
    """The names under which files are written are those of a process that is no more, and of other ranks."""
    out = broken_off(tmp_path / "run")
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    begun = [f".summary.{gone.pid}.json", f".histories.{gone.pid}.png", ".history.csv.part"]
    begun += [
        "paraview/.fluid.pvd",
        "paraview/fluid/.fluid_000003_0001.vti",
        "paraview/block/.block_000002.vtu",
    ]
    begun += ["checkpoints/.step_00000040.vfc.part"]
    for name in begun:
        (out / name).write_text("half")
    run_case(case_with(), out=out, resume=True, comm=SELF)
    names = [{path.relative_to(f).as_posix() for path in contents(f)} for f in (out, whole)]
    assert names[0] == names[1]


def test_what_a_living_process_writes_is_left_alone(tmp_path):
    other = tmp_path / f".summary.{os.getppid()}.json"
    other.write_text("half")
    folder.write_text(tmp_path / "summary.json", "whole")
    assert other.exists()


def test_what_is_free_matches_whole_keys_only():
    keys = provenance_of(parse_case(tomllib.loads(case_defaults())))["case"]
    free = {key for key in keys if FREE.fullmatch(key)}
    assert {"title", "time.t_end", "output.frames", "output.checkpoint_wall"} <= free
    assert not {"time.dt", "time.dt_per_h", "grid.cells.0", "solid.block.material.c1"} & free
    assert not FREE.fullmatch("time.t_end2")


def test_a_finished_run_stays_unless_overwriting_is_asked_for(tmp_path):
    out = tmp_path / "run"
    run_case(case_with("time.t_end='10 ms'"), out=out, comm=SELF)
    before = contents(out)
    with pytest.raises(CaseError, match="holds a finished run; --overwrite replaces it"):
        run_case(case_with(), out=out, comm=SELF)
    assert contents(out) == before
    (out / "notes.txt").write_text("mine")
    result = run_case(case_with("time.t_end='6 ms'"), out=out, overwrite=True, comm=SELF)
    assert result["last"]["t_s"] == pytest.approx(0.006)
    assert [path.name for path in checkpoint.list_checkpoints(out / "checkpoints")] == ["step_00000003.vfc"]
    assert (out / "notes.txt").read_text() == "mine"


def test_an_unfinished_run_and_one_that_cannot_be_read_stay_too(tmp_path):
    out = broken_off(tmp_path / "run")
    before = contents(out)
    with pytest.raises(CaseError, match=r"holds a run that is not finished \(t = 0\.032 s\); --resume"):
        run_case(case_with(), out=out, comm=SELF)
    assert contents(out) == before
    for path in checkpoint.list_checkpoints(out / "checkpoints"):
        path.write_bytes(b"nothing")
    with pytest.raises(CaseError, match=r"its newest checkpoint cannot be read"):
        run_case(case_with(), out=out, comm=SELF)


def test_a_run_does_not_write_over_the_case_that_it_reads(tmp_path):
    file = tmp_path / "case.toml"
    file.write_text(to_toml(case_with()), encoding="utf-8")
    before = file.read_bytes()
    with pytest.raises(
        CaseError, match=r"case\.toml: a run writes case\.toml into its folder, over this case"
    ):
        run_case(load_case(file), out=tmp_path, comm=SELF)
    assert file.read_bytes() == before


def test_a_run_is_gone_on_with_or_replaced_not_both(tmp_path):
    with pytest.raises(CaseError, match="not both"):
        run_case(case_with(), out=tmp_path, comm=SELF, resume=True, overwrite=True)


def test_a_case_that_cannot_be_built_leaves_no_folder(tmp_path):
    with pytest.raises(CaseError, match="explicit viscosity"):
        run_case(
            case_with("fluid.viscous='explicit'", "fluid.viscosity=100"),
            out=tmp_path / "a" / "run",
            comm=SELF,
        )
    assert not (tmp_path / "a" / "run").exists()


HOLD = """
import sys
from mpi4py import MPI
from pathlib import Path
from valvefsi.io.folder import held
with held(Path(sys.argv[1]), MPI.COMM_SELF):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_two_runs_do_not_share_a_folder_and_a_dead_one_holds_none(tmp_path):
    out = broken_off(tmp_path / "run")
    before = contents(out)
    other = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(out)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert other.stdout.readline() == "held\n"
    with pytest.raises(
        CaseError, match=rf"another run or study holds this folder, process {other.pid} on .* since "
    ):
        run_case(case_with(), out=out, resume=True, comm=SELF)
    other.kill()
    other.wait()
    assert (out / folder.LOCK).exists()
    assert {**before, out / folder.LOCK: contents(out)[out / folder.LOCK]} == contents(out)
    run_case(case_with(), out=out, resume=True, comm=SELF)
    assert not (out / folder.LOCK).exists()


def test_a_full_disk_is_one_line_and_the_run_goes_on_when_there_is_room(tmp_path, monkeypatch, whole):
    out, count = tmp_path / "run", []

    def full(self, row):
        count.append(row)
        if len(count) == 4:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(out / "history.csv"))
        return append(self, row)

    append = History.append
    monkeypatch.setattr(History, "append", full)
    with pytest.raises(
        SurroundingsError, match=r"history\.csv: No space left on device; .*step_00000008.vfc is written"
    ) as caught:
        run_case(case_with(), out=out, comm=SELF)
    assert "\n" not in str(caught.value)
    monkeypatch.undo()
    run_case(case_with(), out=out, resume=True, comm=SELF)
    assert (out / "history.csv").read_bytes() == (whole / "history.csv").read_bytes()


def test_a_folder_that_vanishes_or_is_a_file_is_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file"):
        run_case(case_with(), out=tmp_path / "file", comm=SELF)

    def vanish(step, *_):
        if step == 6:
            for path in sorted((tmp_path / "run").rglob("*"), reverse=True):
                path.rmdir() if path.is_dir() else path.unlink()
            (tmp_path / "run").rmdir()

    with pytest.raises(SurroundingsError, match=r"No such file.*; no checkpoint is written"):
        run_case(case_with("output.checkpoint_every=0"), out=tmp_path / "run", comm=SELF, progress=vanish)


def test_summaries_and_pictures_are_whole_or_not_there(tmp_path):
    path = tmp_path / "summary.json"
    folder.write_text(path, "old")

    def half():
        with folder.replacing(path) as temporary:
            temporary.write_text("ne")
            raise RuntimeError("half")

    with pytest.raises(RuntimeError, match="half"):
        half()
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("summary.json", "old")]
    folder.write_text(path, "new")
    assert path.read_text() == "new"


def test_checkpoints_go_by_the_clock_unless_told_otherwise():
    output = parse_case({key: RAW[key] for key in ("grid", "time")}).output
    assert (output.checkpoint_every, output.checkpoint_wall) == (0, 600.0)


def test_a_clock_that_jumps_does_no_harm(tmp_path, monkeypatch, whole):
    import time

    real, jumps = time.perf_counter, [0.0]

    def jumping():
        jumps[0] += 1e7 if int(real() * 1e3) % 2 else -1e7
        return real() + jumps[0]

    monkeypatch.setattr(time, "perf_counter", jumping)
    out = tmp_path / "run"
    result = run_case(case_with("output.checkpoint_wall='1 s'"), out=out, comm=SELF)
    assert result["timing"]["wall_s"] > 0
    assert (out / "history.csv").read_bytes() == (whole / "history.csv").read_bytes()


def test_the_disk_that_a_plan_names_is_enough_and_not_far_too_much(tmp_path, monkeypatch):
    made = case_with("grid.cells=[128, 128]", "solid.block.mesh.elements=[32, 32]", "output.frames=20")
    simulation = build(made, tmp_path / "run", SELF)
    needed = disk_needed(simulation.model, simulation.output, simulation.schedule.num_steps())
    simulation.run()
    used = sum(path.stat().st_size for path in (tmp_path / "run").rglob("*") if path.is_file())
    assert used < needed < 10 * used
    (entry,) = (e for e in plan_case(made, SELF, tmp_path)["plan"] if e.quantity == "disk, at most")
    assert entry.value == pytest.approx(needed / 1e9)
    assert "GB are free" in entry.note


def test_a_disk_that_is_too_small_is_warned_of_before_the_run(tmp_path, monkeypatch):
    monkeypatch.setattr(disk, "disk_free", lambda folder: 1e3)
    with pytest.warns(UserWarning, match=r"the run may need .* GB of disk, 1e-06 GB are free"):
        run_case(case_with("time.t_end='4 ms'"), out=tmp_path / "run", comm=SELF)
