"""A beat whose circuits and orifice are known: flow in closed form, pressures by Fourier series."""

from __future__ import annotations

import numpy as np

from valvefsi.units import MMHG

PERIOD, OPEN, EJECTION, PEAK, SAMPLES = 0.8, 0.15, 0.3, 400.0, 800
"""Cycle [s], start and length of forward flow [s], peak flow [ml/s], samples."""
R_C, R_P, C = 0.04, 1.2, 1.5
"""Windkessel [mmHg s/ml, ml/mmHg]."""
AREA, INERTANCE = 2.2, 0.0015
"""Effective orifice area [cm^2] and inertance [mmHg s^2/ml], rho = 1 g/cm^3."""
LOSS = 1.0 / (2 * AREA**2) / MMHG


def beat(leak=0.0):
    """Times [s], P_LV, P_Ao [mmHg], Q [ml/s] of one cycle; the flow less a leak, which only a probe sees."""
    t = PERIOD * np.arange(SAMPLES) / SAMPLES
    s = np.clip((t - OPEN) / EJECTION, 0.0, 1.0)
    q = PEAK * np.sin(np.pi * s) ** 2
    omega = 2j * np.pi * np.fft.rfftfreq(SAMPLES, PERIOD / SAMPLES)
    p_ao = np.fft.irfft((R_C + R_P / (1 + omega * R_P * C)) * np.fft.rfft(q), SAMPLES)
    slope = np.where((s > 0) & (s < 1), PEAK * np.pi / EJECTION * np.sin(2 * np.pi * s), 0.0)
    shut = (t - OPEN - EJECTION) % PERIOD / (PERIOD - EJECTION)
    lower = np.where((s > 0) & (s < 1), 0.0, 90.0 * np.sin(np.pi * shut) ** 2)
    return t, p_ao + INERTANCE * slope + LOSS * q**2 - lower, p_ao, q - leak


def write(path, leak=0.0, columns=("p_lv", "p_ao", "q_ao")):
    """Write the beat as a record."""
    t, p_lv, p_ao, q = beat(leak)
    known = {"p_lv": ("p_lv_mmHg", p_lv), "p_ao": ("p_ao_mmHg", p_ao), "q_ao": ("q_ao_ml_s", q)}
    head = ",".join(["t_s", *(known[name][0] for name in columns)])
    table = np.stack([t, *(known[name][1] for name in columns)], axis=1)
    np.savetxt(path, table, delimiter=",", header=f"# period: {PERIOD} s\n{head}", comments="", fmt="%.8g")
    return path
