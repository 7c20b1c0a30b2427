"""A thick circular shell at rest, and a closed membrane: pressure and spurious velocity against closed forms.

The shell, inner radius R and thickness w, carries a constant tension mu_s along circles (P_ff = mu_s), the membrane a
constant tension of 1 on the radius R. In a box of 1 x 1 cm with walls at rest both are in equilibrium; what moves is an
error. With r from the centre and the mean of p zero,

    shell:     p = ln(1 + w/R) - C inside, ln((R + w)/r) - C in the wall, -C outside, C = pi mu_s ((R + w)^2 - R^2)/2
    membrane:  the pressure jumps by tension / R = 4.
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
from valvefsi.benchmarks.immersed import Numerics, couple
from valvefsi.benchmarks.immersed_study import order_of
from valvefsi.benchmarks.parameters import read_parameters
from valvefsi.benchmarks.results import environment, row, write_result
from valvefsi.bodies.elastic import Elastic
from valvefsi.coupling.transfer import Coupling
from valvefsi.fluid.boundary import Boundary
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.geometry.blocks import ring
from valvefsi.grid import Array, MacGrid
from valvefsi.solid.materials.fibres import circumferential
from valvefsi.solid.structure import Discretisation, Structure

PARAMETERS = {
    "radius": (0.25, "cm"),
    "wall": (0.0625, "cm"),
    "rho": (1.0, "g/cm^3"),
    "mu": (1.0, "dyn*s/cm^2"),
    "t_end": (0.25, "s"),
    "dt_per_h": (0.25, "s/cm"),
}
CENTRE = (0.5, 0.5)


@dataclass(frozen=True, kw_only=True)
class FibreTension:
    """Fibres under a stress of mu_s per reference area at rest, W = mu_s/2 a . C a.

    Args:
        mu_s: Stress, [dyn/cm^2].
    """

    mu_s: float = 1.0

    @property
    def shear_modulus(self) -> float:
        """Stiffness that limits the step [dyn/cm^2]."""
        return self.mu_s

    def energy(self, kinematics: object) -> object:
        """Return W [dyn/cm^2]."""
        return self.mu_s / 2 * kinematics.I4("around")


class ClosedMembrane:
    """Points on a closed curve under a constant tension; all of them on rank 0.

    Args:
        comm: Communicator.
        radius: Radius of the circle [cm].
        count: Number of points.
        tension: Tension [dyn, per cm depth].
    """

    def __init__(self, comm: MPI.Comm, radius: float, count: int, tension: float = 1.0) -> None:
        angle = 2 * math.pi * np.arange(count if comm.rank == 0 else 0) / count
        self.X = np.stack(
            [CENTRE[0] + radius * np.cos(angle), CENTRE[1] + radius * np.sin(angle), 0 * angle + 0.5], axis=1
        )
        self.tension = tension

    def force(self, chi: Array, U: Array, t: float) -> Array:
        """Return F_k = T (tangent after k - tangent before k), ``(n, 3)`` [dyn]."""
        tangents = np.roll(chi, -1, axis=0) - chi
        tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
        return self.tension * (tangents - np.roll(tangents, 1, axis=0))


@dataclass(frozen=True, kw_only=True)
class Setup:
    """What is run.

    Attributes:
        grid: Cells along the box on the coarsest grid.
        refine: Number of finer grids, each with half the spacing.
        kernels: Names of the kernels.
        couplings: "nodal", "elemental" or "lumped", of the shell; the membrane is nodal.
        ratio: Element size over grid spacing.
        overrides: ``key=value``, names in `PARAMETERS`.
    """

    grid: int = 32
    refine: int = 2
    kernels: Sequence[str] = ("bspline3",)
    couplings: Sequence[str] = ("nodal",)
    ratio: float = 0.5
    overrides: Sequence[str] = ()


def exact_pressure(r: Array, radius: float, wall: float) -> Array:
    """Return the pressure of the shell at distances r from its centre [dyn/cm^2]."""
    outer = radius + wall
    C = 0.5 * math.pi * (outer**2 - radius**2)
    return np.log(outer / np.clip(r, radius, outer)) - C


def run(
    setup: Setup,
    *,
    out: Path,
    comm: MPI.Comm = MPI.COMM_WORLD,
    progress: Callable[[str], object] | None = None,
) -> dict[str, object]:
    """Run shell and membrane on every grid, with every kernel and coupling; see the module (collective)."""
    values = read_parameters(PARAMETERS, setup.overrides)
    grids = [setup.grid * 2**k for k in range(setup.refine + 1)]
    series, started = {}, time.perf_counter()
    for kernel in setup.kernels:
        for coupling in setup.couplings:
            runs = [
                Numerics(grid=n, ratio=setup.ratio, kernel=kernel, coupling=coupling, nu_stab=None)
                for n in grids
            ]
            series[f"shell, {kernel}, {coupling}"] = [shell_at_rest(run, values, comm) for run in runs]
        series[f"membrane, {kernel}"] = [_membrane(kernel, n, setup.ratio, values, comm) for n in grids]
    result = {
        "benchmark": "shell",
        "parameters": dict(values) | {"grids": grids, "ratio": setup.ratio},
        "quantities": series,
        "reference": {"p": "closed form", "jump": 1.0 / values["radius"], "u": 0.0},
        "table": _table(series, grids, values),
        "timing": {"wall_s": time.perf_counter() - started},
        "environment": environment(comm),
    }
    write_result(out, result, comm)
    if comm.rank == 0:
        _draw(series, grids, Path(out) / "shell.png")
    comm.barrier()
    return result


def _relax(model: fsi.Model, n: int, values: Mapping[str, float]) -> fsi.State:
    """Run from rest to the end."""
    steps = max(1, round(values["t_end"] * n / values["dt_per_h"]))
    dt = values["t_end"] / steps
    state = fsi.initial_state(model, dt)
    for _ in range(steps):
        state = fsi.step(model, state, dt)
    return state


def _box(n: int, values: Mapping[str, float], comm: MPI.Comm) -> tuple[MacGrid, NavierStokes]:
    grid = MacGrid([0, 0], [1, 1], [n, n], [False, False], comm)
    return grid, NavierStokes(grid, Boundary(grid), rho=values["rho"], mu=values["mu"])


def _in_cells(grid: MacGrid, state: fsi.State) -> tuple[Array, Array]:
    """Return distance from the centre and pressure, its mean zero, in this rank's cells."""
    x, y, _ = grid.points()
    r = np.broadcast_to(np.hypot(x - CENTRE[0], y - CENTRE[1]), grid.shape)[grid.owned].ravel()
    p = state.p[grid.owned].ravel()
    count = grid.comm.allreduce(p.size)
    return r, p - grid.comm.allreduce(p.sum()) / count


def _fastest(grid: MacGrid, state: fsi.State) -> float:
    local = max(np.abs(c[grid.owned_faces(d)]).max() for d, c in enumerate(state.u))
    return float(grid.comm.allreduce(local, op=MPI.MAX))


def shell_at_rest(numerics: Numerics, values: Mapping[str, float], comm: MPI.Comm) -> dict[str, float]:
    """Return errors of p and the spurious velocity of the shell on one grid (collective)."""
    n, radius, wall = numerics.grid, values["radius"], values["wall"]
    size = numerics.ratio / n
    counts = (round(2 * math.pi * (radius + wall) / size), max(1, round(wall / size)))
    mesh = ring(comm, centre=CENTRE, radii=(radius, radius + wall), elements=counts)
    mesh = mesh.with_fibres(around=circumferential(mesh, through=CENTRE))
    solid = Structure(
        mesh, FibreTension(), nu_stab=None, discretisation=Discretisation(kernel=numerics.kernel)
    )
    grid, fluid = _box(n, values, comm)
    model = fsi.Model(grid=grid, fluid=fluid, bodies=(Elastic(solid, couple(fluid, solid, numerics)),))
    state = _relax(model, n, values)
    r, p = _in_cells(grid, state)
    error = np.abs(p - exact_pressure(r, radius, wall))
    return {
        "p_L1": comm.allreduce(error.sum()) / n**2,
        "p_L2": math.sqrt(comm.allreduce((error**2).sum()) / n**2),
        "p_max": comm.allreduce(error.max(initial=0.0), op=MPI.MAX),
        "u_max": _fastest(grid, state),
        "area_change_percent": 100.0 * (solid.volume(state.bodies[0]["chi"]) / solid.reference_volume - 1.0),
    }


def _membrane(
    kernel: str, n: int, ratio: float, values: Mapping[str, float], comm: MPI.Comm
) -> dict[str, float]:
    """Return the pressure jump and the spurious velocity of the membrane on one grid (collective)."""
    grid, fluid = _box(n, values, comm)
    radius = values["radius"]
    body = ClosedMembrane(comm, radius, round(2 * math.pi * radius * n / ratio))
    model = fsi.Model(grid=grid, fluid=fluid, bodies=(Elastic(body, Coupling(grid, kernel)),))
    state = _relax(model, n, values)
    r, p = _in_cells(grid, state)
    margin = 4.0 / n
    parts = [p[r < radius - margin], p[r > radius + margin]]
    inside, outside = (comm.allreduce(q.sum()) / comm.allreduce(q.size) for q in parts)
    return {"jump": inside - outside, "u_max": _fastest(grid, state)}


def _table(
    series: Mapping[str, Sequence[Mapping]], grids: Sequence[int], values: Mapping[str, float]
) -> list[dict]:
    lines = []
    for name, runs in series.items():
        for n, q in zip(grids, runs, strict=True):
            if "jump" in q:
                exact = 1.0 / values["radius"]
                lines.append(row(f"jump of p, {name}, N = {n}", q["jump"], exact, "tension / R"))
            else:
                lines.append(
                    row(f"L2 error of p, {name}, N = {n}", q["p_L2"], source=f"largest {q['p_max']:.2e}")
                )
            lines.append(row("  spurious velocity", q["u_max"], source="exact 0", unit="cm/s"))
        for key, label in (("p_L1", "L1 error of p"), ("p_L2", "L2 error of p"), ("u_max", "velocity")):
            if key in runs[0]:
                order = order_of([q[key] for q in runs], grids)
                if order is not None:
                    lines.append(row(f"  observed order, {label}", order, source=name))
    return lines


def _draw(series: Mapping[str, Sequence[Mapping]], grids: Sequence[int], path: Path) -> None:
    from valvefsi.post.plots.immersed import Line, Panel, panels

    def lines(kind: str, key: str) -> list[Line]:
        chosen = [(name, runs) for name, runs in series.items() if name.startswith(kind)]
        return [
            Line(
                label=name.removeprefix(f"{kind}, "),
                x=grids,
                y=[q[key] for q in runs],
                colour=k,
                style=("o-", "s--", "^:")[k // 6 % 3],
            )
            for k, (name, runs) in enumerate(chosen)
        ]

    shown = [
        Panel(
            lines=lines("shell", "p_L2"),
            xlabel="cells N",
            ylabel="shell: L2 error of p [dyn/cm$^2$]",
            log="xy",
        ),
        Panel(lines=lines("shell", "u_max"), xlabel="cells N", ylabel="shell: largest |u| [cm/s]", log="xy"),
        Panel(
            lines=lines("membrane", "u_max"),
            xlabel="cells N",
            ylabel="membrane: largest |u| [cm/s]",
            log="xy",
        ),
    ]
    panels(path, shown, title="Shell and membrane at rest", caption="exact: closed-form pressure, no flow")
