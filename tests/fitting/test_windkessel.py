"""Fits of circuits: recovery, coverage, what the data fix, the reference record."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from valvefsi.errors import CaseError
from valvefsi.fitting import uncertainty
from valvefsi.fitting.least_squares import fit
from valvefsi.fitting.uncertainty import correlation_length
from valvefsi.fitting.waveforms import Waveforms
from valvefsi.fitting.windkessel import Cycles, Settings, build_problem, compare, fit_windkessel
from valvefsi.fitting.windkessel_models import CIRCUITS, find_circuit
from valvefsi.units import MMHG

pytestmark = pytest.mark.serial  # nothing in it runs in parallel
QUICK = Settings(profiles=False, draws=0)
TRUTH = {  # parameters, initial states [mmHg, ml, s]
    "downstream": ({"R_c": 0.0576, "R_p": 1.1, "C": 1.4}, [80.0]),
    "two-element": ({"R_p": 1.1, "C": 1.4}, [80.0]),
    "four-element": ({"R_c": 0.08, "R_p": 1.1, "C": 1.4, "L": 0.01}, [80.0, 20.0]),
    "upstream-porcine": ({"R_1": 0.1, "R_2": 0.04, "C_VIA": 0.3}, [10.0]),
    "upstream-bovine": (
        {"C_VIA1": 0.1, "C_VIA2": 0.2, "R_VIA": 0.06, "R_out": 0.04, "R_MV": 1.2},
        [12.0, 12.0],
    ),
}


def drive(t, period=0.8):
    """Return flows [ml/s] and pressures [mmHg] that repeat."""
    phase = 2 * np.pi * t / period
    return {
        "q_ao": 420 * np.maximum(np.sin(phase), 0) ** 1.3,
        "q_lv": 400 * np.maximum(np.sin(phase - 0.2), 0) ** 1.3,
        "q_pump": 520 * np.maximum(np.sin(phase), 0) ** 1.5 - 100 * np.maximum(np.sin(phase - 3.3), 0) ** 2,
        "p_la": 10 + 4 * np.sin(phase - 2) + 2 * np.sin(2 * phase),
        "p_pump": 8 + 180 * np.maximum(np.sin(phase), 0) ** 1.2,
    }


def record(name, *, n=161, cycles=2, periodic=False, truth=None, uneven=False):
    """Return the clean record of a circuit, its output and the values it was made with."""
    model = find_circuit(name)
    t = np.linspace(0, 0.8 * cycles, n)
    if uneven:
        t[1:-1] += np.random.default_rng(2).uniform(-0.3, 0.3, n - 2) * (t[1] - t[0])
    driven = {q: y * (MMHG if q[0] == "p" else 1.0) for q, y in drive(t).items() if q in model.inputs}
    empty = Waveforms(t=t, values={**driven, model.output: np.zeros(n)})
    simulator, _ = build_problem(empty, model, Settings(periodic=periodic), Cycles())
    parameters, start = TRUTH[name]
    values = np.array([*(truth or parameters).values(), *start])[: len(simulator.names)]
    curve = simulator.curve(values)
    return empty.with_values({model.output: curve * MMHG}), curve, values


def external(name):
    folder = os.environ.get("VALVEFSI_DATA")
    if not folder:
        pytest.skip("VALVEFSI_DATA does not name the folder of the external records")
    return Path(folder) / name


@pytest.mark.parametrize("repeated", [False, True])
@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_one_beat_is_as_long_as_its_samples_and_the_interval_to_the_next(repeated, noise):
    closed, _, values = record("downstream", n=101, cycles=1, periodic=True)
    shaken = np.random.default_rng(3).normal(0, noise * MMHG, 101)
    shaken[-1] = shaken[0]
    closed = closed.with_values({"p_ao": closed["p_ao"] + shaken})
    waves = closed if repeated else closed.picked(np.arange(100))
    report = fit_windkessel(waves, "downstream", replace(QUICK, periodic=True, lag="off", starts=2))
    assert report.extra["period_s"] == pytest.approx(0.8, rel=1e-12)
    assert np.allclose(report.fit.values, values, rtol=1e-6 if noise == 0 else 0.05)
    said = "last, which repeats it" if repeated else "100 samples and the interval to the next beat"
    assert any("1 cycle of 0.8 s" in note and said in note for note in report.notes)


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize("name", CIRCUITS)
def test_clean_records_give_the_parameters_back(name, periodic, uneven):
    waves, _, values = record(name, periodic=periodic, uneven=uneven)
    settings = replace(QUICK, periodic=periodic, period=0.8, starts=4)
    report = fit_windkessel(waves, name, settings)
    assert np.allclose(report.fit.values, values, rtol=1e-6)
    assert report.extra["norms_over_time"]["relative_linf"] < 1e-8
    assert correlation_length(np.zeros(50)) == 1.0


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("name", CIRCUITS)
def test_the_jacobian_is_the_complex_step_of_the_curve(name, periodic):
    waves, _, values = record(name, n=60, periodic=periodic, uneven=True)
    simulator, _ = build_problem(waves, find_circuit(name), Settings(periodic=periodic), Cycles())
    by_step = [simulator.curve(values + 1e-30j * unit).imag / 1e-30 for unit in np.eye(len(values))]
    difference = simulator.jacobian(values) - np.array(by_step).T
    assert np.abs(difference).max() < 1e-12 * np.abs(by_step).max()


@pytest.mark.parametrize("name", ["downstream", "two-element", "four-element", "upstream-porcine"])
def test_the_95_percent_intervals_cover_the_truth(name):
    waves, curve, values = record(name)
    model, rng, hits = find_circuit(name), np.random.default_rng(7), []
    size = 0.02 * np.sqrt(np.mean(curve**2))
    for _ in range(200):
        measured = curve + size * rng.standard_normal(len(curve))
        simulator, problem = build_problem(
            waves.with_values({model.output: measured * MMHG}), model, Settings(), Cycles()
        )
        found = fit(problem, starts=1, first=dict(zip(simulator.names, values, strict=True)))
        intervals = uncertainty.linearised(found).intervals
        hits.append([low <= v <= high for (low, high), v in zip(intervals, values, strict=True)])
    print(name, dict(zip(simulator.names, np.mean(hits, axis=0), strict=True)))
    assert 0.90 <= np.mean(hits) <= 0.98
    assert np.mean(hits, axis=0).min() > 0.88


@pytest.mark.slow
def test_profile_intervals_cover_the_truth_where_parameters_trade():
    waves, curve, values = record("upstream-bovine")
    model, rng, hits = find_circuit("upstream-bovine"), np.random.default_rng(7), []
    size = 0.02 * np.sqrt(np.mean(curve**2))
    for _ in range(60):
        measured = curve + size * rng.standard_normal(len(curve))
        simulator, problem = build_problem(
            waves.with_values({"p_lv": measured * MMHG}), model, Settings(), Cycles()
        )
        truth = dict(zip(simulator.names, values, strict=True))
        found = fit(problem, starts=2, first=truth)
        freedom = len(curve) - len(values)
        threshold = found.cost * (1 + stats.f.ppf(0.95, 1, freedom) / freedom)
        held = [fit(problem.with_constant(name, v), starts=1, first=truth).cost for name, v in truth.items()]
        hits.append([cost <= threshold for cost in held])
    print(np.mean(hits, axis=0))
    assert 0.90 <= np.mean(hits) <= 1.0
    assert np.mean(hits, axis=0).min() > 0.85


def test_the_waveforms_of_the_left_heart_are_reproduced():
    report = fit_windkessel(external("left_heart_waveforms.csv"), "downstream", replace(QUICK, starts=8))
    entry = report.as_dict()
    assert report.extra["norms_over_time"]["relative_l2"] <= 0.0170
    assert report.extra["norms_over_time"]["relative_linf"] <= 0.038
    assert entry["relative_l2"] <= 0.0170
    found = report.fit.named
    assert found["R_c"] == pytest.approx(0.0883, abs=5e-5)
    assert found["R_p"] == pytest.approx(1.085, abs=5e-4)
    assert found["C"] == pytest.approx(1.279, abs=5e-4)
    assert report.fit.reached == len(report.fit.starts)
    assert any("neighbouring residuals are alike" in note for note in report.notes)
    wide, narrow = report.extra["ci95_correlated_residuals"]["C"], entry["parameters"]["C"]["ci95"]
    assert np.ptp(wide) > 3 * np.ptp(narrow)


def test_without_flow_it_is_said_what_is_missing():
    with pytest.raises(CaseError, match="needs q_ao and p_ao; missing is q_ao"):
        fit_windkessel(external("pulse_duplicator_pressures.csv"))


def test_a_rigid_windkessel_cannot_tell_its_resistances_apart():
    waves, _, _ = record("downstream", truth={"R_c": 0.1, "R_p": 1.0, "C": 0.0})
    report = fit_windkessel(waves, "downstream", Settings(fixed={"C": 0.0}, draws=0, starts=4))
    assert list(report.fit.named) == ["R_c", "R_p", "C"]
    assert report.fit.named["R_c"] + report.fit.named["R_p"] == pytest.approx(1.1, rel=1e-9)
    parameters = report.parameters()
    assert parameters["C"]["verdict"] == "held"
    assert "trades against R_p" in parameters["R_c"]["verdict"]
    assert report.extra["combinations"]["R_c + R_p"]["value"] == pytest.approx(1.1, rel=1e-9)
    assert report.extra["combinations"]["R_c + R_p"]["std"] is not None


def test_the_compliances_of_the_bovine_circuit_trade_and_their_sum_is_known():
    waves, curve, _ = record("upstream-bovine", n=401)
    noise = 0.5 * np.random.default_rng(3).standard_normal(401)
    waves = waves.with_values({"p_lv": (curve + noise) * MMHG})
    report = fit_windkessel(waves, "upstream-bovine", Settings(draws=0, starts=4))
    parameters, combined = report.parameters(), report.extra["combinations"]["C_VIA1 + C_VIA2"]
    assert "C_VIA2" in parameters["C_VIA1"]["verdict"]
    assert parameters["R_VIA"]["verdict"].startswith(("weak", "not identified"))
    assert combined["std"] < 0.1 * parameters["C_VIA1"]["std"]
    assert combined["value"] == pytest.approx(0.3, abs=4 * combined["std"])
    assert parameters["R_MV"]["verdict"] == "identified"
    assert any(line.startswith("together: C_VIA1 + C_VIA2") for line in report.lines())


def test_an_inertance_is_preferred_only_where_there_is_one():
    for truth, best in (("downstream", "downstream"), ("four-element", "four-element")):
        waves, curve, _ = record(truth, n=301)
        noise = 0.5 * np.random.default_rng(11).standard_normal(301)
        measured = Waveforms(t=waves.t, values={"q_ao": waves["q_ao"], "p_ao": (curve + noise) * MMHG})
        names = ("two-element", "downstream", "four-element")
        rows = compare([fit_windkessel(measured, name, replace(QUICK, starts=4)) for name in names])
        least = min(rows, key=lambda row: row["bic"])
        assert least["circuit"] == best
        assert least["delta_bic"] == 0
        assert all(row["held_out_rmse"] > 0 for row in rows)


def test_cycles_are_the_blocks_of_a_long_record():
    waves, _, _ = record("downstream", n=401, cycles=4)
    report = fit_windkessel(waves, "downstream", replace(QUICK, period=0.8, starts=2))
    assert list(report.as_dict()["blocks"]) == ["cycle 1", "cycle 2", "cycle 3", "cycle 4"]


def test_a_record_turned_round_is_noticed():
    waves, _, values = record("upstream-porcine")
    upside = waves.with_values({"q_lv": -waves["q_lv"]})
    report = fit_windkessel(upside, "upstream-porcine", replace(QUICK, starts=1))
    assert any("--flip q_lv" in note for note in report.notes)
    again = fit_windkessel(upside.flipped(["q_lv"]), "upstream-porcine", replace(QUICK, starts=2))
    assert np.allclose(again.fit.values, values, rtol=1e-6)


def test_the_correlation_length_of_a_moving_average_is_its_closed_form():
    rng = np.random.default_rng(0)
    white = rng.standard_normal(200_000)
    assert correlation_length(white) == pytest.approx(1.0, abs=0.1)
    smoothed = np.convolve(white, np.ones(10), "valid")  # 1 + 2 sum (1 - k / 10) = 10
    assert correlation_length(smoothed) == pytest.approx(10.0, abs=1.0)


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        (Settings(fixed={"R_p": 0.0}), "R_p = 0.0: expected a finite number above zero"),
        (Settings(fixed={"C": -1.0}), "C = -1.0"),
        (Settings(fixed={"C_via": 1.0}), "'C_via': no such parameter"),
        (Settings(fixed={"C": 0.0, "p_wk_start": 3.0}), "no such parameter"),
        (Settings(bounds={"R_c": (-1.0, 1.0)}), "lower bound of zero or above"),
        (Settings(bounds={"R_c": (2.0, 1.0)}), "lower and a larger upper"),
        (Settings(periodic=True, period=-1.0), "period"),
        (Settings(periodic=True, period=9.0), "period"),
        (Settings(period=float("nan")), "period"),
    ],
)
def test_settings_that_cannot_be_used_are_refused(settings, reason):
    waves, _, _ = record("downstream")
    with pytest.raises(CaseError) as caught:
        fit_windkessel(waves, "downstream", settings)
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_unknown_circuit_is_refused_with_the_known_ones():
    with pytest.raises(CaseError, match="downstream, two-element"):
        find_circuit("windkessel")
