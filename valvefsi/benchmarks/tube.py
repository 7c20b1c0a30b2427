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
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mpi4py import MPI
from scipy.special import jn_zeros

from valvefsi import fsi
from valvefsi.benchmarks.parameters import read_parameters
from valvefsi.benchmarks.results import environment, row, write_result
from valvefsi.bodies.patches import PatchedSurface
from valvefsi.coupling.kernels import BSPLINE, KERNELS, largest_square_sum
from valvefsi.coupling.offsets import surface_offset
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import CaseError
from valvefsi.fluid.boundary import Boundary
from valvefsi.fluid.navier_stokes import ExplicitViscosity
from valvefsi.geometry.aortic_section import SPACING, PointSurface
from valvefsi.geometry.patches import SINGLE, patch_labels
from valvefsi.grid import MacGrid
from valvefsi.types import Array, Faces, Progress

PARAMETERS = {
    "h": (0.1, "cm"),
    "radius": (1.25, "cm"),
    "relaxation": (0.1, "s"),
    "t_end": (6.0, "s"),
    "step": (0.8, "1"),
    "hold": (0.25, "1"),
    "shift": (0.1, "1"),
    "wall": ("patches", ("patches", "points")),
    "kernel": ("composite_bspline32", tuple(name for name, kind in KERNELS.items() if kind[0] == BSPLINE)),
}
DIRECTIONS = {0: (0, 1), 20: (4, 11), 45: (1, 1)}
"""Cells along x and z after which the axis comes back to the same place, by angle to z in degrees (20: 19.98)."""
MARGIN = 5.0
"""Least distance of the tube from its next image, in spacings."""
FINAL = 5.783185962946785
"""Square of the first zero of J_0: R^2 / (FINAL nu) is the time in which the flow settles."""
TIMES = 60
"""Terms of the series."""


def start_up(t: Array, relaxation: float) -> Array:
    """Return flow over final flow at times t after the force begins, same shape; R^2 / (5.78 nu) = relaxation."""
    z = jn_zeros(0, TIMES)
    decay = np.exp(-np.multiply.outer(np.asarray(t, dtype=float), z**2) / (FINAL * relaxation))
    return 1.0 - decay @ (32.0 / z**4)


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
        nearest = np.inf
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


def axis_at(angle: int, values: dict[str, float]) -> Axis:
    """Return the tube's place in the smallest periodic box; shifted against the grid by ``shift`` and half of it."""
    h, (i, k) = values["h"], DIRECTIONS[angle]
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

    def step(self, u, p, advection, f, t, dt, pressures=None):  # noqa: ANN001, ANN201
        """Advance by one step, see `NavierStokes.step`."""
        for force, constant in zip(f, self.drive, strict=True):
            force += constant
        return super().step(u, p, advection, f, t, dt, pressures)


def build(angle: int, values: dict[str, float], comm: MPI.Comm) -> tuple[fsi.Model, Faces, float]:
    """Return the model, the weights whose product with the velocity is the flow over the final one, and the step [s].

    Note:
        Collective.
    """
    axis, h, R = axis_at(angle, values), values["h"], values["radius"]
    grid = MacGrid([0.0] * 3, h * np.array(axis.cells), axis.cells, [True] * 3, comm)
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
    share = values["hold"] * h / largest_square_sum(kernel)
    springs = {"stiffness": share / dt**2, "damping": share / dt}
    wall = PatchedSurface(surface, labels, Coupling(grid, kernel), name="tube", **springs)
    return fsi.Model(grid=grid, fluid=fluid, bodies=(wall,)), weights, dt


def measure(
    angle: int, values: dict[str, float], comm: MPI.Comm, progress: Progress | None = None
) -> tuple[Array, Array]:
    """Return times and flow over the final flow after every step, ``(steps,)`` each (collective)."""
    model, weights, dt = build(angle, values, comm)
    owned = [model.grid.owned_faces(d) for d in range(3)]
    state, steps = fsi.initial_state(model, dt), max(4, math.ceil(values["t_end"] / dt))
    flow = np.zeros(steps)
    for k in range(steps):
        state = fsi.step(model, state, dt)
        flow[k] = sum(np.vdot(w[o], u[o]) for w, u, o in zip(weights, state.u, owned, strict=True))
        if progress is not None and ((k + 1) % 500 == 0 or k + 1 == steps):
            here = comm.allreduce(flow[k])
            error = 100.0 * (here - float(start_up(state.t, values["relaxation"])))
            progress(k + 1, state.t, steps * dt, {"flow_error_percent": error})
    comm.Allreduce(MPI.IN_PLACE, flow)
    return dt * np.arange(1, steps + 1), flow


def run(
    *,
    angle: int = 0,
    out: Path = Path("results/tube"),
    overrides: Sequence[str] = (),
    comm: MPI.Comm = MPI.COMM_WORLD,
    progress: Progress | None = None,
) -> dict[str, object]:
    """Run the tube; write ``result.json``, ``flow.csv`` with ``flow_error_percent`` over time, and ``flow.png``.

    Args:
        angle: Angle of the axis to the grid's z axis, 0, 20 or 45 [degrees].
        out: Folder of the results.
        overrides: Parameters as ``key=value``.
        comm: Communicator.
        progress: Called every 500 steps.

    Returns:
        The contents of ``result.json``.

    Raises:
        CaseError: An override is not one, or the angle is another.

    Note:
        Collective.
    """
    if angle not in DIRECTIONS:
        raise CaseError(f"expected one of {', '.join(map(str, DIRECTIONS))}", key="--angle", value=angle)
    values, started = read_parameters(PARAMETERS, overrides), time.perf_counter()
    if values["step"] > 1.0 or values["hold"] > 1.0:
        key = "step" if values["step"] > 1.0 else "hold"
        raise CaseError("expected a part of the limit, at most 1", file="--set", key=key, value=values[key])
    t, flow = measure(angle, values, comm, progress)
    error = 100.0 * (flow - start_up(t, values["relaxation"]))
    result = _result(angle, values, t, error) | {
        "timing": {"wall_s": time.perf_counter() - started, "steps": len(t)},
        "environment": environment(comm),
    }
    write_result(out, result, comm)
    if comm.rank == 0:
        _files(Path(out), angle, values, (t, flow, error))
    comm.barrier()
    return result


def _result(angle: int, values: dict[str, float], t: Array, error: Array) -> dict[str, object]:
    late = t > 0.5 * t[-1]
    settled = np.interp([0.1 * t[-1], 0.5 * t[-1], t[-1]], t, error)
    table = [
        row("flow, error at the end", float(settled[-1]), unit="% of the final flow"),
        row("largest error, start-up included", float(np.abs(error).max()), unit="% of the final flow"),
        row(
            "change of the error over the second half", float(np.ptp(error[late])), unit="% of the final flow"
        ),
    ]
    quantities = {
        "flow_error_percent": float(settled[-1]),
        "largest_flow_error_percent": float(np.abs(error).max()),
        "drift_percent": float(settled[-1] - settled[1]),
    }
    return {
        "benchmark": "tube",
        "parameters": values | {"angle": angle},
        "size": {"cells": list(axis_at(angle, values).cells), "across": 2.0 * values["radius"] / values["h"]},
        "quantities": quantities,
        "table": table,
    }


def _files(out: Path, angle: int, values: dict[str, float], curves: tuple[Array, Array, Array]) -> None:
    from valvefsi.post.plots.tube import start_up_flow

    t, flow, error = curves
    kept = np.unique(np.round(np.geomspace(1, len(t), 600)).astype(int)) - 1
    exact = start_up(t, values["relaxation"])
    rows = np.stack([t, flow, exact, error], axis=1)[kept]
    header = "t_s,flow_over_final,start_up_series,flow_error_percent"
    np.savetxt(out / "flow.csv", rows, delimiter=",", header=header, comments="")
    across = 2.0 * values["radius"] / values["h"]
    title = f"Tube of held points, {across:.3g} cells across, {angle} degrees to the grid"
    start_up_flow(out / "flow.png", (t[kept], flow[kept], exact[kept], error[kept]), title=title)
