# %% [markdown]
# # A soft block under a load, immersed in fluid
#
# What it shows: a mesh from gmsh, a neo-Hookean solid in DOLFINx, a fluid grid, the coupling, and the comparison with
# an exactly incompressible static solution.
# Reference: Lee et al. 2020, supplement E.1. Run time: about 10 s on one rank; also under mpirun.

# %% Parameters
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
from mpi4py import MPI

from valvefsi.bodies.elastic import Elastic
from valvefsi.coupling.transfer import Coupling
from valvefsi.fluid.boundary import Boundary
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.fsi import Model
from valvefsi.geometry.shapes import compressed_block
from valvefsi.grid import MacGrid
from valvefsi.io.history import read_history
from valvefsi.run.recording import Output, Probe
from valvefsi.run.schedule import Schedule
from valvefsi.run.simulation import Simulation
from valvefsi.solid import statics
from valvefsi.solid.loads import DeadLoad, Ramp, Tether
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.structure import Structure

SIZE = 16  # elements along the block; the grid has twice as many cells
OUT = Path(os.environ.get("VALVEFSI_DEMO_OUT", "results/demo_compressed_block"))
comm = MPI.COMM_WORLD
t_end, kernel = 40.0, "bspline3"

# %% Grid and mesh: a box of 40 x 40 cm, a block of 20 x 10 cm in its middle
grid = MacGrid([0, 0], [40, 40], [2 * SIZE, 2 * SIZE], periodic=[False, False], comm=comm)
mesh = compressed_block(comm, lower=(10, 15), size=(20, 10), elements=(SIZE, SIZE // 2), load_width=10)

# %% Material, supports and load: c1 = 80.194 dyn/cm^2, 200 dyn/cm^2 on the middle of the top
top = ("top_loaded", "top_outer")
load = DeadLoad(on=("top_loaded",), traction=(0.0, -200.0), ramp=Ramp(duration=0.4 * t_end, shape="smooth"))
block = Structure(
    mesh,
    NeoHookean(c1=80.194),
    name="block",
    nu_stab=0.4,
    damping=4.0,
    tethers=[
        Tether(on=("bottom",), components=("y",), stiffness=1e5),
        Tether(on=top, components=("x",), stiffness=1e5),
    ],
    loads=[load],
)

# %% Fluid: water-like, walls at rest on all sides
fluid = NavierStokes(grid, Boundary(grid), rho=1.0, mu=0.01)

# %% Run
model = Model(grid=grid, fluid=fluid, bodies=(Elastic(block, Coupling(grid, kernel)),))
output = Output(directory=OUT, history_every=20, probes=(Probe(name="top", body=0, at=(20.0, 25.0)),))
schedule = Schedule(dt=0.005 * 20 / SIZE, t_end=t_end)
outcome = Simulation(model, schedule, output).run()

# %% Compare: the mean of the last fifth against an incompressible solution with mixed elements
solution = statics.solve(
    mesh,
    block.material,
    fixed=[statics.Fixed(on=("bottom",), components=("y",)), statics.Fixed(on=top, components=("x",))],
    loads=[replace(load, ramp=Ramp())],
)
reference = solution.displacement_at((20.0, 25.0))[1]
comm.barrier()
history = {name: np.array(values) for name, values in read_history(OUT / "history.csv").items()}
late = history["t_s"] > 0.8 * t_end
u_y = history["u_y_top_cm"][late].mean()
if comm.rank == 0:
    print(f"u_y of the top centre: {u_y:.4f} cm, incompressible statics {reference:.4f} cm")

# %% Plot
Simulation(model, schedule, output).pictures(
    outcome.state, title="Compressed block", references={"u_y_top_cm": ("statics", reference)}
)

# %% What this demo claims
assert abs(u_y - reference) < 0.03 * abs(reference)
assert abs(history["block_area_change_percent"][-1]) < 1.0
