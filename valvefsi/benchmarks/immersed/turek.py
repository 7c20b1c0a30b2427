"""A flag behind a cylinder (Turek and Hron 2006): how a stream makes it swing, and the forces on both.

A channel of 250 x 41 cm, a cylinder of radius 5 at (20, 20), a flag 35 long and 2 thick from it to A = (60, 20). Inflow
1.5 U 4 y (H - y) / H^2, raised over the ramp as (1 - cos) / 2; rho = 1, nu = 10 cm^2/s; the right side is open.

Here the flag is immersed, which differs from the published set-up in this:

- It is incompressible and neo-Hookean, there compressible (nu = 0.4) and St. Venant-Kirchhoff. Its modulus is chosen
  such that the plate stiffness is the same, c1 = E / (4 (1 - nu^2)) = mu_s / (2 (1 - nu)); ``--set nu=0.5`` gives
  c1 = mu_s instead, a plate 1.2 times as stiff. Strains are a few per cent, so that the law matters little; the flag
  cannot change its area, which moves the tip along x at second order only.
- The fluid keeps the area of what a kernel covers, not of the flag's layers: with ``nu_stab=0.4`` a flag of four cells
  bends 1.06 times as softly as with 0.49.
- Where it is heavier than the fluid (FSI2, rho_s = 10 rho), markers at its nodes carry the difference, see
  `valvefsi.bodies.heavy`.
- It carries the fluid's viscosity, small against its elastic stress (mu omega / mu_s is about 2e-5).
- Surfaces are as thick as the kernel: cylinder and flag act larger by a fraction of h, which the drag feels most. The
  flag goes on into the cylinder and is held there by springs: the clamp gives way a little (``clamp_cm``).

The forces are those of the fluid on cylinder and flag, see `valvefsi.run.forces`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.benchmarks import references
from valvefsi.benchmarks.frame import Record, Report
from valvefsi.benchmarks.immersed.study import Flexible, cost
from valvefsi.benchmarks.options import Values, changed, option, quantities, read_parameters, require
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
from valvefsi.bodies.heavy import Heavy
from valvefsi.bodies.rigid import RigidSurface
from valvefsi.coupling.transfer import Coupling
from valvefsi.fluid.boundary import Boundary, Open, Wall
from valvefsi.fluid.navier_stokes import stable_fluid
from valvefsi.geometry.flow_shapes import flag as flag_mesh
from valvefsi.grid import MacGrid
from valvefsi.grid.grading import graded_edges
from valvefsi.post import diagnostics
from valvefsi.post.diagnostics.signals import oscillation, whole_periods
from valvefsi.post.plots.turek import histories, vorticity
from valvefsi.run.forces import ForceOutput
from valvefsi.run.recording import Probe
from valvefsi.run.simulation import Simulation
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
    grid, h, c1 = channel(cells, comm), THICKNESS / cells, plate_modulus(values)
    rho, mu, size = values["rho"], values["mu"], values["ratio"] * h
    wave = math.sqrt((kappa_stab(c1, values["nu_stab"]) + 4.0 / 3.0 * c1) / rho)
    elastic = 0.5 * size / (math.sqrt(2.0) * wave)
    dt = min(values["share"] * elastic, 0.3 * h / (2.5 * values["U"]))  # or a Courant number of 0.3 at 2.5 U
    hold = {"stiffness": values["hold"] * rho / dt**2, "damping": values["hold"] * rho / dt}
    flag = Structure(
        flag_mesh(comm, along=(ROOT, CLAMP, TIP), thickness=THICKNESS, centre=CENTRE[1], size=size),
        NeoHookean(c1=c1),
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
        fluid=stable_fluid(grid, sides, dt, rho=rho, mu=mu, advection="xsppm7"),
        bodies=(body, cylinder),
    )
    return model, dt


PARAMETERS = quantities("""
    t_end = 8 s, U = 200 cm/s, mu_s = 2e7 dyn/cm^2, nu = 0.4, rho = 1 g/cm^3, rho_s = 1 g/cm^3, mu = 10 dyn*s/cm^2,
    ramp = 2 s, nu_stab = 0.49, ratio = 2, share = 4.5, hold = 0.5, pace = 0.02
""")
"""Default and unit. ``ratio`` is the length of a quadratic element over h, ``share`` the step over the elastic limit
of nodes that move alone, ``hold`` the springs of cylinder and clamp over rho/dt^2 and their dampers over rho/dt,
``pace`` the part of its way back that a point of the cylinder slips through the fluid in a step: without it springs
whose forces cancel in the kernel drift, the drag with them, and the flag swings faster."""
CASES = {
    "fsi1": {"U": 20.0, "mu_s": 5e6, "rho_s": 1.0},
    "fsi2": {"U": 100.0, "mu_s": 5e6, "rho_s": 10.0},
    "fsi3": {"U": 200.0, "mu_s": 2e7, "rho_s": 1.0},
}
PERIODS = {"fsi1": 0.5, "fsi2": 0.5, "fsi3": 1.0 / 5.3}
"""Published period of the flag, of FSI1 that of FSI2 [s]."""
SOURCE = "Turek and Hron 2006"
SAMPLES, SAVED = 200, 400
"""Rows of the history in a published period, rows between checkpoints."""
SIGNALS = {
    "ux": ("u_x_tip_cm", 10.0),
    "uy": ("u_y_tip_cm", 10.0),
    "drag": ("force_x_bodies_dyn_per_cm", 1e-3),
    "lift": ("force_y_bodies_dyn_per_cm", 1e-3),
}
"""Column of each published signal and the factor to mm and N/m."""
LABELS = (("ux", "ux(A)", "mm"), ("uy", "uy(A)", "mm"), ("drag", "drag", "N/m"), ("lift", "lift", "N/m"))
PARTS = ("mean", "amplitude", "frequency")


def published(case: str) -> dict[str, tuple[float, ...]]:
    """Return mean, amplitude and frequency of the displacement of A [mm] and the forces [N/m]; FSI1 is steady."""
    table = references.read("turek_hron2006")
    return {key: tuple(table.value(part, case=case, signal=key) for part in PARTS) for key in SIGNALS}


def watch(model: fsi.Model, sights: Sights) -> Columns:
    """Return what sees the largest displacement of the clamp and the largest speed, and keeps vorticity and flag."""
    flag: Any = model.bodies[0]
    grid, solid = model.grid, flag.solid

    def look(state: fsi.State) -> tuple[Array, list[Array]]:
        X, chi = (gathered(solid, grid.comm, x) for x in (solid.X, state.bodies[0]["chi"]))
        free = np.flatnonzero(X[:, 0] > CLAMP - 1e-6)
        around = free[outline_of(X[free, 0], X[free, 1] - CENTRE[1], 0.5 * THICKNESS, TIP)]
        return diagnostics.vorticity(grid, state.u)[:, :, 0, 2], [chi[around, :2]]

    def values(state: fsi.State) -> tuple[float, float]:
        root = flag.X[:, 0] < CLAMP + 1e-6
        shift = np.linalg.norm((state.bodies[0]["chi"] - flag.X)[root], axis=1).max(initial=0.0)
        speed, _ = diagnostics.fastest_place(grid, state.u)
        sights.take(state, grid, lambda: look(state))
        return grid.comm.allreduce(float(shift), op=MPI.MAX), speed

    return Columns(("clamp_cm", "speed_cm_per_s"), values)


@dataclass(frozen=True, kw_only=True)
class TurekFsi(Flexible):
    """The flag, on one grid or on several."""

    name = "turek-fsi"
    parameters = PARAMETERS

    case: str = option("fsi3", "fsi1 (steady), fsi2 (a heavy flag) or fsi3.", choices=tuple(CASES))
    cells: int = option(4, "Cells across the flag.", least=2)

    @property
    def folder(self) -> str:
        return f"turek-{self.case}"

    def read(self) -> Values:
        return self.ended(read_parameters(changed(PARAMETERS, **CASES[self.case]), self.overrides))

    def check(self, values: Values) -> None:
        for key in ("nu", "nu_stab"):
            require(values[key] < 0.5 + 1e-12 * (key == "nu"), "expected at most 0.5", values, key)
        message = f"expected the fluid's density, {values['rho']:g} g/cm^3, or more"
        require(values["rho_s"] >= values["rho"], message, values, "rho_s")

    @property
    def comparable(self) -> bool:
        """Whether the published numbers are those of this flag: nothing physical was changed."""
        physical = CASES[self.case] | {key: PARAMETERS[key][0] for key in ("rho", "mu")}
        return all(self.values[key] == value for key, value in physical.items())

    def label(self, run: int) -> str:
        return f"{self.case}, {run} cells across the flag"

    def simulation(self, cells: int, folder: Path, comm: MPI.Comm) -> tuple[Simulation, Sights, Record]:
        model, dt = build(cells, self.kernel, self.values, comm)
        period = PERIODS[self.case]
        physical = {key: value for key, value in self.values.items() if key != "t_end"}
        steps, every = math.ceil(self.values["t_end"] / dt - 1e-6), max(1, round(period / SAMPLES / dt))
        sights = Sights([max(1, steps - round(part * period / dt)) for part in (0.5, 0.25, 0.0)])
        simulation = fixed_steps(
            model,
            folder,
            dt,
            steps,
            rows=steps,
            history_every=every,
            checkpoint_every=SAVED * every,
            checkpoint_wall_s=0.0,
            probes=(Probe(name="tip", body=0, at=(TIP, CENTRE[1])),),
            forces=(ForceOutput(name="bodies", bodies=(0, 1)),),
            observers=(watch(model, sights),),
            provenance=physical | {"case": self.case, "cells": cells, "kernel": self.kernel},
        )
        return simulation, sights, {"h": THICKNESS / cells, "points": model.bodies[1].num_points}

    def read_off(self, h: History) -> Record:
        t, curves = signals(h)
        periods = whole_periods(t, h["u_y_tip_cm"][1:]) if len(t) else None
        quantities = {
            key: dict(zip(PARTS, oscillation(t, x, periods) if len(t) else (math.nan,) * 3, strict=True))
            for key, x in curves.items()
        }
        clamp = 10.0 * float(h["clamp_cm"].max())
        return {"quantities": quantities, "clamp_mm": clamp, "J_off": off_one(h, "flag")}

    def pictures(self, cells: int, folder: Path, h: History, snapshots: Sequence[dict[str, Any]]) -> None:
        name = f"{self.case.upper()}, {cells} cells across the flag, {self.kernel}"
        expected, (t, curves) = published(self.case) if self.comparable else {}, signals(h)
        if len(t):
            histories(folder / "history.png", t, curves, expected, title=name)
        if snapshots:
            scale, body = 4.0 * self.values["U"] / RADIUS, (*CENTRE, RADIUS)
            vorticity(folder / "vorticity.png", snapshots, body, scale=scale, title=name)

    def report(self, records: Sequence[Record], reference: None) -> Report:
        report = super().report(records, None)
        parameters = {**report.parameters, "case": self.case}
        return replace(report, parameters=parameters, reference=published(self.case) | {"source": SOURCE})

    def lines(self, r: Record) -> list[Row]:
        lines = []
        for key, label, unit in LABELS:
            for what, value in zip(PARTS, published(self.case)[key], strict=True):
                # A steady case has neither amplitude nor frequency, a mean that is next to nothing no per cent.
                compared = (value, SOURCE) if self.comparable and abs(value) > 0.0 else (None, "")
                name = f"{label}, {what}, {r['cells']} cells" if what == "mean" else f"  {what}"
                kind = {"unit": "1/s" if what == "frequency" else unit}
                relative = what != "mean" or key == "drag"
                lines.append(row(name, r["quantities"][key][what], *compared, **kind, relative=relative))
        return [
            *lines,
            row("  largest displacement of the clamp", r["clamp_mm"], unit="mm"),
            row("  largest |J - 1|", r["J_off"], 0.0, "incompressible", relative=False),
            row("  wall-clock time of this call", r["wall_s"], source=cost(r), unit="s"),
        ]


def signals(h: History) -> tuple[Array, dict[str, Array]]:
    """Return times [s], displacements [mm] and forces [N/m] of a history without its first row, ``(n,)`` each.

    The first row has no forces: they are means since the row before.
    """
    return h["t_s"][1:], {key: factor * h[column][1:] for key, (column, factor) in SIGNALS.items()}
