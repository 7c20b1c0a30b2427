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
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.benchmarks import references
from valvefsi.benchmarks.frame import Benchmark, Job, Record, Report, public, refined
from valvefsi.benchmarks.options import Values, option, quantities, require
from valvefsi.benchmarks.results import Row, row
from valvefsi.benchmarks.running import (
    History,
    Sights,
    Snapshot,
    attempt,
    fixed_steps,
    gathered,
    off_one,
    outline_of,
)
from valvefsi.bodies.elastic import Elastic
from valvefsi.coupling.kernels import KERNELS
from valvefsi.coupling.transfer import Coupling
from valvefsi.fluid.boundary import Boundary, Open, Wall
from valvefsi.fluid.navier_stokes import ExplicitViscosity, NavierStokes
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
from valvefsi.types import Array

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
REFINEMENT, SAMPLES = 1.5, 600
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


def solid_of(mesh: SolidMesh, values: Values, kernel: str) -> Structure:
    """Return the leaflets of a mesh, as stiff as the published plate (collective)."""
    plate = values["E"] / (1.0 - values["nu"] ** 2)
    quadratic = Discretisation(degree=2)
    material = NeoHookean(c1=0.25 * plate)
    return Structure(mesh, material, name="leaflets", nu_stab=values["nu_stab"], discretisation=quadratic)


@dataclass(frozen=True)
class Built:
    """A model, the length of a step and its limits [s]."""

    model: fsi.Model
    dt: float
    limits: dict[str, float]


def build(cells: int, kernel: str, values: Values, comm: MPI.Comm) -> Built:
    """Return the model on one grid (collective)."""
    grid = channel(cells, comm)
    h, thickness, length = HEIGHT / cells, values["thickness"], values["length"]
    elements = max(1, round(0.5 * thickness / h)), max(4, math.ceil(length / (values["ratio"] * h)))
    solid = solid_of(
        two_leaflets(comm, root=ROOT, height=HEIGHT, size=(thickness, length), elements=elements),
        values,
        kernel,
    )
    rho, mu, strength = values["rho"], values["mu"], values["inflow"]

    def inflow(x: Array, y: Array, z: Array, t: float) -> tuple[Array, float]:
        return strength * (math.sin(2.0 * math.pi * t) + 1.1) * y * (HEIGHT - y) + 0.0 * x * z, 0.0

    sides = Boundary(grid, {"x_lower": Wall(velocity=inflow), "x_upper": Open()})
    coupling = Coupling(grid, kernel, sides.signs)
    explicit = ExplicitViscosity(grid, sides, rho=rho, mu=mu)
    model = fsi.Model(grid=grid, fluid=explicit, bodies=(Elastic(solid, coupling),))
    limits = {
        "leaflets, measured at rest": measured_limit(model, min(step_limits(model).values()), 0),
        "viscosity, where explicit": ExplicitViscosity.limit(grid, rho=rho, mu=mu),
    }
    dt = values["share"] * limits["leaflets, measured at rest"]
    if 2.0 * dt >= limits["viscosity, where explicit"]:
        fluid = NavierStokes(grid, sides, rho=rho, mu=mu)
        model = fsi.Model(grid=grid, fluid=fluid, bodies=(Elastic(solid, coupling),))
    return Built(model, dt, limits)


class Leaflet:
    """One of the leaflets among the nodes of the solid: its tip and its outline.

    Args:
        X: Reference positions of all nodes by number, ``(num_nodes, 3)`` [cm].
        upper: Whether it hangs from the upper wall.
        size: Thickness and length [cm].

    Attributes:
        tip: Number of the node in the middle of its end.
        nodes: Numbers of its nodes.
        root: Numbers of the nodes at its root.
        outline: Numbers of the nodes on its outline, in order.
    """

    def __init__(self, X: Array, upper: bool, size: tuple[float, float]) -> None:
        thickness, length = size
        self.nodes = np.flatnonzero((X[:, 1] > 0.5 * HEIGHT) == upper)
        own = X[self.nodes]
        height = HEIGHT - own[:, 1] if upper else own[:, 1]
        aside = own[:, 0] - ROOT
        self.tip = int(self.nodes[np.argmin(np.hypot(aside, height - length))])
        self.root = self.nodes[height < height.min() + 1e-6]
        self.outline = self.nodes[outline_of(height, aside, 0.5 * thickness, length)]


@dataclass
class Watch:
    """Sees tips, gap and the largest speed, and keeps the flow at some steps for a picture (collective).

    Attributes:
        model: The model of `build`.
        size: Thickness and length of a leaflet [cm].
        sights: Snapshots.
    """

    model: fsi.Model
    size: tuple[float, float]
    sights: Sights = field(default_factory=lambda: Sights([]))
    columns = ("upper_dx_cm", "upper_dy_cm", "lower_dx_cm", "lower_dy_cm", "gap_cm", "speed_cm_per_s")

    def __post_init__(self) -> None:
        """Find the leaflets among the nodes."""
        body: Any = self.model.bodies[0]
        self.solid: Structure = body.solid
        self.X = gathered(self.solid, self.model.grid.comm, self.solid.X)
        self.lower, self.upper = (Leaflet(self.X, upper, self.size) for upper in (False, True))

    def row(self, state: fsi.State) -> dict[str, float]:
        """Return displacements of both tips, the gap and the largest component of the velocity (collective)."""
        chi = gathered(self.solid, self.model.grid.comm, state.bodies[0]["chi"])
        tips = [*(chi - self.X)[self.upper.tip, :2], *(chi - self.X)[self.lower.tip, :2]]
        outlines = [chi[leaflet.outline, :2] for leaflet in (self.lower, self.upper)]
        speed, _ = diagnostics.fastest_place(self.model.grid, state.u)
        self.sights.take(state, self.model.grid, lambda: (self._speed(state), outlines))
        return dict(zip(self.columns, map(float, (*tips, gap(*outlines), speed)), strict=True))

    def _speed(self, state: fsi.State) -> Array:
        velocity: Array = diagnostics.cell_velocity(self.model.grid, state.u)[:, :, 0, :2]
        return np.linalg.norm(velocity, axis=2)


@dataclass(frozen=True, kw_only=True)
class Valve2D(Benchmark[int, None]):
    """The leaflets, on one grid or on several, each 1.5 times as fine as the one before."""

    name = "valve-2d"
    resumable = True
    parameters = PARAMETERS

    cells: int = option(92, "Cells across the channel.", least=24)
    t_end: float | None = option(None, "End of the run [s], as --set t_end.", between=(0.0, math.inf))
    refine: int = option(0, "Number of finer grids, each 1.5 times as fine.", least=0, most=4)
    kernel: str = option("bspline3", "Kernel of the coupling.", choices=tuple(KERNELS))

    def check(self, values: Values) -> None:
        require(values["nu"] < 0.5, "expected below 0.5", values, "nu")
        require(values["length"] < 0.5 * HEIGHT, "the leaflets would overlap", values, "length")

    @property
    def comparable(self) -> bool:
        """Whether the published numbers are those of these leaflets, and a period is run."""
        physical = [key for key in PARAMETERS if key not in ("nu_stab", "ratio", "share", "t_end")]
        return self.values["t_end"] >= 1.0 and self.published(*physical)

    def runs(self) -> list[int]:
        return refined(self.cells, self.refine, REFINEMENT)

    def label(self, run: int) -> str:
        return f"N = {run}"

    def place(self, run: int, out: Path) -> Path:
        return out / f"N{run}"

    def simulation(self, built: Built, job: Job) -> tuple[Simulation, Watch]:
        t_end = self.values["t_end"]
        steps = max(3, math.ceil(t_end / built.dt))
        dt, size = t_end / steps, (self.values["thickness"], self.values["length"])
        due = [min(steps, round(t / dt)) for t in snapshot_times(t_end)]
        watch = Watch(built.model, size, Sights(due))
        simulation = fixed_steps(
            built.model,
            job.folder,
            dt,
            steps,
            rows=SAMPLES,
            observers=(watch,),
            provenance=self.values | {"kernel": self.kernel},
        )
        return simulation, watch

    def one(self, run: int, job: Job) -> Record:
        begin, built = time.perf_counter(), build(run, self.kernel, self.values, job.comm)
        simulation, watch = self.simulation(built, job)
        end = attempt(simulation, job)
        grid, steps = built.model.grid, int(end.history["step"][-1])
        if job.comm.rank == 0:
            self._pictures(run, job.folder, end.history, watch.sights.snapshots)
        return {
            "cells": run,
            "grid": list(grid.cells[:2]),
            "spacing": [float(h) for h in grid.spacing[:2]],
            "nodes": built.model.bodies[0].num_points,
            "dt": built.dt,
            "limits": built.limits,
            "steps": steps,
            "failed": end.failed,
            "quantities": numbers(end.history),
            "step_ms": 1e3 * (time.perf_counter() - begin) / max(1, end.steps),
        }

    def _pictures(self, cells: int, folder: Path, h: History, snapshots: Sequence[Snapshot]) -> None:
        name = f"Two leaflets in a channel, {cells} cells across, {self.kernel}"
        curves = {key.removesuffix("_cm"): h[key] for key in Watch.columns} | {"t": h["t_s"]}
        tips(folder / "tips.png", curves, published(), name)
        if snapshots:
            in_the_flow(folder / "flow.png", [vars(s) for s in snapshots], title=name)

    def report(self, records: Sequence[Record], reference: None) -> Report:
        options = {"kernel": self.kernel, "grids": self.runs()}
        codes = {key: {"value": value, "range": band} for key, (value, band) in published().items()}
        return Report(
            parameters=self.values | options,
            quantities={r["cells"]: r["quantities"] for r in records},
            reference=codes | {"source": SOURCE},
            more={"runs": [public(r) for r in records]},
            table=[line for r in records for line in self._lines(r)],
        )

    def _lines(self, r: Record) -> list[Row]:
        q, name = r["quantities"], f"N = {r['cells']}"
        lines = [row(name, "broke down", source=r["failed"][:90])] if r["failed"] else []
        for key, (value, (low, high)) in published().items():
            codes = (value, f"{SOURCE}; over codes {low} ... {high}") if self.comparable else (None, "")
            lines.append(row(f"{LARGEST[key]}, {name}", q[key], *codes, unit="cm"))
        still: dict[str, Any] = {"reference": 0.0, "source": "incompressible", "relative": False}
        cost = f"dt = {r['dt']:.3g} s, {r['steps']} steps, {r['grid'][0]} x {r['grid'][1]} cells"
        return [
            *lines,
            row("  smallest gap between the leaflets", q["smallest_gap"], unit="cm"),
            row("  largest difference of the mirrored tips", q["asymmetry"], unit="cm"),
            row("  relative change of area", q["area_change"], **still),
            row("  largest |J - 1|", q["largest_J_off"], **still),
            row("  time of a step", r["step_ms"], source=cost, unit="ms"),
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
