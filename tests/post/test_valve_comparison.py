"""How far two beats of a valve are apart, against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from matplotlib.image import imread

from tests.valve_waves import LEAKAGE, PERIOD, SALINE, closed_forms, waves
from valvefsi.errors import CaseError
from valvefsi.post.plots.valve_comparison import Overlay, valve_comparison
from valvefsi.post.valve_beat import Beat, mean_beat
from valvefsi.post.valve_comparison import FLOW_LESS_OFFSET, NUMBERS, Pair, compare_beats
from valvefsi.units import MMHG

SEVEN = 7 * PERIOD / 2000
"""Seven samples of 2000 a cycle, 3 ms."""


def beat(name="A", samples=2000, phase=0.0, period=PERIOD, change=None, **about):
    """The closed-form waveforms from a phase of their cycle on [s], some of them replaced."""
    t = np.linspace(0.0, period, samples, endpoint=False)
    found = waves(t * PERIOD / period + phase)
    values = {"q_ao" if key == "q" else key: y for key, y in found.items()}
    return Beat(name=name, t=t, period=period, values=values | (change or {}), **about)


def sines(samples=1000, **late):
    """Sines of one amplitude each, some time late [s], with a period of 1 s."""
    t = np.linspace(0.0, 1.0, samples, endpoint=False)
    sizes = {"p_lv": 1.0, "p_ao": 10.0, "pdva": 3.0}
    values = {name: sizes[name] * np.sin(2 * np.pi * (t - s)) for name, s in late.items()}
    return Beat(name="sines", t=t, period=1.0, values=values)


def l2_of(pair, shift=0.0):
    return {name: pair.norms(name, shift)["l2_percent"] for name in pair.quantities}


def test_norms_of_a_late_sine_are_the_closed_form_ones():
    late = 0.02
    pair = Pair(a=sines(p_lv=late, p_ao=0.0), b=sines(p_lv=0.0, p_ao=0.0))
    size = 100 * 2 * math.sin(math.pi * late)
    found = pair.norms("p_lv")
    assert found["l2_percent"] == pytest.approx(size, rel=1e-5)
    assert found["linf_percent"] == pytest.approx(size, rel=1e-5)
    assert found["nrmse_percent"] == pytest.approx(size / math.sqrt(2) / 2, rel=1e-5)
    assert pair.norms("p_ao") == dict.fromkeys(found, 0.0)


def test_one_sample_that_is_off_counts_fully_in_linf_and_little_in_l2():
    a, b = (sines(p_lv=0.0) for _ in range(2))
    a.values["p_lv"][250] += 0.5
    found = Pair(a=a, b=b).norms("p_lv")
    assert found["linf_percent"] == pytest.approx(50.0, rel=1e-9)
    assert found["l2_percent"] == pytest.approx(100 * math.sqrt(0.5**2 * 1e-3 / 0.5), rel=1e-6)


@pytest.mark.parametrize("ahead", [SEVEN, -SEVEN])
def test_a_waveform_shifted_by_3_ms_is_found_to_be_and_nothing_is_left(ahead):
    pair = Pair(a=beat(phase=ahead), b=beat("B"))
    shift = pair.common_shift(0.007)
    assert shift == pytest.approx(ahead, abs=1e-7), "what is ahead is moved later"
    assert abs(shift) == pytest.approx(0.003, abs=1e-7)
    assert max(l2_of(pair, shift).values()) < 1e-3
    assert min(l2_of(pair).values()) > 0.1
    assert pair.common_shift(0.0) == 0.0


def test_a_shift_ends_at_its_bound_and_says_so():
    pair = Pair(a=beat(phase=0.012), b=beat("B"))
    shift = pair.common_shift(0.007)
    assert shift == pytest.approx(0.007, abs=1e-7)
    assert compare_beats(pair, shift, 0.007)["shift_at_its_bound"]
    assert not compare_beats(pair, 0.005, 0.007)["shift_at_its_bound"]
    with pytest.raises(CaseError, match="shift-max = 0.4: expected a time in 0 ... 0.2143 s"):
        pair.common_shift(0.4)


def test_the_shift_is_common_and_weighs_relative_norms():
    """The minimum of sin^2(pi (s - s_1)) + sin^2(pi (s - s_2)), whatever the sizes of the waveforms."""
    pair = Pair(a=sines(p_lv=-0.006, p_ao=0.001), b=sines(p_lv=0.0, p_ao=0.0))
    assert pair.common_shift(0.007) == pytest.approx(0.0025, abs=1e-5)


def test_an_area_of_another_valve_does_not_decide_the_shift():
    pair = Pair(a=sines(p_lv=-0.003, pdva=0.006), b=sines(p_lv=0.0, pdva=0.0))
    assert pair.common_shift(0.007) == pytest.approx(0.003, abs=1e-7)
    alone = Pair(a=sines(pdva=0.006), b=sines(pdva=0.0))
    assert alone.common_shift(0.007) == pytest.approx(-0.006, abs=1e-7)


def test_a_run_that_begins_at_another_phase_is_put_in_its_place():
    pair = Pair(a=beat(phase=100 * PERIOD / 2000), b=beat("B"), start=100 * PERIOD / 2000)
    assert max(l2_of(pair).values()) < 1e-9
    assert min(l2_of(Pair(a=pair.a, b=pair.b)).values()) > 3
    for start in (-0.1, PERIOD):
        with pytest.raises(CaseError, match="start = .*: expected 0 or more and less than 0.857143 s"):
            Pair(a=pair.a, b=pair.b, start=start)


def test_periods_a_little_apart_are_stretched_and_others_refused():
    b = beat("B")
    for pair in (
        Pair(a=beat(period=0.995 * PERIOD), b=b),
        Pair(a=beat(samples=4000, period=1.005 * PERIOD), b=b),
    ):
        assert pair.t[[0, -1]] == pytest.approx([0.0, PERIOD], rel=1e-12), "the clock is that of B"
    assert max(l2_of(Pair(a=beat(period=0.995 * PERIOD), b=b)).values()) < 1e-9
    with pytest.raises(CaseError, match="the periods differ by 2 %, more than 1 %"):
        Pair(a=beat(period=1.02 * PERIOD), b=b)


def test_both_are_taken_at_the_finer_sampling():
    for samples in ((2000, 256), (256, 2000)):
        a, b = (beat(samples=n) for n in samples)
        pair = Pair(a=a, b=b)
        assert len(pair.t) == 2001
        assert pair.t[[0, -1]] == pytest.approx([0.0, PERIOD])
        assert 0.0 < l2_of(pair)["q_ao"] < 1.0, "linear between the coarser samples"


def test_the_offset_of_a_probe_is_taken_off_the_record_alone():
    clean = {key: y for key, y in waves(beat().t, leakage=0.0, backflow=0.0).items() if key == "q"}["q"]
    run = beat(change={"q_ao": clean})
    record = beat("B", change={"q_ao": clean - 4.0}, measured=True)
    pair = Pair(a=run, b=record)
    assert record.diastolic_offset() == pytest.approx(-4.0, rel=0.01)
    assert pair.offsets[0] is None
    size = np.sqrt(np.mean((clean - 4.0) ** 2))
    assert pair.norms("q_ao")["l2_percent"] == pytest.approx(100 * 4.0 / size, rel=1e-3)
    assert pair.norms(FLOW_LESS_OFFSET)["l2_percent"] < 0.02
    leaky = beat(samples=2000)
    same = Pair(a=leaky, b=beat("B", measured=True))
    assert same.offsets[1] == pytest.approx(-LEAKAGE, rel=0.01)
    size = np.sqrt(np.mean((leaky.values["q_ao"] + LEAKAGE) ** 2))
    apart = same.norms(FLOW_LESS_OFFSET)["l2_percent"]
    assert apart == pytest.approx(100 * LEAKAGE / size, rel=0.01), "the run keeps its leakage"
    assert FLOW_LESS_OFFSET not in Pair(a=leaky, b=beat("B")).quantities


def test_repeatability_is_the_spread_over_the_size():
    t = beat().t
    waveform = 100 * MMHG * (1 + 0.5 * np.sin(2 * np.pi * t / PERIOD))
    spread = {"p_ao": np.full(len(t), 2 * MMHG), "q_ao": np.full(len(t), 3.0)}
    record = beat("B", change={"p_ao": waveform}, deviations=spread, measured=True)
    found = compare_beats(Pair(a=beat(), b=record), 0.0, 0.0)["quantities"]
    assert found["p_ao"]["repeatability_l2_percent"]["b"] == pytest.approx(
        200 / 100 / math.sqrt(1.125), rel=1e-6
    )
    assert found["p_ao"]["repeatability_l2_percent"]["a"] is None
    assert found["p_lv"]["repeatability_l2_percent"]["b"] is None
    q = record.values["q_ao"] - record.diastolic_offset()
    repeats = found[FLOW_LESS_OFFSET]["repeatability_l2_percent"]["b"]
    assert repeats == pytest.approx(100 * 3.0 / np.sqrt(np.mean(q**2)), rel=1e-4)


@pytest.mark.parametrize("phase", [0.0, 0.25])
def test_numbers_stand_side_by_side_wherever_the_cycle_begins(phase):
    rows = compare_beats(Pair(a=beat(phase=phase, test=SALINE), b=beat("B")), 0.0, 0.0)["numbers"]["rows"]
    exact = closed_forms()
    expected = {
        "peak_flow_ml_per_s": exact["peak_flow"],
        "forward_volume_ml": exact["forward_volume"],
        "mean_pressure_difference_mmHg": exact["mean_pressure_difference"] / MMHG,
        "effective_orifice_area_cm2": exact["effective_orifice_area"],
        "peak_pdva_cm2": exact["peak_pdva"],
        "open_over_10_percent_ms": 1e3 * (exact["closing_end"] - exact["opening_start"]),
        "regurgitant_fraction_percent": 100 * exact["regurgitant_fraction"],
    }
    assert tuple(rows) == NUMBERS
    for name, value in expected.items():
        assert rows[name]["a"] == pytest.approx(value, rel=2e-3), name
        assert rows[name]["b"] == pytest.approx(value, rel=2e-3), name
    bigger = beat(change={"q_ao": 1.1 * beat().values["q_ao"]}, test=SALINE)
    row = compare_beats(Pair(a=bigger, b=beat("B")), 0.0, 0.0)["numbers"]["rows"]["peak_flow_ml_per_s"]
    assert row["difference_percent"] == pytest.approx(10.0)
    assert row["difference"] == pytest.approx(40.0, rel=1e-5)


def test_the_fluid_of_a_run_is_that_of_the_record():
    """EOA goes with the root of the density."""
    heavy = type(SALINE)(rho=1.21, mu=0.01, diameter=2.5)
    for sides in ({"a": beat(test=heavy), "b": beat("B")}, {"a": beat(), "b": beat("B", test=heavy)}):
        found = compare_beats(Pair(**sides), 0.0, 0.0)["numbers"]
        assert found["density_g_per_cm3"] == 1.21
        for side in "ab":
            area = found["rows"]["effective_orifice_area_cm2"][side]
            assert area == pytest.approx(1.1 * closed_forms()["effective_orifice_area"], rel=2e-3)


def test_what_one_of_them_lacks_is_left_out_and_said():
    part = beat("B", measured=True)
    part = Beat(
        name="B", t=part.t, period=PERIOD, values={q: part.values[q] for q in ("q_ao", "pdva")}, measured=True
    )
    found = compare_beats(Pair(a=beat(test=SALINE), b=part), 0.0, 0.0)
    assert tuple(found["quantities"]) == ("q_ao", FLOW_LESS_OFFSET, "pdva")
    assert found["diastolic_offset_ml_per_s"]["b"] == pytest.approx(-LEAKAGE, rel=0.01)
    assert found["numbers"]["missing"] == {"b": "B has no p_lv and no p_ao"}
    assert found["numbers"]["rows"]["peak_pdva_cm2"]["b"] == pytest.approx(3.5)
    assert found["numbers"]["rows"]["peak_flow_ml_per_s"]["difference"] is None
    pressure = Beat(name="C", t=part.t, period=PERIOD, values={"p_lv": beat().values["p_lv"]})
    with pytest.raises(CaseError, match="nothing to compare: C has p_lv; B has q_ao, pdva"):
        Pair(a=pressure, b=part)


def test_a_waveform_of_zeros_has_no_relative_norm():
    still = beat("B", change={"pdva": np.zeros(2000)})
    pair = Pair(a=beat(), b=still)
    assert set(pair.norms("pdva").values()) == {None}
    assert pair.common_shift(0.007) == pytest.approx(0.0, abs=1e-7)


def test_the_mean_beat_of_a_record_and_its_spread():
    t = np.arange(4 * 500) * PERIOD / 500
    each = np.repeat([-3.0, -1.0, 1.0, 3.0], 500)
    phases, found, count = mean_beat(t + 7.0, {"q_ao": waves(t)["q"] + each}, PERIOD)
    assert count == 4
    assert phases == pytest.approx(t[:500], abs=1e-12)
    inside = slice(2, 498)
    assert found["values"]["q_ao"][inside] == pytest.approx(waves(t[:500])["q"][inside], abs=1e-6)
    assert found["deviations"]["q_ao"][inside] == pytest.approx(math.sqrt(20 / 3), abs=1e-6)
    _, found, count = mean_beat(t[:1000], {"q_ao": t[:1000]}, PERIOD)
    assert (count, found["deviations"]) == (2, {}), "a spread of two is none"
    assert mean_beat(t[:400], {"q_ao": t[:400]}, PERIOD)[2] == 0
    phases, found, count = mean_beat(t[:700] + 7.0, {"q_ao": t[:700]}, PERIOD)
    assert count == 1
    assert phases == pytest.approx(t[:500], abs=1e-12), "what is more than a cycle is left out"
    assert found["values"]["q_ao"] == pytest.approx(t[:500])


def test_the_comparison_is_drawn(tmp_path):
    a, b = beat(phase=0.01), beat("B", 200, deviations={"q_ao": np.full(200, 5.0)})
    pair = Pair(a=a, b=b)
    overlays = [
        Overlay(
            quantity=name,
            **dict(zip("ab", pair.values(name), strict=True)),
            shifted=pair.values(name, 0.005)[0],
            deviation=b.deviation_at(name, pair.t) if name in b.deviations else None,
        )
        for name in pair.quantities
    ]
    names = {"a": "A", "b": "B", "shifted": "shifted"}
    path = valve_comparison(tmp_path / "all.png", pair.t, overlays, names, title="Two beats")
    assert np.ptp(imread(path)[..., :3]) > 0.5
    assert valve_comparison(tmp_path / "one.png", pair.t, overlays[2:3], names).stat().st_size > 5000
