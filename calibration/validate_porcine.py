"""The whole chain: from a beat and biaxial tests of our own making to how near a valve comes to them.

What it shows: leaflet, downstream circuit and pump are fitted and put into a case, as ``valvefsi validate`` does; the
loop runs with an orifice for the valve, and with ``--valve`` with the valve itself, until two beats are alike. The
record was made with such an orifice, so that what is found can be compared with the truth.
Run it with ``python calibration/validate_porcine.py`` (20 s; with ``--valve`` some hours).
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from loop_model import INERTANCE
from porcine_loop import DOWNSTREAM
from valve_beat import VALVE

from valvefsi.case.study_tables import load_study
from valvefsi.studies.validation import How, validation_stages

STUDY = Path(__file__).with_suffix(".toml")


def study(out: Path, *, valve: bool = False) -> dict[str, tuple[float, float]]:
    """Make all stages, and return what was found beside the truth (mmHg, ml, s)."""
    stages = validation_stages(load_study(STUDY, [] if valve else ["grids=[]"]), out, How(say=print))
    stages.make()
    orifice, fitted = stages.record("orifice")["result"], stages.record("downstream")["result"]
    found = {name: (fitted["parameters_mmHg_ml_s"][name], value) for name, value in DOWNSTREAM.items()}
    found["EOA"] = orifice["effective_orifice_area_cm2"], VALVE["open"]
    return found | {"inertance": (orifice["inertance_mmHg_s2_per_ml"], INERTANCE)}


if __name__ == "__main__":
    out = Path("results") / STUDY.stem
    for name, (value, truth) in study(out, valve="--valve" in sys.argv).items():
        print(f"{name} {value:.4g}, truth {truth:.4g}")
    print((out / "compare" / "norms.md").read_text(encoding="utf-8"))
