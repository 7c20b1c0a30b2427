"""The README is short, and its example runs as it stands."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")

pytestmark = pytest.mark.serial


def test_the_readme_is_short():
    assert len(TEXT.encode()) <= 8000


def test_the_example_runs_and_prints_two_numbers_that_agree(tmp_path):
    code = re.search(r"```python\n(.*?)```", TEXT, re.DOTALL)[1]
    assert len([line for line in code.splitlines() if line.strip()]) <= 20
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
    immersed, static = map(float, re.findall(r"(-\d\.\d+) cm", done.stdout))
    assert abs(immersed - static) < 0.05 * abs(static)


@pytest.mark.parametrize(
    "name", ["README.md", "CONTRIBUTING.md", "docs/start.md", "docs/validation/index.md"]
)
def test_the_make_targets_of_a_document_exist(name):
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    named = re.findall(r"`make ([a-z-]+)[^`]*`|^make ([a-z-]+)", (ROOT / name).read_text(), re.MULTILINE)
    assert named
    assert {a or b for a, b in named} <= targets
