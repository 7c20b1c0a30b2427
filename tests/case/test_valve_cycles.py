"""Where the cycles of a valve start, and what a report says of several of them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from tests.valve_waves import CLOSING, EJECTION, OPEN, PERIOD, SALINE, record, waves
from valvefsi.case import load_case
from valvefsi.case.target_tables import Target
from valvefsi.case.valve_report import report_valve
from valvefsi.post.valve_numbers import cycle_numbers, repeated_cycle, valve_numbers
from valvefsi.post.valve_record import ValveRecord, first_closed
from valvefsi.post.valve_times import TIMES
from valvefsi.units import MMHG

DEMO = Path(__file__).parents[2] / "demos" / "pericardial_valve.toml"
CLOSED = OPEN + EJECTION + CLOSING


def shifted(phase, cycles=2.0, samples=3000, **change):
    """A record that begins at a phase of the cycle."""
    t = np.arange(round(cycles * samples) + 1) * PERIOD / samples
    return ValveRecord(t=t, period=PERIOD, **(waves(t + phase) | change))


@pytest.mark.parametrize("area", [True, False])
@pytest.mark.parametrize("phase", [0.0, 0.05, 0.12, 0.25, 0.39, 0.41, 0.5])
def test_the_first_cycle_starts_where_the_valve_is_closed_first(phase, area):
    given = shifted(phase)
    given = given if area else dataclasses.replace(given, pdva=None)
    start = first_closed(given)
    if phase + 0.02 * PERIOD <= OPEN or phase >= CLOSED:
        assert start == 0.0
    else:
        # Backflow is little, 5 % of the peak flow, before its half sine ends.
        assert CLOSED - CLOSING / 3 < start + phase - 0.02 * PERIOD <= CLOSED
    got = cycle_numbers(dataclasses.replace(given, start=start), SALINE, 0)
    assert got.reasons.keys() <= {"peak_pdva", "mean_pdva", "opening_half", "closing_half"}
    assert got.forward_volume == pytest.approx(cycle_numbers(record(), SALINE).forward_volume, rel=1e-5)
    since = start + phase if start + phase < OPEN else start + phase - PERIOD
    assert got.forward_start == pytest.approx(OPEN - since, abs=PERIOD / 3000)


def test_flow_that_only_passes_through_zero_is_no_closed_valve():
    """At the end of forward flow it is zero for a moment; without an area nothing else tells."""
    still = dataclasses.replace(shifted(0.25), pdva=None)
    assert first_closed(still) + 0.25 > OPEN + EJECTION + CLOSING / 2


def test_noise_does_not_move_the_start_out_of_the_closed_phase():
    rng, clean = np.random.default_rng(3), shifted(0.25)
    noisy = dataclasses.replace(clean, q=clean.q + 4.0 * rng.standard_normal(len(clean.t)))
    start = first_closed(noisy)
    assert CLOSED - CLOSING / 3 < start + 0.25 < OPEN + PERIOD


def test_no_start_without_a_whole_cycle_after_it():
    assert first_closed(shifted(0.25, cycles=1.0)) is None
    assert first_closed(shifted(0.25, cycles=1.25)) is not None
    still = shifted(0.0, cycles=1.0)
    assert first_closed(dataclasses.replace(still, q=0.0 * still.q)) is None


def test_a_valve_that_closes_less_than_it_was_before_has_times_still():
    """Leaflets at rest lie closer together than under load: the levels of the fall are its own."""
    one = record()
    leftover = 0.12 * 3.5
    late = one.t > OPEN + EJECTION / 2
    area = np.where(late, leftover + one.pdva * (1.0 - leftover / 3.5), one.pdva)
    got, plain = (cycle_numbers(dataclasses.replace(one, pdva=a), SALINE) for a in (area, one.pdva))
    for name in TIMES:
        assert getattr(got, name) == pytest.approx(getattr(plain, name), abs=1e-9), name
    open_at_edge = cycle_numbers(shifted(0.25, cycles=1.0), SALINE)
    assert "open at the cycle's edge" in open_at_edge.reasons["opening_start"]


def history(folder, given):
    columns = {
        "t_s": given.t,
        "p_z_lower_mmHg": given.p_lv / MMHG,
        "p_z_upper_mmHg": given.p_ao / MMHG,
        "q_z_upper_ml_s": given.q,
        "pdva_cm2": given.pdva,
        "leaflets_volume_change_percent": 0.0 * given.t,
    }
    table = np.stack(list(columns.values()), axis=1)
    np.savetxt(folder / "history.csv", table, delimiter=",", header=",".join(columns), comments="")


def case(*more):
    period = f"circuit.ventricle.pump.period='{PERIOD - 1e-6} s'"
    made = load_case(DEMO, [period, *more])
    if any("cycles_from" in text for text in more):
        return made
    pumps = (c.pump and c.pump.model_copy(update={"cycles_from": None}) for c in made.circuit)
    circuits = tuple(c.model_copy(update={"pump": p}) for c, p in zip(made.circuit, pumps, strict=True))
    return made.model_copy(update={"circuit": circuits})


def test_a_report_counts_whole_cycles_from_the_first_closed_phase(tmp_path):
    given = shifted(0.25, cycles=3.0, samples=1000)
    slow = 1.0 + 0.02 * (given.t > 1.3)
    history(tmp_path, dataclasses.replace(given, p_ao=given.p_ao * slow))
    numbers = report_valve(case("circuit.aorta.target_pressure='105 mmHg'"), tmp_path)["valve"]
    first, *more = numbers["cycles"]
    assert CLOSED - CLOSING / 3 < first["start_s"] + 0.25 - 0.02 * PERIOD < CLOSED + 0.001
    assert len(more) == 1, "the third is not whole"
    assert "missing" not in more[0]
    assert 0.0 < numbers["change_between_cycles"]["p_ao"] < 0.02
    assert numbers["plausible"]["change between cycles"]["plausible"]
    pressure = numbers["plausible"]["mean aortic pressure"]
    assert pressure["value"] == pytest.approx(100 * more[0]["mean_aortic_pressure_mmHg"] / 105, rel=1e-12)
    assert pressure["plausible"]
    assert "cardiac output" not in numbers["plausible"], "it has no target"
    aim = Target(beats_per_minute=70, cardiac_output=60.0, mean_aortic_pressure=105 * MMHG)
    aimed = report_valve(case().model_copy(update={"target": aim}), tmp_path)["valve"]
    output = aimed["plausible"]["cardiac output"]
    own = aimed["cycles"][-1]["cardiac_output_l_per_min"]
    assert (output["value"], output["unit"]) == (pytest.approx(100 * own / 3.6, rel=1e-12), "% of the target")
    other = case("circuit.aorta.target_pressure='120 mmHg'", "circuit.ventricle.pump.cycles_from='0.7 s'")
    numbers = report_valve(other, tmp_path)["valve"]
    assert [cycle["start_s"] for cycle in numbers["cycles"]] == pytest.approx([0.7, 0.7 + PERIOD], abs=2e-6)
    assert not numbers["plausible"]["mean aortic pressure"]["plausible"]
    late = report_valve(case("circuit.ventricle.pump.cycles_from='3 s'"), tmp_path)["valve"]
    assert late["cycles"] == []
    assert "ends before the first cycle" in late["reasons"][0]


def test_a_cycle_that_is_cut_in_forward_flow_is_repeated_and_cut_where_the_valve_is_shut(tmp_path):
    history(tmp_path, shifted(0.0, cycles=3.0, samples=1000))
    cut = report_valve(case("circuit.ventricle.pump.cycles_from='0.2 s'"), tmp_path)["valve"]
    assert len(cut["cycles"]) == 2
    expected = cycle_numbers(record(), SALINE).in_lab_units()
    for k, cycle in enumerate(cut["cycles"]):
        assert cycle["cycle"] == k
        assert cycle["repeated"]
        assert "missing" not in cycle
        for name in (
            "forward_volume_ml",
            "effective_orifice_area_cm2",
            "forward_energy_loss_mJ",
            "open_time_ms",
        ):
            assert cycle[name] == pytest.approx(expected[name], rel=3e-3), name
        for name in ("forward_start_ms", "opening_start_ms", "closing_end_ms"):
            since = 1e3 * cycle["start_s"] + cycle[name] - expected[name]
            assert (
                since % (1e3 * PERIOD) == pytest.approx(0.0, abs=2.0)
                or since % (1e3 * PERIOD) > 1e3 * PERIOD - 2
            )
        assert 0.2 + k * PERIOD <= cycle["start_s"] < 0.2 + (k + 1) * PERIOD
    assert cut["plausible"]["mean difference"]["plausible"]
    assert "repeated" in cut["definitions"]
    whole = report_valve(case("circuit.ventricle.pump.cycles_from='0.7 s'"), tmp_path)["valve"]
    assert "repeated" not in whole["cycles"][0]
    assert "repeated" not in whole["definitions"]


def test_a_valve_that_is_never_shut_has_no_cycle_to_repeat():
    running = shifted(0.0, cycles=1.0, q=np.full(3001, 100.0))
    assert repeated_cycle(running, SALINE, 0) is None


def test_without_a_target_the_mean_pressure_is_not_judged(tmp_path):
    history(tmp_path, shifted(0.5, cycles=1.0, samples=1000))
    bare = case()
    circuits = tuple(c.model_copy(update={"target_pressure": None}) for c in bare.circuit)
    plausible = report_valve(bare.model_copy(update={"circuit": circuits}), tmp_path)["valve"]["plausible"]
    assert not {"mean aortic pressure", "change between cycles"} & set(plausible)


def test_every_cycle_counts_from_its_own_start():
    given = shifted(0.5, cycles=2.0)
    first, second = valve_numbers(given, SALINE)
    assert second.start == pytest.approx(PERIOD)
    assert second.forward_start == pytest.approx(first.forward_start, abs=PERIOD / 3000)


def test_sections_stand_in_for_circuits(tmp_path):
    given = shifted(0.5, cycles=1.0, samples=1000)
    columns = {
        "t_s": given.t,
        "pressure_upstream_dyn_per_cm2": given.p_lv,
        "pressure_downstream_dyn_per_cm2": given.p_ao,
        "flow_upstream_cm3_per_s": given.q,
        "flow_downstream_cm3_per_s": given.q,
        "pdva_cm2": given.pdva,
        "leaflets_volume_change_percent": 0.0 * given.t,
    }
    table = np.stack(list(columns.values()), axis=1)
    np.savetxt(tmp_path / "history.csv", table, delimiter=",", header=",".join(columns), comments="")
    folder = DEMO.parent
    between = load_case(folder / "pericardial_valve_pressures.toml", [f"time.t_end='{PERIOD} s'"])
    numbers = report_valve(between, tmp_path)["valve"]
    expected = cycle_numbers(given, SALINE).in_lab_units()
    for name in ("forward_volume_ml", "mean_pressure_difference_mmHg", "closing_start_ms"):
        assert numbers["cycles"][0][name] == pytest.approx(expected[name], rel=1e-5)
    assert "mean aortic pressure" not in numbers["plausible"]
    assert report_valve(load_case(folder / "pericardial_valve_steady.toml"), tmp_path) == {}
