# %% [markdown]
# # A valve that beats
#
# What it shows: a case with leaflets, a rigid test section and a flow loop; its plan; its first steps; how to go on,
# and where the numbers of the valve are.
# Reference: what flows in flows out, and the circuits start at 85 mmHg. Run time: 40 s; a whole beat takes longer.

# %% Parameters
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from valvefsi.case import load_case
from valvefsi.io.history import read_history

ROOT = Path(__file__).resolve().parents[1]
OUT = Path(os.environ.get("VALVEFSI_DEMO_OUT", "results/demo_valve")).resolve()
CASE = ROOT / "demos" / "pericardial_valve.toml"
T_END = "0.14 ms"  # a beat is "857 ms"
VALVEFSI = [sys.executable, "-m", "valvefsi"]

# %% [markdown]
# ## Before you believe a number
#
# Earlier versions had leaflets of linear hexahedra, which lock in bending, and a housing whose points crept inwards:
# their beats were those of a plate in a thickening wall. Leaflets are solid shells now, and walls are held in patches,
# each checked by itself (`docs/validation/valves.md`). Whole beats are not compared with a measurement yet: use the
# case to set up your own, and do not rely on its numbers.
#
# ## The case
#
# `demos/pericardial_valve.toml` has a box of fluid with graded sides, three leaflets that `valvefsi` meshes from a few
# lengths, a rigid aortic section (`[housing]`), and two circuits: pump and impedance adapter upstream (S4, S5), a
# three-element Windkessel downstream (S9, S10). One line each changes the valve, the fluid or the spacing.

# %% What is in it
case = load_case(CASE)
print(case.title)
print("valve:", case.solid[0].mesh.valve.type, case.solid[0].mesh.valve.diameter, "cm")
print("circuits:", [f"{circuit.name} ({circuit.model})" for circuit in case.circuit])

# %% [markdown]
# ## The plan
#
# `valvefsi run demos/pericardial_valve.toml --plan` times a few steps and says what the beat takes, on this machine and
# on more ranks. Read the step limits: the smallest decides.

# %% Plan
subprocess.run([*VALVEFSI, "run", str(CASE), "--plan"], check=True)

# %% [markdown]
# ## The run
#
# `mpirun -n 2 valvefsi run demos/pericardial_valve.toml` runs one beat; here it ends after a few steps. Steps are
# adaptive: they follow the Courant number and the stable step of the leaflets, which is measured as they deform. When
# something fails the run goes back to its last good state; `recoveries` in `summary.json` says so.

# %% The first steps, then on from the checkpoint
options = ["--out", str(OUT), "--set", "output.history_every=1"]
subprocess.run([*VALVEFSI, "run", str(CASE), *options, "--set", "time.t_end=0.06 ms"], check=True)
subprocess.run(
    [*VALVEFSI, "run", str(CASE), *options, "--set", f"time.t_end={T_END}", "--resume"], check=True
)

# %% [markdown]
# ## What it leaves
#
# `history.csv`: flows, pressures, open area, volumes, over time. `summary.json`: the numbers of whole cycles (stroke
# volume, pressure difference, effective orifice area, closing volume, leakage, energy loss, opening and closing times),
# some beside their plausible range, and of the leaflets and the fluid (flutter, coaptation, stress by phase and place,
# shear stress and its exposure), each with what it means. `valvefsi numbers DIR` takes them again.
# `valvefsi plot --figure S8 DIR` draws a finished beat as the supplement of Lee et al. 2020 does, S6 to S19.
# `leaflets.png` and `free_edges.png`: the valve from downstream as it opens and closes. `paraview/`: series for
# ParaView. `valvefsi plot DIR --slice y=0 --field velocity_z` and `valvefsi movie` draw planes of the fluid,
# also while it runs.

# %% Read them
history = {name: np.array(values) for name, values in read_history(OUT / "history.csv").items()}
summary = json.loads((OUT / "summary.json").read_text())
print(f"{len(history['t_s'])} rows to t = {history['t_s'][-1] * 1e3:.2f} ms, {sorted(summary)}")

# %% What this demo claims
inflow, outflow = history["q_z_lower_ml_s"], -history["q_z_upper_ml_s"]
assert np.abs(inflow - outflow).max() < 1e-9 * max(1.0, np.abs(inflow).max())
assert history["p_z_lower_mmHg"][0] == 85.0
assert history["p_z_upper_mmHg"][0] == 85.0
assert abs(history["t_s"][-1] - 0.14e-3) < 1e-12
assert np.all(np.abs(history["leaflets_J_min"] - 1) < 1e-3)
