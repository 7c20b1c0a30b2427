# %% [markdown]
# # How sure is a pressure difference?
#
# What it shows: `valvefsi sample` carries the uncertainty of a flow loop's circuit through the loop with an orifice for
# the valve, and says which input the spread of each number comes from. The valve itself is left out: seconds, not days.
# Reference: a straight line through the samples, by itself. Run time: 10 s.

# %% Parameters
import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
OUT = Path(os.environ.get("VALVEFSI_DEMO_OUT", "results/demo_sample")).resolve()
STUDY = ROOT / "calibration" / "sample_loop.toml"
RUNS = 96

# %% [markdown]
# ## The study
#
# `calibration/sample_loop.toml` names a case, whose two circuits are taken, an orifice, and what is uncertain: the
# outlet's constants as `valvefsi fit windkessel` found them in `calibration/porcine_loop.csv`, with their intervals and
# correlation; 5 % of the upstream circuit's, 2 % of the area, and an inertance of which only the range is known.
#
# Its design is Saltelli's (some thousand samples, SALib). A polynomial chaos of few samples is what runs in three
# dimensions need; here it is tried on the circuit: on the command line
# `valvefsi sample calibration/sample_loop.toml --set design.method=latin-hypercube`.

# %% Run it
changes = ["design.method=latin-hypercube", f"design.size={RUNS}", "design.degree=2"]
command = [sys.executable, "-m", "valvefsi", "sample", str(STUDY), "--out", str(OUT), "--overwrite"]
subprocess.run([*command, *(word for text in changes for word in ("--set", text))], check=True)
found = {row["output"]: row for row in json.loads((OUT / "sample.json").read_text())["outputs"]}

# %% [markdown]
# ## What it says
#
# `sample.png` has a row for each number: bars of the part of its variance that goes with each input (alone, and with
# everything it does together with others), and the samples over the input that counts most. The surrogate's error at
# left-out samples is said with every number; above a tenth of the variance its indices are not to be trusted.

# %% The numbers
for name, row in found.items():
    print(f"{name}: {row['mean']:.4g}, 95 % {row['low']:.4g} to {row['high']:.4g}; {row['text']}")
    for one in sorted(row["indices"], key=lambda one: -one["total"])[:3]:
        low, high = one["total_interval"]
        print(
            f"    {one['group']}: {100 * one['total']:.0f} % of the variance ({100 * low:.0f} to {100 * high:.0f} %)"
        )

# %% Compare: squares of the slopes of a straight line, times the variances of the inputs
with (OUT / "samples.csv").open() as file:
    rows = list(csv.DictReader(file))
inputs = [name for name in rows[0] if name.endswith("]")]
x = np.array([[float(row[name]) for name in inputs] for row in rows])
y = np.array([float(row["mean_pressure_difference_mmHg"]) for row in rows])
slopes = np.linalg.lstsq(np.column_stack([np.ones(len(x)), (x - x.mean(0)) / x.std(0)]), y)[0][1:]
line = dict(zip(inputs, slopes**2 / np.sum(slopes**2), strict=True))
gradient = {one["group"]: one for one in found["mean_pressure_difference_mmHg"]["indices"]}
apart = {}
for name in ("area", "inertance", "R_1"):
    share = next(value for label, value in line.items() if label.startswith(f"{name} ["))
    apart[name] = share - gradient[name]["first"]
    print(f"{name}: {share:.3f} by a straight line, {gradient[name]['first']:.3f} by the chaos")

# %% What this demo claims
assert all(row["count"] == RUNS and row["surrogate_relative_error"] < 0.05 for row in found.values())
assert all(abs(sum(one["first"] for one in row["indices"]) - 1) < 0.05 for row in found.values()), (
    "nearly additive"
)
assert max(map(abs, apart.values())) < 0.05
