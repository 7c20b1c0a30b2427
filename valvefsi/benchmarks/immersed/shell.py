"""A thick circular shell at rest, and a closed membrane: pressure and spurious velocity against closed forms.

The shell, inner radius R and thickness w, carries a constant tension mu_s along circles (P_ff = mu_s), the membrane a
constant tension of 1 on the radius R. In a box of 1 x 1 cm with walls at rest both are in equilibrium; what moves is an
error. With r from the centre and the mean of p zero,

    shell:     p = ln(1 + w/R) - C inside, ln((R + w)/r) - C in the wall, -C outside, C = pi mu_s ((R + w)^2 - R^2)/2
    membrane:  the pressure jumps by tension / R = 4.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.benchmarks.frame import Benchmark, Job, Record, Report, refined
from valvefsi.benchmarks.immersed.study import COUPLINGS, Numerics, couple
from valvefsi.benchmarks.options import Values, option, quantities
from valvefsi.benchmarks.results import Row, order_row, row
from valvefsi.bodies.elastic import Elastic
from valvefsi.coupling.kernels import KERNELS
from valvefsi.coupling.transfer import Coupling
from valvefsi.fluid.boundary import Boundary
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.geometry.blocks import ring
from valvefsi.grid import MacGrid
from valvefsi.post.diagnostics import fastest_place
from valvefsi.post.plots.immersed import Line, Panel, panels
from valvefsi.solid.materials.fibres import circumferential
from valvefsi.solid.structure import Structure
from valvefsi.types import Array
from valvefsi.verification.convergence import ratios_of
from valvefsi.verification.norms import error_norms

PARAMETERS = quantities("""
    radius = 0.25 cm, wall = 0.0625 cm, rho = 1 g/cm^3, mu = 1 dyn*s/cm^2, t_end = 0.25 s,
    dt_per_h = 0.25 s/cm
""")
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

    def energy(self, kinematics: Any) -> Any:
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


def exact_pressure(r: Array, radius: float, wall: float) -> Array:
    """Return the pressure of the shell at distances r from its centre [dyn/cm^2]."""
    outer = radius + wall
    C = 0.5 * math.pi * (outer**2 - radius**2)
    return np.log(outer / np.clip(r, radius, outer)) - C


@dataclass(frozen=True, kw_only=True)
class Series:
    """One body on one grid: a shell with its numerics, or a membrane, which is nodal."""

    body: str
    numerics: Numerics

    @property
    def name(self) -> str:
        """Name of the series that it belongs to."""
        n = self.numerics
        return f"shell, {n.kernel}, {n.coupling}" if self.body == "shell" else f"membrane, {n.kernel}"

    def __str__(self) -> str:
        return f"{self.name}, N = {self.numerics.grid}"


@dataclass(frozen=True, kw_only=True)
class Shell(Benchmark[Series, None]):
    """Shell and membrane on every grid, with every kernel and coupling."""

    name = "shell"
    parameters = PARAMETERS

    grid: int = option(32, "Cells along each edge of the box.", least=8)
    refine: int = option(2, "Number of finer grids.", least=0, most=4)
    kernels: tuple[str, ...] = option(
        ("bspline3",), "Kernels, or all.", metavar="K,K|all", choices=tuple(KERNELS), everything=True
    )
    couplings: tuple[str, ...] = option(("nodal",), "nodal, elemental, lumped; several.", choices=COUPLINGS)
    ratio: float = 0.5

    def runs(self) -> list[Series]:
        return [
            Series(
                body=body,
                numerics=Numerics(grid=n, ratio=self.ratio, kernel=kernel, coupling=coupling, nu_stab=None),
            )
            for kernel in self.kernels
            for body, coupling in [*(("shell", c) for c in self.couplings), ("membrane", "nodal")]
            for n in refined(self.grid, self.refine)
        ]

    def one(self, run: Series, job: Job) -> Record:
        measure = shell_at_rest if run.body == "shell" else membrane_at_rest
        q = measure(run.numerics, self.values, job.comm)
        return {"series": run.name, "grid": run.numerics.grid, "quantities": q}

    def report(self, records: Sequence[Record], reference: None) -> Report:
        series, table = _by_series(records), []
        for name, runs in series.items():
            table += [line for run in runs for line in self._lines(name, run)]
            q = [run["quantities"] for run in runs]
            ratios = ratios_of([run["grid"] for run in runs])
            for key, label in (("p_L1", "L1 error of p"), ("p_L2", "L2 error of p"), ("u_max", "velocity")):
                if key in q[0]:
                    errors, label = [one[key] for one in q], f"  observed order, {label}"
                    table += order_row(label, errors, ratios, exact=0.0, source=name)
        return Report(
            parameters=self.values | {"grids": refined(self.grid, self.refine), "ratio": self.ratio},
            quantities={name: [run["quantities"] for run in runs] for name, runs in series.items()},
            reference={"p": "closed form", "jump": 1.0 / self.values["radius"], "u": 0.0},
            table=table,
        )

    def _lines(self, name: str, run: Record) -> list[Row]:
        q, n = run["quantities"], run["grid"]
        if "jump" in q:
            exact = 1.0 / self.values["radius"]
            line = row(f"jump of p, {name}, N = {n}", q["jump"], exact, "tension / R")
        else:
            line = row(f"L2 error of p, {name}, N = {n}", q["p_L2"], source=f"largest {q['p_max']:.2e}")
        return [line, row("  spurious velocity", q["u_max"], source="exact 0", unit="cm/s")]

    def draw(self, records: Sequence[Record], reference: None, out: Path) -> None:
        def panel(kind: str, key: str, label: str) -> Panel:
            series = {n: runs for n, runs in _by_series(records).items() if n.startswith(kind)}
            lines = [
                Line(
                    label=name.removeprefix(f"{kind}, "),
                    x=[run["grid"] for run in runs],
                    y=[run["quantities"][key] for run in runs],
                    colour=k,
                    style=("o-", "s--", "^:")[k // 6 % 3],
                )
                for k, (name, runs) in enumerate(series.items())
            ]
            return Panel(lines=lines, xlabel="cells N", ylabel=f"{kind}: {label}", log="xy")

        three = [
            panel("shell", "p_L2", "L2 error of p [dyn/cm$^2$]"),
            panel("shell", "u_max", "largest |u| [cm/s]"),
            panel("membrane", "u_max", "largest |u| [cm/s]"),
        ]
        caption = "exact: closed-form pressure, no flow"
        panels(out / "shell.png", three, title="Shell and membrane at rest", caption=caption)


def _by_series(records: Sequence[Record]) -> dict[str, list[Record]]:
    names = dict.fromkeys(record["series"] for record in records)
    return {name: [record for record in records if record["series"] == name] for name in names}


def _at_rest(
    n: int, values: Values, comm: MPI.Comm, body_in: Callable[[NavierStokes], Elastic]
) -> tuple[MacGrid, fsi.State, Array, Array]:
    """Run a body from rest to the end; return grid, state, distance from the centre and pressure, of mean zero."""
    grid = MacGrid([0, 0], [1, 1], [n, n], [False, False], comm)
    fluid = NavierStokes(grid, Boundary(grid), rho=values["rho"], mu=values["mu"])
    model = fsi.Model(grid=grid, fluid=fluid, bodies=(body_in(fluid),))
    steps = max(1, round(values["t_end"] * n / values["dt_per_h"]))
    dt = values["t_end"] / steps
    state = fsi.initial_state(model, dt)
    for _ in range(steps):
        state = fsi.step(model, state, dt)
    x, y, _ = grid.points()
    r = np.broadcast_to(np.hypot(x - CENTRE[0], y - CENTRE[1]), grid.shape)[grid.owned].ravel()
    p = state.p[grid.owned].ravel()
    mean = comm.allreduce(p.sum()) / comm.allreduce(p.size)
    return grid, state, r, p - mean


def shell_at_rest(numerics: Numerics, values: Values, comm: MPI.Comm) -> dict[str, float]:
    """Return errors of p and the spurious velocity of the shell on one grid (collective)."""
    n, radius, wall = numerics.grid, values["radius"], values["wall"]
    size = numerics.ratio / n
    counts = (round(2 * math.pi * (radius + wall) / size), max(1, round(wall / size)))
    mesh = ring(comm, centre=CENTRE, radii=(radius, radius + wall), elements=counts)
    mesh = mesh.with_fibres(around=circumferential(mesh, through=CENTRE))
    solid = Structure(mesh, FibreTension(), nu_stab=None)
    grid, state, r, p = _at_rest(
        n, values, comm, lambda fluid: Elastic(solid, couple(fluid, solid, numerics))
    )
    error = error_norms(p - exact_pressure(r, radius, wall), comm)
    return {
        "p_L1": error.L1,
        "p_L2": error.L2,
        "p_max": error.largest,
        "u_max": fastest_place(grid, state.u)[0],
        "area_change_percent": 100.0 * (solid.volume(state.bodies[0]["chi"]) / solid.reference_volume - 1.0),
    }


def membrane_at_rest(numerics: Numerics, values: Values, comm: MPI.Comm) -> dict[str, float]:
    """Return the pressure jump and the spurious velocity of the membrane on one grid (collective)."""
    n, radius = numerics.grid, values["radius"]
    membrane: Any = ClosedMembrane(comm, radius, round(2 * math.pi * radius * n / numerics.ratio))
    grid, state, r, p = _at_rest(
        n, values, comm, lambda fluid: Elastic(membrane, Coupling(fluid.grid, numerics.kernel))
    )
    margin = 4.0 / n
    parts = [p[r < radius - margin], p[r > radius + margin]]
    inside, outside = (comm.allreduce(q.sum()) / comm.allreduce(q.size) for q in parts)
    return {"jump": inside - outside, "u_max": fastest_place(grid, state.u)[0]}
