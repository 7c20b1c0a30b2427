"""Flow loop of the porcine valve: from a record to the downstream circuit and the pump's pressure.

What it shows: the three-element Windkessel (S9-S10) is fitted to q_ao and p_ao, and the pressure of the pump is
derived from q_lv and p_lv (S4-S5). The record is of our own making, so that both can be compared with the truth.
Run it with ``python calibration/porcine_loop.py`` (10 s); ``--remake`` makes the record again.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import loop_model

from valvefsi.circulation.pump import UpstreamPorcine
from valvefsi.circulation.windkessel import Downstream
from valvefsi.fitting.waveforms import read_waveforms
from valvefsi.fitting.windkessel import Settings, fit_windkessel
from valvefsi.fitting.windkessel_pump import derive_pump
from valvefsi.units import MMHG

RECORD = Path(__file__).with_suffix(".csv")
RESULTS = Path(__file__).parent / "results" / "porcine_loop"
DOWNSTREAM = {"R_c": 0.0576, "R_p": 1.14, "C": 2.43}
UPSTREAM = {"R_1": 0.10, "R_2": 0.04, "C_VIA": 0.30}
NOISE = {"q_ao": 1.0, "p_ao": 0.5, "q_lv": 1.0, "p_lv": 0.5}
SEED, CYCLES, SMOOTH = 2021, 3, 0.04
HEADER = [
    "origin: made by calibration/porcine_loop.py, a model without space; not a measurement",
    f"downstream: S9-S10, {DOWNSTREAM} in mmHg, ml, s; R_c and C as published by Kaiser, R_p set for 100 mmHg",
    f"upstream: S4-S5, {UPSTREAM}, our choice; pump: 8 + 205 sin(pi s / 0.4)^1.2 mmHg for s < 0.4 of a cycle",
    f"70 beats a minute; normal noise {NOISE} (mmHg, ml/s), seed {SEED}; flows positive downstream",
]


def pump(t: float) -> list[float]:
    """Return the pressure of the pump [mmHg]."""
    s = (t / loop_model.PERIOD) % 1.0
    return [8.0 + 205.0 * max(np.sin(np.pi * s / 0.4), 0.0) ** 1.2 * (s < 0.4)]


def make_record(path: Path) -> Path:
    """Make the record."""
    found = loop_model.run_loop(UpstreamPorcine(**UPSTREAM), Downstream(**DOWNSTREAM), pump, CYCLES)
    return loop_model.write_record(path, loop_model.noisy(found, NOISE, SEED), HEADER)


def study(out: Path, record: Path = RECORD) -> dict[str, object]:
    """Fit, derive, compare with the truth, and write everything to ``out``."""
    waves = read_waveforms(record)
    report = fit_windkessel(waves, "downstream", Settings(draws=40))
    report.write(out / "downstream")
    derived = derive_pump(waves, UPSTREAM, cutoff=SMOOTH)
    derived.write(out / "upstream")
    plain = derive_pump(waves, UPSTREAM)
    truth = np.array([pump(t)[0] for t in waves.t])
    errors = {
        name: float(np.sqrt(np.mean((found.pump.p_pump / MMHG - truth) ** 2)))
        for name, found in (("smoothed", derived), ("as measured", plain))
    }
    result = {
        "downstream": loop_model.against_truth(report, DOWNSTREAM),
        "pump_pressure_rms_error_mmHg": errors,
        "pump_roundtrip_mmHg": {"smoothed": derived.roundtrip, "as measured": plain.roundtrip},
    }
    (out / "result.json").write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    print(report.summary(), derived.summary(), json.dumps(result, indent=2), sep="\n\n")
    return result


if __name__ == "__main__":
    if "--remake" in sys.argv or not RECORD.exists():
        make_record(RECORD)
    study(RESULTS)
