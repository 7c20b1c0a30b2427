"""A study whose members are stand-ins that take no time."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from mpi4py import MPI

from valvefsi.io import checkpoint
from valvefsi.studies import runner
from valvefsi.studies.members import Member
from valvefsi.studies.runner import run_members

PROGRAM = (sys.executable, str(Path(__file__).with_name("fake_member.py")))
CASE = """
title = "driven box"
[grid]
lower = [0, 0]
upper = [1, 1]
cells = [16, 16]
[fluid]
viscosity = 0.1
sides.y_upper = { velocity = [1.0, 0.0] }
[time]
dt = "50 ms"
t_end = "1 s"
"""


def members(*viscosities, **also):
    """Members of these viscosities; ``t_end`` for all."""
    more = tuple(f"time.{key}={value}" for key, value in also.items())
    return [Member(f"viscosity={mu}", (f"fluid.viscosity={mu}", *more)) for mu in viscosities]


class Study:
    """A folder with a case, and a folder for the study."""

    def __init__(self, root):
        self.case, self.folder = root / "case.toml", root / "study"
        self.case.write_text(CASE)
        self.folder.mkdir()
        meta = {"t": 0.25, "dt": 0.05}
        saved = checkpoint.save(root, 5, {}, {}, meta, MPI.COMM_SELF)
        saved.rename(self.folder / "checkpoint.vfc")

    def run(self, chosen, **options):
        return run_members(self.case, chosen, self.folder, **options)

    @property
    def events(self):
        """What the members said: kind and the rest, in order."""
        path = self.folder / "events"
        lines = path.read_text().splitlines() if path.exists() else []
        return [next(iter(json.loads(line).items())) for line in lines]

    def begun(self):
        """Name of each member that has begun, and whether it went on."""
        return {told["name"]: told["resume"] for kind, told in self.events if kind == "begin"}

    def forget(self):
        (self.folder / "events").unlink()

    def record(self, name):
        return json.loads((self.folder / name / "member.json").read_text())


@pytest.fixture
def study(tmp_path, monkeypatch):
    """Return a study of stand-ins."""
    monkeypatch.setattr(runner, "PROGRAM", PROGRAM)
    monkeypatch.setattr(runner, "POLL", 0.02)
    return Study(tmp_path)
