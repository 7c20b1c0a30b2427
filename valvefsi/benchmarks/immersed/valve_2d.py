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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.benchmarks.grid_series import refined, run_series
from valvefsi.benchmarks.parameters import read_parameters
from valvefsi.benchmarks.polygon_gap import gap
from valvefsi.benchmarks.results import row
from valvefsi.bodies.elastic import Elastic
from valvefsi.coupling.kernels import KERNELS
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import CaseError, StabilityError
from valvefsi.fluid.boundary import Boundary, Open, Wall
from valvefsi.fluid.navier_stokes import ExplicitViscosity, NavierStokes
from valvefsi.geometry.mesh import SolidMesh, mesh_from_gmsh
from valvefsi.grid import Array, MacGrid
from valvefsi.grid.grading import graded_edges
from valvefsi.post import diagnostics
from valvefsi.run.planning import step_limits
from valvefsi.run.stable_step import measured_limit
from valvefsi.runtime.memory import keep_freed_memory
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.structure import Discretisation, Structure

LENGTH, HEIGHT, ROOT = 8.0, 1.61, 2.0
"""Length and height of the channel, and where the leaflets are [cm]."""
FINE = (1.6, 2.8)
"""Stretch of the channel with the smallest cells, where the leaflets sweep [cm]."""
PARAMETERS = {
    "E": (5.6e7, "dyn/cm^2"),
    "nu": (0.4, "1"),
    "rho": (100.0, "g/cm^3"),
    "mu": (10.0, "dyn*s/cm^2"),
    "thickness": (0.0212, "cm"),
    "length": (0.7, "cm"),
    "inflow": (5.0, "1/(cm*s)"),
    "nu_stab": (0.49, "1"),
    "ratio": (1.0, "1"),
    "share": (0.6, "1"),
}
"""Default and unit; ``ratio`` is element length over h, ``share`` the step over the limit measured at rest."""
PUBLISHED = {"max_dx": (0.583, (0.551, 0.583)), "max_dy": (0.411, (0.365, 0.411))}
"""Largest displacements of the upper tip and their range over codes [cm]."""
SOURCE = "Kamensky et al. 2015, digitised"
REFINEMENT, SAMPLES = 1.5, 600


@dataclass(frozen=True, kw_only=True)
class Setup:
    """What is run.

    Attributes:
        cells: Cells across the channel on the coarsest grid.
        t_end: End of the run [s].
        refine: Number of finer grids, each 1.5 times as fine.
        kernel: Kernel of the coupling.
        overrides: ``key=value``, names in `PARAMETERS`.
    """

    cells: int = 92
    t_end: float = 3.0
    refine: int = 0
    kernel: str = "bspline3"
    overrides: Sequence[str] = ()

    def __post_init__(self) -> None:
        """Check the names and ranges."""
        if self.kernel not in KERNELS:
            raise CaseError(f"a kernel is one of {', '.join(KERNELS)}", key="--kernel", value=self.kernel)
        if not (math.isfinite(self.t_end) and self.t_end > 0.0):
            raise CaseError("expected a time above 0", key="--t-end", value=self.t_end)


def leaflets(comm: MPI.Comm, *, size: tuple[float, float], elements: tuple[int, int] = (1, 40)) -> SolidMesh:
    """Mesh both leaflets, from wall to tip, with quadrilaterals; tag "body".

    Args:
        comm: Communicator the mesh is distributed on.
        size: Thickness and length [cm].
        elements: Elements across and along each.

    Note:
        Collective.
    """

    def build(gmsh: object) -> None:
        geo, surfaces = gmsh.model.geo, []
        left, right = ROOT - 0.5 * size[0], ROOT + 0.5 * size[0]
        for root, tip in ((0.0, size[1]), (HEIGHT, HEIGHT - size[1])):
            corners = [(left, root), (right, root), (right, tip), (left, tip)]
            points = [geo.addPoint(x, y, 0.0) for x, y in corners]
            lines = [geo.addLine(points[k], points[(k + 1) % 4]) for k in range(4)]
            surface = geo.addPlaneSurface([geo.addCurveLoop(lines)])
            for k, line in enumerate(lines):
                geo.mesh.setTransfiniteCurve(line, elements[k % 2] + 1)
            geo.mesh.setTransfiniteSurface(surface, "Left", points)
            geo.mesh.setRecombine(2, surface)
            surfaces.append(surface)
        geo.synchronize()
        gmsh.model.addPhysicalGroup(2, surfaces, name="body")
        gmsh.model.mesh.generate(2)

    return mesh_from_gmsh(build, comm, source="leaflets")


def channel(cells: int, comm: MPI.Comm) -> MacGrid:
    """Return the grid: ``cells`` across, as fine along the channel where the leaflets sweep, graded away from there."""
    h = HEIGHT / cells
    wide = min(0.1, 4.0 * h), min(0.2, 8.0 * h)
    along = [(0.0, wide[0]), (FINE[0], h), (FINE[1], h), (LENGTH, wide[1])]
    return MacGrid.graded([graded_edges(along), graded_edges([(0.0, h), (HEIGHT, h)])], [False, False], comm)


def solid_of(mesh: SolidMesh, values: Mapping[str, float], kernel: str) -> Structure:
    """Return the leaflets of a mesh, as stiff as the published plate (collective)."""
    plate = values["E"] / (1.0 - values["nu"] ** 2)
    quadratic = Discretisation(degree=2, kernel=kernel)
    material = NeoHookean(c1=0.25 * plate)
    return Structure(mesh, material, name="leaflets", nu_stab=values["nu_stab"], discretisation=quadratic)


def build(
    cells: int, kernel: str, values: Mapping[str, float], comm: MPI.Comm
) -> tuple[fsi.Model, float, dict[str, float]]:
    """Return the model, the length of a step and its limits [s] (collective)."""
    grid = channel(cells, comm)
    h, thickness, length = HEIGHT / cells, values["thickness"], values["length"]
    elements = max(1, round(0.5 * thickness / h)), max(4, math.ceil(length / (values["ratio"] * h)))
    solid = solid_of(leaflets(comm, size=(thickness, length), elements=elements), values, kernel)
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
    return model, dt, limits


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
        left, right = (np.abs(aside - s * 0.5 * thickness) < 1e-6 for s in (-1.0, 1.0))
        end = (height > length - 1e-6) & ~left & ~right
        self.outline = np.concatenate(
            [
                self.nodes[left][np.argsort(height[left])],
                self.nodes[end][np.argsort(aside[end])],
                self.nodes[right][np.argsort(-height[right])],
            ]
        )


COLUMNS = ("t", "upper_dx", "upper_dy", "lower_dx", "lower_dy", "gap", "area_change", "J_off", "speed")
"""Columns of ``tip.csv``: s, cm, relative change of both leaflets' area, largest |J - 1|, largest component [cm/s]."""


class Watch:
    """What is read off a run: rows of `COLUMNS`, and snapshots of flow and leaflets.

    Args:
        model: The model of `build`.
        values: The parameters.

    Note:
        Collective.
    """

    def __init__(self, model: fsi.Model, values: Mapping[str, float]) -> None:
        self.model, self.solid = model, model.bodies[0].solid
        self.X = self.gathered(self.solid.X)
        size = values["thickness"], values["length"]
        self.lower, self.upper = (Leaflet(self.X, upper, size) for upper in (False, True))
        self.rows: list[list[float]] = []
        self.snapshots: list[dict[str, object]] = []

    def gathered(self, chi: Array) -> Array:
        """Return the positions of all nodes by number, on all ranks (collective)."""
        whole = np.zeros((self.solid.num_nodes, 3))
        whole[self.solid.ids] = chi
        return self.model.grid.comm.allreduce(whole)

    def record(self, state: fsi.State) -> dict[str, float]:
        """Append a row and return it by name (collective).

        Raises:
            StabilityError: A velocity is not finite, or an element is inverted.
        """
        chi, comm = self.gathered(state.bodies[0]["chi"]), self.model.grid.comm
        J = self.solid.jacobian(state.bodies[0]["chi"])
        off = comm.allreduce(float(np.abs(J - 1.0).max(initial=0.0)), op=MPI.MAX)
        speed, _ = diagnostics.fastest_place(self.model.grid, state.u)
        if not (math.isfinite(speed) and off < 1.0):
            raise StabilityError(
                f"the velocity is not finite or an element is inverted, |J - 1| = {off:.3g}, t = {state.t:.4g} s; "
                "try a smaller share"
            )
        tips = [chi[k] - self.X[k] for k in (self.upper.tip, self.lower.tip)]
        between = gap(chi[self.upper.outline, :2], chi[self.lower.outline, :2])
        change = self.solid.volume(state.bodies[0]["chi"]) / self.solid.reference_volume - 1.0
        self.rows.append([state.t, *tips[0][:2].tolist(), *tips[1][:2].tolist(), between, change, off, speed])
        return dict(zip(COLUMNS, self.rows[-1], strict=True))

    def snapshot(self, state: fsi.State) -> None:
        """Keep the flow and the leaflets' outlines for a picture (collective)."""
        grid, chi = self.model.grid, self.gathered(state.bodies[0]["chi"])
        speed = np.linalg.norm(diagnostics.cell_velocity(grid, state.u)[:, :, 0, :2], axis=2)
        whole = np.zeros(grid.cells[:2])
        whole[tuple(slice(s, s + n) for s, n in zip(grid.start[:2], speed.shape, strict=True))] = speed
        edges = [grid.lower[d] + np.concatenate([[0.0], np.cumsum(grid.cell_widths[d])]) for d in range(2)]
        outlines = [chi[leaflet.outline, :2] for leaflet in (self.lower, self.upper)]
        speed = grid.comm.allreduce(whole)
        self.snapshots.append({"t": state.t, "edges": edges, "speed": speed, "outlines": outlines})


def snapshot_times(t_end: float) -> Array:
    """Times of the pictures: five of the last period, or of the whole run where that is shorter [s]."""
    return t_end - min(1.0, t_end) * (1.0 - np.array([0.2, 0.4, 0.6, 0.8, 1.0]))


def march(
    model: fsi.Model, dt: float, t_end: float, watch: Watch, progress: Callable | None = None
) -> tuple[int, str | None]:
    """Run from rest; return the number of steps and, where the run broke down, why (collective)."""
    steps = max(3, math.ceil(t_end / dt))
    dt, every = t_end / steps, max(1, steps // SAMPLES)
    shown = {min(steps, round(t / dt)) for t in snapshot_times(t_end)}
    state = fsi.initial_state(model, dt)
    watch.record(state)
    found: dict[str, float] = {}
    try:
        for k in range(1, steps + 1):
            state = fsi.step(model, state, dt)
            if k % every == 0 or k == steps:
                found = watch.record(state)
            if k in shown:
                watch.snapshot(state)
            if progress is not None:
                progress(k, state.t, t_end, {name: found.get(name, 0.0) for name in COLUMNS[1:3]})
    except StabilityError as error:
        return state.step, str(error)
    return steps, None


def numbers(rows: Sequence[Sequence[float]]) -> dict[str, float]:
    """Read extremes off a history: displacements of the upper tip, gap, asymmetry, area and J."""
    h = dict(zip(COLUMNS, np.array(rows).T, strict=True))
    apart = np.hypot(h["upper_dx"] - h["lower_dx"], h["upper_dy"] + h["lower_dy"])
    return {
        "max_dx": float(h["upper_dx"].max()),
        "max_dy": float(h["upper_dy"].max()),
        "t_max_dx": float(h["t"][np.argmax(h["upper_dx"])]),
        "min_dx": float(h["upper_dx"].min()),
        "min_dy": float(h["upper_dy"].min()),
        "smallest_gap": float(h["gap"].min()),
        "asymmetry": float(apart.max()),
        "area_change": float(h["area_change"][np.argmax(np.abs(h["area_change"]))]),
        "largest_J_off": float(h["J_off"].max()),
        "largest_speed": float(h["speed"].max()),
    }


def run(
    setup: Setup,
    *,
    out: Path,
    comm: MPI.Comm = MPI.COMM_WORLD,
    progress: Callable[[str], Callable] | None = None,
) -> dict[str, object]:
    """Run every grid; write ``result.json`` and, of each grid, ``tip.csv`` and pictures.

    Args:
        setup: What is run.
        out: Folder of the results.
        comm: Communicator.
        progress: Makes what shows a run from its name.

    Returns:
        The contents of ``result.json``.

    Raises:
        CaseError: A parameter cannot be used.

    Note:
        Collective.
    """
    keep_freed_memory()
    values = _checked(read_parameters(PARAMETERS, setup.overrides))
    grids = refined(setup.cells, setup.refine, REFINEMENT)

    def one(cells: int) -> dict[str, object]:
        shown = progress(f"N = {cells}") if progress else None
        return _one(setup, cells, values, (Path(out), comm), shown)

    def told(runs: Sequence[Mapping]) -> dict[str, object]:
        return {
            "benchmark": "valve-2d",
            "parameters": dict(values) | {"t_end": setup.t_end, "kernel": setup.kernel, "grids": grids},
            "reference": {key: {"value": value, "range": band} for key, (value, band) in PUBLISHED.items()}
            | {"source": SOURCE},
            "table": _table(runs, setup.t_end, values),
        }

    return run_series(grids, one, told, out=out, comm=comm)


def _checked(values: dict[str, float]) -> dict[str, float]:
    if not values["nu"] < 0.5:
        raise CaseError("expected below 0.5", file="--set", key="nu", value=values["nu"])
    if not values["length"] < 0.5 * HEIGHT:
        raise CaseError("the leaflets would overlap", file="--set", key="length", value=values["length"])
    return values


def _one(
    setup: Setup,
    cells: int,
    values: Mapping[str, float],
    where: tuple[Path, MPI.Comm],
    progress: Callable | None,
) -> dict[str, object]:
    """Run one grid and write what belongs to it alone."""
    (out, comm), begin = where, time.perf_counter()
    model, dt, limits = build(cells, setup.kernel, values, comm)
    watch = Watch(model, values)
    steps, failed = march(model, dt, setup.t_end, watch, progress)
    wall = time.perf_counter() - begin
    if comm.rank == 0:
        from valvefsi.post.plots.valve_2d import in_the_flow, tips

        folder = out / f"N{cells}"
        folder.mkdir(parents=True, exist_ok=True)
        np.savetxt(folder / "tip.csv", watch.rows, delimiter=",", comments="", header=",".join(COLUMNS))
        name = f"Two leaflets in a channel, {cells} cells across, {setup.kernel}"
        tips(folder / "tips.png", dict(zip(COLUMNS, np.array(watch.rows).T, strict=True)), PUBLISHED, name)
        if watch.snapshots:
            in_the_flow(folder / "flow.png", watch.snapshots, title=name)
    comm.barrier()
    return {
        "cells": cells,
        "grid": list(model.grid.cells[:2]),
        "spacing": [float(h) for h in model.grid.spacing[:2]],
        "nodes": model.bodies[0].solid.num_nodes,
        "dt": dt,
        "limits": limits,
        "steps": steps,
        "failed": failed,
        "quantities": numbers(watch.rows),
        "wall_s": wall,
        "step_ms": 1e3 * wall / steps,
    }


def _table(runs: Sequence[Mapping], t_end: float, values: Mapping[str, float]) -> list[dict[str, object]]:
    physical = [key for key in PARAMETERS if key not in ("nu_stab", "ratio", "share")]
    known = t_end >= 1.0 and all(values[key] == PARAMETERS[key][0] for key in physical)
    lines = []
    for r in runs:
        q, name = r["quantities"], f"N = {r['cells']}"
        if r["failed"]:
            lines.append(row(f"{name}", "broke down", source=r["failed"][:90]))
        for key, label in (("max_dx", "largest dx of the upper tip"), ("max_dy", "largest dy")):
            value, (low, high) = PUBLISHED[key]
            source = f"{SOURCE}; over codes {low} ... {high}" if known else ""
            lines.append(row(f"{label}, {name}", q[key], value if known else None, source, unit="cm"))
        lines.append(row("  smallest gap between the leaflets", q["smallest_gap"], unit="cm"))
        lines.append(row("  largest difference of the mirrored tips", q["asymmetry"], unit="cm"))
        lines.append(
            row("  relative change of area", q["area_change"], 0.0, "incompressible", relative=False)
        )
        lines.append(row("  largest |J - 1|", q["largest_J_off"], 0.0, "incompressible", relative=False))
        cost = f"dt = {r['dt']:.3g} s, {r['steps']} steps, {r['grid'][0]} x {r['grid'][1]} cells"
        lines.append(row("  time of a step", r["step_ms"], source=cost, unit="ms"))
    return lines
