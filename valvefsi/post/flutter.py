"""Flutter of a leaflet's free edge: frequency and amplitude of its swing about a slow motion.

The position over time, evenly spaced, loses its best parabola and is weighted by a Hann window over its length T. The
highest local maximum of its amplitude spectrum between 2/T and the Nyquist frequency is the flutter. Two frequencies
closer than 2/T are not told apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from valvefsi.types import Array

FEWEST = 16
"""Samples below which there is no spectrum."""
TREND = 2
"""Degree of the polynomial that is taken out."""
FINER = 16
"""How many times finer than 1/T the spectrum is evaluated."""
LOWEST = 2.0
"""Periods that the window holds at the lowest frequency."""


@dataclass(frozen=True, kw_only=True)
class Flutter:
    """What swings in a window.

    Attributes:
        frequency: Frequency of the strongest swing [Hz].
        amplitude: Its amplitude, half of its way [cm].
        deviation: Standard deviation of all that is left without the trend [cm].
        resolution: Resolution of the spectrum, 1/T [Hz].
        nyquist: Highest frequency that the samples show [Hz].
    """

    frequency: float
    amplitude: float
    deviation: float
    resolution: float
    nyquist: float

    @property
    def share(self) -> float:
        """Part of the variance that a sine of the frequency and the amplitude has."""
        return 0.5 * (self.amplitude / self.deviation) ** 2 if self.deviation > 0.0 else 0.0


def flutter(t: Array, x: Array) -> Flutter | str:
    """Return the flutter of a position, or why there is none.

    Args:
        t: Times, ascending, ``(n,)`` [s].
        x: Position, ``(n,)`` [cm].
    """
    if len(t) < FEWEST:
        return f"{len(t)} samples, {FEWEST} are needed"
    even = np.linspace(t[0], t[-1], len(t))
    y = np.interp(even, t, x)
    s = np.linspace(-1.0, 1.0, len(t))
    y = y - np.polynomial.Polynomial.fit(s, y, TREND)(s)
    length, step = float(t[-1] - t[0]), float(even[1] - even[0])
    window = np.hanning(len(y) + 2)[1:-1]
    spectrum = 2.0 / window.sum() * np.abs(np.fft.rfft(window * y, FINER * len(y)))
    frequency = np.fft.rfftfreq(FINER * len(y), step)
    peaks = 1 + np.flatnonzero((spectrum[1:-1] > spectrum[:-2]) & (spectrum[1:-1] >= spectrum[2:]))
    peaks = peaks[frequency[peaks] >= LOWEST / length]
    deviation = float(y.std())
    if not len(peaks) or not deviation > 1e-12 * np.abs(x).max(initial=0.0):
        return f"no peak of the spectrum above {LOWEST / length:.3g} Hz, two periods in the window"
    best = peaks[np.argmax(spectrum[peaks])]
    return Flutter(
        frequency=float(frequency[best]),
        amplitude=float(spectrum[best]),
        deviation=deviation,
        resolution=1.0 / length,
        nyquist=0.5 / step,
    )
