"""Outliers, cycles and smoothing of records."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from valvefsi.errors import CaseError
from valvefsi.fitting.waveform_repair import find_outliers, find_period, repair, smooth, whole_cycles
from valvefsi.fitting.waveforms import Waveforms, read_waveforms

pytestmark = pytest.mark.serial  # nothing in it runs in parallel
PERIOD = 0.8


def beats(n=600, cycles=3, noise=0.0, seed=1):
    """Return three beats of pressure and flow with the flow's flat diastole."""
    t = np.linspace(0, cycles * PERIOD, n)
    phase = 2 * np.pi * t / PERIOD
    q = 400 * np.maximum(np.sin(phase), 0) ** 1.2
    p = 90 + 20 * np.sin(phase - 0.6) + 6 * np.sin(2 * phase)
    rng = np.random.default_rng(seed)
    return Waveforms(
        t=t, values={"p_ao": p + noise * rng.normal(size=n), "q_ao": q + noise * rng.normal(size=n)}
    )


def external(name):
    folder = os.environ.get("VALVEFSI_DATA")
    if not folder:
        pytest.skip("VALVEFSI_DATA does not name the folder of the external records")
    return Path(folder) / name


def test_the_six_ten_fold_samples_of_the_pulse_duplicator_are_found_and_no_other():
    waves = read_waveforms(external("pulse_duplicator_pressures.csv"))
    found = find_outliers(waves)
    assert [outlier.quantity for outlier in found] == ["p_ao"] * 6
    assert [outlier.sample for outlier in found] == [91, 215, 449, 666, 728, 987]
    assert [outlier.row for outlier in found] == [93, 217, 451, 668, 730, 989]
    assert {outlier.reason for outlier in found} == {"10 x"}
    mended = repair(waves, found)
    for outlier in found:
        assert outlier.instead == pytest.approx(outlier.value / 10, rel=1e-12)
        near = mended["p_ao"][outlier.sample - 1 : outlier.sample + 2]
        assert np.ptp(near) < 0.02 * near.mean()
    assert find_outliers(mended) == ()
    assert find_outliers(waves) == found
    assert find_period(mended.t, mended["p_ao"]) == pytest.approx(0.8, rel=5e-3)


def test_the_waveforms_of_the_left_heart_have_no_outlier():
    assert find_outliers(read_waveforms(external("left_heart_waveforms.csv"))) == ()


@pytest.mark.parametrize("n", [60, 200, 600, 3000])
@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_steep_and_flat_parts_are_no_outliers(n, noise):
    assert find_outliers(beats(n=n, noise=noise)) == ()


@pytest.mark.parametrize("seed", range(5))
def test_planted_outliers_are_found_exactly(seed):
    clean = beats(noise=1.0, seed=seed)
    rng = np.random.default_rng(seed)
    where = np.sort(rng.choice(np.arange(0, 600, 12), 8, replace=False))
    p = clean["p_ao"].copy()
    p[where[:4]] *= 10
    p[where[4:6]] /= 10
    p[where[6:]] += 300
    found = find_outliers(clean.with_values({"p_ao": p}))
    assert [outlier.sample for outlier in found] == list(where)
    assert [outlier.reason for outlier in found] == ["10 x"] * 4 + ["0.1 x"] * 2 + ["spike"] * 2
    mended = repair(clean.with_values({"p_ao": p}), found)
    assert np.abs(mended["p_ao"] - clean["p_ao"]).max() < 6
    assert np.allclose(mended["p_ao"][where[:6]], clean["p_ao"][where[:6]], rtol=1e-12)


def test_two_outliers_side_by_side_are_both_found():
    clean = beats()
    p = clean["p_ao"].copy()
    p[300:302] *= 10
    assert [outlier.sample for outlier in find_outliers(clean.with_values({"p_ao": p}))] == [300, 301]


def test_a_constant_or_short_record_has_no_outliers():
    t = np.linspace(0, 1, 50)
    assert find_outliers(Waveforms(t=t, values={"q_ao": np.zeros(50)})) == ()
    assert find_outliers(Waveforms(t=t[:6], values={"q_ao": np.array([0, 0, 9e9, 0, 0, 0.0])})) == ()


@pytest.mark.parametrize("noise", [0.0, 5.0])
def test_the_period_is_found(noise):
    waves = beats(noise=noise)
    assert find_period(waves.t, waves["p_ao"]) == pytest.approx(PERIOD, rel=1e-2)
    one = beats(cycles=1)
    assert find_period(one.t, one["p_ao"]) is None
    assert find_period(one.t, np.ones(600)) is None


def test_a_record_is_cut_to_whole_cycles_and_closed():
    waves = beats(n=700, cycles=3)
    short = waves.picked(waves.t < 2.9 * PERIOD)
    cut, count = whole_cycles(short, PERIOD)
    assert count == 2
    assert cut.t[-1] - cut.t[0] == pytest.approx(2 * PERIOD)
    assert all(array[-1] == array[0] for array in cut.values.values())
    with pytest.raises(CaseError, match="period"):
        whole_cycles(short, 5.0)


def test_a_record_without_its_last_sample_is_still_whole():
    waves = beats(n=601, cycles=3).picked(np.arange(600))
    cut, count = whole_cycles(waves, PERIOD)
    assert count == 3
    assert len(cut.t) == 601


@pytest.mark.parametrize("uneven", [False, True])
def test_smoothing_halves_an_oscillation_of_the_cut_off_period(uneven):
    t = np.linspace(0, 4, 801)
    if uneven:
        t = t + 0.001 * np.sin(40 * t)
    for period, kept in ((0.2, 0.5), (0.8, 0.996), (0.05, 1 / 257)):
        y = np.sin(2 * np.pi * t / period)
        z = smooth(Waveforms(t=t, values={"p_lv": y}), ["p_lv"], 0.2)["p_lv"]
        inner = slice(200, 600)
        assert (z[inner] @ y[inner]) / (y[inner] @ y[inner]) == pytest.approx(kept, abs=0.02)


def test_no_smoothing_leaves_the_record_as_it_is():
    waves = beats()
    assert smooth(waves, ["p_ao"], 0.0) is waves
    with pytest.raises(CaseError, match="smooth"):
        smooth(waves, ["p_ao"], -1.0)
    assert "halves a period of 0.05 s" in smooth(waves, ["p_ao"], 0.05).notes[0]
