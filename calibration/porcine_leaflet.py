"""Porcine leaflet: from biaxial tests along the circumferential and radial axes to the constants of its material.

What it shows: the specimen is mounted as Billiar and Sacks did (Figure S1a), fibres along axis 1, and the
modified HGO material is fitted to first Piola-Kirchhoff stress over stretch. The record is of our own making, so
that the constants can be compared with the truth. Run it with ``python calibration/porcine_leaflet.py`` (10 s);
``--remake`` makes the record again.
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
RESULTS = Path(__file__).parent / "results" / "porcine_leaflet"
TRUTH = {"c10": 1.21, "c01": 7.99, "kappa": 0.0, "angle": 0.0, "k1": 24.26, "k2": 57.62}
LARGEST, NOISE, SEED = 200.0, 0.02, 1996
HEADER = [
    "origin: made by calibration/porcine_leaflet.py, a model; not a measurement",
    f"material: modified HGO, {TRUTH} (kPa, degrees); constants remembered as published for porcine leaflets, "
    "unverified",
    f"loads in the ratios {leaflet_model.RATIOS} up to S = {LARGEST} kPa, fibres along axis 1",
    f"normal noise of {NOISE:.0%} of the largest stress, seed {SEED}",
]


def make_record(path: Path) -> Path:
    """Make the record."""
    rng, rows = np.random.default_rng(SEED), []
    tests = leaflet_model.make_tests(HGO(angle=0.0), list(TRUTH.values()), LARGEST)
    stretches = [np.sqrt(1 + 2 * strains[:, :2]) for _, strains, _ in tests]
    stresses = [stretch * loads for stretch, (_, _, loads) in zip(stretches, tests, strict=True)]  # P = F S
    size = NOISE * max(stress.max() for stress in stresses)
    for (number, _, _), stretch, stress in zip(tests, stretches, stresses, strict=True):
        measured = stress + size * rng.standard_normal(stress.shape)
        rows += [[number, *a, *b] for a, b in zip(stretch, measured, strict=True)]
    columns = ["protocol", "stretch1", "stretch2", "PK1_1_kPa", "PK1_2_kPa"]
    return leaflet_model.write_record(path, HEADER, columns, rows)


def study(out: Path, record: Path = RECORD) -> dict[str, object]:
    """Fit, compare with the truth, and write everything to ``out``."""
    found = fit_biaxial(record, "hgo", fibre_angle=0.0, compare=["lee-sacks", "fung"])
    found.write(out)
    result = leaflet_model.against_truth(found, TRUTH)
    (out / "result.json").write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    print(found.summary())
    return result


if __name__ == "__main__":
    if "--remake" in sys.argv or not RECORD.exists():
        make_record(RECORD)
    study(RESULTS)
