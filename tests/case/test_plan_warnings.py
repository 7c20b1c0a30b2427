"""What a plan warns of: jets in short boxes, and histories that miss what drives the flow."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.case_text import written
from valvefsi.case import load_case
from valvefsi.case.plan_warnings import plan_warnings

pytestmark = pytest.mark.serial
ROOT = Path(__file__).parents[2]
VALVE = ROOT / "valvefsi" / "cli" / "starts" / "valve" / "valve.toml"
CHANNEL = """
[grid]
lower = [0, 0]
upper = [4, 1]
cells = [16, 4]
[fluid]
viscosity = 0.1
[fluid.sides]
x_lower = {velocity_expression = ["mean", "0"], table = "inflow.csv"}
x_upper = {type = "open"}
[time]
dt = "1 ms"
t_end = "1 s"
[output]
history_every = 10
"""
DISK = """
[grid]
lower = [0, 0, 0]
upper = [2, 2, 4]
cells = [8, 8, 16]
[fluid.sides]
z_lower = {type = "mixed", centre = [1, 1, 0], radius = "5 mm"}
z_upper = {type = "open"}
[time]
dt = "1 ms"
t_end = "1 s"
"""


def said(case):
    return [f"{entry.quantity}: {entry.note}" for entry in plan_warnings(case)]


def sine(folder, period):
    t = np.linspace(0.0, 1.0, 2001)
    rows = [f"{a:.6f},{np.sin(2 * np.pi * a / period):.9f}" for a in t]
    (folder / "inflow.csv").write_text("\n".join(["t_s,mean", *rows]) + "\n")


def test_a_history_is_as_fine_as_its_fastest_signal_asks(tmp_path):
    """A sine goes through its range in T / pi at its steepest: four rows in that time are one every T / 4 pi."""
    for period, coarse in ((0.126, False), (0.125, True)):
        sine(tmp_path, period)
        lines = said(written(tmp_path, CHANNEL))
        assert len(lines) == coarse
    assert lines[0].startswith("warning, history: a row every 10 ms is too few for mean of x_lower")
    assert "output.history_every = 9" in lines[0]


def test_a_valve_wants_its_jet_one_and_a_half_diameters():
    assert [line for line in said(load_case(VALVE)) if "jet" in line] == []
    short = load_case(
        VALVE,
        ["grid.upper=['2.55 cm', '2.55 cm', '5.05 cm']", "grid.core_upper=['2.1 cm', '2.1 cm', '5.05 cm']"],
    )
    (line,) = (line for line in said(short) if "jet" in line)
    assert line.startswith(
        "warning, fluid: the jet of leaflets has 1.3 diameters of the box behind the posts"
    )


def test_a_jet_from_a_disk_wants_three_diameters(tmp_path):
    assert said(written(tmp_path, DISK)) == []
    (line,) = said(written(tmp_path, DISK.replace('radius = "5 mm"', 'radius = "8 mm"')))
    assert "a jet from z_lower has 2.5 of its diameters" in line


@pytest.mark.parametrize("path", sorted((ROOT / "demos").glob("*.toml")), ids=lambda path: path.stem)
def test_the_cases_that_are_shown_give_no_warning_of_their_box(path):
    assert [line for line in said(load_case(path)) if "jet" in line] == []
