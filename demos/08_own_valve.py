# %% [markdown]
# # Your own leaflets in your own housing
#
# What it shows: leaflets from a mesh file and a housing from an STL file get what the meshed valve gets, by tags:
# stent, clamps, open area, pictures, stress of each leaflet, fibre directions, solid-shell elements.
# Reference: the meshed valve whose file is read back. Run time: 40 s on one rank.

# %% Parameters
import json
import os
import subprocess
import sys
from pathlib import Path

import meshio
import numpy as np

from valvefsi.case import load_case
from valvefsi.case.build import run_case
from valvefsi.io.history import read_history

ROOT = Path(__file__).resolve().parents[1]
OUT = Path(os.environ.get("VALVEFSI_DEMO_OUT", "results/demo_own_valve")).resolve()
T_END = "0.24 ms"  # six steps; a beat is "857 ms"
OUT.mkdir(parents=True, exist_ok=True)

# %% [markdown]
# ## The leaflets
#
# A mesh of yours has its axis along z, the flow towards larger z, and physical groups for four kinds of facets: where
# the leaflets are attached, their free edges, and their two sides. Each may consist of several groups, of any names.
# `valvefsi mesh import FILE --unit 1mm --out leaflets.msh` brings it to cm; it keeps the groups of a gmsh file and
# names patches where there are none. Here `valvefsi mesh valve` stands in for your mesh: it writes such a file.

# %% leaflets.msh
VALVEFSI = [sys.executable, "-m", "valvefsi"]
shape = ["--h", "2mm", "--ratio", "1.5", "--set", "gap=1mm", "--set", "nose=1.5mm", "--set", "drop=5mm"]
subprocess.run([*VALVEFSI, "mesh", "valve", *shape, "--out", str(OUT / "leaflets.msh")], check=True)
groups = meshio.read(OUT / "leaflets.msh").field_data
print({name: "facets" if dim == 2 else "cells" for name, (number, dim) in groups.items()})

# %% [markdown]
# ## The housing
#
# Any surface of triangles about the z axis that reaches from one z side of the box to the other, such as an STL file in
# mm. Here it is a tube that widens downstream.

# %% housing.stl
AROUND, ALONG = 48, 40
phi, z = 2 * np.pi * np.arange(AROUND) / AROUND, np.linspace(-20.0, 60.0, ALONG + 1)
radius = 12.5 + 4.0 * np.clip(z / 20.0, 0.0, 1.0) ** 2
ring = [np.outer(radius, np.cos(phi)).ravel(), np.outer(radius, np.sin(phi)).ravel(), np.repeat(z, AROUND)]
points = np.stack(ring, axis=1)
index = np.arange(len(points)).reshape(ALONG + 1, AROUND)
turned = np.roll(index, -1, axis=1)
quads = np.stack([index[:-1], turned[:-1], turned[1:], index[1:]], axis=-1).reshape(-1, 4)
triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
meshio.Mesh(points, [("triangle", triangles)]).write(OUT / "housing.stl", binary=True)

# %% [markdown]
# ## The case
#
# `[solid.mesh.leaflets]` says what the groups are; left out, a key has the name of its own, `attached = ["attached"]`.
# From them follow: the stent, a wall from the annulus up to the attached edge, which must go around the axis with gaps
# of at most a post; the open area and the free edges; the leaflets' circumferential and radial directions, which a
# material's angle counts from; and the two sides between which solid shells have their thickness. A tether on the
# attached facets is the clamp. What does not fit is refused before anything is run.

# %% input.toml
(OUT / "input.toml").write_text(
    f"""
include = "{ROOT / "demos" / "pericardial_valve.toml"}"
title = "own leaflets in an own housing"
[grid]
lower = ["-2.5 cm", "-2.5 cm", "-2 cm"]
upper = ["2.5 cm", "2.5 cm", "6 cm"]
core_lower = ["-2.1 cm", "-2.1 cm", "-2 cm"]
core_upper = ["2.1 cm", "2.1 cm", "6 cm"]
h = "2 mm"
[housing]
file = "housing.stl"
file_unit = "1 mm"
annulus = "-1 mm"
stent = "leaflets"
[time]
dt_per_h = "0.0002 s/cm"
t_end = "{T_END}"
[output]
history_every = 2
frames = 3
stress = ["von_mises"]
[[solid]]
name = "leaflets"
element = "solid_shell"
kappa = "1e7 dyn/cm^2"
[solid.mesh]
file = "leaflets.msh"
[solid.mesh.leaflets]
diameter = "25 mm"
attached = ["attached"]
free = ["free"]
[solid.material]
model = "hgo"
c10 = "10 kPa"
c01 = 8.0
families = [{{ k1 = "20 kPa", k2 = 50.0, fibre = "20 deg from circumferential" }}]
[[solid.tether]]
on = ["attached"]
stiffness = "2e8 dyn/cm^3"
damping = "1000 dyn*s/cm^3"
"""
)
run_case(load_case(OUT / "input.toml"), out=OUT / "own", overwrite=True)

# %% [markdown]
# ## The same leaflets, meshed by the case
#
# `mesh = { valve = { type = "pericardial" } }` makes the same mesh. Its own directions are those of the formula.

# %% Run it, and compare
same = (
    "{ type = 'pericardial', diameter = '25 mm', ratio = 1.5, gap = '1 mm', nose = '1.5 mm', drop = '5 mm' }"
)
meshed = load_case(OUT / "input.toml", [f"solid.leaflets.mesh={{ valve = {same} }}"])
run_case(meshed, out=OUT / "meshed", overwrite=True)
area = {name: np.array(read_history(OUT / name / "history.csv")["pdva_cm2"]) for name in ("own", "meshed")}
peaks = json.loads((OUT / "own" / "summary.json").read_text())["valve"]["leaflets"]
print("open area [cm^2]:", area["own"][-1], "own,", area["meshed"][-1], "meshed")
print("von Mises stress at the last frame [kPa]:", peaks["leaflet_1"]["von_mises_p99_kPa"])

# %% What this demo claims
assert set(peaks) == {"leaflet_1", "leaflet_2", "leaflet_3"}
assert (OUT / "own" / "free_edges.png").exists()
(OUT / "leaflets.png").write_bytes((OUT / "own" / "leaflets.png").read_bytes())
assert np.abs(area["own"] - area["meshed"]).max() < 1e-3 * area["meshed"][0]
assert area["own"][0] > 0.1
