"""The flag behind a cylinder of `valvefsi.benchmarks.immersed.turek`: mesh, points of the cylinder, grid, model."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.benchmarks.options import Values
from valvefsi.benchmarks.running import flow_of
from valvefsi.bodies.elastic import Elastic
from valvefsi.bodies.heavy import Heavy
from valvefsi.bodies.rigid import RigidSurface
from valvefsi.coupling.transfer import Coupling
from valvefsi.fluid.boundary import Boundary, Open, Wall
from valvefsi.geometry.flow_shapes import flag as flag_mesh
from valvefsi.grid import MacGrid
from valvefsi.grid.grading import graded_edges
from valvefsi.solid.loads import Tether
from valvefsi.solid.materials import NeoHookean, kappa_stab
from valvefsi.solid.structure import Discretisation, Structure
from valvefsi.types import Array

LENGTH, HEIGHT = 250.0, 41.0
"""Length and height of the channel [cm]."""
CENTRE, RADIUS = (20.0, 20.0), 5.0
"""The cylinder [cm]."""
TIP, THICKNESS, ROOT = 60.0, 2.0, 23.0
"""Where the flag ends, its thickness, and where it begins, inside the cylinder [cm]."""
CLAMP = CENTRE[0] + math.sqrt(RADIUS**2 - (0.5 * THICKNESS) ** 2)
"""Where the flag leaves the cylinder [cm]."""
CORE = ((13.0, 65.0), (10.0, 30.0))
"""Stretches along both axes with the smallest cells [cm]."""


def cylinder_points(h: float) -> tuple[Array, Array]:
    """Return points on circles that fill the cylinder but not the flag, and the area of each [cm, cm^2]."""
    places, areas = [], []
    rings = math.ceil(RADIUS / (0.6 * h))
    for k in range(rings):
        r = RADIUS * (k + 0.5) / rings
        n = max(6, math.ceil(2.0 * math.pi * r / (0.6 * h)))
        angle = 2.0 * math.pi * (np.arange(n) + 0.5 * (k % 2)) / n
        places.append(np.stack([r * np.cos(angle), r * np.sin(angle), np.full(n, 0.5)], axis=1))
        areas.append(np.full(n, 2.0 * math.pi * r * RADIUS / (rings * n)))
    X, area = np.concatenate(places) + (*CENTRE, 0.0), np.concatenate(areas)
    free = (X[:, 0] < ROOT) | (np.abs(X[:, 1] - CENTRE[1]) > 0.5 * THICKNESS)
    return X[free], area[free]


def channel(cells: int, comm: MPI.Comm) -> MacGrid:
    """Return the grid: ``cells`` across the flag where it sweeps and around the cylinder, graded away from there."""
    h = THICKNESS / cells
    (x0, x1), (y0, y1) = CORE
    along = [(0.0, 2.0 * h), (x0, h), (x1, h), (x1 + 50.0 * h, 4.0 * h), (LENGTH, 8.0 * h)]
    across = [(0.0, 1.5 * h), (y0, h), (y1, h), (HEIGHT, 1.5 * h)]
    return MacGrid.graded([graded_edges(along), graded_edges(across)], [False, False], comm)


def length_of_step(h: float, values: Values) -> float:
    """Return the step: the share of the elastic limit, and a Courant number of 0.3 at 2.5 U [s]."""
    c1 = plate_modulus(values)
    wave = math.sqrt((kappa_stab(c1, values["nu_stab"]) + 4.0 / 3.0 * c1) / values["rho"])
    elastic = 0.5 * values["ratio"] * h / (math.sqrt(2.0) * wave)
    return min(values["share"] * elastic, 0.3 * h / (2.5 * values["U"]))


def plate_modulus(values: Values) -> float:
    """Shear modulus of an incompressible plate as stiff as the published one [dyn/cm^2]."""
    return 0.5 * values["mu_s"] / (1.0 - values["nu"])


def inflow(values: Values) -> Callable[[Array, Array, Array, float], tuple[Array, float]]:
    """Return the velocity on the left side as a function of place and time."""
    U, ramp = values["U"], values["ramp"]

    def velocity(x: Array, y: Array, z: Array, t: float) -> tuple[Array, float]:
        raised = 0.5 * (1.0 - math.cos(math.pi * min(t, ramp) / ramp))
        return 1.5 * U * raised * 4.0 * y * (HEIGHT - y) / HEIGHT**2 + 0.0 * x * z, 0.0

    return velocity


def build(cells: int, kernel: str, values: Values, comm: MPI.Comm) -> tuple[fsi.Model, float]:
    """Return the model and the length of a step [s] (collective)."""
    grid = channel(cells, comm)
    h = THICKNESS / cells
    dt, rho, mu = length_of_step(h, values), values["rho"], values["mu"]
    hold = {"stiffness": values["hold"] * rho / dt**2, "damping": values["hold"] * rho / dt}
    flag = Structure(
        flag_mesh(
            comm, along=(ROOT, CLAMP, TIP), thickness=THICKNESS, centre=CENTRE[1], size=values["ratio"] * h
        ),
        NeoHookean(c1=plate_modulus(values)),
        name="flag",
        nu_stab=values["nu_stab"],
        discretisation=Discretisation(degree=2),
        tethers=[Tether(on=("root",), **hold)],
    )
    coupling = Coupling(grid, kernel)
    points, areas = cylinder_points(h)
    cylinder = RigidSurface(points, areas, coupling, name="cylinder", slip=values["pace"] / dt, **hold)
    sides = Boundary(grid, {"x_lower": Wall(velocity=inflow(values)), "x_upper": Open()})
    density = values["rho_s"]
    body = Heavy(flag, coupling, rho=rho, density=density) if density > rho else Elastic(flag, coupling)
    model = fsi.Model(
        grid=grid,
        fluid=flow_of(grid, sides, dt, rho=rho, mu=mu, advection="xsppm7"),
        bodies=(body, cylinder),
    )
    return model, dt
