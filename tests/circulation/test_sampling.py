"""Records of many different intervals: exponentials interpolated between sizes are those of each interval."""

from __future__ import annotations

import numpy as np
import pytest

from valvefsi.circulation.linear import STEP
from valvefsi.circulation.sampling import Sampling
from valvefsi.circulation.windkessel import Downstream, FourElement

MILD = Downstream(R_c=0.0883, R_p=1.085, C=1.279)
STIFF = FourElement(R_c=0.09, R_p=1.05, C=1.2, L=1e-5)
"""Rates of 1 and of 9,000 a second."""


def times(n, gap=0.0):
    rng = np.random.default_rng(5)
    step = rng.uniform(0.5e-3, 1.5e-3, n - 1)
    step[n // 2] += gap
    return np.concatenate([[0.0], np.cumsum(step)])


@pytest.mark.parametrize("gap", [0.0, 0.4])
@pytest.mark.parametrize("circuit", [MILD, STIFF])
def test_a_record_of_uneven_times_is_stepped_as_one_by_one(circuit, gap):
    t = times(600, gap)
    system, u = circuit.system(), 200 * np.sin(7 * t)[:, None] ** 2
    x = np.linspace(80.0, 95.0, len(system.states))
    together = system.simulate(t, u, x)
    state = system.start(x, u[0], t[0])
    for n in range(1, len(t)):
        state = system.advance(state, u[n], t[n] - t[n - 1])  # an exponential of its own
        assert np.abs(state.x - together[n]).max() < 2e-12 * np.abs(together).max()


@pytest.mark.parametrize("circuit", [MILD, STIFF])
def test_derivatives_of_uneven_records_are_those_by_a_complex_step_through_every_interval(circuit):
    t = times(300)
    system, u = circuit.system(), 200 * np.sin(7 * t)[:, None] ** 2
    x = np.linspace(80.0, 95.0, len(system.states))
    moved = type(circuit)(**{**vars(circuit), "C": circuit.C + STEP * 1j}).system()
    z, slopes = x.astype(complex), [0.0]
    for n in range(1, len(t)):
        E, G0, G1 = (part[0] for part in moved.propagators(t[n] - t[n - 1]))
        z = E @ z + G0 @ u[n - 1] + G1 @ u[n]
        slopes.append((moved.C @ z + moved.D @ u[n]).imag / STEP)
    start = np.zeros((len(x), 1))
    found = system.sensitivities(t, u, system.simulate(t, u, x), [moved], start)[:, 0]
    assert np.abs(found - slopes).max() < 1e-11 * np.abs(slopes).max()


def test_a_thousand_different_intervals_need_few_exponentials_and_equal_ones_a_single_one():
    assert len(Sampling.of(times(1001)).steps(10.0).dt) < 12
    assert len(Sampling.of(np.linspace(0, 1, 1001)).steps(10.0).dt) <= 3
    assert len(Sampling.of(0.25 * np.arange(100)).steps(10.0).dt) == 1
