"""Studies of grids: which members there are, and what is found of answers whose order is known."""

from __future__ import annotations

import csv
import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.studies import made_up_beat
from tests.studies.conftest import CASE
from valvefsi.case import load_case
from valvefsi.errors import CaseError
from valvefsi.post.valve_beat import Beat
from valvefsi.studies import runner
from valvefsi.studies.dependence import dependence, iterations, kind_of
from valvefsi.studies.grid_numbers import (
    assess,
    beat_rows,
    changed_waves,
    numbers_of,
    waveform_rows,
    without_round_off,
)
from valvefsi.studies.grid_report import draw_verification, write_verification
from valvefsi.studies.grid_study import Wanted, make_grid_study
from valvefsi.studies.members import collected
from valvefsi.studies.runner import run_members, waiting_members

PROGRAM = (sys.executable, str(Path(__file__).with_name("fake_grids.py")))
GRIDS = "0.25,0.125,0.0625"


@pytest.fixture
def case(tmp_path, monkeypatch):
    """Return a case file, whose members are stand-ins."""
    monkeypatch.setattr(runner, "PROGRAM", PROGRAM)
    monkeypatch.setattr(runner, "POLL", 0.02)
    path = tmp_path / "case.toml"
    path.write_text(CASE.replace("50 ms", "10 ms").replace("1 s", "200 ms"))
    return path


def wanted(**options):
    return Wanted(**{"grids": GRIDS, **options})


def test_the_members_are_the_grids_and_the_base_with_one_change_each(case):
    study = make_grid_study(
        case,
        wanted(
            steps=[1, 0.5],
            also=["fluid.viscosity=0.2,0.3", "fluid.advection=centred"],
            along=["fluid.density=1,1.5,2"],
            base="0.125",
            overrides=["time.t_end=1"],
        ),
    )
    assert [m.name for m in study.grids] == ["h=0.25", "h=0.125", "h=0.0625"]
    assert study.spacings == (0.25, 0.125, 0.0625)
    assert study.grids[1].overrides == ("time.t_end=1", "grid.h=0.125", "fluid.density=1.5")
    assert study.base is study.grids[1]
    assert [m.name for m in study.members[3:]] == [
        "h=0.125,dt=0.5x",
        "h=0.125,viscosity=0.2",
        "h=0.125,viscosity=0.3",
        "h=0.125,advection=centred",
    ]
    assert study.cases["h=0.125,dt=0.5x"].dt == pytest.approx(0.005)
    assert study.changes["fluid.viscosity=0.3"].overrides == (*study.base.overrides, "fluid.viscosity=0.3")
    assert len(study.cases) == len(study.members)
    assert study.expected == 2.0
    assert make_grid_study(case, wanted(order=1.5)).expected == 1.5


def test_a_spacing_takes_the_place_of_cells_and_cells_that_of_a_spacing(case):
    assert load_case(case, ["grid.h=0.125"]).grid.spacing == 0.125
    assert load_case(case, ["grid.h=0.125", "grid.cells=[4, 4]"]).grid.spacing == 0.25


def test_adaptive_steps_keep_to_a_smaller_courant_number_too(case):
    case.write_text(case.read_text().replace('dt = "10 ms"', 'dt = "10 ms"\ncontrol = "adaptive"\ncfl = 0.4'))
    study = make_grid_study(case, wanted(steps=[0.25]))
    found = study.cases["h=0.0625,dt=0.25x"].time
    assert (found.dt, found.cfl) == (pytest.approx(0.0025), pytest.approx(0.1))


def test_what_goes_with_the_grid_is_said(case):
    (steps, *rest) = make_grid_study(case, wanted()).notes()
    assert "0.01 s on all grids" in steps
    assert not any("refined by" in note for note in rest)
    case.write_text(case.read_text().replace('dt = "10 ms"', "dt_per_h = 0.04"))
    (steps, refined, _) = make_grid_study(case, wanted(grids="0.125,0.1,0.0625")).notes()
    assert "from 0.005 to 0.0025 s with the spacing" in steps
    assert "refined by 1.25 only; 1.3 or more" in refined


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"grids": "0.125,0.25"}, "expected spacings from coarse to fine, found 1.25 mm, 2.5 mm"),
        ({"grids": "0.25,0.15"}, r"member h=0.15: grid.h = 0.15: an axis is not a whole number of cells"),
        ({"base": "0.5"}, r"--base = '0.5': expected one of the grids 0.25, 0.125, 0.0625"),
        ({"ranks": [0]}, r"--ranks = 0: expected whole numbers above 0"),
        ({"steps": [2.0]}, r"--steps = 2.0: expected factors above 0, 1 at most"),
        ({"along": ["fluid.density=1,2"]}, "expected a value for each of 3 grids, found 2"),
        ({"also": ["fluid.viscosity=-1"]}, r"member h=0.0625,viscosity=-1: fluid.viscosity = -1.0: expected"),
    ],
)
def test_a_study_that_cannot_be_run_is_refused_before_anything_starts(case, options, said):
    with pytest.raises(CaseError, match=said):
        make_grid_study(case, wanted(**options))


@pytest.mark.serial
def test_answers_of_known_order_are_found_and_what_failed_is_named(case, tmp_path):
    folder = tmp_path / "study"
    folder.mkdir()
    box = "grid.lower=[-1, 0] & grid.upper=[2, 1]"
    also = ["fluid.viscosity=0.2", box]
    study = make_grid_study(case, wanted(steps=[0.5, 0.25], also=also, ranks=[1, 2]))
    assert not any("GRID" in note for note in study.notes())
    (folder / "broken").write_text("0.25")
    outcomes = run_members(case, study.members, folder, jobs=2)
    partly = assess(study, outcomes)
    assert partly["failed"] == {"h=0.25": "ConvergenceError: it does not converge"}
    assert {row["kind"] for row in partly["quantities"]} == {"two grids", "no order"}
    assert partly["notes"][0].startswith("TWO GRIDS: no observed order, no Richardson value")
    (folder / "broken").unlink()
    with pytest.raises(CaseError, match="--resume goes on"):
        waiting_members(case, study.members, folder)
    assert waiting_members(case, study.members, folder, resume=True) == [study.grids[0]]
    outcomes = run_members(case, study.members, folder, resume=True)
    began = (folder / "events").read_text().split()
    assert len(began) == 10, "what is done is not done again"
    assert began.count("h=0.0625,ranks=2") == 2, "one of them is run on two ranks"
    result = assess(study, outcomes)
    check_numbers({row["quantity"]: row for row in result["quantities"]})
    check_changes(result)
    check_dependence(result, box)
    write_verification(case, study, result, folder)
    picture = draw_verification("box", result, outcomes, folder / "verification.png", study)
    assert picture.stat().st_size > 20_000
    page = (folder / "verification.md").read_text()
    assert "| last.u_x_tip_cm | 3.0457 | 3.0129 | 3.0047 | 2 | 3.002 |" in page
    assert "| last.u_x_tip_cm | 3.0047 | 3.0037 | 3.0032 | 1 |" in page
    assert "| other | whatever else was asked for | last.u_x_tip_cm, +1 % | " in page
    assert "Iterations: the fluid's solves are direct: " in page
    assert json.loads((folder / "verification.json").read_text())["quantities"] == result["quantities"]
    with (folder / "verification.csv").open() as file:
        rows = {(row["quantity"], row["norm"]): row for row in csv.DictReader(file)}
    assert float(rows["last.u_x_tip_cm", ""]["order"]) == pytest.approx(2.0)
    assert float(rows["p_z_lower_mmHg", "L2"]["order"]) == pytest.approx(1.0)


def test_files_of_members_that_are_gone_are_named(case, tmp_path):
    folder = tmp_path / "study"
    study = make_grid_study(case, wanted())
    run_members(case, study.members, folder)
    (folder / "h=0.125" / "history.csv").unlink()
    outcomes = run_members(case, study.members, folder, resume=True)
    result = assess(study, outcomes)
    (note,) = [note for note in result["notes"] if note.startswith("MISSING FILE")]
    assert note.startswith(
        "MISSING FILE: h=0.125/history.csv is not there or cannot be read: no waveform of h=0.125 "
    )
    assert result["quantities"]
    write_verification(case, study, result, folder)
    assert note in (folder / "verification.md").read_text()
    (folder / "h=0.25" / "summary.json").write_text('{"last": {"u_cm": 1')
    notes = assess(study, outcomes)["notes"]
    assert any(note.startswith("MISSING FILE: h=0.25/summary.json") for note in notes)
    assert waiting_members(case, study.members, folder, resume=True) == [study.grids[0]]
    assert any(
        "summary.json is not there or damaged" in o.message for o in collected(case, study.grids, folder)
    )


def check_numbers(rows):
    """Orders of the stand-ins' numbers: 2, oscillating, diverging, none, 1."""
    assert rows["last.u_x_tip_cm"]["order"] == pytest.approx(2.0)
    assert rows["last.u_x_tip_cm"]["extrapolated"] == pytest.approx(3.002)
    assert rows["last.kinetic_energy_erg"]["order"] == pytest.approx(1.0)
    kinds = {name.removeprefix("last."): row["kind"] for name, row in rows.items()}
    assert kinds == {
        "u_x_tip_cm": "monotone",
        "shaky_cm": "oscillating",
        "worse_cm": "diverging",
        "fixed_cm": "unchanged",
        "kinetic_energy_erg": "monotone",
        "block_J_max": "no order",
        "largest_at_s": "no order",
    }
    for name in ("block_J_max", "largest_at_s"):
        row = rows[f"last.{name}"]
        assert (row["order"], row["index"], row["extrapolated"], row["uncertainty"]) == (None,) * 4
        assert row["text"].endswith("it ranges over 0.1875")


def check_changes(result):
    """The time step is of first order, 1 % more under another viscosity; waves do not change."""
    steps = {row["quantity"]: row for row in result["time_steps"]}["last.u_x_tip_cm"]
    assert steps["factors"] == [1.0, 0.5, 0.25]
    assert (steps["order"], steps["uncertainty"]) == (pytest.approx(1.0), pytest.approx(1.25 * 0.2 * 0.0025))
    tip = {row["change"]: row for row in result["changes"] if row["quantity"] == "last.u_x_tip_cm"}
    assert tip["fluid.viscosity=0.2"]["difference_percent"] == pytest.approx(1.0)
    assert tip["time step x 0.5"]["difference"] == pytest.approx(-0.001)
    waves = [row for row in result["changes"] if "norm" in row]
    assert {row["difference_percent"] for row in waves} == {0.0}
    assert {row["quantity"] for row in waves} == {"p_z_lower_mmHg"}


def check_dependence(result, box):
    """Each kind of change has its row; what was not varied is said."""
    rows = {row["of"]: row for row in result["dependence"]}
    assert list(rows) == ["time step", "ranks", "domain size", "other"], "there is no body, and no kernel"
    assert rows["domain size"]["changes"] == [box]
    assert rows["ranks"]["changes"] == ["ranks=2"]
    assert rows["ranks"]["number_percent"] == 0.0
    assert rows["other"]["number"] == "last.u_x_tip_cm"
    assert rows["other"]["number_percent"] == pytest.approx(1.0)
    assert rows["time step"]["number_percent"] == pytest.approx(-100 * 0.2 * 0.0075 / 3.0047, rel=1e-3)
    assert rows["time step"]["text"] == "varied"
    rows = {row["of"]: row for row in dependence([])}
    assert list(rows) == ["time step", "ranks", "domain size", "kernel"]
    assert {(row["number"], row["waveform"], row["text"][:10]) for row in rows.values()} == {
        (None, None, "NOT VARIED")
    }


def test_what_beats_leave_is_in_the_iterations_and_what_is_not_known_is_said(case):
    base = load_case(case)
    numbers = {f"valve.cycles.{k}.cardiac_output_l_per_min": 5.0 + 0.4 * 0.25**k for k in range(3)}
    found = iterations(base, numbers | {"valve.cycles.2.closing_volume_ml": 3.0})
    (row,) = found["beats"]
    assert row["quantity"] == "cardiac_output_l_per_min"
    assert row["error"] == pytest.approx(0.4 * 0.25**2)
    assert row["error_percent"] == pytest.approx(100 * 0.025 / 5.025)
    assert "direct" in found["solves"]
    assert iterations(base, {})["text"] == "nothing repeats in this case"
    coupled = load_case(case, ["fluid.viscous=coupled"])
    assert iterations(coupled, {})["solves"] == "FGMRES ends at a residual of 1e-10 of that of no change"


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        ("time step x 0.5", "time step"),
        ("ranks=2", "ranks"),
        ("solid.leaflets.kernel=ib4", "kernel"),
        ("grid.upper=[3, 1]", "domain size"),
        ("grid.lower=[-3, 0, 0] & fluid.sides.z_lower.centre=[0, 0, -3]", "domain size"),
        ("grid.h=1mm", "other"),
        ("fluid.viscosity=2", "other"),
    ],
)
def test_a_change_is_of_the_kind_that_it_is_of(change, kind):
    assert kind_of(change) == kind


@pytest.mark.parametrize("order", [1.0, 2.0])
def test_a_waveform_of_known_order_is_found_whatever_the_times(order):
    h = (0.2, 0.15, 0.1)

    def waves(k):
        t = np.linspace(0.0, 1.0 + 0.1 * k, 4001 + 100 * k)
        return {"t_s": t, "p": np.cos(t) + h[k] ** order * np.sin(9 * t), "zero": 0 * t}

    ratios = [h[0] / h[1], h[1] / h[2]]
    rows = waveform_rows([waves(k) for k in range(3)], ratios, 2.0)
    assert {row["quantity"] for row in rows} == {"p"}, "what is zero has no norm"
    for row in rows:
        assert row["order"] == pytest.approx(order, rel=1e-4)
    last = next(row for row in rows if row["norm"] == "L2")
    t = np.linspace(0.0, 1.0, 4001)
    size, error = (
        math.sqrt(np.trapezoid(y**2, t)) for y in (np.cos(t) + 0.1**order * np.sin(9 * t), np.sin(9 * t))
    )
    assert last["index"] == pytest.approx(1.25 * 0.1**order * error / size, rel=1e-3)
    wrong = [waves(0), waves(2), waves(1)]
    assert waveform_rows(wrong, ratios, 2.0)[0]["order"] != pytest.approx(order, rel=1e-2)


def test_rows_that_one_run_has_and_another_has_not_make_no_difference():
    """A wave that starts at once, written every 4 ms and every 2 ms: the same where both have a row."""
    waves = {}
    for name, dt in (("base", 4e-3), ("half", 2e-3)):
        t = np.arange(0.0, 0.1001, dt)
        waves[name] = {"t_s": t, "p_mmHg": np.where(t > 0.0, 5.0 + np.sin(40 * t), 0.0)}
    rows = changed_waves(waves, "base", {"time step x 0.5": "half"})
    assert [row["difference_percent"] for row in rows] == pytest.approx([0.0, 0.0], abs=1e-9)
    (row, _) = waveform_rows([waves["base"], waves["half"]], [2.0], 1.0)
    assert row["differences"] == pytest.approx([0.0], abs=1e-12)


def test_two_waveforms_have_no_order_and_one_has_no_row():
    t = np.linspace(0.0, 1.0, 11)
    grids = [{"t_s": t, "p": 1 + 0.1 * t}, {"t_s": t, "p": 1 + 0 * t}]
    (row, _) = waveform_rows(grids, [2.0], 1.0)
    assert (row["kind"], row["order"]) == ("two grids", None)
    assert row["uncertainty"] == pytest.approx(3 * row["differences"][0])
    assert waveform_rows(grids[:1], [], 1.0) == []


def test_the_cycles_of_valves_are_compared_as_compare_does():
    t, p_lv, _, _ = made_up_beat.beat()
    a, b = (
        Beat(name=name, t=t[:-1], period=made_up_beat.PERIOD, values={"p_lv": size * p_lv[:-1]})
        for name, size in (("coarse", 1.02), ("fine", 1.0))
    )
    (row,) = beat_rows([a, b])
    assert (row["a"], row["b"], row["quantity"]) == ("coarse", "fine", "p_lv")
    assert row["l2_percent"] == pytest.approx(2.0)


def test_what_symmetry_forbids_is_no_answer():
    t = np.linspace(0.0, 1.0, 3)
    runs = {
        "a": {"u_x_cm": 1e-15, "u_y_cm": -4.0, "q_ml_s": 1e-9},
        "b": {"u_x_cm": -2e-14, "u_y_cm": -3.9, "q_ml_s": 0.0},
    }
    found, silent = without_round_off(runs)
    assert silent == {"u_x_cm"}
    assert found == {name: {**numbers, "u_x_cm": 0.0} for name, numbers in runs.items()}
    waves, silent = without_round_off({"a": {"u_x_cm": 1e-14 * t, "u_y_cm": t, "t_s": t}})
    assert (silent, waves["a"]["u_x_cm"].any(), waves["a"]["u_y_cm"].any()) == ({"u_x_cm"}, False, True)


def test_what_a_run_took_or_was_asked_for_is_no_answer():
    summary = {
        "last": {"step": 4.0, "t_s": 1.0, "u": 2},
        "timing": {"wall_s": 5.0},
        "valve": {
            "cycles": [{"cycle": 0, "start_s": 0.1, "peak_flow_ml_per_s": 400.0, "times_from": "pdva"}],
            "plausible": {"area": {"value": 60.0, "from": 50.0, "to": 95.0, "ok": True}},
        },
    }
    assert numbers_of(summary) == {
        "last.u": 2.0,
        "valve.cycles.0.peak_flow_ml_per_s": 400.0,
        "valve.plausible.area.value": 60.0,
    }
