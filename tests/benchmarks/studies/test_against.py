"""Steps of two commits in turns: a repository of stubs, whose command writes the time of a step that it is told."""

from __future__ import annotations

import json
import os
import subprocess

import pytest

from valvefsi.benchmarks.frame import Report
from valvefsi.benchmarks.studies.against import Against
from valvefsi.benchmarks.studies.speed import Speed
from valvefsi.errors import CaseError

pytestmark = pytest.mark.serial  # starts processes of its own

NOTHING = Report(parameters={}, table=[])
CASE = {"block.toml": ["--case", "block.toml", "--steps", "2"]}
COMMAND = """
import json, pathlib, sys
out = pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
log = pathlib.Path("{log}")
number = len(log.read_text().splitlines()) if log.exists() else 0
with log.open("a") as file:
    file.write(json.dumps(["{name}", *sys.argv[1:-2]]) + "\\n")
step = {step} * (1 + number // 2)  # a load that grows from turn to turn
(out / "result.json").write_text(json.dumps({result}))
"""
FAILING = "import sys\nsys.exit({message!r})\n"
TOO_OLD = "import sys\nprint('│ No such option: --case │', file=sys.stderr)\nsys.exit(2)\n"


@pytest.fixture
def commit(tmp_path):
    """What writes the command of the package, commits it and returns the commit's hash."""
    root = tmp_path.resolve() / "repository"
    (root / "valvefsi").mkdir(parents=True)
    (root / "valvefsi" / "__init__.py").write_text("")
    who = ["-c", "user.name=stub", "-c", "user.email=stub@example.org"]

    def git(*words):
        clean = {k: v for k, v in os.environ.items() if not k.startswith("GIT_")}
        done = subprocess.run(
            ["git", "-C", root, *who, *words], capture_output=True, text=True, check=True, env=clean
        )
        return done.stdout.strip()

    def write(text):
        (root / "valvefsi" / "__main__.py").write_text(text)
        git("add", "-A")
        git("commit", "-q", "-m", "stub")
        return git("rev-parse", "HEAD")

    git("init", "-q")
    return write


def command(tmp_path, name, step, result='{"case": {"step_ms": step}}'):
    return COMMAND.format(log=tmp_path / "log", name=name, step=step, result=result)


def test_a_slower_step_is_seen_through_a_load_that_grows(commit, tmp_path):
    there = commit(command(tmp_path, "there", 10.0))
    commit(command(tmp_path, "here", 11.0))
    report = Against(rev=there[:12], turns=5, root=tmp_path.resolve() / "repository").compare(CASE)
    q = report.quantities["block.toml"]
    assert q["ratio"] == pytest.approx(1.1)
    assert q["ratio_range"] == pytest.approx([1.1, 1.1])
    assert (q["here_ms"], q["there_ms"]) == pytest.approx((33.0, 30.0)), "medians of 1 to 5 times a step"
    assert report.table[0]["source"].startswith("slower in every turn")
    assert report.parameters["commit"] == there
    runs = [json.loads(line) for line in (tmp_path / "log").read_text().splitlines()]
    assert [run[0] for run in runs] == ["there", "here", "here", "there"] * 2 + ["there", "here"]
    assert {tuple(run[1:]) for run in runs} == {("bench", "speed", *CASE["block.toml"])}
    assert not (tmp_path / "repository" / ".git" / "worktrees").exists(), "the other commit's folder is gone"


def test_what_is_not_on_one_side_in_every_turn_is_no_difference(commit, tmp_path):
    there = commit(command(tmp_path, "there", 10.0))
    commit(command(tmp_path, "here", "(9.9 if number // 2 % 2 else 10.1)"))
    report = Against(rev=there, turns=5, root=tmp_path.resolve() / "repository").compare(CASE)
    assert report.table[0]["source"] == "0.990 ... 1.010 in 5 turns"
    assert report.quantities["block.toml"]["ratio"] == pytest.approx(1.01)


def test_grids_are_read_from_their_place(commit, tmp_path):
    there = commit(command(tmp_path, "there", 4.0, '{"grids": [{"step_ms": step}]}'))
    report = Against(rev=there, turns=2, root=tmp_path.resolve() / "repository").compare(
        {"box": ["--sizes", "8"]}
    )
    assert report.quantities["box"]["ratio"] == 1.0
    assert report.table[0]["source"] == "1.000 ... 1.000 in 2 turns"


def test_what_cannot_be_compared_is_one_clear_line(commit, tmp_path):
    root = tmp_path.resolve() / "repository"
    with pytest.raises(CaseError, match="not run from a git repository"):
        Against(rev="HEAD", turns=2, root=tmp_path.resolve()).compare(CASE)
    old, broken = commit(TOO_OLD), commit(FAILING.format(message="error: block.toml: no such file"))
    bare = commit(FAILING.format(message="No module named 'valvefsi.cli'"))
    here = commit(command(tmp_path, "here", 1.0))
    for rev, text in [
        ("v99", "--against = 'v99': the repository has no such commit"),
        (old, f"'{old}': the commit is too old to time these steps: No such option: --case"),
        (bare, "the commit is too old to time these steps: No module named 'valvefsi.cli'"),
        (broken, "the steps of that commit fail: error: block.toml: no such file"),
    ]:
        with pytest.raises(CaseError) as caught:
            Against(rev=rev, turns=2, root=root).compare(CASE)
        assert text in str(caught.value)
        assert "\n" not in str(caught.value)
    commit(FAILING.format(message="error: no memory"))
    with pytest.raises(CaseError, match="the steps of this commit fail: error: no memory"):
        Against(rev=here, turns=2, root=root).compare(CASE)


def test_grids_and_cases_become_options_of_the_processes(monkeypatch, tmp_path, shared_tmp):
    seen = {}
    monkeypatch.setattr(Against, "compare", lambda self, subjects, announce: seen.update(subjects) or NOTHING)
    Speed(sizes=(8, 16), dim=2, steps=3, overrides=["mu=1"], against="v1").run(out=shared_tmp)
    shared = ["--steps", "3", "--set", "mu=1"]
    assert seen["8^2 cells"] == ["--sizes", "8", "--dim", "2", *shared]
    assert seen["16^2 cells"] == ["--sizes", "16", "--dim", "2", *shared]
    monkeypatch.chdir(tmp_path)
    Speed(case="a.toml", state="run", steps=3, overrides=["mu=1"], against="v1").run(out=shared_tmp)
    place = tmp_path.resolve()
    assert seen["a.toml"] == ["--case", str(place / "a.toml"), "--state", str(place / "run"), *shared]
