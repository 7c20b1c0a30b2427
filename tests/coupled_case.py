"""A small immersed block that the coupled tests share."""

from __future__ import annotations

from dataclasses import replace

from mpi4py import MPI

from valvefsi.bodies.elastic import Elastic
from valvefsi.bodies.heavy import Heavy
from valvefsi.bodies.slip import DarcySlip
from valvefsi.coupling.transfer import Coupling
from valvefsi.fluid.boundary import Boundary, Wall
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.fsi import Model
from valvefsi.geometry.shapes import compressed_block
from valvefsi.grid import MacGrid
from valvefsi.run.recording import Output, Probe
from valvefsi.run.schedule import Schedule
from valvefsi.run.simulation import Simulation
from valvefsi.solid.loads import DeadLoad, Ramp, Tether
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.structure import Damping, Structure

STEPS = 40
DT = 0.02


def block_model(
    comm=MPI.COMM_WORLD,
    *,
    lid=0.0,
    tether=2e4,
    load=200.0,
    cells=24,
    elements=(8, 4),
    nu_stab=0.4,
    damping=4.0,
    viscosity=0.0,
):
    """Block of Lee2020 E.1 on a coarse grid, loaded at once, under a lid that moves."""
    mesh = compressed_block(comm, elements=elements)
    solid = Structure(
        mesh,
        NeoHookean(c1=80.194),
        name="block",
        nu_stab=nu_stab,
        damping=Damping(body=damping, viscosity=viscosity),
        tethers=[
            Tether(on=("bottom",), components=("y",), stiffness=tether),
            Tether(on=("top_loaded", "top_outer"), components=("x",), stiffness=tether),
        ],
        loads=[DeadLoad(on=("top_loaded",), traction=(0.0, -load), ramp=Ramp(duration=0.5))],
    )
    grid = MacGrid([0, 0], [40, 40], [cells, cells], [False, False], comm)
    fluid = NavierStokes(grid, Boundary(grid, {"y_upper": Wall(velocity=(lid, 0.0))}), rho=1.0, mu=0.1)
    return Model(grid=grid, fluid=fluid, bodies=(Elastic(solid, Coupling(grid, "bspline3")),))


def simulation(folder, comm=MPI.COMM_WORLD, *, steps=STEPS, model=None, dt=DT, cfl_max=0.5, **options):
    """A run of the block into a folder."""
    model = model or block_model(comm, lid=2.0)
    output = Output(
        directory=folder,
        **{
            "history_every": 5,
            "frames": 4,
            "probes": (Probe(name="top_centre", body=0, at=(20.0, 25.0)),),
            **options,
        },
    )
    return Simulation(model, Schedule(dt=dt, t_end=steps * dt, cfl_max=cfl_max), output)


def moved(state, **tables):
    """The state with other values in the table of its first body."""
    return replace(state, bodies=({**state.bodies[0], **tables}, *state.bodies[1:]))


def heavy(model, density=7.0):
    """The model with its first body heavier than the fluid."""
    body = model.bodies[0]
    dense = Heavy(body.solid, body.coupling, rho=model.fluid.rho, density=density)
    return replace(model, bodies=(dense, *model.bodies[1:]))


def slipping(model, permeability, law=DarcySlip):
    """The model with slip of its first body, None for none."""
    body = model.bodies[0]
    slip = None if permeability is None or law is None else law(permeability, body.solid.weights[:, None])
    return replace(model, bodies=(Elastic(body.solid, body.coupling, slip=slip), *model.bodies[1:]))


def coupled(model, coupling):
    """The model with another coupling of its first body."""
    return replace(model, bodies=(Elastic(model.bodies[0].solid, coupling), *model.bodies[1:]))
