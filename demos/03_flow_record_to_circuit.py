# %% [markdown]
# # From a flow record to a circuit, and a tube that ends in it
#
# What it shows: `valvefsi fit windkessel` fits the three-element Windkessel (S9, S10) to flow and pressure; the circuit
# then closes a side of a box of fluid.
# Reference: the constants the record was made with; an independent integration of S9-S10. Run time: 15 s.

# %% Parameters
import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp

from valvefsi.case import load_case
from valvefsi.case.build import run_case
from valvefsi.io.history import read_history

ROOT = Path(__file__).resolve().parents[1]
OUT = Path(os.environ.get("VALVEFSI_DEMO_OUT", "results/demo_circuit")).resolve()
RECORD = ROOT / "calibration" / "porcine_loop.csv"
TRUTH = {"R_c": 0.0576, "R_p": 1.14, "C": 2.43}  # mmHg s/ml, mmHg s/ml, ml/mmHg
T_END = 0.4

# %% [markdown]
# ## The fit
#
# On the command line: `valvefsi fit windkessel calibration/porcine_loop.csv --circuit downstream`. The record holds
# `t_s`, `q_ao_ml_s` and `p_ao_mmHg`; flows are positive downstream. Cycles are found in it.

# %% Run it
command = [sys.executable, "-m", "valvefsi", "fit", "windkessel", str(RECORD), "--circuit", "downstream"]
subprocess.run([*command, "--out", str(OUT / "fit")], check=True)
fit = json.loads((OUT / "fit" / "fit.json").read_text())["parameters"]

# %% [markdown]
# ## A tube that ends in the circuit
#
# A square tube of 2 x 2 cm with walls that slip: the flow is uniform, so the flow through the outlet is the record's.
# The side `x_upper` is open, and the circuit sets its pressure. `circuit.toml` is what the fit wrote.

# %% The inflow as a table, the case as a file
with RECORD.open() as file:
    rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
t, q = (np.array([float(row[name]) for row in rows]) for name in ("t_s", "q_ao_ml_s"))
q *= 1 - np.exp(-t / 0.01)  # the fluid begins at rest
(OUT / "inflow.csv").write_text("t_s,u\n" + "\n".join(f"{a},{b / 4.0}" for a, b in zip(t, q, strict=True)))
case_file = OUT / "input.toml"
case_file.write_text(
    f"""
[grid]
lower = ["0 cm", "0 cm", "0 cm"]
upper = ["2 cm", "2 cm", "2 cm"]
cells = [8, 8, 8]
[fluid.sides]
x_lower = {{ velocity_expression = ["u", "0", "0"], table = "inflow.csv" }}
x_upper = {{ type = "open", circuit = "outlet" }}
y_lower = {{ type = "free_slip" }}
y_upper = {{ type = "free_slip" }}
z_lower = {{ type = "free_slip" }}
z_upper = {{ type = "free_slip" }}
[time]
dt = "0.2 ms"
t_end = "{T_END} s"
[output]
history_every = 20
[[circuit]]
name = "outlet"
include = "fit/circuit.toml"
"""
)
run_case(load_case(case_file), out=OUT, overwrite=True)

# %% Compare: S9 and S10 integrated by themselves, with the same flow and the fitted constants
R_c, R_p, C = (fit[name]["value"] for name in ("R_c", "R_p", "C"))
history = {name: np.array(values) for name, values in read_history(OUT / "history.csv").items()}
time, pressure = history["t_s"], history["p_x_upper_mmHg"]
exact = solve_ivp(
    lambda s, p: [(np.interp(s, t, q) - p[0] / R_p) / C],
    (0, T_END),
    [fit["p_wk_start"]["value"]],
    t_eval=time,
    rtol=1e-8,
)
reference = exact.y[0] + R_c * np.interp(time, t, q)
gap = np.linalg.norm(pressure - reference) / np.linalg.norm(reference)
print(f"outlet pressure, relative L2 difference from S9-S10 alone: {gap:.2e}")

# %% Plot
figure, axes = plt.subplots(layout="constrained", figsize=(6, 3.5))
axes.plot(time, pressure, linewidth=4, alpha=0.5, label="side of the box")
axes.plot(time, reference, "k--", label="S9, S10 alone")
axes.set(xlabel="t [s]", ylabel="pressure [mmHg]")
axes.legend(frameon=False)
figure.savefig(OUT / "outlet.png", dpi=120)

# %% What this demo claims
assert all(fit[name]["ci95"][0] <= truth <= fit[name]["ci95"][1] for name, truth in TRUTH.items())
assert gap < 0.001
