"""The command that adds an optional part: one that works for how the package is installed."""

from __future__ import annotations

import re
import shlex
import sys
import tomllib
from pathlib import Path

from valvefsi.runtime.installing import how_to_add, how_to_set_up, pip_command, source_tree

ROOT = Path(__file__).parents[2]
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]


def package(folder, *, source):
    """A package with or without the file that its sources are installed by."""
    inside = folder / "valvefsi"
    inside.mkdir()
    if source:
        (folder / "pyproject.toml").write_text("")
    return inside


def test_an_installed_wheel_adds_an_extra_by_the_name_of_the_package(tmp_path):
    command = how_to_add("plot", package(tmp_path, source=False))
    assert command.endswith("pip install 'valvefsi[plot]'")
    assert "make" not in how_to_set_up(tmp_path / "valvefsi")


def test_sources_are_named_by_their_folder_so_that_it_works_in_any_other(tmp_path):
    folder = tmp_path / "a b"
    folder.mkdir()
    words = shlex.split(how_to_add("plot", package(folder, source=True)))
    assert words[-2:] == ["-e", f"{folder}[plot]"]
    assert shlex.split(how_to_set_up(folder / "valvefsi")) == ["make", "-C", str(folder), "setup"]


def test_pip_is_that_of_this_python(tmp_path, monkeypatch):
    other = tmp_path / "pip"
    other.write_text("#!/bin/sh\n")
    other.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(sys, "executable", "/some where/python")
    assert shlex.split(pip_command()) == ["/some where/python", "-m", "pip"]
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    assert pip_command() == "pip"


def test_no_other_module_says_how_to_install_an_extra_and_each_that_is_named_exists():
    named = set()
    for path in (ROOT / "valvefsi").rglob("*.py"):
        text = path.read_text()
        named |= set(re.findall(r"how_to_add\(['\"](\w+)['\"]", text))
        assert path.name == "installing.py" or not re.search(r"pip install ['\"\-]", text), path
    assert {"plot", "movies", "report", "dolfinx", "uncertainty"} <= named
    assert named <= set(EXTRAS)


def test_this_suite_runs_from_its_sources():
    assert source_tree() == ROOT
    assert shlex.split(how_to_add("plot"))[-2:] == ["-e", f"{ROOT}[plot]"]
