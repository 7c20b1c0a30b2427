# %% [markdown]
# # A material of your own in ten lines
#
# What it shows: a material is an energy W(F, fibres); stress, forces and tangents follow from it. The Gent material is
# written beside a case, used in statics and named in a case file.
# Reference: uniaxial tension of the incompressible Gent material in closed form. Run time: 15 s on one rank.

# %% Parameters
import os
import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from mpi4py import MPI

from valvefsi.case import load_case
from valvefsi.case.build import run_case
from valvefsi.geometry.shapes import box
from valvefsi.solid import statics
from valvefsi.solid.loads import DeadLoad

OUT = Path(os.environ.get("VALVEFSI_DEMO_OUT", "results/demo_material")).resolve()
MU, LIMIT = 100.0, 2.0  # shear modulus [dyn/cm^2], where I1 - 3 ends

# %% [markdown]
# ## The ten lines
#
# Parameters say their unit and range; they are checked when the material is made. `kinematics` offers `F`, `C`, `J`,
# the invariants `I1`, `I1_bar`, ... and, for named fibre fields, `I4_bar`. `shear_modulus` is the linearised one; the
# volumetric stabilisation (S22) needs it.

# %% gent.py, beside the case
OUT.mkdir(parents=True, exist_ok=True)
(OUT / "gent.py").write_text(
    '''
from dataclasses import dataclass
import ufl
from valvefsi.solid.materials.parameters import parameter

@dataclass(frozen=True, kw_only=True)
class Gent:
    """Rubber whose chains have an end: W = -mu limit / 2 ln(1 - (I1_bar - 3) / limit)."""
    mu: float = parameter("dyn/cm^2", above=0.0)
    limit: float = parameter("1", above=0.0)
    @property
    def shear_modulus(self):
        return self.mu
    def energy(self, kinematics):
        return -self.mu * self.limit / 2 * ufl.ln(1 - (kinematics.I1_bar - 3) / self.limit)
'''
)
sys.path.insert(0, str(OUT))
from gent import Gent

# %% Statics: a cube pulled by a dead load, exactly incompressible
mesh = box(MPI.COMM_WORLD, size=(1, 1, 1), elements=(1, 1, 1))
symmetry = [statics.Fixed(on=(f"{a}_lower",), components=(a,)) for a in "xyz"]


def pulled(traction):
    """Stretch of the cube under a traction [dyn/cm^2]."""
    load = DeadLoad(on=("x_upper",), traction=(traction, 0.0, 0.0))
    solution = statics.solve(mesh, Gent(mu=MU, limit=LIMIT), fixed=symmetry, loads=[load])
    return 1.0 + solution.displacement_at((1.0, 1.0, 1.0))[0]


# %% Compare: P11 = mu (stretch - 1 / stretch^2) limit / (limit - (I1 - 3))
stretches = np.array([1.1, 1.3, 1.5])
I1 = stretches**2 + 2 / stretches
tractions = MU * (stretches - stretches**-2) * LIMIT / (LIMIT - (I1 - 3))
computed = np.array([pulled(traction) for traction in tractions])
print("stretch, exact:   ", stretches, "\nstretch, computed:", computed)

# %% [markdown]
# ## In a case
#
# Its file names it. The file is Python that the case would run, so it is run only where that is allowed: `trust=True`
# here, `--trust` on the command line. Units are converted as for any material.

# %% A coupled run of a few steps
case_file = OUT / "input.toml"
case_file.write_text(
    """
[grid]
lower = ["0 cm", "0 cm"]
upper = ["4 cm", "4 cm"]
cells = [16, 16]
[fluid.sides]
y_upper = { velocity = ["1 cm/s", "0 cm/s"] }
[time]
dt = "5 ms"
t_end = "0.2 s"
[[solid]]
name = "block"
mesh = { shape = "rectangle", lower = ["1 cm", "1 cm"], size = ["2 cm", "2 cm"], elements = [8, 8] }
material = { model = "gent.py:Gent", mu = "10 Pa", limit = 2.0 }
"""
)
last = run_case(load_case(case_file, trust=True), out=OUT, overwrite=True)["last"]

# %% Plot
fine = np.linspace(1.0, 1.6, 100)
figure, axes = plt.subplots(layout="constrained", figsize=(6, 3.5))
axes.plot(
    fine, MU * (fine - fine**-2) * LIMIT / (LIMIT - (fine**2 + 2 / fine - 3)), "k--", label="closed form"
)
axes.plot(computed, tractions, "o", label="statics")
axes.set(xlabel="stretch", ylabel="nominal stress [dyn/cm^2]")
axes.legend(frameon=False)
figure.savefig(OUT / "gent.png", dpi=120)

# %% What this demo claims
assert np.abs(computed / stretches - 1).max() < 1e-6
assert abs(last["block_area_change_percent"]) < 0.5
