"""A validation from a made-up record, whose constants are known, to the verdict; no run in three dimensions."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from tests.studies import made_up_beat as made
from valvefsi.case import load_case
from valvefsi.case.study_tables import load_study
from valvefsi.errors import CaseError
from valvefsi.fitting.bench_beat import read_bench_beat
from valvefsi.fitting.waveforms import read_waveforms
from valvefsi.studies.bench_start import start_sample
from valvefsi.studies.validation import How, validation_stages
from valvefsi.units import MMHG

pytestmark = pytest.mark.skipif(
    MPI.COMM_WORLD.size > 1, reason="runs on several ranks are processes of their own"
)
ROOT = Path(__file__).parents[2]
STUDY = f"""
case = "{ROOT / "demos" / "porcine_valve.toml"}"
grids = []
max_beats = 12
tolerance = 0.001
record.file = "beat.csv"
upstream = {{ R_1 = "0.1 mmHg*s/ml", R_2 = "0.04 mmHg*s/ml", C_VIA = "0.3 ml/mmHg", smooth = "0 s" }}
downstream = {{ profiles = false, draws = 0 }}
orifice.fit_area = true
targets.l2.p_ao = 1.0
"""


def study_in(folder, leak=0.0, changes=()):
    """The study in a folder, with its record."""
    made.write(folder / "beat.csv", leak)
    (folder / "study.toml").write_text(STUDY)
    return load_study(folder / "study.toml", changes)


def made_in(folder, changes=(), leak=0.0, only=None):
    """What is said while a study is made."""
    lines = []
    stages = validation_stages(study_in(folder, leak, changes), folder / "out", How(say=lines.append))
    stages.make(only)
    return stages, lines


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    return folder, made_in(folder)[0]


def test_the_constants_of_the_windkessel_are_recovered(whole):
    found = whole[1].record("downstream")["result"]
    known = {"R_c": made.R_C, "R_p": made.R_P, "C": made.C}
    assert found["parameters_mmHg_ml_s"] == pytest.approx(known, rel=2e-3)
    assert found["l2_percent"] < 0.05


def test_the_run_begins_where_the_valve_is_about_to_open(whole):
    start = whole[1].record("case")["result"]["start_in_record_s"]
    assert start == pytest.approx(made.OPEN, abs=1.5 * made.PERIOD / made.SAMPLES)


def test_the_case_is_that_of_the_study_with_the_circuits_of_the_record(whole):
    folder, stages = whole
    case = load_case(folder / "out" / "case" / "case.toml")
    ventricle, aorta = case.circuit
    assert (ventricle.name, aorta.name) == ("ventricle", "aorta")
    found = stages.record("downstream")["result"]["parameters_mmHg_ml_s"]
    assert aorta.parameters["R_p"] == pytest.approx(found["R_p"] * MMHG)
    assert aorta.parameters["C"] == pytest.approx(found["C"] / MMHG)
    assert ventricle.parameters["C_VIA"] == pytest.approx(0.3 / MMHG)
    assert (ventricle.pump.period, ventricle.pump.cycles_from, case.time.t_end) == (0.8, 0.0, 0.8)
    assert Path(ventricle.pump.file) == folder / "out" / "upstream" / "pump.csv"
    _, p_lv, p_ao, q = made.beat()
    first = round(stages.record("case")["result"]["start_in_record_s"] / made.PERIOD * made.SAMPLES)
    assert aorta.start["p_wk"] == pytest.approx((p_ao[first] - found["R_c"] * q[first]) * MMHG, rel=1e-6)
    assert ventricle.start["p_via"] == pytest.approx((p_lv[first] + 0.04 * q[first]) * MMHG, rel=1e-6)
    assert aorta.target_pressure == pytest.approx(p_ao.mean() * MMHG, rel=1e-3)
    assert case.solid[0].material.preset == "porcine_leaflet_hgo"
    assert case.grid.spacing == pytest.approx(0.1)


def test_the_pump_is_one_cycle_that_closes(whole):
    pump = read_waveforms(whole[0] / "out" / "upstream" / "pump.csv")
    assert (pump.t[0], pump.t[-1]) == (0.0, pytest.approx(made.PERIOD))
    assert len(pump.t) == made.SAMPLES + 1
    assert abs(pump["p_pump"][-1] - pump["p_pump"][0]) < 0.02 * np.ptp(pump["p_pump"])


def test_the_loop_with_the_orifice_of_the_record_gives_the_record_back(whole):
    """Fitted circuits, derived pump, orifice read off the record, put together: the beat that all of it came from."""
    found = whole[1].record("orifice")["result"]
    assert found["effective_orifice_area_cm2"] == pytest.approx(made.AREA, rel=5e-3)
    assert found["inertance_mmHg_s2_per_ml"] == pytest.approx(made.INERTANCE, rel=5e-3)
    assert found["periodic"]
    assert max(found["last_two_apart_l2_percent"].values()) <= 0.1
    verdict = json.loads((whole[0] / "out" / "compare" / "verdict.json").read_text())
    (result,) = verdict["against_record"]
    off = {name: row["as_they_are"]["l2_percent"] for name, row in result["quantities"].items()}
    assert off["p_lv"] < 0.3
    assert off["p_ao"] < 0.1
    assert off["q_ao"] < 0.6
    assert abs(result["shift_ms"]) < 0.2


def test_the_verdict_has_tables_and_pictures(whole):
    compare = whole[0] / "out" / "compare"
    assert (compare / "orifice" / "comparison.png").stat().st_size > 20_000
    rows = [line.split(",") for line in (compare / "norms.csv").read_text().splitlines()]
    assert rows[0][:4] == ["A", "B", "quantity", "L2_percent"]
    assert [row[2] for row in rows[1:]] == ["p_lv", "p_ao", "q_ao", "q_ao_without_offset"]
    text = (compare / "norms.md").read_text().splitlines()
    assert len(text) == len(rows) + 1
    verdict = json.loads((compare / "verdict.json").read_text())
    assert (
        float(rows[1][3]) == verdict["against_record"][0]["quantities"]["p_lv"]["as_they_are"]["l2_percent"]
    )
    assert verdict["checks"] == [], "the orifice has no target"
    assert verdict["next"] == ["there is no run in three dimensions yet: name grids"]


def test_only_what_depends_on_a_change_is_made_again(whole, tmp_path):
    """A new pump makes the case, the orifice and the comparison; the fit of the outlet stays."""
    folder = shutil.copytree(whole[0], tmp_path / "copy")

    def why(*changes):
        stages = validation_stages(study_in(folder, changes=changes), folder / "out")
        return {name: reason for name in stages.stages if (reason := stages.outdated(name))}

    pump = "upstream.R_1='0.12 mmHg*s/ml'"
    assert why() == {}
    assert why("shift_max='3 ms'") == {"compare": "changed: shift_max"}
    assert why("orifice.fit_area=false") == {"orifice": "changed: orifice.fit_area"}
    assert why("title='another'") == {"case": "changed: title"}
    assert why("changes=['fluid.viscosity=\"1 cP\"']") == {"case": "changed: case.fluid.viscosity"}
    assert why("max_beats=13", "downstream.draws=1").keys() == {"orifice", "downstream"}
    assert why(pump) == {"upstream": "changed: R_1"}
    made_in(folder, [pump], only=["upstream"])
    assert why(pump).keys() == {"case", "orifice"}
    made_in(folder, [pump], only=["case"])
    assert why(pump).keys() == {"orifice", "compare"}
    assert set(why()) == {"upstream", "orifice", "compare"}, "going back is a change like any other"


def test_the_verdict_is_silent_on_a_fit_that_the_study_no_longer_has(whole, tmp_path):
    folder = shutil.copytree(whole[0], tmp_path / "copy")
    shutil.copytree(folder / "out" / "downstream", folder / "out" / "leaflet")
    validation_stages(study_in(folder), folder / "out").make(["compare"], again=True)
    verdict = json.loads((folder / "out" / "compare" / "verdict.json").read_text())
    assert list(verdict["stages"]) == ["downstream", "upstream", "case", "orifice"]


def test_a_leak_that_only_the_probe_sees_is_taken_off_where_that_is_asked_for(tmp_path):
    """With it the mean flow is too small and R_p too large, without it R_p is the true one."""
    with_it = made_in(tmp_path, leak=6.0, only=["downstream"])[0].record("downstream")["result"]
    found = made_in(tmp_path, ["record.without_offset=true"], leak=6.0, only=["downstream"])
    without = found[0].record("downstream")["result"]
    assert with_it["parameters_mmHg_ml_s"]["R_p"] > 1.05 * made.R_P
    assert without["parameters_mmHg_ml_s"]["R_p"] == pytest.approx(made.R_P, rel=5e-3)
    assert "downstream: changed: record.without_offset" in found[1]


def test_a_material_that_is_fitted_goes_into_the_case(tmp_path):
    changes = [
        f"leaflet.file='{ROOT / 'calibration' / 'porcine_leaflet.csv'}'",
        "leaflet.model='neo_hookean'",
        "leaflet.starts=2",
    ]
    stages, _ = made_in(tmp_path, changes, only=["leaflet", "downstream", "upstream", "case"])
    found = stages.record("leaflet")["result"]["parameters"]["c1"]
    material = load_case(tmp_path / "out" / "case" / "case.toml").solid[0].material
    assert material.model == "neo_hookean"
    assert material.parameters["c1"] == pytest.approx(found * 1e4)
    with pytest.raises(
        CaseError, match="leaflet.solid = 'leaf': the case has no such solid, it has leaflets"
    ):
        made_in(tmp_path, [*changes, "leaflet.solid='leaf'"], only=["case"])


def test_the_start_can_be_given(tmp_path):
    file = made.write(tmp_path / "beat.csv")
    beat = read_bench_beat(file)
    assert beat.t[start_sample(beat, file, 0.4)] == pytest.approx(0.4)
    assert beat.t[start_sample(beat, file, 0.4005)] == pytest.approx(0.401)
    with pytest.raises(CaseError, match="record.start = 0.9: expected less than the period, 0.8 s"):
        start_sample(beat, file, 0.9)


@pytest.mark.parametrize(
    ("columns", "change", "said"),
    [
        (("p_lv", "p_ao"), "", "beat.csv: a loop needs p_lv, p_ao and q_ao; missing q_ao"),
        (None, "orifice.area='2 cm^2'", "orifice.fit_area = True: area and inertance are fitted together"),
        (None, "case='none.toml'", "case = 'none.toml': no such file"),
        (None, "record.file='bet.csv'", "record.file = 'bet.csv': no such file; did you mean 'beat.csv'?"),
        (None, "max_beat=3", "max_beat = 3: unknown key; did you mean 'max_beats'?"),
        (None, "tolerance=2", "tolerance = 2: expected a number less than 1"),
        (
            None,
            "grids=['0.5 mm', '1 mm']",
            "grids = [0.05, 0.1]: expected positive spacings from coarse to fine",
        ),
        (None, "downstream.R_c='3 ml'", "downstream.R_c = '3 ml': expected a quantity in dyn*s/cm^5"),
        (None, "targets.l2.q=3", "expected one of p_lv, p_ao, q_ao, q_ao_without_offset, pdva"),
        (None, "grids=['0.77 mm']", "an axis is not a whole number of cells of this spacing"),
        (None, "changes=['grid.g=3']", "grid.g = 3: unknown key"),
    ],
)
def test_what_cannot_be_used_is_one_line_with_file_key_and_value(tmp_path, columns, change, said):
    study_in(tmp_path)
    made.write(tmp_path / "beat.csv", columns=columns or ("p_lv", "p_ao", "q_ao"))

    def everything():
        study = load_study(tmp_path / "study.toml", [change] if change else [])
        validation_stages(study, tmp_path / "out").make()

    with pytest.raises(CaseError) as caught:
        everything()
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_case_without_the_two_circuits_is_refused(tmp_path):
    circuits = "".join(
        f'[[circuit]]\nname = "{name}"\nmodel = "downstream"\nR_c = 1\nR_p = 1\nC = 1\n'
        for name in ("ventricle", "aorta")
    )
    (tmp_path / "own.toml").write_text(f'include = "{ROOT / "demos" / "pericardial_valve.toml"}"\n{circuits}')
    study = study_in(tmp_path, changes=["case='own.toml'"])
    with pytest.raises(
        CaseError, match="ventricle.model = 'downstream': expected a circuit upstream-porcine at z_lo"
    ):
        validation_stages(study, tmp_path / "out")


def test_a_case_with_a_target_is_refused(tmp_path):
    target = "[target]\nbeats_per_minute = 70\ncardiac_output = 80\nmean_aortic_pressure = 1e5\n"
    (tmp_path / "own.toml").write_text(f'include = "{ROOT / "demos" / "porcine_valve.toml"}"\n{target}')
    study = study_in(tmp_path, changes=["case='own.toml'"])
    with pytest.raises(
        CaseError, match="own.toml: target: a study takes pump and resistance from its record"
    ):
        validation_stages(study, tmp_path / "out")
