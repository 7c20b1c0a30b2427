# %% [markdown]
# # Your own leaflet or structure
#
# What it shows: a closed surface from elsewhere becomes a mesh with tags (`valvefsi mesh import`), gets fibres, is held
# at one patch and bent by a stream.
# Reference: the volume of the body in closed form; both are incompressible. Run time: 15 s on one rank.

# %% Parameters: a curved flap, a part of a tube, in mm as most files from elsewhere
import os
import subprocess
import sys
from pathlib import Path

import meshio
import numpy as np

from valvefsi.case import load_case
from valvefsi.case.build import run_case
from valvefsi.io.history import read_history

OUT = Path(os.environ.get("VALVEFSI_DEMO_OUT", "results/demo_own")).resolve()
INNER, OUTER, HALF_ANGLE, LOW, HIGH = (
    8.0,
    10.0,
    np.radians(40.0),
    2.0,
    10.0,
)  # mm; the axis is z through (2, 10) mm
OUT.mkdir(parents=True, exist_ok=True)

# %% [markdown]
# ## The surface
#
# Any closed surface will do: STL from segmentation or CAD, or a volume mesh (`.msh`, `.vtu`). Here we make one.

# %% flap.stl
AROUND, UP = 24, 12
angles, heights = np.linspace(-HALF_ANGLE, HALF_ANGLE, AROUND + 1), np.linspace(LOW, HIGH, UP + 1)


def grid(r, a, z):
    """Corners of a surface of quadrilaterals, each cut in two triangles."""
    r, a, z = np.broadcast_arrays(r, a, z)
    p = np.stack([2.0 + r * np.cos(a), 10.0 + r * np.sin(a), z], axis=-1)
    quads = np.stack([p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]], axis=2).reshape(-1, 4, 3)
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


A, Z, R = angles[:, None], heights[None, :], np.linspace(INNER, OUTER, 4)
parts = [grid(r, A, Z) for r in (INNER, OUTER)]
parts += [grid(R[:, None], a, Z) for a in (-HALF_ANGLE, HALF_ANGLE)]
parts += [grid(R[None, :], A, z) for z in (LOW, HIGH)]
corners = np.concatenate(parts)
mesh = meshio.Mesh(corners.reshape(-1, 3), [("triangle", np.arange(3 * len(corners)).reshape(-1, 3))])
mesh.write(OUT / "flap.stl", binary=True)

# %% [markdown]
# ## The import
#
# On the command line: `valvefsi mesh import flap.stl --unit 1mm --size 1.5mm --out flap.msh`. The surface is cut into
# patches where its normal turns by more than 40 degrees; they are called `surface_1`, `surface_2`, ...

# %% Run it, and find the patch at the bottom
command = [sys.executable, "-m", "valvefsi", "mesh", "import", str(OUT / "flap.stl"), "--unit", "1mm"]
subprocess.run([*command, "--size", "1.5mm", "--out", str(OUT / "flap.msh")], check=True)
made = meshio.read(OUT / "flap.msh")
names = {number: name for name, (number, dim) in made.field_data.items() if dim == 2}
lowest, volume = {}, 0.0
for block, tags in zip(made.cells, made.cell_data["gmsh:physical"], strict=True):
    p = made.points[block.data]
    if block.type == "triangle":
        lowest |= {names[tag]: p[tags == tag][..., 2].mean() for tag in np.unique(tags)}
    if block.type == "tetra":
        volume += np.abs(np.linalg.det(p[:, 1:] - p[:, :1])).sum() / 6
bottom = min(lowest, key=lowest.get)
exact = HALF_ANGLE * (OUTER**2 - INNER**2) * (HIGH - LOW) * 1e-3
print(f"held at {bottom}; volume {volume:.5f} cm^3, closed form {exact:.5f} cm^3")

# %% [markdown]
# ## The case
#
# Fibres run around the axis of the tube. The bottom is held by a tether; its stiffness is as large as the step allows.
# Linear tetrahedra bend too stiffly: `degree = 2`. Points must not stand further apart than 1.25 h, or fluid leaks.

# %% A stream of 5 cm/s against the hollow side
(OUT / "input.toml").write_text(
    f"""
[grid]
lower = ["0 cm", "0 cm", "0 cm"]
upper = ["2 cm", "2 cm", "1.5 cm"]
cells = [16, 16, 12]
[fluid]
viscosity = "4 cP"
[fluid.sides]
x_lower = {{ velocity_expression = ["5 * (1 - exp(-t / 0.02))", "0", "0"] }}
x_upper = {{ type = "open" }}
y_lower = {{ type = "free_slip" }}
y_upper = {{ type = "free_slip" }}
z_upper = {{ type = "free_slip" }}
[time]
dt = "0.5 ms"
t_end = "0.1 s"
[output]
history_every = 20
[[solid]]
name = "flap"
degree = 2
mesh = {{ file = "flap.msh" }}
[solid.material]
model = "hgo"
c10 = "10 Pa"
c01 = 5.0
families = [{{ k1 = "20 Pa", k2 = 5.0, kappa = 0.1, fibre = "around" }}]
[[solid.fibre]]
name = "around"
rule = "circumferential"
through = ["2 mm", "10 mm", "0 mm"]
[[solid.tether]]
on = ["{bottom}"]
stiffness = "2e4 dyn/cm^3"
[[solid.probe]]
name = "tip"
at = ["11 mm", "10 mm", "10 mm"]
"""
)
last = run_case(load_case(OUT / "input.toml"), out=OUT, overwrite=True)["last"]
history = {name: np.array(values) for name, values in read_history(OUT / "history.csv").items()}
print(
    f"tip {last['u_x_tip_cm']:.3f} cm downstream, volume changed by {last['flap_volume_change_percent']:.3f} %"
)

# %% Plot: a plane through the flap and the stream, without a display
plot = [sys.executable, "-m", "valvefsi", "plot", str(OUT), "--slice", "y=1cm", "--field", "velocity_x"]
subprocess.run(plot, check=True)

# %% What this demo claims
assert abs(volume / exact - 1) < 0.005
assert last["u_x_tip_cm"] > 0.02
assert np.abs(history["flap_volume_change_percent"]).max() < 1.0
assert last["flap_J_min"] > 0.5
