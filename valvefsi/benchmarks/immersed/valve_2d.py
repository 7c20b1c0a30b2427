"""Two leaflets in a channel (Kamensky et al. 2015): how far pulsating inflow bends them, against other codes.

A channel of 8 x 1.61 cm with flexible leaflets, 0.0212 cm thick and 0.7 cm long, clamped to both walls at x = 2.
Inflow 5 (sin 2 pi t + 1.1) y (1.61 - y) on the left; the right side is open.

Published: a St. Venant-Kirchhoff shell without thickness for the fluid, E = 5.6e7, nu = 0.4. Here: an incompressible
neo-Hookean solid of the fluid's density whose plate stiffness is the same, c1 = E / (4 (1 - nu^2)); the strains of a
thin leaflet are a few per cent, so that the law itself matters little. It carries the fluid's viscosity.

The solid is incompressible by its own bulk modulus. The fluid keeps the area of what a kernel covers, not that of the
two faces of a leaflet thinner than the kernel, of which one is stretched and one compressed as it bends: a leaflet with
nu_stab = 0.4 bends as a plate of that Poisson's ratio, 1.2 times as softly, and its tip goes 4 % too far (with 46 cells
across).

The open side has no normal traction and no velocity along it, and charges what flows back with its dynamic pressure;
it lies six centimetres downstream. The inflow starts at once, with the fluid at rest.

The leaflets end on the walls: kernels read the mirror image of the flow beyond them, so that nodes on a wall stay where
they are, which clamps the leaflets.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.benchmarks import references
from valvefsi.benchmarks.frame import Record, Report
from valvefsi.benchmarks.immersed.study import Flexible, cost
from valvefsi.benchmarks.options import Values, option, quantities, require
from valvefsi.benchmarks.results import Row, row
from valvefsi.benchmarks.running import (
    Columns,
    History,
    Sights,
    fixed_steps,
    gathered,
    off_one,
    outline_of,
)
from valvefsi.bodies.elastic import Elastic
from valvefsi.coupling.transfer import Coupling
from valvefsi.fluid.boundary import Boundary, Open, Wall
from valvefsi.fluid.navier_stokes import ExplicitViscosity, stable_fluid
from valvefsi.geometry.flow_shapes import two_leaflets
from valvefsi.geometry.mesh import SolidMesh
from valvefsi.geometry.polygon_gap import gap
from valvefsi.grid import MacGrid
from valvefsi.grid.grading import graded_edges
from valvefsi.post import diagnostics
from valvefsi.post.plots.valve_2d import in_the_flow, tips
from valvefsi.run.planning import step_limits
from valvefsi.run.simulation import Simulation
from valvefsi.run.stable_step import measured_limit
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.structure import Discretisation, Structure
from valvefsi.types import Array, Indices

LENGTH, HEIGHT, ROOT = 8.0, 1.61, 2.0
"""Length and height of the channel, and where the leaflets are [cm]."""
FINE = (1.6, 2.8)
"""Stretch of the channel with the smallest cells, where the leaflets sweep [cm]."""
PARAMETERS = quantities("""
    t_end = 3 s, E = 5.6e7 dyn/cm^2, nu = 0.4, rho = 100 g/cm^3, mu = 10 dyn*s/cm^2, thickness = 0.0212 cm,
    length = 0.7 cm, inflow = 5 1/(cm*s), nu_stab = 0.49, ratio = 1, share = 0.6
""")
"""Default and unit; ``ratio`` is element length over h, ``share`` the step over the limit measured at rest."""
SOURCE = "Kamensky et al. 2015, digitised"
SAMPLES = 600
"""Rows of the history that are wanted."""
LARGEST = {"max_dx": "largest dx of the upper tip", "max_dy": "largest dy"}
"""What is compared, and its name in the table."""


def published() -> dict[str, tuple[float, tuple[float, float]]]:
    """Return the largest displacements of the upper tip and their range over codes [cm]."""
    number = references.read("kamensky2015").value
    values = {key: [number(name, quantity=key) for name in ("value", "low", "high")] for key in LARGEST}
    return {key: (value, (low, high)) for key, (value, low, high) in values.items()}


def channel(cells: int, comm: MPI.Comm) -> MacGrid:
    """Return the grid: ``cells`` across, as fine along the channel where the leaflets sweep, graded away from there."""
    h = HEIGHT / cells
    wide = min(0.1, 4.0 * h), min(0.2, 8.0 * h)
    along = [(0.0, wide[0]), (FINE[0], h), (FINE[1], h), (LENGTH, wide[1])]
    return MacGrid.graded([graded_edges(along), graded_edges([(0.0, h), (HEIGHT, h)])], [False, False], comm)


def solid_of(mesh: SolidMesh, values: Values) -> Structure:
    """Return the leaflets of a mesh, as stiff as the published plate (collective)."""
    plate = values["E"] / (1.0 - values["nu"] ** 2)
    quadratic = Discretisation(degree=2)
    material = NeoHookean(c1=0.25 * plate)
    return Structure(mesh, material, name="leaflets", nu_stab=values["nu_stab"], discretisation=quadratic)


def build(cells: int, kernel: str, values: Values, comm: MPI.Comm) -> tuple[fsi.Model, dict[str, float]]:
    """Return the model on one grid and the limits of its step [s] (collective)."""
    grid = channel(cells, comm)
    h, size = HEIGHT / cells, (values["thickness"], values["length"])
    elements = max(1, round(0.5 * size[0] / h)), max(4, math.ceil(size[1] / (values["ratio"] * h)))
    mesh = two_leaflets(comm, root=ROOT, height=HEIGHT, size=size, elements=elements)
    strength, physics = values["inflow"], {"rho": values["rho"], "mu": values["mu"]}

    def inflow(x: Array, y: Array, z: Array, t: float) -> tuple[Array, float]:
        return strength * (math.sin(2.0 * math.pi * t) + 1.1) * y * (HEIGHT - y) + 0.0 * x * z, 0.0

    sides = Boundary(grid, {"x_lower": Wall(velocity=inflow), "x_upper": Open()})
    leaflets = Elastic(solid_of(mesh, values), Coupling(grid, kernel, sides.signs))
    model = fsi.Model(grid=grid, fluid=ExplicitViscosity(grid, sides, **physics), bodies=(leaflets,))
    limits = {
        "leaflets, measured at rest": measured_limit(model, min(step_limits(model).values()), 0),
        "viscosity, where explicit": ExplicitViscosity.limit(grid, **physics),
    }
    return replace(model, fluid=stable_fluid(grid, sides, step_of(limits, values), **physics)), limits


def step_of(limits: Mapping[str, float], values: Values) -> float:
    """Return the longest step that is taken [s]."""
    return values["share"] * limits["leaflets, measured at rest"]


class Leaflet(NamedTuple):
    """Numbers of the nodes of one of the leaflets: all, the one in the middle of its tip, its outline in order."""

    nodes: Indices
    tip: int
    outline: Indices


def leaflet_of(X: Array, size: tuple[float, float], *, upper: bool) -> Leaflet:
    """Return the leaflet that hangs from the upper wall, or stands on the lower one.

    Args:
        X: Reference positions of all nodes by number, ``(num_nodes, 3)`` [cm].
        size: Thickness and length [cm].
        upper: Which of them.
    """
    thickness, length = size
    nodes = np.flatnonzero((X[:, 1] > 0.5 * HEIGHT) == upper)
    height = HEIGHT - X[nodes, 1] if upper else X[nodes, 1]
    aside = X[nodes, 0] - ROOT
    tip = nodes[np.argmin(np.hypot(aside, height - length))]
    return Leaflet(nodes, int(tip), nodes[outline_of(height, aside, 0.5 * thickness, length)])


COLUMNS = ("upper_dx_cm", "upper_dy_cm", "lower_dx_cm", "lower_dy_cm", "gap_cm", "speed_cm_per_s")


def watch(model: fsi.Model, size: tuple[float, float], sights: Sights) -> Columns:
    """Return what sees displacements of both tips, the gap and the largest speed, and keeps speed and outlines."""
    body: Any = model.bodies[0]
    grid, solid = model.grid, body.solid
    X = gathered(solid, grid.comm, solid.X)
    lower, upper = (leaflet_of(X, size, upper=which) for which in (False, True))

    def speed(state: fsi.State) -> Array:
        return np.linalg.norm(diagnostics.cell_velocity(grid, state.u)[:, :, 0, :2], axis=2)

    def values(state: fsi.State) -> list[float]:
        chi = gathered(solid, grid.comm, state.bodies[0]["chi"])
        outlines = [chi[leaflet.outline, :2] for leaflet in (lower, upper)]
        sights.take(state, grid, lambda: (speed(state), outlines))
        tips = (chi - X)[[upper.tip, lower.tip], :2].ravel()
        return [*tips, gap(*outlines), diagnostics.fastest_place(grid, state.u)[0]]

    return Columns(COLUMNS, values)


@dataclass(frozen=True, kw_only=True)
class Valve2D(Flexible):
    """The leaflets, on one grid or on several."""

    name = "valve-2d"
    parameters = PARAMETERS

    cells: int = option(92, "Cells across the channel.", least=24)

    def check(self, values: Values) -> None:
        require(values["nu"] < 0.5, "expected below 0.5", values, "nu")
        require(values["length"] < 0.5 * HEIGHT, "the leaflets would overlap", values, "length")

    @property
    def comparable(self) -> bool:
        """Whether the published numbers are those of these leaflets, and a period is run."""
        physical = [key for key in PARAMETERS if key not in ("nu_stab", "ratio", "share", "t_end")]
        return self.values["t_end"] >= 1.0 and self.published(*physical)

    def label(self, run: int) -> str:
        return f"N = {run}"

    def simulation(self, cells: int, folder: Path, comm: MPI.Comm) -> tuple[Simulation, Sights, Record]:
        t_end, (model, limits) = self.values["t_end"], build(cells, self.kernel, self.values, comm)
        longest = step_of(limits, self.values)
        steps = max(3, math.ceil(t_end / longest))
        sights = Sights([min(steps, round(t / t_end * steps)) for t in snapshot_times(t_end)])
        observers = (watch(model, (self.values["thickness"], self.values["length"]), sights),)
        more: dict[str, Any] = {"observers": observers, "provenance": self.values | {"kernel": self.kernel}}
        simulation = fixed_steps(model, folder, t_end / steps, steps, rows=SAMPLES, **more)
        spacing = [float(h) for h in model.grid.spacing[:2]]
        return simulation, sights, {"spacing": spacing, "dt": longest, "limits": limits}

    def read_off(self, h: History) -> Record:
        return {"quantities": numbers(h)}

    def pictures(self, cells: int, folder: Path, h: History, snapshots: Sequence[dict[str, Any]]) -> None:
        name = f"Two leaflets in a channel, {cells} cells across, {self.kernel}"
        curves = {key.removesuffix("_cm"): h[key] for key in COLUMNS} | {"t": h["t_s"]}
        tips(folder / "tips.png", curves, published(), name)
        if snapshots:
            in_the_flow(folder / "flow.png", snapshots, title=name)

    def report(self, records: Sequence[Record], reference: None) -> Report:
        codes = {key: {"value": value, "range": band} for key, (value, band) in published().items()}
        report = super().report(records, None)
        parameters = {**report.parameters, "grids": self.runs()}
        return replace(report, parameters=parameters, reference=codes | {"source": SOURCE})

    def lines(self, r: Record) -> list[Row]:
        q, name, lines = r["quantities"], f"N = {r['cells']}", []
        for key, (value, (low, high)) in published().items():
            codes = (value, f"{SOURCE}; over codes {low} ... {high}") if self.comparable else (None, "")
            lines.append(row(f"{LARGEST[key]}, {name}", q[key], *codes, unit="cm"))
        still: dict[str, Any] = {"reference": 0.0, "source": "incompressible", "relative": False}
        return [
            *lines,
            row("  smallest gap between the leaflets", q["smallest_gap"], unit="cm"),
            row("  largest difference of the mirrored tips", q["asymmetry"], unit="cm"),
            row("  relative change of area", q["area_change"], **still),
            row("  largest |J - 1|", q["largest_J_off"], **still),
            row("  time of a step", r["step_ms"], source=cost(r), unit="ms"),
        ]


def snapshot_times(t_end: float) -> Array:
    """Times of the pictures: five of the last period, or of the whole run where that is shorter [s]."""
    return t_end - min(1.0, t_end) * (1.0 - np.array([0.2, 0.4, 0.6, 0.8, 1.0]))


def numbers(h: History) -> dict[str, float]:
    """Read extremes off a history: displacements of the upper tip, gap, asymmetry, area and J."""
    dx, dy = h["upper_dx_cm"], h["upper_dy_cm"]
    apart = np.hypot(dx - h["lower_dx_cm"], dy + h["lower_dy_cm"])
    area = 1e-2 * h["leaflets_area_change_percent"]
    return {
        "max_dx": float(dx.max()),
        "max_dy": float(dy.max()),
        "t_max_dx": float(h["t_s"][np.argmax(dx)]),
        "min_dx": float(dx.min()),
        "min_dy": float(dy.min()),
        "smallest_gap": float(h["gap_cm"].min()),
        "asymmetry": float(apart.max()),
        "area_change": float(area[np.argmax(np.abs(area))]),
        "largest_J_off": off_one(h, "leaflets"),
        "largest_speed": float(h["speed_cm_per_s"].max()),
    }
