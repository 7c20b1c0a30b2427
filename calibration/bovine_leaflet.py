"""Bovine pericardial leaflet: from biaxial tests at 45 degrees to its fibres to the constants of its material.

What it shows: the specimen is mounted as Kim did (Figure S1c), its fibres at 45 degrees to the load axes, and the
modified HGO material and the fibre angle are fitted to first Piola-Kirchhoff stress over the whole deformation in
the plane, shear included. The record is of our own making, so that the constants can be compared with the truth.
Run it with ``python calibration/bovine_leaflet.py`` (15 s); ``--remake`` makes the record again.

The deformation is controlled, not the load: with kappa > 0 the stress of this material jumps where its fibres go
slack, and equal loads without shear stress would hold it exactly there.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import leaflet_model

from valvefsi.fitting.biaxial import fit_biaxial
from valvefsi.fitting.planar_hgo import HGO

RECORD = Path(__file__).with_suffix(".csv")
RESULTS = Path(__file__).parent / "results" / "bovine_leaflet"
TRUTH = {"c10": 0.119, "c01": 22.59, "kappa": 0.292, "angle": 45.0, "k1": 2380.0, "k2": 149.8}
LARGEST, NOISE, SEED = 400.0, 0.02, 2007
PATHS = ((1.0, 1.0, 0.0), (1.0, 0.6, 0.0), (0.6, 1.0, 0.0), (1.0, 0.8, 0.15), (0.8, 1.0, -0.15))
"""Direction of F11, F22 and of the shear in each protocol."""
HEADER = [
    "origin: made by calibration/bovine_leaflet.py, a model; not a measurement",
    f"material: modified HGO, {TRUTH} (kPa, degrees); constants remembered as published for bovine pericardium, "
    "unverified",
    f"stretched, and sheared a little, up to P = {LARGEST} kPa; fibres at 45 degrees to the load axes",
    f"normal noise of {NOISE:.0%} of the largest stress, seed {SEED}",
]


def make_record(path: Path) -> Path:
    """Make the record."""
    rng, rows = np.random.default_rng(SEED), []
    paths = [np.array([[one, shear], [shear, two]]) for one, two, shear in PATHS]
    for number, F, stress in leaflet_model.stretch_tests(HGO(), list(TRUTH.values()), paths, LARGEST):
        measured = stress + NOISE * LARGEST * rng.standard_normal(stress.shape)
        rows += [[number, *a.ravel(), *b] for a, b in zip(F, measured, strict=True)]
    columns = ["protocol", "F11", "F12", "F21", "F22", "P11_kPa", "P22_kPa", "P12_kPa"]
    return leaflet_model.write_record(path, HEADER, columns, rows)


def study(out: Path, record: Path = RECORD) -> dict[str, object]:
    """Fit, compare with the truth, and write everything to ``out``."""
    found = fit_biaxial(record, "hgo")
    found.write(out)
    result = leaflet_model.against_truth(found, TRUTH)
    (out / "result.json").write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    print(found.summary())
    return result


if __name__ == "__main__":
    if "--remake" in sys.argv or not RECORD.exists():
        make_record(RECORD)
    study(RESULTS)
