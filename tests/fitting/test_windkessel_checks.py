"""What a record's faults do to a fit of a circuit is said: a lag, coarse sampling, a circuit that misses the data."""

from __future__ import annotations

import json

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from valvefsi.circulation.windkessel import Downstream
from valvefsi.cli.fit_windkessel import windkessel
from valvefsi.errors import CaseError
from valvefsi.fitting.least_squares import Parameter, Problem, fit
from valvefsi.fitting.report import assess
from valvefsi.fitting.waveforms import Waveforms, write_waveforms
from valvefsi.fitting.windkessel import Cycles, Settings, build_problem, fit_windkessel
from valvefsi.fitting.windkessel_models import find_circuit
from valvefsi.units import MMHG

pytestmark = pytest.mark.serial  # nothing in it runs in parallel
TRUTH = {"R_c": 0.0576, "R_p": 1.1, "C": 1.4}
QUICK = {"profiles": False, "draws": 0, "starts": 2}
PERIOD = 0.8


def smooth(t):
    return 420 * np.maximum(np.sin(2 * np.pi * t / PERIOD), 0) ** 1.3


def sharp(t):
    """A steep start, and a backflow of 40 ms."""
    s = t % PERIOD
    forward = 420 * np.maximum(np.sin(np.pi * s / 0.28), 0) ** 0.7 * (s < 0.28)
    return forward - 250 * np.maximum(np.sin(np.pi * (s - 0.28) / 0.04), 0) * ((s >= 0.28) & (s < 0.32))


def record(flow=smooth, *, lag=0.0, step=0.005, noise=0.5, seed=0, cycles=3):
    """Return a record sampled from a run with steps of 0.1 ms, its pressure late by ``lag`` [s]."""
    fine = np.arange(-6 * PERIOD, cycles * PERIOD + 0.1, 1e-4)
    system, q = Downstream(**TRUTH).system(), flow(fine)
    p = system.outputs(system.simulate(fine, q[:, None], np.array([90.0])), q[:, None])
    t = np.arange(0, cycles * PERIOD + 1e-9, step)
    measured = np.interp(t - lag, fine, p) + noise * np.random.default_rng(seed).standard_normal(len(t))
    return Waveforms(t=t, values={"q_ao": np.interp(t, fine, q), "p_ao": measured * MMHG})


@pytest.mark.parametrize("lag", [0.006, -0.006])
def test_a_lag_is_found_and_said_and_no_parameter_is_called_identified(lag):
    report = fit_windkessel(record(lag=lag), "downstream", Settings(**QUICK))
    found = report.extra["lag"]
    assert abs(found["value_ms"] - 1e3 * lag) < 3 * found["std_ms"] < 3
    note = next(note for note in report.notes if "--lag fit" in note)
    assert ("follows" if lag > 0 else "leads") in note
    off = report.fit.named["R_c"] / TRUTH["R_c"] - 1
    assert abs(off) > 0.05
    assert found["relative_changes"]["R_c"] == pytest.approx(1 / (1 + off) - 1, abs=0.03)
    assert all(entry["verdict"] == "doubtful: the record has a lag" for entry in report.parameters().values())


def test_a_lag_that_is_fitted_gives_the_parameters_back():
    for seed in range(4):
        settings = Settings(**QUICK, lag="fit")
        report = fit_windkessel(record(lag=0.006, seed=seed), "downstream", settings)
        entries = report.parameters()
        for name, truth in {**TRUTH, "lag": 6.0}.items():
            assert abs(entries[name]["value"] - truth) < 3.5 * entries[name]["std"], (seed, name)
        assert entries["lag"]["unit"] == "ms"
        assert entries["R_c"]["verdict"] == "identified"
        assert report.fit.reached == 2
    periodic = fit_windkessel(
        record(lag=0.006), "downstream", Settings(**QUICK, lag="fit", periodic=True, period=PERIOD)
    )
    assert periodic.fit.named["lag"] == pytest.approx(6.0, abs=1.5)


def test_no_lag_is_said_where_there_is_none():
    for seed in range(10):
        report = fit_windkessel(record(seed=seed), "downstream", Settings(**QUICK))
        assert report.extra["lag"] is None
        assert report.parameters()["C"]["verdict"] == "identified"
    assert fit_windkessel(record(lag=0.006), "downstream", Settings(**QUICK, lag="off")).extra["lag"] is None
    with pytest.raises(CaseError, match="lag = 'maybe': expected one of check, fit, off"):
        Settings(lag="maybe")


@pytest.mark.parametrize("name", ["downstream", "four-element"])
def test_a_late_output_is_the_run_with_samples_at_the_late_times(name):
    t = np.linspace(0, 2 * PERIOD, 161)
    waves = Waveforms(t=t, values={"q_ao": smooth(t), "p_ao": np.zeros(161)})
    model = find_circuit(name)
    simulator, problem = build_problem(waves, model, Settings(lag="fit"), Cycles())
    values = np.array(
        [{**TRUTH, "L": 0.01}.get(n, 80.0 if n == "p_wk_start" else 20.0) for n in simulator.names]
    )
    values[-1] = 6.2
    late = t[simulator.kept] - 6.2e-3
    both = np.union1d(
        t, late
    )  # inputs are straight between samples: more samples on the lines change nothing
    system, u = simulator.system(values), np.interp(both, t, smooth(t))[:, None]
    y = system.outputs(system.simulate(both, u, simulator.states(values)[0]), u) / MMHG
    expected = y[np.searchsorted(both, late)]
    assert np.abs(simulator.curve(values) - expected).max() < 1e-6 * np.ptp(expected)
    for k, step in enumerate([*(1e-5 * values[:-1]), 1e-4]):
        unit = step * (np.arange(len(values)) == k)
        slope = (simulator.curve(values + unit) - simulator.curve(values - unit)) / (2 * step)
        assert np.abs(problem.jacobian(values)[:, k] - slope).max() < 0.02 * np.abs(slope).max()


def test_coarse_sampling_is_said_with_about_the_error_it_makes():
    coarse = fit_windkessel(record(sharp, step=0.02, noise=0.3, cycles=4), "downstream", Settings(**QUICK))
    note = next(note for note in coarse.notes if "coarse" in note)
    assert "every 20 ms" in note
    said = float(note.split("R_c by about ")[1].split(" %")[0])
    assert said == pytest.approx(100 * abs(coarse.fit.named["R_c"] / TRUTH["R_c"] - 1), abs=1.5)
    fine = fit_windkessel(record(sharp, step=0.005, noise=0.3, cycles=4), "downstream", Settings(**QUICK))
    assert not any("coarse" in note for note in fine.notes)


def test_nothing_is_identified_by_a_circuit_that_misses_the_data():
    report = fit_windkessel(record(), "two-element", Settings(**QUICK, lag="off"))
    assert report.assessment.alike > 5
    assert any("neighbouring residuals are alike" in note for note in report.notes)
    assert {entry["verdict"] for entry in report.parameters().values()} == {
        "doubtful: residuals are systematic"
    }


def test_few_starts_at_the_best_are_warned_of_and_the_work_is_told_as_it_goes_on():
    t = np.linspace(0, 1, 60)
    parameters = (
        Parameter(name="rate", lower=1.0, upper=100.0),
        Parameter(name="size", lower=-5.0, upper=5.0),
    )
    problem = Problem(
        parameters=parameters,
        data=np.sin(40 * t) + 0.05 * np.random.default_rng(0).standard_normal(60),
        model=lambda v: v[1] * np.sin(v[0] * t),
        blocks=np.arange(60) // 20,
    )
    told = []
    best = fit(problem, starts=8, seed=3, notify=lambda *what: told.append(what))
    assessment = assess(best, draws=5, notify=lambda *what: told.append(what))
    assert best.named["rate"] == pytest.approx(40, abs=0.5)
    assert best.reached == 1
    assert assessment.remarks()[0].startswith("warning: 1 of 8 starts reached the best cost")
    counts = {"starts": 8, "profiles": 2, "resampling": 5}
    assert told == [(what, k + 1, count) for what, count in counts.items() for k in range(count)]


def test_the_command_says_what_it_does_before_it_begins_and_fits_a_lag(tmp_path):
    path = write_waveforms(record(lag=0.006), tmp_path / "late.csv")
    app = typer.Typer()
    app.command()(windkessel)
    done = CliRunner().invoke(
        app, [str(path), "--starts", "2", "--lag", "fit", "--out", str(tmp_path / "out")]
    )
    assert done.output.startswith("windkessel fit, downstream: late.csv\n")
    written = json.loads((tmp_path / "out" / "fit.json").read_text())
    assert written["parameters"]["lag"]["value"] == pytest.approx(6.0, abs=1.5)
    shown = CliRunner().invoke(app, ["--help"]).output
    assert "t_s,p_ao_mmHg,q_ao_ml_s" in shown
