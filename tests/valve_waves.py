"""Closed-form waveforms of a valve in a pulse duplicator, and the numbers that they have."""

from __future__ import annotations

import itertools

import numpy as np
from scipy.integrate import quad

from valvefsi.post.valve_record import ValveRecord, ValveTest
from valvefsi.units import MMHG

PERIOD, OPEN, EJECTION, PEAK = 60 / 70, 0.10, 0.30, 400.0
"""Cycle [s], start and length of forward flow [s], peak flow [cm^3/s]; the flow is half a sine."""
CLOSING, BACKFLOW, LEAKAGE = 0.03, 60.0, 3.0
"""Length of closing [s], its peak [cm^3/s], also half a sine, and a constant leakage [cm^3/s]."""
QUADRATIC, INERTIAL = 12 * MMHG, 6 * MMHG
"""Pressure difference in forward flow, QUADRATIC sin^2 s + INERTIAL cos s with s = pi (t - OPEN)/EJECTION."""
LARGEST_AREA = 3.5
SALINE = ValveTest(rho=1.0, mu=0.01, diameter=2.5)


def step(x):
    """From 0 to 1, with level ends."""
    x = np.clip(x, 0, 1)
    return x**2 * (3 - 2 * x)


def waves(t, leakage=LEAKAGE, backflow=BACKFLOW):
    """Closed-form waveforms of a periodic cycle."""
    t = np.mod(t + 1e-12, PERIOD) - 1e-12
    end, since = OPEN + EJECTION, t - OPEN
    s = np.pi * since / EJECTION
    forward = (since >= 0) & (since <= EJECTION)
    closing = np.where((t > end) & (t < end + CLOSING), np.sin(np.pi * (t - end) / CLOSING), 0.0)
    q = np.where(forward, PEAK * np.sin(s), -leakage - backflow * closing)
    omega = 2 * np.pi / PERIOD
    p_ao = MMHG * (100 + 16 * np.sin(omega * (t - 0.14)) + 4 * np.sin(2 * omega * (t - 0.12)))
    dp = QUADRATIC * np.sin(s) ** 2 + INERTIAL * np.cos(s)
    rising = 8 * MMHG + (p_ao + INERTIAL - 8 * MMHG) * step(t / OPEN)
    falling = 8 * MMHG + (p_ao - INERTIAL - 8 * MMHG) * step(1 - (t - end) / 0.09)
    p_lv = np.where(since < 0, rising, np.where(forward, p_ao + dp, falling))
    pdva = LARGEST_AREA * np.interp(t, [OPEN, OPEN + 0.04, end - 0.05, end + CLOSING], [0, 1, 1, 0])
    return {"p_lv": p_lv, "p_ao": p_ao, "q": q, "pdva": pdva}


def record(cycles=1.0, samples=4000, **change):
    t = np.arange(round(cycles * samples) + 1) * PERIOD / samples
    return ValveRecord(t=t, period=PERIOD, **(waves(t) | change))


def power(t):
    """What the flow loses over the valve [erg/s]."""
    now = waves(t)
    return (now["p_lv"] - now["p_ao"]) * now["q"]


def lost(first, last):
    """Energy that is lost from one time to another, by Gauss' quadrature of the closed forms [erg]."""
    kinks = [
        k
        for k in (OPEN, OPEN + EJECTION, OPEN + EJECTION + CLOSING, OPEN + EJECTION + 0.09)
        if first < k < last
    ]
    ends = [first, *kinks, last]
    return sum(quad(power, a + 1e-9, b - 1e-9)[0] for a, b in itertools.pairwise(ends))


def closed_forms():
    """The numbers of the waveforms above."""
    ratio = INERTIAL / (2 * QUADRATIC)
    s = np.arccos(ratio - np.hypot(ratio, 1))
    squares = s / 2 - np.sin(2 * s) / 4
    rms, mean = PEAK * np.sqrt(squares / s), (QUADRATIC * squares + INERTIAL * np.sin(s)) / s
    forward, closing = 2 * PEAK * EJECTION / np.pi, 2 * BACKFLOW * CLOSING / np.pi
    leakage = LEAKAGE * (PERIOD - EJECTION)
    # Closing ends where its half sine falls below the floor, 2 % of the peak flow.
    shut = OPEN + EJECTION + CLOSING * (1 - np.arcsin(0.02 * PEAK / BACKFLOW) / np.pi)
    return {
        "forward_volume": forward,
        "net_volume": forward - closing - leakage,
        "cardiac_output": (forward - closing - leakage) / PERIOD,
        "peak_flow": PEAK,
        "rms_forward_flow": PEAK / np.sqrt(2),
        "rms_flow": rms,
        "forward_start": OPEN,
        "forward_end": OPEN + EJECTION,
        "forward_duration": EJECTION,
        "pressure_start": OPEN,
        "pressure_end": OPEN + EJECTION * s / np.pi,
        "mean_pressure_difference": mean,
        "peak_pressure_difference": QUADRATIC + INERTIAL**2 / (4 * QUADRATIC),
        "effective_orifice_area": rms / (51.6 * np.sqrt(mean / MMHG / SALINE.rho)),
        "regurgitant_volume": closing + leakage,
        "regurgitant_fraction": (closing + leakage) / forward,
        "closing_volume": closing + LEAKAGE * CLOSING,
        "leakage_volume": leakage - LEAKAGE * CLOSING,
        "leakage_flow": LEAKAGE,
        "forward_energy_loss": 4 / 3 * QUADRATIC * PEAK * EJECTION / np.pi,
        "closing_energy_loss": lost(OPEN + EJECTION, shut),
        "leakage_energy_loss": lost(0.0, OPEN) + lost(shut, PERIOD),
        "energy_loss": lost(0.0, PERIOD),
        "opening_start": OPEN + 0.004,
        "opening_half": OPEN + 0.02,
        "opening_end": OPEN + 0.036,
        "closing_start": OPEN + EJECTION - 0.042,
        "closing_half": OPEN + EJECTION - 0.01,
        "closing_end": OPEN + EJECTION + CLOSING - 0.008,
        "opening_duration": 0.032,
        "open_duration": EJECTION - 0.078,
        "closing_duration": 0.064,
        "open_time": EJECTION + CLOSING - 0.012,
        "peak_pdva": LARGEST_AREA,
        "mean_pdva": LARGEST_AREA * (EJECTION - 0.09 + 0.04 / 2 + 0.05 * (1 + 3 / 8) / 2) / EJECTION,
        "peak_reynolds": 4 * PEAK / (np.pi * 2.5 * 0.01),
        "mean_aortic_pressure": 100 * MMHG,
    }
