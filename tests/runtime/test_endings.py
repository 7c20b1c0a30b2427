"""Signals that end a command before it computes: one line and the documented exit code, wherever they come."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

pytestmark = pytest.mark.serial

IN_AN_IMPORT = """
import os, sys
class Ends:
    def find_spec(self, name, *others):
        if name == {module!r}:
            os.kill(os.getpid(), {number})
sys.meta_path.insert(0, Ends())
sys.argv = ["valvefsi", "case", "--defaults"]
from valvefsi.__main__ import main
main()
"""
AFTER_PETSC = """
import os, sys
from valvefsi.runtime.signals import end_in_one_line
end_in_one_line()
from valvefsi.runtime import dolfinx_compat
from valvefsi.errors import Stopped
try:
    os.kill(os.getpid(), 15)
except Stopped as stop:
    sys.exit(f"{stop.signal}: {stop}")
"""


def ended(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)


@pytest.mark.parametrize("module", ["typer", "pydantic"])
@pytest.mark.parametrize(("number", "word"), [(signal.SIGTERM, "terminated"), (signal.SIGINT, "interrupted")])
def test_a_signal_while_libraries_are_imported_is_one_line(number, word, module):
    """Of the command line itself, and of a command that it has begun."""
    done = ended(IN_AN_IMPORT.format(module=module, number=int(number)))
    assert done.returncode == 128 + number
    again = "start it again, a run that had begun goes on with --resume"
    assert done.stderr == f"{word}; {again}\n"
    assert done.stdout == ""


def test_petsc_leaves_sigterm_alone():
    done = ended(AFTER_PETSC)
    assert done.stderr.startswith("15: terminated; start it again"), done.stderr
    assert done.returncode == 1
