"""A short slice of the campaign, and that the campaign sees what it is for."""

from __future__ import annotations

import argparse
import json
import random
import shutil
import tomllib
from collections import Counter

import pytest
from mpi4py import MPI

from tests.campaign import fuzz
from tests.campaign.__main__ import COUNTS, keep
from tests.campaign.comparison import OTHER, differences, torn
from tests.campaign.fuzz import ACCEPTED, REFUSED, one
from tests.campaign.processes import LATE, Job, full_disk_and_resume, kill_and_resume
from valvefsi.case import parse_case
from valvefsi.case.build import run_case
from valvefsi.errors import CaseError

pytestmark = pytest.mark.serial
SLICE = {"cases": 40, "csv": 60, "meshes": 20, "folders": 5}


@pytest.mark.parametrize("kind", SLICE)
def test_damaged_files_are_refused_in_one_line_or_give_what_they_say(kind, tmp_path):
    found = Counter(one(kind, 20, number, tmp_path) for number in range(SLICE[kind]))
    good = (REFUSED, ACCEPTED, fuzz.FAILED, "resumed, same answer", "resumed, rows of the history lost")
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
    assert set(COUNTS) == {*fuzz.ATTACKS, "kills"}


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


LATE_SEED = 4
"""A seed whose second number is below a half: the kill waits for the first file."""


class Fake(Job):
    """A process that runs other code."""

    def start(self, out, *more, begin=()):
        return super().start(out, *more, begin=("-c", WRITES.format(self.arguments[0])))


@pytest.mark.parametrize(
    ("code", "outcome"),
    [
        ("(out / 'a.json').write_text('{'); time.sleep(60)", "kill -9: torn file a.json"),
        (
            "(out / 'a.json').write_text('{}'); time.sleep(60 * ('again' not in sys.argv))",
            "same in every file",
        ),
        ("(out / 'a.json').write_text('[]'); time.sleep(60 * ('again' not in sys.argv))", "another answer"),
        (
            "(out / '.b').write_text(''); time.sleep(60 * ('again' not in sys.argv))",
            "another answer in 2 files",
        ),
        ("time.sleep(60 * ('again' not in sys.argv)); sys.exit('error: no')", "failed: error: no"),
        ("", LATE),
    ],
)
def test_a_kill_sees_what_it_leaves(code, outcome, tmp_path):
    whole = tmp_path / "whole"
    whole.mkdir()
    (whole / "a.json").write_text("{}")
    job = Fake("fake", (code,), again=("again",), writes_late="write_text" in code)
    length = 60.0 if outcome == LATE else 10.0 if job.writes_late else 1.0
    assert outcome in kill_and_resume(job, whole, tmp_path / "out", random.Random(LATE_SEED), length)


@pytest.mark.parametrize(
    ("code", "outcome"),
    [
        ("sys.exit(3)", "not one line: exit 3"),
        ("print('Traceback', file=sys.stderr); sys.exit(4)", "not one line: exit 4"),
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
