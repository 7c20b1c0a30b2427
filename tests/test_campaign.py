"""A short slice of the campaign, and that the campaign sees what it is for."""

from __future__ import annotations

import argparse
import json
import random
import shutil
import signal
import subprocess
import tomllib
from collections import Counter
from contextlib import closing
from typing import ClassVar

import pytest
from mpi4py import MPI

from tests.campaign import chains, fuzz
from tests.campaign.__main__ import COUNTS, keep
from tests.campaign.chains import Chain
from tests.campaign.comparison import OTHER, differences, torn
from tests.campaign.fuzz import one
from tests.campaign.outcomes import (
    ACCEPTED,
    ELSE,
    FAILED,
    REFUSED,
    RESUMED,
    RIGHT,
    ROWS_LOST,
    Log,
    columns,
    is_bad,
)
from tests.campaign.processes import BLOCK, Job, full_disk_and_resume
from tests.campaign.warm import Warm
from valvefsi.case import parse_case
from valvefsi.case.build import run_case
from valvefsi.errors import CaseError

pytestmark = pytest.mark.serial
SLICE = {"cases": 40, "csv": 60, "meshes": 20, "folders": 5}


@pytest.mark.parametrize("kind", SLICE)
def test_damaged_files_are_refused_in_one_line_or_give_what_they_say(kind, tmp_path):
    found = Counter(one(kind, 20, number, tmp_path) for number in range(SLICE[kind]))
    good = (REFUSED, ACCEPTED, FAILED, RESUMED, ROWS_LOST)
    assert {outcome: times for outcome, times in found.items() if outcome not in good} == {}
    assert found[REFUSED] > 0 or kind == "folders"
    assert sum(found[outcome] for outcome in good if outcome != REFUSED) > 0 or kind == "meshes"


@pytest.mark.parametrize(
    ("fault", "outcome"),
    [
        (ZeroDivisionError("division by zero"), "TRACEBACK: ZeroDivisionError: 'division by zero'"),
        (CaseError("x" * 3000), REFUSED),
        (OSError("a\nb"), "NOT ONE LINE: 'a\\nb'"),
    ],
)
def test_the_campaign_tells_a_fault_from_a_refusal(fault, outcome, tmp_path, monkeypatch):
    def fail(rng, folder):
        raise fault

    monkeypatch.setitem(fuzz.ATTACKS, "cases", fail)
    assert one("cases", 1, 0, tmp_path) == outcome


def test_the_campaign_sees_a_hang(tmp_path, monkeypatch):
    def hang(rng, folder):
        while True:
            pass

    monkeypatch.setitem(fuzz.ATTACKS, "cases", hang)
    monkeypatch.setattr(fuzz, "PATIENCE", 1)
    assert one("cases", 1, 0, tmp_path) == "HANG"


def test_the_campaign_sees_another_answer(tmp_path, monkeypatch):
    real = fuzz.difference
    monkeypatch.setattr(fuzz, "difference", lambda ours, theirs: 1e-3 + real(ours, theirs))
    monkeypatch.setattr(fuzz, "last_gap", lambda ours, theirs: 1e-3)
    found = {one("folders", 20, number, tmp_path) for number in range(3)}
    assert any(outcome.startswith("WRONG: 1.0e-03 off") for outcome in found)


def test_an_item_follows_from_its_seed_alone():
    texts = [fuzz.mutated(fuzz.SMALL, random.Random("cases 1 7"), ",") for _ in range(2)]
    assert texts[0] == texts[1] != fuzz.SMALL
    assert set(COUNTS) == {*fuzz.ATTACKS, "kills", "faults"}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of eight steps with everything that a run leaves."""
    out = tmp_path_factory.mktemp("run") / "whole"
    changes = ["time.t_end='16 ms'", "output.checkpoint_every=4"]
    run_case(parse_case(tomllib.loads(fuzz.SMALL), changes), out=out, comm=MPI.COMM_SELF)
    return out


def changed_by(path, old, new):
    data = path.read_bytes()
    assert data.count(old) >= 1, path
    path.write_bytes(data.replace(old, new, 1))


FAULTS = {
    "summary.json": lambda path: changed_by(path, b'"courant": 0.', b'"courant": 1.'),
    "case.toml": lambda path: changed_by(path, b"stirred", b"shaken_"),
    "history.csv": lambda path: changed_by(path, b"\n4,", b"\n5,"),
    "paraview/fluid.pvd": lambda path: changed_by(path, b'timestep="0.004"', b'timestep="0.005"'),
    "paraview/fluid/fluid_000002_0000.vti": lambda path: path.write_bytes(
        (path.parent / "fluid_000001_0000.vti").read_bytes()
    ),
    "paraview/block/block_000002.vtu": lambda path: path.write_bytes(
        (path.parent / "block_000001.vtu").read_bytes()
    ),
    "checkpoints/step_00000008.vfc": lambda path: changed_by(
        path, path.read_bytes()[-8:], b"\0\0\0\0\0\0\xf0?"
    ),
    "flow.png": lambda path: shutil.copy(path.parent / "histories.png", path),
    "paraview/block.pvd": lambda path: path.unlink(),
    ".summary.1.json": lambda path: path.write_text("half"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_the_comparison_sees_a_fault_in_every_kind_of_file(name, run, tmp_path):
    ours = tmp_path / "ours"
    shutil.copytree(run, ours)
    assert differences(ours, run) == {}
    FAULTS[name](ours / name)
    assert name in differences(ours, run)


def test_the_comparison_passes_over_the_clock_and_nothing_else(run, tmp_path):
    ours = tmp_path / "ours"
    shutil.copytree(run, ours)
    summary = json.loads((ours / "summary.json").read_text())
    summary["timing"]["wall_s"] *= 2.0
    (ours / "summary.json").write_text(json.dumps(summary))
    assert differences(ours, run) == {}
    summary["timing"]["cells"] += 1
    (ours / "summary.json").write_text(json.dumps(summary))
    assert differences(ours, run)["summary.json"] > 1e-3
    (ours / "checkpoints" / "step_00000004.vfc").unlink()
    assert differences(ours, run)["checkpoints/step_00000004.vfc"] == OTHER
    assert set(differences(ours, run, checkpoints=False)) == {"summary.json"}


def test_a_torn_file_is_seen(run, tmp_path):
    ours = tmp_path / "ours"
    shutil.copytree(run, ours)
    assert list(torn(ours)) == []
    for path in sorted(path for path in ours.rglob("*") if path.is_file()):
        whole = path.read_bytes()
        path.write_bytes(whole[: len(whole) // 2])
        grows, name = path.name == "history.csv", path.relative_to(ours).as_posix()
        assert grows or name in list(torn(ours)), path
        path.write_bytes(whole)


WRITES = """
import sys, time
from pathlib import Path
out = Path(sys.argv[sys.argv.index("--out") + 1])
out.mkdir(exist_ok=True)
{}
"""


class Fake(Job):
    """A process that runs other code; the last of them stands for a server of forks."""

    alive: ClassVar[list[subprocess.Popen[str]]] = []

    def start(self, out, *more, begin=()):
        process = super().start(out, *more, begin=("-c", WRITES.format(self.arguments[0])))
        self.alive[:] = [process]
        return process


class Direct:
    """Looks at the last process itself, and counts the time by its looks."""

    def __init__(self):
        self.looks = 0

    def spent(self, rank):
        self.looks += 1
        return 0.02 * self.looks

    def kill(self, rank):
        Fake.alive[-1].kill()
        return True

    def settle(self):
        return True


@pytest.mark.parametrize(
    ("code", "outcome"),
    [
        ("(out / 'a.json').write_text('{'); time.sleep(60)", "kill -9: torn file a.json, torn file a.json"),
        (
            "(out / 'a.json').write_text('{}'); time.sleep(60 * ('again' not in sys.argv))",
            "kill -9: done again, same in every file",
        ),
        (
            "(out / 'a.json').write_text('[]'); time.sleep(60 * ('again' not in sys.argv))",
            "kill -9: done again, another answer in 1 files: a.json inf",
        ),
        (
            "(out / '.b').write_text(''); time.sleep(60 * ('again' not in sys.argv))",
            "kill -9: done again, another answer in 2 files",
        ),
        (
            "time.sleep(60 * ('again' not in sys.argv)); sys.exit('error: no')",
            "done again, failed: error: no",
        ),
        ("sys.exit('error: no')", "without a kill, failed: error: no"),
        ("(out / 'a.json').write_text('{}')", ""),
    ],
)
def test_a_kill_counts_by_what_it_leaves_and_by_the_answer_at_the_end(code, outcome, tmp_path):
    whole = tmp_path / "whole"
    whole.mkdir()
    (whole / "a.json").write_text("{}")
    job = Fake("fake", (code,), again=("again",), writes_late="write_text" in code)
    length = 0.1 if "sleep" in code else 1e9
    seed = LATE_SEED if job.writes_late else EARLY_SEED
    chain = Chain(job, Direct(), tmp_path / "out", random.Random(seed), length)
    (found,) = chain.outcomes(whole, 1) or [""]
    assert found.startswith(outcome) if outcome.startswith("kill") else found.endswith(outcome)


LATE_SEED, EARLY_SEED = 4, 3
"""A seed whose kill waits for the first file, and one whose kill does not."""


GOES_ON = """
checkpoint, starts = out / 'checkpoints' / 'step_00000001.vfc', out / 'starts'
checkpoint.parent.mkdir(exist_ok=True)
if '--resume' in sys.argv and not checkpoint.exists():
    sys.exit(print('error: there is no checkpoint to resume from', file=sys.stderr) or 2)
if '--overwrite' in sys.argv and checkpoint.exists():
    sys.exit('error: a run that could go on is begun anew')
if starts.exists():
    checkpoint.touch()
with starts.open('a') as file:
    file.write('.')
if len(starts.read_text()) < 5:
    (out / 'ready').touch()
    time.sleep(60)
"""
"""Writes a checkpoint from its second start on, and comes to its end at its fifth."""


class WhenReady(Direct):
    """Lets a process write what it writes before it is killed."""

    def __init__(self, out):
        super().__init__()
        self.ready = out / "ready"

    def spent(self, rank):
        return super().spent(rank) if self.ready.exists() else None

    def kill(self, rank):
        self.ready.unlink()
        return super().kill(rank)


def test_a_run_is_killed_again_after_it_went_on_and_every_kill_is_counted(tmp_path, monkeypatch):
    monkeypatch.setattr(chains, "torn", lambda folder: iter(()))  # its checkpoints are empty
    out = tmp_path / "out"
    chain = Chain(Fake("fake", (GOES_ON,)), WhenReady(out), out, random.Random(EARLY_SEED), 0.1)
    assert chain.kill(9) == (["kill -9: begun anew", *(3 * ["kill -9: resumed"])], "")


def test_a_fork_ends_as_the_command_line_does_and_dies_when_it_is_killed(tmp_path):
    job = Job("block", ("run", str(tmp_path / "block.toml")))
    (tmp_path / "block.toml").write_text(BLOCK)
    with closing(Warm()) as warm:
        forked = job.forked_by(warm)
        code, said = forked.run(tmp_path / "out", "--nonsense")
        assert code == 2
        assert "--nonsense" in said
        process = forked.start(tmp_path / "out")
        while warm.spent(0) is None:
            assert process.poll() is None
        assert warm.kill(0)
        process.communicate()
        assert process.returncode == -signal.SIGKILL
        assert warm.settle()
        assert warm.ranks() == {}


@pytest.mark.parametrize(
    ("code", "outcome"),
    [
        ("sys.exit(3)", "not one line: exit 3"),
        ("print('Traceback', file=sys.stderr); sys.exit(4)", "not one line: exit 4"),
        ("print('error: x, error stack: MPI_File', file=sys.stderr); sys.exit(4)", "not one line: exit 4"),
        (
            "(out / 'a.json').write_text('{'); print('error: full', file=sys.stderr); sys.exit(4)",
            "torn file a.json",
        ),
    ],
)
def test_a_full_disk_is_one_line_or_is_counted_as_a_fault(code, outcome, tmp_path):
    job = Fake("fake", (code,))
    assert outcome in full_disk_and_resume(job, tmp_path, tmp_path / "out", 2000)


def test_counts_are_put_beside_those_of_other_attacks(tmp_path):
    out, given = tmp_path / "counts.json", argparse.Namespace(seed=7)
    keep(out, {"a": {"x": 1}}, given)
    keep(out, {"b": {"x": 2, "y": 3}}, given)
    keep(out, {"a": {"z": 4}}, given)
    result = json.loads(out.read_text())
    counts = [(row["case"], row["quantity"], row["computed"]) for row in result["quantities"]]
    assert counts == [("b", "x", 2), ("b", "y", 3), ("a", "z", 4)]
    assert [run["command"] for run in result["runs"]] == 2 * ["python -m tests.campaign --seed 7"]


def test_the_log_goes_on_where_it_was_and_knows_its_seed(tmp_path):
    log = Log(tmp_path / "log", 7)
    log.add("a", 0, ["x"])
    log.add("a", 1, ["y", "z"])
    Log(tmp_path / "log", 8).add("a", 2, ["w"])
    assert log.read("a") == {0: ["x"], 1: ["y", "z"]}
    assert log.read("b") == {}
    assert Log(None, 7).read("a") == {}


@pytest.mark.parametrize("outcome", ["TRACEBACK: x", "HANG", "WRONG: 1", "CRASH: exit 3", "NOT ONE LINE: x"])
def test_a_fault_is_counted_as_one_in_the_table_of_damaged_files(outcome):
    found = columns([REFUSED, ACCEPTED, RESUMED, outcome])
    assert found[ELSE] == 1
    assert found[RIGHT] == 2
    assert is_bad(outcome)
    assert not any(map(is_bad, (REFUSED, ACCEPTED, FAILED, RESUMED, ROWS_LOST)))
