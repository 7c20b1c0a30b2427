"""The mean beat of a record: columns, standard deviations, period, and what is refused."""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.valve_waves import PERIOD, waves
from valvefsi.errors import CaseError
from valvefsi.fitting.bench_beat import read_bench_beat
from valvefsi.post.valve_beat import QUANTITIES
from valvefsi.post.valve_comparison import Pair, compare_beats
from valvefsi.units import MMHG

pytestmark = pytest.mark.serial  # nothing in it runs in parallel
CALIBRATION = Path(__file__).parents[2] / "calibration"
OWN = CALIBRATION / "valve_beat.csv"
HEAD = "t_s,p_lv_mmHg,q_ao_ml_s"


def written(folder, cycles=1.0, head=HEAD, remark="", more=""):
    """A record of closed-form waveforms, 200 samples a cycle."""
    t = np.arange(round(200 * cycles)) * PERIOD / 200
    found = waves(t)
    rows = [f"{a},{p / MMHG},{q}{more}" for a, p, q in zip(t, found["p_lv"], found["q"], strict=True)]
    path = folder / "record.csv"
    path.write_text("\n".join([*([remark] if remark else []), head, *rows]) + "\n", encoding="utf-8")
    return path


def columns(path):
    """The record as numbers by heading, read by other means."""
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    table = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    return dict(zip(lines[0].split(","), table.T, strict=True))


def test_the_shipped_record_is_read_with_its_spread():
    beat, raw = read_bench_beat(OWN), columns(OWN)
    assert tuple(beat.values) == QUANTITIES
    assert np.allclose(beat.values["p_lv"], raw["p_lv_mmHg"] * MMHG)
    assert np.allclose(beat.values["pdva"], raw["pdva_cm2"])
    assert np.allclose(beat.deviations["p_ao"], raw["sd_p_ao"] * MMHG), "in the unit of its quantity"
    assert np.allclose(beat.deviations["q_ao"], raw["sd_q_ao"])
    assert beat.period == pytest.approx(60 / 70, rel=1e-9)
    assert beat.measured
    assert beat.cycles == 1


def test_the_shipped_record_is_what_its_script_makes(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(CALIBRATION))
    spec = importlib.util.spec_from_file_location("valve_beat_script", CALIBRATION / "valve_beat.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    again, kept = columns(script.make_record(tmp_path / "again.csv")), columns(OWN)
    assert again.keys() == kept.keys()
    for name, column in again.items():
        assert np.allclose(column, kept[name], atol=2e-4), name
    for name in ("loop_model", "porcine_loop"):
        sys.modules.pop(name, None)


def test_the_shipped_record_has_the_offset_and_the_spread_it_was_made_with():
    """Spread of a beat: noise, its size, and its place in time times the slope; ten beats give it to a quarter."""
    beat = read_bench_beat(OWN)
    slope = np.gradient(beat.values["p_ao"], beat.t)
    made = np.sqrt((0.3 * MMHG) ** 2 + (0.004 * beat.values["p_ao"]) ** 2 + (0.001 * slope) ** 2)
    spread = np.sqrt(np.mean(beat.deviations["p_ao"] ** 2) / np.mean(made**2))
    assert 0.75 < spread < 1.4
    leak = 0.01 * np.sqrt(2 * 90 * MMHG)  # of the shut orifice under 90 mmHg
    assert beat.diastolic_offset() == pytest.approx(-3.0 - leak, rel=0.15)


@pytest.mark.parametrize(
    ("remark", "period"),
    [
        ("# the period of 60/70 s is assumed", 60 / 70),
        ("# period: 857.0 ms", 0.857),
        ("# Period = 0.855 s", 0.855),
        ("# nothing said", PERIOD),
        ("", PERIOD),
    ],
)
def test_the_period_is_what_a_remark_says_or_the_length(tmp_path, remark, period):
    beat = read_bench_beat(written(tmp_path, remark=remark))
    assert beat.period == pytest.approx(period, rel=1e-9)
    assert read_bench_beat(written(tmp_path, remark=remark), period=0.856).period == 0.856


def test_several_cycles_are_found_and_averaged(tmp_path):
    beat = read_bench_beat(written(tmp_path, cycles=4.0))
    assert beat.cycles == 4
    assert beat.period == pytest.approx(PERIOD, rel=1e-3)
    assert beat.at("q_ao", np.array([0.25])) == pytest.approx(waves(np.array([0.25]))["q"], rel=1e-2)
    assert beat.deviations["p_lv"].max() < 0.05 * np.ptp(beat.values["p_lv"]), "all cycles are alike"
    assert read_bench_beat(written(tmp_path, cycles=4.0), period=2 * PERIOD).cycles == 2
    two = read_bench_beat(written(tmp_path, cycles=2.0))
    assert (two.cycles, two.period) == (2, pytest.approx(PERIOD, rel=1e-3)), "two are several, too"


def test_standard_deviations_may_have_units_of_their_own(tmp_path):
    head = f"{HEAD},p_lv_std_kPa,sd_q_ao,sd_v_lv"
    beat = read_bench_beat(written(tmp_path, head=head, more=",0.5,2,9"))
    assert beat.deviations.keys() == {"p_lv", "q_ao"}
    assert np.allclose(beat.deviations["p_lv"], 5000.0)
    assert np.allclose(beat.deviations["q_ao"], 2.0)


@pytest.mark.parametrize(
    ("change", "period", "message"),
    [
        ({"head": "t_s,p_la_mmHg,q_lv_ml_s"}, None, "missing columns: expected any of p_lv_mmHg, p_ao_mmHg"),
        ({"head": "x,p_lv_mmHg,q_ao_ml_s"}, None, "no column of times"),
        (
            {"cycles": 0.5, "remark": "# period: 0.857 s"},
            None,
            "no whole cycle of 0.857 s (from the record's",
        ),
        ({}, 2.0, "no whole cycle of 2 s (as given)"),
        ({"remark": "# period of 60/0 s"}, None, "expected a positive time"),
        ({"head": f"{HEAD},sd_q_ao", "more": ",x"}, None, "column sd_q_ao = 'x': expected a number"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(tmp_path, change, period, message):
    with pytest.raises(CaseError) as caught:
        read_bench_beat(written(tmp_path, **change), period=period)
    assert message in str(caught.value)
    assert "record.csv" in str(caught.value)


def test_the_measured_beat_has_the_numbers_that_are_known_of_it():
    """Recorded elsewhere from its ten beats; spread of one beat about the mean by another formula, within a tenth."""
    folder = os.environ.get("VALVEFSI_DATA")
    if not folder:
        pytest.skip("VALVEFSI_DATA does not name the folder of the external records")
    path = Path(folder) / "porcine_bench_mean_beat.csv"
    if not path.is_file():
        pytest.skip(f"{path.name} is not in VALVEFSI_DATA")
    beat, raw = read_bench_beat(path), columns(path)
    assert beat.period == pytest.approx(60 / 70, rel=1e-12)
    found = compare_beats(Pair(a=beat, b=beat), 0.0, 0.0)
    headings = {"p_lv": "p_lv_mmHg", "p_ao": "p_ao_mmHg", "q_ao": "q_ao_ml_s", "pdva": "pdva_cm2"}
    for name, about in {"p_lv": 0.60, "p_ao": 0.31, "q_ao": 2.3, "pdva": 4.7}.items():
        row = found["quantities"][name]
        spread = 100 * np.sqrt(np.mean(raw[f"sd_{name}"] ** 2) / np.mean(raw[headings[name]] ** 2))
        assert row["repeatability_l2_percent"]["b"] == pytest.approx(spread, rel=1e-3)
        assert spread == pytest.approx(about, rel=0.13), (
            "sample against population, root mean square against mean"
        )
        assert row["as_they_are"]["l2_percent"] == 0.0
    known = {
        "peak_flow_ml_per_s": (455, 4),
        "forward_volume_ml": (73.4, 0.3),
        "mean_pressure_difference_mmHg": (8.57, 0.13),
        "effective_orifice_area_cm2": (2.48, 0.02),
        "peak_pdva_cm2": (2.27, 0.005),
        "open_over_10_percent_ms": (238, 1),
        "regurgitant_fraction_percent": (6.1, 0.6),
    }
    for name, (value, spread) in known.items():
        assert found["numbers"]["rows"][name]["b"] == pytest.approx(value, abs=spread), name
    assert beat.diastolic_offset() == pytest.approx(-4.9, abs=0.5)
