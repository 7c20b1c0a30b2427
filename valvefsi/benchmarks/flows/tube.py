"""Flow in a straight tube of held points, at any angle to the grid, from rest to long after it has settled.

The tube goes through a periodic box along a direction in which box and tube meet again: along z, or in the plane of x
and z with the ratio of whole numbers as tangent. A force along the axis drives the fluid in it. From rest the mean
speed over the one of the parabola is, with the zeros z_k of the Bessel function J_0,

    Q(t) / Q_final = 1 - sum_k 32 / z_k^4 exp(-z_k^2 nu t / R^2)          (Szymanski 1932)

which has settled to 1 % after some R^2 / (5.78 nu) times five. The points lie outside the tube by the kernel's offset,
`valvefsi.coupling.offsets`. ``wall=points`` holds them one by one: then the wall thickens for as long as the run lasts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.benchmarks.frame import Job, Report, Single
from valvefsi.benchmarks.options import Values, option, quantities, read_quantities, require
from valvefsi.benchmarks.results import row
from valvefsi.benchmarks.running import Columns, completed, fixed_steps
from valvefsi.bodies.patches import PatchedSurface
from valvefsi.bodies.rigid import explicit_springs
from valvefsi.coupling.kernels import BSPLINE, KERNELS
from valvefsi.coupling.offsets import surface_offset
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import CaseError
from valvefsi.fluid.boundary import Boundary
from valvefsi.fluid.navier_stokes import ExplicitViscosity
from valvefsi.geometry.aortic_section import SPACING, PointSurface
from valvefsi.geometry.patches import SINGLE, patch_labels
from valvefsi.grid import MacGrid
from valvefsi.post.plots.tube import start_up_flow
from valvefsi.types import Array, Faces
from valvefsi.verification.closed_forms import FINAL, start_up

PARAMETERS = quantities(
    "radius = 1.25 cm, relaxation = 0.1 s, t_end = 6 s, step = 0.8, hold = 0.25, shift = 0.1",
    wall=("patches", ("patches", "points")),
    kernel=("composite_bspline32", tuple(name for name, kind in KERNELS.items() if kind[0] == BSPLINE)),
)
DIRECTIONS = {0: (0, 1), 20: (4, 11), 45: (1, 1)}
"""Cells along x and z after which the axis comes back to the same place, by angle to z in degrees (20: 19.98)."""
MARGIN = 5.0
"""Least distance of the tube from its next image, in spacings."""


@dataclass(frozen=True, kw_only=True)
class Axis:
    """Where the tube lies in its box.

    Attributes:
        cells: Cells of the box.
        h: Grid spacing [cm].
        frame: Unit vectors along the axis and two across it, ``(3, 3)``.
        length: Length of the axis in the box [cm].
        through: A point on it, ``(3,)`` [cm].
        radius: Radius of the tube [cm].
    """

    cells: tuple[int, int, int]
    h: float
    frame: Array
    length: float
    through: Array
    radius: float

    def distance(self, x: Faces) -> Array:
        """Distance of places from the nearest image of the axis [cm]."""
        box = self.h * np.array(self.cells)
        nearest: Array = np.full(1, np.inf)
        for image in np.ndindex(3, 3, 3):
            at = [c - o for c, o in zip(x, self.through + (np.array(image) - 1.0) * box, strict=True)]
            across = [sum(e * c for e, c in zip(unit, at, strict=True)) for unit in self.frame[1:]]
            nearest = np.minimum(nearest, np.hypot(*across))
        return nearest

    def surface(self) -> PointSurface:
        """Return the tube's points, at most half a spacing apart."""
        rows = 2 * math.ceil(self.length / (2.0 * SPACING * self.h))
        around = math.ceil(2.0 * math.pi * self.radius / (SPACING * self.h))
        turned = 0.5 * (np.arange(rows)[:, None] % 2)
        phi = (2.0 * math.pi / around * (np.arange(around) + turned)).ravel()
        along = np.repeat(self.length / rows * np.arange(rows), around)
        normals = np.outer(np.cos(phi), self.frame[1]) + np.outer(np.sin(phi), self.frame[2])
        area = 2.0 * math.pi * self.radius * self.length / len(phi)
        return PointSurface(
            points=self.through + np.outer(along, self.frame[0]) + self.radius * normals,
            areas=np.full(len(phi), area),
            normals=normals,
            faces=np.zeros((0, 4), dtype=np.int64),
        )


def axis_at(angle: int, h: float, values: Values) -> Axis:
    """Return the tube's place in the smallest periodic box; shifted against the grid by ``shift`` and half of it."""
    i, k = DIRECTIONS[angle]
    apart = math.ceil(2.0 * values["radius"] / h + MARGIN)
    times = math.ceil(apart * math.hypot(i, k) / (i * k)) if i else 4
    cells = (i * times or apart, apart, k * times)
    tangent = np.array([i, 0.0, k]) / math.hypot(i, k)
    across = np.array([tangent[2], 0.0, -tangent[0]])
    middle = 0.5 * h * np.array(cells) * (1.0, 1.0, 0.0)
    return Axis(
        cells=cells,
        h=h,
        frame=np.stack([tangent, across, [0.0, 1.0, 0.0]]),
        length=h * times * math.hypot(i, k),
        through=middle + h * values["shift"] * np.array([1.0, 0.5, 0.0]),
        radius=values["radius"],
    )


class DrivenFluid(ExplicitViscosity):
    """A fluid with a constant force density on it, ``drive`` [dyn/cm^3]."""

    drive: Faces = ()

    def step(
        self, u: Faces, p: Array, advection: Any, f: Faces, *rest: Any, **more: Any
    ) -> tuple[Faces, Array]:
        """Advance by one step, see `NavierStokes.step`."""
        for force, constant in zip(f, self.drive, strict=True):
            force += constant
        return super().step(u, p, advection, f, *rest, **more)


def build(angle: int, h: float, values: Values, comm: MPI.Comm) -> tuple[fsi.Model, Faces, float]:
    """Return the model, the weights whose product with the velocity is the flow over the final one, and the step [s].

    Note:
        Collective.
    """
    axis, R = axis_at(angle, h, values), values["radius"]
    grid = MacGrid([0.0] * 3, [h * n for n in axis.cells], axis.cells, [True] * 3, comm)
    mu = R**2 / (FINAL * values["relaxation"])  # the density is 1 g/cm^3
    dt = values["step"] * ExplicitViscosity.limit(grid, rho=1.0, mu=mu)
    inside = [np.clip(0.5 + (R - axis.distance(grid.points(d))) / h, 0.0, 1.0) for d in range(3)]
    fluid = DrivenFluid(grid, Boundary(grid, {}), rho=1.0, mu=mu)
    fluid.drive = tuple(8.0 * mu / R**2 * axis.frame[0, d] * inside[d] for d in range(3))
    part = h**3 / (axis.length * math.pi * R**2)  # the final mean speed is 1 cm/s
    weights = tuple(part * axis.frame[0, d] * inside[d] for d in range(3))
    surface, kernel = axis.surface(), values["kernel"]
    labels = (
        patch_labels([surface], h) if values["wall"] == "patches" else np.full(len(surface.points), SINGLE)
    )
    surface = surface.moved(h * surface_offset(kernel, surface.normals, tuple(axis.frame[0])))
    hold = explicit_springs(kernel, h, dt, values["hold"])
    wall = PatchedSurface(surface, labels, Coupling(grid, kernel), name="tube", **hold)
    return fsi.Model(grid=grid, fluid=fluid, bodies=(wall,)), weights, dt


def flow_over_final(model: fsi.Model, weights: Faces, relaxation: float) -> Columns:
    """Return what reads off the flow over the final one, and how far it is off the series [% of the final flow]."""
    grid = model.grid

    def values(state: fsi.State) -> tuple[float, float]:
        places = [grid.owned_faces(d) for d in range(3)]
        here = sum(np.vdot(w[o], u[o]) for w, u, o in zip(weights, state.u, places, strict=True))
        flow = float(grid.comm.allreduce(here))
        return flow, 100.0 * (flow - float(start_up(np.array(state.t), relaxation)))

    return Columns(("flow_over_final", "flow_error_percent"), values)


@dataclass(frozen=True, kw_only=True)
class Tube(Single):
    """Flow in a tube of held points, from rest until long after it has settled."""

    name = "tube"
    resumable = True
    parameters = PARAMETERS

    grid: str = option("1 mm", "Grid spacing; the tube is 25 mm wide.", metavar="H")
    angle: int = option(0, "Angle of the tube to the grid [degrees].", choices=tuple(DIRECTIONS))

    def check(self, values: Values) -> None:
        if not self.spacing > 0.0:
            raise CaseError("expected a positive length", key="--grid", value=self.grid)
        for key in ("step", "hold"):
            require(values[key] <= 1.0, "expected a part of the limit, at most 1", values, key)

    @property
    def spacing(self) -> float:
        """Grid spacing [cm]."""
        return read_quantities({"grid": (0.1, "cm")}, [f"grid={self.grid}"])["grid"]

    @property
    def across(self) -> float:
        """Spacings across the tube."""
        return 2.0 * self.values["radius"] / self.spacing

    def measured(self, job: Job) -> Report:
        values, unit = self.values, "% of the final flow"
        model, weights, dt = build(self.angle, self.spacing, values, job.comm)
        steps = max(4, math.ceil(values["t_end"] / dt))
        simulation = fixed_steps(
            model,
            job.folder,
            dt,
            steps,
            rows=600,
            observers=(flow_over_final(model, weights, values["relaxation"]),),
            provenance={**values, "grid": self.spacing, "angle": self.angle},
        )
        h = completed(simulation, job)
        t, flow, error = (h[name] for name in ("t_s", "flow_over_final", "flow_error_percent"))
        middle, last = np.interp([0.5 * t[-1], t[-1]], t, error)
        numbers = {
            "flow_error_percent": float(last),
            "largest_flow_error_percent": float(np.abs(error).max()),
            "drift_percent": float(last - middle),
        }
        swing = float(np.ptp(error[t > 0.5 * t[-1]]))
        return Report(
            parameters={**values, "h": self.spacing, "angle": self.angle},
            quantities=numbers,
            more={"size": {"cells": list(model.grid.cells), "across": self.across}},
            table=[
                row("flow, error at the end", numbers["flow_error_percent"], unit=unit),
                row("largest error, start-up included", numbers["largest_flow_error_percent"], unit=unit),
                row("change of the error over the second half", swing, unit=unit),
            ],
            timing={"steps": steps},
            draw=lambda out: self._draw(out, t, flow, error),
        )

    def _draw(self, out: Path, t: Array, flow: Array, error: Array) -> None:
        """Draw the flow over the series, and how far it is off."""
        exact = start_up(t, self.values["relaxation"])
        title = f"Tube of held points, {self.across:.3g} cells across, {self.angle} degrees to the grid"
        start_up_flow(out / "flow.png", (t[1:], flow[1:], exact[1:], error[1:]), title=title)
