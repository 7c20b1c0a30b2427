"""The README is short, and its example runs as it stands."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from valvefsi.benchmarks.references import read

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")

pytestmark = pytest.mark.serial


def test_the_readme_is_short():
    assert len(TEXT.encode()) <= 8000


def test_the_example_has_ten_lines_and_its_number_is_that_of_statics(tmp_path):
    code = re.search(r"```python\n(.*?)```", TEXT, re.DOTALL)[1]
    assert len(code.splitlines()) <= 10
    code = code.replace('"demos/', f'"{ROOT}/demos/')
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=os.environ,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    immersed = float(re.search(r"(-\d\.\d+) cm at t = 30 s", done.stdout)[1])
    static = read("compression_statics").value("u_y_top_centre_cm", elements_x=128)
    assert abs(immersed - static) < 0.05 * abs(static)
    assert (tmp_path / "results" / "example" / "top_centre.png").stat().st_size > 1000


@pytest.mark.parametrize(
    "name", ["README.md", "CONTRIBUTING.md", "docs/start.md", "docs/validation/index.md"]
)
def test_the_make_targets_of_a_document_exist(name):
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    named = re.findall(r"`make ([a-z-]+)[^`]*`|^make ([a-z-]+)", (ROOT / name).read_text(), re.MULTILINE)
    assert named
    assert {a or b for a, b in named} <= targets
