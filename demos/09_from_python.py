# %% [markdown]
# # From Python, in a notebook
#
# What it shows: runs from Python with changed keys, histories as arrays and figures, fields as pyvista meshes, errors.
# Reference: what makes density, viscosity and stiffness twice as large leaves the motion as it is. Run time: 10 s.
#
# JupyterLab with jupytext opens this script as a notebook, and `jupytext --to notebook demos/09_from_python.py` makes
# one of it (`pip install 'valvefsi[notebook]'`).

# %% The case: a file's name, or its tables as a dictionary; every number may carry a unit
import os
from pathlib import Path

import numpy as np

import valvefsi

OUT = Path(os.environ.get("VALVEFSI_DEMO_OUT", "results/demo_python"))
case = {
    "title": "a soft square under a sliding lid",
    "grid": {"lower": ["0 cm", "0 cm"], "upper": ["1 cm", "1 cm"], "cells": [24, 24]},
    "fluid": {"viscosity": "1 cP", "sides": {"y_upper": {"velocity": ["1 cm/s", "0 cm/s"]}}},
    "time": {"dt": "5 ms", "t_end": "1.5 s"},
    "output": {"history_every": 10, "frames": 6},
    "solid": [
        {
            "name": "square",
            "mesh": {
                "shape": "rectangle",
                "lower": ["3 mm", "3 mm"],
                "size": ["3 mm", "3 mm"],
                "elements": [12, 12],
            },
            "material": {"model": "neo_hookean", "c1": "0.1 Pa"},
            "probe": [{"name": "corner", "at": ["6 mm", "6 mm"]}],
        }
    ],
}

# %% [markdown]
# ## A run
#
# Keywords are keys of the case with two underscores for each dot, items of lists by name; a dictionary of paths does
# the same. `out`, `resume`, `overwrite`, `allow_change` and `trust` are those of `valvefsi run`. In a notebook one line
# shows progress. Under mpirun the same script runs on all ranks.

# %% Two runs, the second with twice the density, viscosity and stiffness
first = valvefsi.simulate(case, out=OUT / "first", overwrite=True)
changes = {"solid.square.material.c1": "0.2 Pa", "fluid.density": "2 g/cm^3"}
twice = valvefsi.simulate(case, changes, out=OUT / "twice", overwrite=True, fluid__viscosity="2 cP")
twice

# %% [markdown]
# ## Its history
#
# A mapping of columns to numpy arrays; `units` names the unit of each, `to_pandas()` makes a table where pandas is
# there.

# %% Arrays
for run in (first, twice):
    t, u = run.history["t_s"], run.history["u_x_corner_cm"]
    print(
        f"{run.folder.name}: {len(t)} rows, the corner moved by {u[-1]:.3f} {run.history.units['u_x_corner_cm']}"
    )
print(f"steps: {first.summary['timing']['steps']}")

# %% A figure, which a notebook shows: columns with one unit share a panel
figure = first.plot("u_x_corner_cm", "u_y_corner_cm", "square_area_change_percent")
figure.savefig(OUT / "corner.png")
figure

# %% [markdown]
# ## Its fields
#
# `fields(t)` is the frame nearest to a time as a pyvista mesh, `fields(t, of="square")` that of a solid: slice, sample
# and `mesh.plot()` them. It needs pyvista, `pip install 'valvefsi[plot]'`.

# %% The fluid at half a second
try:
    mesh = first.fields(0.5)
    print(mesh.n_cells, "cells:", ", ".join(mesh.cell_data), "at", mesh.field_data["t_s"][0], "s")
except valvefsi.ValvefsiError as error:
    print(error)

# %% [markdown]
# ## Errors, and runs that are there
#
# What goes wrong is one kind of error, with the line that the command would print.

# %% A key that is misspelt, and a run opened from its folder
try:
    valvefsi.simulate(case, out=OUT / "wrong", fluid__viscosty="2 cP")
except valvefsi.ValvefsiError as error:
    message = str(error)
    print(message)
opened = valvefsi.open(OUT / "first")

# %% What this demo claims
assert message.endswith("unknown key; did you mean 'viscosity'?")
assert np.array_equal(opened.history["u_x_corner_cm"], first.history["u_x_corner_cm"])
assert abs(first.history["u_x_corner_cm"]).max() > 0.05
assert np.allclose(twice.history["u_x_corner_cm"], first.history["u_x_corner_cm"], rtol=0, atol=1e-10)
assert np.allclose(
    twice.history["kinetic_energy_erg"], 2 * first.history["kinetic_energy_erg"], rtol=1e-8, atol=0
)
