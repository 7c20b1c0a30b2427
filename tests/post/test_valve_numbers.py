"""Numbers of a valve from closed-form waveforms."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.ordering import assert_order
from tests.valve_waves import (
    BACKFLOW,
    CLOSING,
    EJECTION,
    INERTIAL,
    OPEN,
    PEAK,
    PERIOD,
    QUADRATIC,
    SALINE,
    closed_forms,
    record,
)
from valvefsi.post.valve_numbers import (
    NUMBERS,
    cycle_change,
    cycle_numbers,
    effective_orifice_area,
    valve_numbers,
)
from valvefsi.post.valve_record import ValveRecord, ValveTest
from valvefsi.units import MMHG


def test_every_number_of_a_closed_form_cycle():
    got = cycle_numbers(record(), SALINE)
    assert got.reasons == {}
    for name, value in closed_forms().items():
        # Backflow below the floor, 2 % of the peak flow, is leakage: 0.4 % of the closing volume.
        slack = 1e-2 if name in ("closing_volume", "leakage_volume", "leakage_flow") else 2e-3
        assert getattr(got, name) == pytest.approx(value, rel=slack), name
    assert set(NUMBERS) - set(closed_forms()) == {"peak_to_peak_difference", "times_from"}
    assert got.times_from == "pdva"


def test_forward_flow_is_net_closing_and_leakage():
    got = cycle_numbers(record(), SALINE)
    assert got.forward_volume == pytest.approx(
        got.net_volume + got.closing_volume + got.leakage_volume, rel=1e-13
    )
    assert got.cardiac_output * PERIOD == pytest.approx(got.net_volume, rel=1e-13)


@pytest.mark.parametrize("since", [0.06, 1.0])
def test_flow_that_creeps_forward_through_the_closed_valve_does_not_begin_the_forward_flow(since):
    """From 60 ms before the rise, or from the start of the cycle on, 0.2 % of the peak flow."""
    plain = record()
    waiting = (plain.t > OPEN - since) & (plain.t < OPEN)
    creeping = record(q=np.where(waiting, 2e-3 * PEAK, plain.q))
    a, b = (cycle_numbers(r, SALINE) for r in (plain, creeping))
    assert np.all(creeping.q[waiting] > 0)
    assert a.forward_start == pytest.approx(OPEN, abs=2e-4)
    for name in ("forward_start", "forward_duration", "rms_forward_flow", "effective_orifice_area"):
        assert getattr(b, name) == pytest.approx(getattr(a, name), rel=5e-3), name


def test_the_energy_that_is_lost_is_what_its_parts_lose():
    got = cycle_numbers(record(), SALINE)
    parts = got.forward_energy_loss + got.closing_energy_loss + got.leakage_energy_loss
    assert got.energy_loss == pytest.approx(parts, rel=1e-13)
    assert got.in_lab_units()["forward_energy_loss_mJ"] == pytest.approx(
        1e-4 * got.forward_energy_loss, rel=1e-13
    )


def test_the_numbers_converge_with_the_samples():
    expected = closed_forms()["effective_orifice_area"]

    def error(samples):
        return abs(cycle_numbers(record(samples=samples), SALINE).effective_orifice_area - expected)

    assert_order(error, (300, 600, 1200, 2400), order=1.5, below=2e-5)


def test_the_area_of_an_orifice_comes_back_from_its_own_law():
    q, area, rho = 250.0, 2.1, 1.06
    got = effective_orifice_area(q, 0.5 * rho * (q / area) ** 2, rho)
    assert got == pytest.approx(area * np.sqrt(2 * MMHG) / 51.6, rel=1e-13)
    assert got == pytest.approx(area, rel=8e-4)
    with pytest.raises(ValueError, match="mean_difference: expected a positive pressure"):
        effective_orifice_area(q, 0.0, rho)


def test_a_valve_that_is_an_orifice_gives_its_area_whatever_the_flow():
    one = record()
    q = np.maximum(one.q, 0)
    dp = 0.5 * (q / 1.8) ** 2
    got = cycle_numbers(dataclasses.replace(one, q=q, p_lv=one.p_ao + dp), SALINE)
    assert got.effective_orifice_area == pytest.approx(1.8, rel=1e-3)
    assert (got.pressure_start, got.pressure_end) == pytest.approx((OPEN, OPEN + EJECTION), abs=3e-4)
    assert got.regurgitant_volume == pytest.approx(0, abs=1e-12)
    assert got.closing_volume == 0


NOISE, NOISE_SAMPLES = {"p_lv": MMHG, "p_ao": MMHG, "q": 4.0}, 1500


def scatter(of):
    """Standard deviations on paper, of numbers ``of`` a cycle whose samples have independent noise."""
    dt = PERIOD / NOISE_SAMPLES
    noise, flow = np.hypot(NOISE["p_lv"], NOISE["p_ao"]), NOISE["q"]
    length, s = of.pressure_end - of.pressure_start, np.pi * (of.pressure_end - OPEN) / EJECTION
    # Near its end the impulse is a parabola and a Brownian motion; where the sum is largest is Chernoff's variable,
    # of standard deviation 0.513. It takes away time without pressure: mean and square of the flow change with it.
    fall = -np.pi / EJECTION * (QUADRATIC * np.sin(2 * s) - INERTIAL * np.sin(s))
    end = 0.513 * (noise * np.sqrt(dt) / (fall / 2)) ** (2 / 3)
    mean = noise * np.sqrt(dt / length) / of.mean_pressure_difference
    share = 0.5 * (1 - (PEAK * np.sin(s) / of.rms_flow) ** 2)
    return {
        "forward_volume": flow * np.sqrt(EJECTION * dt),
        "net_volume": flow * np.sqrt(PERIOD * dt),
        "regurgitant_volume": flow * np.sqrt((PERIOD - EJECTION) * dt),
        "closing_volume": flow * np.sqrt(CLOSING * dt),
        "pressure_end": end,
        "mean_pressure_difference": of.mean_pressure_difference * np.hypot(mean, end / length),
        "effective_orifice_area": of.effective_orifice_area
        * np.hypot(mean / 2, (0.5 - share) * end / length),
    }


def test_noise_moves_the_numbers_as_far_as_it_must_and_to_neither_side():
    clean = record(samples=NOISE_SAMPLES)
    expected, found = cycle_numbers(clean, SALINE), []
    for seed in range(16):
        rng = np.random.default_rng(seed)
        noisy = {k: getattr(clean, k) + v * rng.standard_normal(len(clean.t)) for k, v in NOISE.items()}
        found.append(cycle_numbers(dataclasses.replace(clean, **noisy), SALINE))
        assert found[-1].reasons == {}
        # Six samples from its ends the flow is 3.6 standard deviations above zero.
        assert found[-1].forward_duration == pytest.approx(EJECTION, abs=12 * PERIOD / NOISE_SAMPLES)
    for name, deviation in scatter(expected).items():
        error = np.array([getattr(numbers, name) for numbers in found]) - getattr(expected, name)
        # Four standard deviations for each, and for their mean, which shows a lean to one side.
        assert np.abs(error).max() < 4 * deviation, name
        assert abs(error.mean()) < 4 * deviation / np.sqrt(len(found)), name
        assert error.std() > deviation / 2, name


def test_a_late_spike_of_backflow_is_leakage_not_closing():
    one = record()
    late = one.q - 80 * np.exp(-(((one.t - 0.7) / 0.01) ** 2))
    got, plain = cycle_numbers(dataclasses.replace(one, q=late), SALINE), cycle_numbers(one, SALINE)
    assert got.closing_volume == pytest.approx(plain.closing_volume, rel=1e-12)
    assert got.leakage_volume - plain.leakage_volume == pytest.approx(0.8 * np.sqrt(np.pi), rel=1e-6)


def test_a_dip_of_the_pressure_difference_does_not_cut_its_interval():
    one = record()
    dip = 14 * MMHG * np.exp(-(((one.t - 0.2) / 0.004) ** 2))
    got, plain = (cycle_numbers(dataclasses.replace(one, p_lv=one.p_lv - d), SALINE) for d in (dip, 0 * dip))
    assert ((one.p_lv - dip - one.p_ao)[(one.t > 0.15) & (one.t < 0.25)]).min() < 0
    assert (got.pressure_start, got.pressure_end) == (plain.pressure_start, plain.pressure_end)


@pytest.mark.parametrize(("first", "second"), [(2, 3), (3, 2)])
def test_of_two_positive_parts_that_a_deep_dip_parts_the_larger_counts(first, second):
    one, third = record(), EJECTION / 3
    part = np.floor((one.t - OPEN) / third)
    heights = np.select([part == k for k in range(3)], [first, -6, second], 0)
    dp = MMHG * heights * np.abs(np.sin(np.pi * (one.t - OPEN) / third))
    got = cycle_numbers(dataclasses.replace(one, p_lv=one.p_ao + dp), SALINE)
    start = OPEN + (0 if first > second else 2 * third)
    assert (got.pressure_start, got.pressure_end) == pytest.approx((start, start + third), abs=3e-4)
    assert got.mean_pressure_difference == pytest.approx(3 * MMHG * 2 / np.pi, rel=2e-3)


def test_without_the_area_the_times_come_from_the_flow():
    got = cycle_numbers(dataclasses.replace(record(), pdva=None), SALINE)
    assert got.times_from == "flow"
    assert got.opening_start == got.forward_start
    rise = EJECTION * np.arcsin(0.9) / np.pi
    assert got.opening_duration == pytest.approx(rise, rel=1e-3)
    assert got.closing_start == pytest.approx(OPEN + EJECTION - rise, rel=1e-3)
    tail = CLOSING * np.arcsin(0.02 * PEAK / BACKFLOW) / np.pi
    assert got.closing_end == pytest.approx(OPEN + EJECTION + CLOSING - tail, abs=2e-4)
    assert got.peak_pdva is None
    assert set(got.reasons) == {"peak_pdva", "mean_pdva", "opening_half", "closing_half"}


def test_two_equal_cycles_give_equal_numbers_and_no_change():
    two = record(2)
    first, second = valve_numbers(two, SALINE)
    assert (first.cycle, second.cycle) == (0, 1)
    assert second.times_from == first.times_from
    for name in set(NUMBERS) - {"times_from"}:
        assert getattr(second, name) == pytest.approx(getattr(first, name), rel=1e-9), name
    change, reasons = cycle_change(two)
    assert reasons == {}
    assert max(change.values()) < 1e-6


def test_the_change_between_cycles_is_the_relative_norm():
    two = record(2)
    scale = np.where(two.t < PERIOD, 0.97, 1.0)
    change, _ = cycle_change(dataclasses.replace(two, q=scale * two.q, p_ao=scale * two.p_ao))
    assert change["q"] == pytest.approx(0.03, rel=1e-3)
    # The jump at the cycle's edge lies in one step.
    assert change["p_ao"] == pytest.approx(0.03, rel=1e-3)
    assert change["p_lv"] < 1e-9
    change, reasons = cycle_change(record(1.5))
    assert set(change.values()) == {None}
    assert "two complete cycles in a row are needed, the record has 1 complete" in reasons["q"]


def test_the_start_of_the_cycles_may_be_moved_in_the_closed_phase():
    three = record(3)
    moved = dataclasses.replace(three, start=0.6)
    assert moved.num_cycles == 3
    got, expected = cycle_numbers(moved, SALINE, 0), cycle_numbers(three, SALINE, 0)
    assert got.effective_orifice_area == pytest.approx(expected.effective_orifice_area, rel=1e-4)
    assert got.regurgitant_volume == pytest.approx(expected.regurgitant_volume, rel=1e-3)
    assert got.forward_start == pytest.approx(OPEN + PERIOD - 0.6, abs=PERIOD / 4000)


def test_an_incomplete_cycle_has_reasons_in_place_of_numbers():
    first, second = valve_numbers(record(1.6), SALINE)
    assert first.reasons == {}
    assert all(getattr(second, name) is None for name in NUMBERS)
    assert set(second.reasons) == set(NUMBERS)
    assert "the record ends 0.3429 s before the cycle does" in second.reasons["peak_flow"]
    assert second.start == pytest.approx(PERIOD)


def test_a_record_that_stops_a_sample_short_is_complete():
    one = record()
    short = ValveRecord(period=PERIOD, **{n: getattr(one, n)[:-1] for n in ("t", *one.signals)})
    assert cycle_numbers(short, SALINE).net_volume == pytest.approx(
        cycle_numbers(record(), SALINE).net_volume
    )


def test_what_cannot_be_given_says_why():
    one = record()
    broken = one.q.copy()
    broken[1000] = np.nan
    got = cycle_numbers(dataclasses.replace(one, q=broken), SALINE)
    assert got.effective_orifice_area is None
    assert "q is not finite at t = 0.2142" in got.reasons["effective_orifice_area"]
    shut = cycle_numbers(dataclasses.replace(one, q=0 * one.q - 1), SALINE)
    assert shut.forward_volume is None
    assert shut.reasons["forward_volume"] == "no forward flow"
    assert shut.net_volume == pytest.approx(-PERIOD)
    weak = cycle_numbers(dataclasses.replace(one, p_lv=one.p_ao - 1), SALINE)
    assert weak.reasons["effective_orifice_area"] == "p_lv never exceeds p_ao during forward flow"
    assert weak.forward_volume is not None
    gone = (one.t > 0.2) & (one.t < 0.3)
    holed = ValveRecord(period=PERIOD, **{n: getattr(one, n)[~gone] for n in ("t", *one.signals)})
    assert "two samples are 0.1" in cycle_numbers(holed, SALINE).reasons["peak_flow"]


def test_a_cycle_that_starts_with_the_valve_open_is_told_so():
    got = cycle_numbers(dataclasses.replace(record(3), start=0.25), SALINE, 0)
    for name in ("forward_volume", "effective_orifice_area", "closing_volume", "opening_start"):
        assert getattr(got, name) is None
        assert "start the cycle in the closed phase" in got.reasons[name]
    assert got.net_volume == pytest.approx(closed_forms()["net_volume"], rel=2e-3)


def test_none_of_the_numbers_is_nan_and_none_is_missing_silently():
    one = record(2)
    for start in np.linspace(0, PERIOD, 23):
        for area in (one.pdva, None):
            for got in valve_numbers(dataclasses.replace(one, start=start, pdva=area), SALINE):
                for name in NUMBERS:
                    value = getattr(got, name)
                    assert (value is None) == (name in got.reasons), (start, name)
                    assert isinstance(value, str | None) or np.isfinite(value)


def test_the_laboratory_reads_its_own_units():
    got = cycle_numbers(record(), SALINE)
    lab = got.in_lab_units()
    assert lab["cardiac_output_l_per_min"] == pytest.approx(got.cardiac_output * 0.06)
    assert lab["mean_pressure_difference_mmHg"] == pytest.approx(got.mean_pressure_difference / MMHG)
    assert lab["regurgitant_fraction_percent"] == pytest.approx(100 * got.regurgitant_fraction)
    assert lab["forward_duration_ms"] == pytest.approx(300, abs=0.5)
    assert lab["forward_volume_ml"] == got.forward_volume
    assert lab["rms_flow_ml_per_s"] == got.rms_flow
    assert lab["effective_orifice_area_cm2"] == got.effective_orifice_area
    assert len(lab) == len(got.as_dict()) - 1
    assert got.as_dict()["peak_flow"] == got.peak_flow


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q": np.zeros(3)}, "q: expected the shape"),
        ({"t": np.zeros(4001)}, "t: expected two or more finite times"),
        ({"period": 0.0}, "period: expected a positive time, found 0.0"),
        ({"start": -1.0}, "start: expected 0.0 or later"),
    ],
)
def test_a_record_is_checked_at_birth(change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(record(), **change)


def test_a_test_is_checked_at_birth_and_a_missing_cycle_is_told():
    with pytest.raises(ValueError, match="mu: expected a positive number, found 0"):
        ValveTest(rho=1, mu=0, diameter=2.5)
    with pytest.raises(ValueError, match="levels: expected 0 < lower < upper < 1"):
        ValveTest(rho=1, mu=0.01, diameter=2.5, levels=(0.9, 0.1))
    with pytest.raises(IndexError, match="cycle 3: the record begins 2"):
        cycle_numbers(record(2), SALINE, 3)
