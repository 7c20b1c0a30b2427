"""A release: one version everywhere, and a wheel that holds every file that the package opens."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import valvefsi

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "valvefsi"
MANIFEST = "import sys; from setuptools import setup; setup(script_args=['-q', 'egg_info', '--egg-base', sys.argv[1]])"
BUILD = "import sys; from setuptools import build_meta; print(build_meta.build_wheel(sys.argv[1]))"

pytestmark = pytest.mark.serial


def tracked(*folders):
    """What git keeps, of some folders."""
    command = ["git", "ls-files", *folders]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("not in a clone")
    return {name for name in listed.stdout.splitlines() if (ROOT / name).exists()}


def data_files():
    """What git keeps of the package besides modules, as a wheel names it."""
    return {name for name in tracked("valvefsi") if not name.endswith(".py")}


def test_the_source_package_holds_what_the_clone_holds(tmp_path):
    command = [sys.executable, "-c", MANIFEST, str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    held = set((tmp_path / "valvefsi.egg-info" / "SOURCES.txt").read_text(encoding="utf-8").splitlines())
    assert tracked() <= held, sorted(tracked() - held)
    assert not [
        name for name in held if "__pycache__" in name or name.startswith(("results/", "docs/generated/"))
    ]


def test_the_wheel_holds_every_module_and_every_file_that_the_package_opens(tmp_path):
    source = tmp_path / "source"
    source.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        (source / name).write_bytes((ROOT / name).read_bytes())
    (source / "valvefsi").symlink_to(PACKAGE)
    command = [sys.executable, "-c", BUILD, str(tmp_path)]
    done = subprocess.run(command, cwd=source, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    (wheel,) = tmp_path.glob("*.whl")
    assert wheel.name == f"valvefsi-{valvefsi.__version__}-py3-none-any.whl"
    held = set(zipfile.ZipFile(wheel).namelist())
    modules = {path.relative_to(ROOT).as_posix() for path in PACKAGE.rglob("*.py")}
    assert data_files() | modules <= held
    assert not [name for name in held if name.startswith(("tests/", "docs/", "demos/"))]


def test_the_version_is_one_and_the_changelog_has_it():
    table = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert table["project"]["dynamic"] == ["version"]
    assert table["tool"]["setuptools"]["dynamic"]["version"] == {"attr": "valvefsi.__version__"}
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    released = re.findall(r"^## \[(\d+\.\d+\.\d+)\] - (\d{4}-\d\d-\d\d)$", changes, re.MULTILINE)
    assert released[0][0] == valvefsi.__version__
    assert f"\nversion: {released[0][0]}\ndate-released: {released[0][1]}\n" in citation
    assert released == sorted(released, key=lambda one: [int(n) for n in one[0].split(".")], reverse=True)
