"""The plan of a run on the terminal: its first line and its table, of one source and one unit for each quantity."""

from __future__ import annotations

import pytest

from valvefsi.bodies.body import Entry
from valvefsi.case import load_case
from valvefsi.case.schedule import schedule_of
from valvefsi.case.target import at_target
from valvefsi.cli.new import STARTS
from valvefsi.cli.run import first_line
from valvefsi.cli.tables import planned

pytestmark = pytest.mark.serial


def test_a_plan_has_one_unit_for_all_steps_and_times_as_people_say_them():
    entries = [
        Entry(quantity="time step", value=2.8e-5, unit="s"),
        Entry(quantity="step limit", value=1.5e-4, unit="s", note="a bound"),
        Entry(quantity="spacing h", value=0.0416667, unit="cm"),
        Entry(quantity="expected time", value=5832.6, unit="s", wall=True),
        Entry(quantity="on 64 ranks", value=174.0, unit="s", wall=True),
    ]
    assert planned(entries) == [
        ("time step", "0.028", "ms", ""),
        ("step limit", "0.15", "ms", "a bound"),
        ("spacing h", "0.41667", "mm", ""),
        ("expected time", "1 h 37 min", "", ""),
        ("on 64 ranks", "2 min 54 s", "", ""),
    ]
    assert planned([Entry(quantity="time step", value=0.00625, unit="s")])[0][1:3] == ("6.25", "ms")


@pytest.mark.parametrize(
    "overrides", [[], ["time.t_end='60.1 ms'"], ["target.beats_per_minute=60", "target.beats=2"]]
)
def test_the_first_line_of_a_plan_has_the_numbers_of_its_table(overrides):
    case = load_case(STARTS / "valve" / "valve.toml", overrides)
    first = first_line(case, "valve")
    schedule = schedule_of(at_target(case)[0])
    entries = [
        Entry(quantity="spacing h", value=case.grid.spacing, unit="cm"),
        Entry(quantity="steps", value=schedule.num_steps()),
        Entry(quantity="time step", value=schedule.dt, unit="s"),
    ]
    h, steps, dt = (f"{value} {unit}".strip() for _, value, unit, _ in planned(entries))
    assert f"cells of {h}, {steps} steps or more, of at most {dt}\n" in first
