"""Flutter of a free edge from histories in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from valvefsi.post.flutter import flutter

T = np.linspace(0.040, 0.180, 141)
"""A hundred and forty milliseconds of an open valve, a sample every millisecond [s]."""


def swing(frequency, amplitude=0.05, phase=0.4, t=T):
    """A sine on top of a leaflet that drifts back [cm]."""
    return (
        1.1 - 0.8 * (t - t[0]) - 6.0 * (t - t[0]) ** 2 + amplitude * np.sin(2 * np.pi * frequency * t + phase)
    )


@pytest.mark.parametrize("frequency", [20.0, 33.3, 47.0, 60.0, 150.0])
@pytest.mark.parametrize("phase", [0.0, 1.0, 2.5])
def test_frequency_and_amplitude_of_a_swing_come_back_whatever_the_drift(frequency, phase):
    found = flutter(T, swing(frequency, phase=phase))
    assert found.resolution == pytest.approx(1 / 0.14)
    assert found.nyquist == pytest.approx(500.0)
    assert found.frequency == pytest.approx(frequency, abs=0.15 * found.resolution)
    assert found.amplitude == pytest.approx(0.05, rel=0.06)
    assert found.share == pytest.approx(1.0, abs=0.12)


def test_a_long_window_has_the_swing_to_a_thousandth():
    t = np.linspace(0.0, 1.0, 1001)
    found = flutter(t, swing(37.25, t=t))
    assert found.frequency == pytest.approx(37.25, abs=0.04)
    assert found.amplitude == pytest.approx(0.05, rel=1e-3)


def test_the_stronger_of_two_swings_is_found_and_how_much_of_the_motion_it_is():
    t = np.linspace(0.0, 0.7, 701)
    found = flutter(t, swing(30.0, 0.03, t=t) + 0.04 * np.sin(2 * np.pi * 62.0 * t))
    assert found.frequency == pytest.approx(62.0, abs=0.1)
    assert found.share == pytest.approx(16 / 25, abs=0.02)


def test_times_that_are_not_even_are_made_even():
    rng = np.random.default_rng(4)
    t = np.sort(np.concatenate([[0.04, 0.18], rng.uniform(0.04, 0.18, 400)]))
    found = flutter(t, swing(40.0, t=t))
    assert found.frequency == pytest.approx(40.0, abs=1.0)
    assert found.amplitude == pytest.approx(0.05, rel=0.06)


def test_a_motion_slower_than_two_periods_in_the_window_is_no_flutter():
    found = flutter(T, swing(9.0))
    assert isinstance(found, str) or (found.frequency > 2 / 0.14 and found.share < 0.01)


def test_a_leaflet_that_only_drifts_does_not_flutter():
    assert "no peak of the spectrum above 14.3 Hz, two periods in the window" in flutter(T, swing(1.0, 0.0))
    assert flutter(T, np.ones_like(T)).startswith("no peak")


def test_too_few_samples_have_no_spectrum():
    assert flutter(T[:15], swing(40.0)[:15]) == "15 samples, 16 are needed"
