# %% [markdown]
# # On many ranks
#
# What it shows: the same command under mpirun, one answer on any number of ranks, a plan of what a run takes.
# Reference: the run on one rank, to round-off. Run time: 20 s.

# %% Parameters
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from valvefsi.io.history import read_history

ROOT = Path(__file__).resolve().parents[1]
OUT = Path(os.environ.get("VALVEFSI_DEMO_OUT", "results/demo_ranks")).resolve()
CASE = ROOT / "demos" / "compressed_block.toml"
beside = Path(sys.executable).parent / "mpirun"
MPIRUN = str(beside) if beside.exists() else shutil.which("mpirun")
VALVEFSI = [sys.executable, "-m", "valvefsi"]

# %% [markdown]
# ## The plan
#
# `valvefsi run CASE.toml --plan` runs nothing. It says how large the run is, which limit its step has, and what it is
# expected to take; with `valvefsi bench speed --model` a cost model says the same for many cores.

# %% What the run takes
subprocess.run([*VALVEFSI, "run", str(CASE), "--plan"], check=True)

# %% [markdown]
# ## The run
#
# On the command line: `mpirun -n 2 valvefsi run demos/compressed_block.toml`. The grid is split among the ranks in
# pencils; points of the solids go to the rank that owns their cell. Use the `mpirun` of the same environment. Where
# cores are left, loops take them as threads (`VALVEFSI_THREADS=2`). A checkpoint may be read on another number of
# ranks.

# %% One rank, then two
curves = {}
for ranks in (1, 2):
    folder = OUT / f"ranks_{ranks}"
    options = ["--set", "time.t_end=1 s", "--out", str(folder)]
    subprocess.run(
        [MPIRUN, "-n", str(ranks), *VALVEFSI, "run", str(CASE), *options],
        check=True,
        stdout=subprocess.DEVNULL,
    )
    curves[ranks] = {name: np.array(values) for name, values in read_history(folder / "history.csv").items()}
    wall = json.loads((folder / "summary.json").read_text())["timing"]["wall_s"]
    print(f"{ranks} rank(s): {wall:.2f} s")

# %% Plot
figure, axes = plt.subplots(layout="constrained", figsize=(6, 3.5))
for ranks, style in ((1, "-"), (2, "--")):
    axes.plot(curves[ranks]["t_s"], curves[ranks]["u_y_top_centre_cm"], style, label=f"{ranks} rank(s)")
axes.set(xlabel="t [s]", ylabel="u_y of the top centre [cm]")
axes.legend(frameon=False)
figure.savefig(OUT / "ranks.png", dpi=120)

# %% What this demo claims
gap = max(
    np.abs(curves[1][name] - curves[2][name]).max() for name in ("u_y_top_centre_cm", "kinetic_energy_erg")
)
assert np.abs(curves[1]["u_y_top_centre_cm"]).max() > 0.01
assert gap < 1e-9
