"""``valvefsi doctor``: what it says of parts that work, that are missing and that raise; completion of the Tab key."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest
from mpi4py import MPI

from valvefsi.cli.doctor import Check, Finding, doctor, found_by
from valvefsi.errors import SurroundingsError

module = importlib.import_module("valvefsi.cli.doctor")

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts processes of its own")


def raising():
    raise RuntimeError("no such\nlibrary")


GOOD = Check(name="a", look=lambda: Finding(good=True, text="version 1"))
SLOW = Check(name="b", look=lambda: Finding(good=False, text="slow", advice="wait"), needed=False)
BROKEN = Check(name="c", look=raising, advice="apt-get install it")


def test_each_part_has_a_verdict_and_what_is_not_good_an_advice(monkeypatch, capsys):
    monkeypatch.setattr(module, "CHECKS", (GOOD, SLOW))
    doctor()
    lines = [line.split(maxsplit=2) for line in capsys.readouterr().out.splitlines()]
    assert lines == [["ok", "a", "version 1"], ["note", "b", "slow"], ["->", "wait"]]


def test_what_raises_is_a_finding_and_the_rest_is_looked_at(monkeypatch, capsys):
    monkeypatch.setattr(module, "CHECKS", (BROKEN, GOOD))
    with pytest.raises(SurroundingsError, match="before this is put right: c$"):
        doctor()
    lines = [line.split(maxsplit=2) for line in capsys.readouterr().out.splitlines()]
    assert lines == [
        ["FAILS", "c", "no such library"],
        ["->", "apt-get", "install it"],
        ["ok", "a", "version 1"],
    ]


@pytest.mark.parametrize("name", ["Python", "DOLFINx", "gmsh", "coupled run", "speed"])
def test_what_this_suite_runs_on_is_in_order(name, monkeypatch):
    monkeypatch.setattr(module, "PAIRS", float("inf"))  # no test asserts a time
    monkeypatch.setattr(module, "BOX", 16)
    check = next(check for check in module.CHECKS if check.name == name)
    assert found_by(check).good, found_by(check)


def test_programs_that_are_not_on_the_path_are_missed(monkeypatch):
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    for name, said in (("command", "/nowhere"), ("ffmpeg", "apt-get"), ("MPI", " setup; with Debian")):
        finding = found_by(next(check for check in module.CHECKS if check.name == name))
        assert not finding.good
        assert said in finding.advice


def test_completion_is_installed_and_completes(tmp_path):
    command = [sys.executable, "-c", "from valvefsi.cli import main; main()"]
    own = os.environ | {"HOME": str(tmp_path), "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    made = subprocess.run([*command, "--install-completion", "bash"], env=own, capture_output=True, text=True)
    assert made.returncode == 0, made.stderr
    text = (Path(tmp_path) / ".bash_completions" / "valvefsi.sh").read_text()
    assert "_VALVEFSI_COMPLETE=complete_bash" in text
    for typed, position, word in (("do", "1", "doctor"), ("new be", "2", "beam")):
        asked = {
            "_VALVEFSI_COMPLETE": "complete_bash",
            "COMP_WORDS": f"valvefsi {typed}",
            "COMP_CWORD": position,
        }
        done = subprocess.run(command, env=own | asked, capture_output=True, text=True)
        assert done.stdout.split() == [word]
