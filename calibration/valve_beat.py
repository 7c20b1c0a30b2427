"""A measured beat of our own making: the mean of ten beats of a valve in a pulse duplicator, and their spread.

What it shows: the columns that ``valvefsi compare`` reads. The loop is that of `porcine_loop.py` with an orifice whose
area follows flow and pressure in place of the valve; each of ten beats has its own size, its own place in time and its
own noise. Run it with ``python calibration/valve_beat.py`` (5 s); it makes the record again.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import loop_model
from porcine_loop import DOWNSTREAM, UPSTREAM, pump

from valvefsi.circulation.pump import UpstreamPorcine
from valvefsi.circulation.windkessel import Downstream

RECORD = Path(__file__).with_suffix(".csv")
VALVE = {"open": 3.0, "leak": 0.01, "opening": 0.008, "closing": 0.012}
NOISE = {"p_lv": 0.5, "p_ao": 0.3, "q_ao": 3.0, "pdva": 0.02}
GAIN, JITTER = 0.004, 0.001
"""Standard deviations of the size of a beat, and of its place in time [s]."""
OFFSET, SAMPLES, BEATS, SEED = -3.0, 256, 10, 2022
"""Offset of the flow probe [ml/s], samples of a beat, beats, seed."""
BEGIN = 0.9
"""Part of the pump's cycle at which the record begins, in the closed phase."""
HEADER = [
    "origin: made by calibration/valve_beat.py, a model without space; not a measurement",
    f"loop of calibration/porcine_loop.py with an orifice: {VALVE} in cm^2 and s",
    f"{BEATS} beats, their mean and sample standard deviation: size {GAIN:.1%}, time {1e3 * JITTER:g} ms, normal noise",
    f"{NOISE} in mmHg, ml/s, cm^2, seed {SEED}; offset of the flow probe {OFFSET:g} ml/s",
    f"period: {loop_model.PERIOD:.9f} s, from {BEGIN:g} of the pump's",
]


def beats() -> dict[str, np.ndarray]:
    """Return ten beats of each quantity, ``(10, 256)`` [mmHg, ml/s, cm^2]."""
    circuits = UpstreamPorcine(**UPSTREAM), Downstream(**DOWNSTREAM)
    found = loop_model.run_loop(*circuits, pump, 2, valve=loop_model.Orifice(**VALVE))
    clean = {name: found["q" if name == "q_ao" else name] for name in NOISE}
    t = loop_model.PERIOD * (np.arange(SAMPLES) / SAMPLES + BEGIN)
    rng, made = np.random.default_rng(SEED), {name: [] for name in NOISE}
    for _ in range(BEATS):
        gain, late = 1.0 + GAIN * rng.standard_normal(), JITTER * rng.standard_normal()
        for name, deviation in NOISE.items():
            y = np.interp(t - late, found["t"], clean[name])
            noise = deviation * rng.standard_normal(SAMPLES) + (OFFSET if name == "q_ao" else 0.0)
            made[name].append(np.maximum(gain * y + noise, 0.0) if name == "pdva" else gain * y + noise)
    return {name: np.array(rows) for name, rows in made.items()}


def make_record(path: Path) -> Path:
    """Write mean and standard deviation of the beats."""
    made = beats()
    columns = {"t_s": loop_model.PERIOD * np.arange(SAMPLES) / SAMPLES}
    units = {"p_lv": "mmHg", "p_ao": "mmHg", "q_ao": "ml_s", "pdva": "cm2"}
    columns |= {f"{name}_{units[name]}": rows.mean(axis=0) for name, rows in made.items()}
    columns |= {f"sd_{name}": rows.std(axis=0, ddof=1) for name, rows in made.items()}
    lines = [*(f"# {line}" for line in HEADER), ",".join(columns)]
    digits = [6 if name == "t_s" else 4 for name in columns]
    for row in zip(*columns.values(), strict=True):
        lines.append(",".join(f"{value:.{n}f}" for value, n in zip(row, digits, strict=True)))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


if __name__ == "__main__":
    print(make_record(RECORD))
