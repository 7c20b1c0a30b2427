"""The last whole cycle of a run, and what differs between two cases."""

from __future__ import annotations

import numpy as np
import pytest

from tests.case.test_valve_cycles import DEMO
from tests.valve_waves import PERIOD, waves
from valvefsi.case import load_case
from valvefsi.case.values import case_differences
from valvefsi.case.valve_runs import read_run
from valvefsi.case.writing import to_toml
from valvefsi.errors import CaseError
from valvefsi.units import MMHG

BASE = (f"circuit.ventricle.pump.period='{PERIOD!r} s'", "circuit.ventricle.pump.cycles_from='0 s'")


def run_folder(folder, cycles=1.0, *, phase=0.0, overrides=(), without=(), first=1.0):
    """A folder as a run leaves it: waveforms of some cycles, the first of them of another size."""
    t = np.arange(round(cycles * 500) + 1) * PERIOD / 500
    found = waves(t + phase)
    size = np.where(t < PERIOD, first, 1.0)
    history = {
        "step": np.arange(len(t)),
        "t_s": t,
        "p_z_lower_mmHg": found["p_lv"] / MMHG,
        "p_z_upper_mmHg": found["p_ao"] / MMHG,
        "q_z_upper_ml_s": size * found["q"],
        "pdva_cm2": found["pdva"],
    }
    table = np.stack([history[name] for name in history if name not in without], axis=1)
    folder.mkdir(exist_ok=True)
    head = ",".join(name for name in history if name not in without)
    np.savetxt(folder / "history.csv", table, delimiter=",", header=head, comments="")
    (folder / "case.toml").write_text(to_toml(load_case(DEMO, [*BASE, *overrides])), encoding="utf-8")
    return folder


def test_the_last_whole_cycle_of_a_run_is_taken(tmp_path):
    case, beat = read_run(run_folder(tmp_path / "run", 2.6, first=0.5))
    assert case.circuit[0].pump.period == pytest.approx(PERIOD)
    assert beat.name == "run"
    assert not beat.measured
    assert beat.start == pytest.approx(PERIOD)
    assert beat.period == pytest.approx(PERIOD)
    assert len(beat.t) == 500
    assert np.allclose(beat.values["q_ao"], waves(beat.t)["q"], atol=1e-6)
    assert np.allclose(beat.values["p_lv"], waves(beat.t)["p_lv"], rtol=1e-6)
    assert beat.test.diameter == case.solid[0].mesh.valve.diameter
    assert beat.notes == ()


def test_cycles_count_from_where_the_case_says(tmp_path):
    changed = ["circuit.ventricle.pump.cycles_from='0.3 s'"]
    beat = read_run(run_folder(tmp_path / "run", 2.6, overrides=changed))[1]
    assert beat.start == pytest.approx(0.3 + PERIOD)
    assert np.allclose(beat.values["q_ao"], waves(beat.t + 0.3)["q"], atol=2.0)
    assert read_run(tmp_path / "run", period=1.5 * PERIOD)[1].start == pytest.approx(0.3)


def test_a_cycle_that_ends_elsewhere_is_noted(tmp_path):
    folder = run_folder(tmp_path / "run")
    lines = (folder / "history.csv").read_text().splitlines()
    cells = lines[-1].split(",")
    lines[-1] = ",".join([*cells[:2], "60.0", *cells[3:]])
    (folder / "history.csv").write_text("\n".join(lines) + "\n")
    assert "not periodic yet, the cycle ends elsewhere than it began: p_lv by" in read_run(folder)[1].notes[0]


@pytest.mark.parametrize(
    ("cycles", "about", "message"),
    [
        (0.9, {}, "no whole cycle of 0.857143 s from 0 s on: incomplete"),
        (1.0, {"without": ("pdva_cm2",)}, "history.csv: missing column pdva_cm2"),
        (
            1.0,
            {"without": ("p_z_lower_mmHg", "q_z_upper_ml_s")},
            "missing columns p_z_lower_mmHg, q_z_upper_ml_s",
        ),
        (
            1.0,
            {"overrides": ["circuit.ventricle.pump.cycles_from='3 s'"]},
            "no whole cycle of 0.857143 s from 3 s",
        ),
        (0.0, {}, "expected two or more finite times"),
    ],
)
def test_a_run_that_cannot_be_used_is_refused_in_one_line(tmp_path, cycles, about, message):
    with pytest.raises(CaseError) as caught:
        read_run(run_folder(tmp_path / "run", cycles, **about))
    assert message in str(caught.value)


def test_a_pump_without_a_period_needs_one(tmp_path):
    folder = run_folder(tmp_path / "run")
    text = (folder / "case.toml").read_text()
    (folder / "case.toml").write_text(text.replace(f'period = "{PERIOD!r} s"\n', "", 1))
    with pytest.raises(CaseError, match="the pump has no period; give one with --period"):
        read_run(folder)
    assert read_run(folder, period=PERIOD)[1].period == PERIOD


@pytest.mark.parametrize("name", ["case.toml", "history.csv"])
def test_a_folder_without_a_run_is_said_to_be_one(tmp_path, name):
    folder = run_folder(tmp_path / "run")
    (folder / name).unlink()
    with pytest.raises(CaseError, match=f"there is no run of a valve here, {name} is missing"):
        read_run(folder)


def test_cases_differ_by_keys_as_they_are_set(tmp_path):
    a = load_case(DEMO)
    b = load_case(DEMO, ["fluid.viscosity='2 cP'", "solid.leaflets.damping=5", "time.t_end='3 s'"])
    found = case_differences(a, b)
    assert found.keys() == {"fluid.viscosity", "solid.leaflets.damping", "time.t_end"}
    assert found["fluid.viscosity"] == (a.fluid.viscosity, 0.02)
    again = load_case(DEMO, [f"{key}={value}" for key, (_, value) in found.items()])
    assert case_differences(b, again) == {}
    assert case_differences(a, a) == {}
    copy = tmp_path / "pump.csv"
    copy.write_bytes((DEMO.parent / "pericardial_valve_pump.csv").read_bytes())
    assert case_differences(a, load_case(DEMO, [f"circuit.ventricle.pump.file='{copy}'"])) == {}
    copy.write_text(copy.read_text() + "# more\n")
    other = case_differences(a, load_case(DEMO, [f"circuit.ventricle.pump.file='{copy}'"]))
    assert other.keys() == {"circuit.ventricle.pump.file"}
