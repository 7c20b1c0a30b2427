"""Mean, amplitude and frequency of what swings, read off a record over time."""

from __future__ import annotations

import numpy as np

from valvefsi.types import Array

HARMONICS = 10
"""Multiples of the flag's frequency that the reduction keeps: forces carry noise of points that cross cells."""


def whole_periods(t: Array, x: Array, *, most: int = 5) -> tuple[float, float, int] | None:
    """Return begin, end and number of the last whole periods in the later half of a record, None without one.

    A period begins where the signal passes the middle upwards after it was well below.

    Args:
        t: Times, ``(n,)`` [s].
        x: Values, ``(n,)``.
        most: Largest number of periods.
    """
    late = t >= 0.5 * (t[0] + t[-1])
    t, x = t[late], x[late]
    low, high = float(x.min()), float(x.max())
    away, armed, starts = x - 0.5 * (low + high), False, []
    for k in range(1, len(x)):
        armed = armed or away[k - 1] < -0.2 * (high - low)
        if armed and away[k - 1] < 0.0 <= away[k]:
            starts.append(t[k] - away[k] * (t[k] - t[k - 1]) / (away[k] - away[k - 1]))
            armed = False
    starts = starts[-most - 1 :]
    return (float(starts[0]), float(starts[-1]), len(starts) - 1) if len(starts) > 1 else None


def oscillation(t: Array, x: Array, periods: tuple[float, float, int] | None) -> tuple[float, float, float]:
    """Read mean, amplitude and frequency off a signal.

    Mean and amplitude are half the sum and half the difference of the largest and the smallest value of a period,
    averaged over the periods, after what is faster than `HARMONICS` times the flag is taken out; the frequency is that
    of the strongest Fourier mode.

    Args:
        t: Times, ``(n,)`` [s].
        x: Values, ``(n,)``.
        periods: Begin, end and number of whole periods of the flag; None takes the later half and no frequency.
    """
    if periods is None:
        x = x[t >= 0.5 * (t[0] + t[-1])]
        return 0.5 * float(x.max() + x.min()), 0.5 * float(x.max() - x.min()), float("nan")
    begin, end, count = periods
    n = 256 * count
    modes = np.fft.rfft(np.interp(begin + (end - begin) * np.arange(n) / n, t, x))
    modes[HARMONICS * count + 1 :] = 0.0
    parts = np.fft.irfft(modes, n).reshape(count, -1)
    top, bottom = float(parts.max(axis=1).mean()), float(parts.min(axis=1).mean())
    strongest = 1 + int(np.argmax(np.abs(modes[1:])))
    return 0.5 * (top + bottom), 0.5 * (top - bottom), strongest / (end - begin)
