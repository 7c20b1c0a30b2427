# %% [markdown]
# # The smallest coupled run
# What it shows: a case as a dictionary, a soft square in a cavity with a sliding lid, its history and a picture.
# Reference: both are incompressible, so the square keeps its area. Run time: 5 s on one rank; also under mpirun.

# %% The case: every number may carry a unit, what is left out has its default
import os
from pathlib import Path

from mpi4py import MPI

from valvefsi.case import parse_case
from valvefsi.case.build import run_case
from valvefsi.io.history import read_history

OUT = Path(os.environ.get("VALVEFSI_DEMO_OUT", "results/demo_minimal"))
square = {
    "name": "square",
    "mesh": {"shape": "rectangle", "lower": ["3 mm", "3 mm"], "size": ["3 mm", "3 mm"], "elements": [16, 16]},
    "material": {"model": "neo_hookean", "c1": "0.1 Pa"},
    "probe": [{"name": "corner", "at": ["6 mm", "6 mm"]}],
}
case = parse_case(
    {
        "grid": {"lower": ["0 cm", "0 cm"], "upper": ["1 cm", "1 cm"], "cells": [32, 32]},
        "fluid": {"viscosity": "1 cP", "sides": {"y_upper": {"velocity": ["1 cm/s", "0 cm/s"]}}},
        "time": {"dt": "4 ms", "t_end": "2 s"},
        "solid": [square],
    }
)

# %% Run it
last = run_case(case, out=OUT, overwrite=True)["last"]

# %% What this demo claims
change = read_history(OUT / "history.csv")["square_area_change_percent"][-1]
if MPI.COMM_WORLD.rank == 0:
    print(f"the corner moved by {last['u_x_corner_cm']:.3f} cm, the area changed by {change:.3f} %")
assert last["u_x_corner_cm"] < -0.05
assert abs(change) < 1.0
