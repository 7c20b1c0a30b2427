"""Where a run begins in a measured beat, and the beat from there on as a record that fits take."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from valvefsi.errors import CaseError
from valvefsi.fitting.waveforms import Waveforms
from valvefsi.post.valve_beat import QUANTITIES, Beat
from valvefsi.types import Array

NEEDED = QUANTITIES[:3]
"""Waveforms that a loop is fitted to: pressures before and after the valve, and its flow."""


def start_sample(beat: Beat, file: Path, start: float | None = None) -> int:
    """Return the number of the sample at which a run begins.

    Args:
        beat: The measured beat.
        file: Its file, for messages.
        start: Time in the beat, of which the next sample is taken [s]; unless given, the valve is about to open: P_LV
            rises over P_Ao for the last time before the flow has half of its peak.

    Raises:
        CaseError: A waveform is missing, the time is not in the beat, or P_LV never rises over P_Ao there.
    """
    if missing := [name for name in NEEDED if name not in beat.values]:
        message = f"a loop needs p_lv, p_ao and q_ao; missing {', '.join(missing)}"
        raise CaseError(message, file=file)
    if start is not None:
        if start >= beat.period:
            raise CaseError(
                f"expected less than the period, {beat.period:.6g} s", key="record.start", value=start
            )
        return int(np.searchsorted(beat.t, start - 1e-9 * beat.period)) % len(beat.t)
    above = beat.values["p_lv"] >= beat.values["p_ao"]
    q = beat.values["q_ao"]
    back = (int(np.argmax(q)) - np.arange(len(q))) % len(q)  # from the peak of the flow back in time
    half = int(np.argmax(q[back] < 0.5 * q.max()))
    rising = np.flatnonzero(above[back[half:]] & ~above[back[half:] - 1])
    if not len(rising):
        raise CaseError("P_LV nowhere rises over P_Ao: give a time", file=file, key="record.start")
    return int(back[half + rising[0]])


def from_sample(beat: Beat, first: int, file: Path, offset: float = 0.0) -> Waveforms:
    """Return the beat from one of its samples on, times from 0 s, its flow less an offset as q_ao and q_lv."""
    order = (first + np.arange(len(beat.t))) % len(beat.t)
    t = (beat.t[order] - beat.t[first]) % beat.period
    values = {name: beat.values[name][order] for name in NEEDED}
    values["q_ao"] = values["q_ao"] - offset
    units = {"p_lv": "mmHg", "p_ao": "mmHg", "q_ao": "ml_s", "q_lv": "ml_s"}
    return Waveforms(t=t, values={**values, "q_lv": values["q_ao"]}, units=units, file=file)


def repeated(waves: Waveforms, period: float, cycles: int) -> Waveforms:
    """Return a beat several times, closed by its first sample."""
    n = len(waves.t)
    samples = np.append(np.tile(np.arange(n), cycles), 0)
    t: Array = np.append((waves.t + period * np.arange(cycles)[:, None]).ravel(), cycles * period)
    picked = waves.picked(samples)
    return Waveforms(**{**vars(picked), "t": t})
