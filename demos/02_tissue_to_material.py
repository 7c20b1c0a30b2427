# %% [markdown]
# # From biaxial tissue tests to a material
#
# What it shows: `valvefsi fit biaxial` fits the modified HGO material to planar biaxial tests (S1-S3), says how well
# each constant is fixed by the data, and writes a table that a case includes.
# Reference: the record is made with constants that are known (calibration/porcine_leaflet.py). Run time: 10 s.

# %% Parameters
import json
import os
import subprocess
import sys
from pathlib import Path

from valvefsi.case import load_case

ROOT = Path(__file__).resolve().parents[1]
OUT = Path(os.environ.get("VALVEFSI_DEMO_OUT", "results/demo_tissue")).resolve()
RECORD = ROOT / "calibration" / "porcine_leaflet.csv"
TRUTH = {"c10": 1.21, "c01": 7.99, "k1": 24.26, "k2": 57.62}  # kPa, -, kPa, -

# %% [markdown]
# ## The record
#
# A CSV file: one line per sample, columns for protocol, stretches (or strains, or deformation gradient) and stresses
# (or membrane tensions), with the unit in the heading. Headings of your own are named with `--column stretch1=lx`.
# Lines that begin with `#` say where the data are from.

# %% Its first lines
OUT.mkdir(parents=True, exist_ok=True)
print("\n".join(RECORD.read_text().splitlines()[:9]))

# %% [markdown]
# ## The fit
#
# On the command line: `valvefsi fit biaxial calibration/porcine_leaflet.csv --model hgo --fibre-angle 0`. Here protocol
# 5 is held back with `--protocols` and predicted, and another material is fitted for comparison.

# %% Run it
options = ["--model", "hgo", "--fibre-angle", "0", "--protocols", "1,2,3,4", "--compare", "lee-sacks"]
command = [sys.executable, "-m", "valvefsi", "fit", "biaxial", str(RECORD), *options, "--out", str(OUT)]
subprocess.run(command, check=True)

# %% [markdown]
# ## What it says
#
# Each constant has a value, a 95 % interval from its profile likelihood and a verdict: *identified*, *weak*, *at bound*
# or *trades against* another one. `fit.png` shows data and model for each protocol, `profiles.png` the likelihoods. A
# constant that is not identified should not be read as a property of the tissue.

# %% The same in fit.json
fit = json.loads((OUT / "fit.json").read_text())
for name, truth in TRUTH.items():
    entry = fit["parameters"][name]
    low, high = entry["ci95"]
    print(
        f"{name}: {entry['value']:.4g} {entry['unit']}, 95 % {low:.4g} ... {high:.4g}, true {truth}, {entry['verdict']}"
    )

# %% [markdown]
# ## Into a case
#
# `material.toml` is included where a case names its material. Its angle is relative to the leaflet's own
# circumferential direction, which the meshes of valves have; a mesh of your own gets it as a fibre field
# (`[[solid.fibre]]`). For a flat sheet, `--axis1 x` writes an angle to the x axis.

# %% A case that uses it
case_file = OUT / "input.toml"
case_file.write_text(
    """
[grid]
lower = ["-2 cm", "-2 cm", "-1 cm"]
upper = ["2 cm", "2 cm", "3 cm"]
cells = [40, 40, 40]
[time]
dt = "10 us"
t_end = "1 ms"
[[solid]]
name = "leaflets"
mesh = { valve = { type = "porcine", diameter = "25 mm" } }
material = { include = "material.toml" }
"""
)
material = load_case(case_file).solid[0].material
print(material.model, material.parameters)

# %% What this demo claims
inside = [
    fit["parameters"][n]["ci95"][0] <= truth <= fit["parameters"][n]["ci95"][1] for n, truth in TRUTH.items()
]
assert sum(inside) >= 3, "a 95 % interval misses now and then; all but one must hold the truth"
assert fit["prediction"]["5"]["relative_l2"] < 0.08, (
    "the protocol held back is predicted as well as the noise lets it"
)
assert abs(material.parameters["c10"] - 1e4 * fit["parameters"]["c10"]["value"]) < 1e-6 * 1e4
