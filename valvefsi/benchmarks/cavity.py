"""Flow in a square cavity whose lid slides: velocity on the centre lines against Ghia, Ghia and Shin (1982)."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from mpi4py import MPI
from scipy.interpolate import CubicSpline

from valvefsi.benchmarks.parameters import read_parameters
from valvefsi.benchmarks.results import environment, row, write_result
from valvefsi.errors import CaseError, ConvergenceError
from valvefsi.fluid.boundary import Boundary, Wall
from valvefsi.fluid.navier_stokes import ExplicitViscosity, NavierStokes
from valvefsi.grid import Array, Faces, MacGrid
from valvefsi.post import diagnostics

Progress = Callable[[int, float, float, dict[str, float]], None]

PARAMETERS = {"cfl": (0.3, "1"), "steady": (1e-5, "1"), "t_max": (1000.0, "1")}
SOURCE = "Ghia et al. 1982, tables I and II"
NOTE = "the table for Re 100 is itself off by about 0.009 in one place"

GHIA = {
    100: {
        "u": (
            (0.0000, 0.00000),
            (0.0547, -0.03717),
            (0.0625, -0.04192),
            (0.0703, -0.04775),
            (0.1016, -0.06434),
            (0.1719, -0.10150),
            (0.2813, -0.15662),
            (0.4531, -0.21090),
            (0.5000, -0.20581),
            (0.6172, -0.13641),
            (0.7344, 0.00332),
            (0.8516, 0.23151),
            (0.9531, 0.68717),
            (0.9609, 0.73722),
            (0.9688, 0.78871),
            (0.9766, 0.84123),
            (1.0000, 1.00000),
        ),
        "v": (
            (0.0000, 0.00000),
            (0.0625, 0.09233),
            (0.0703, 0.10091),
            (0.0781, 0.10890),
            (0.0938, 0.12317),
            (0.1563, 0.16077),
            (0.2266, 0.17507),
            (0.2344, 0.17527),
            (0.5000, 0.05454),
            (0.8047, -0.24533),
            (0.8594, -0.22445),
            (0.9063, -0.16914),
            (0.9453, -0.10313),
            (0.9531, -0.08864),
            (0.9609, -0.07391),
            (0.9688, -0.05906),
            (1.0000, 0.00000),
        ),
    },
    1000: {
        "u": (
            (0.0000, 0.00000),
            (0.0547, -0.18109),
            (0.0625, -0.20196),
            (0.0703, -0.22220),
            (0.1016, -0.29730),
            (0.1719, -0.38289),
            (0.2813, -0.27805),
            (0.4531, -0.10648),
            (0.5000, -0.06080),
            (0.6172, 0.05702),
            (0.7344, 0.18719),
            (0.8516, 0.33304),
            (0.9531, 0.46604),
            (0.9609, 0.51117),
            (0.9688, 0.57492),
            (0.9766, 0.65928),
            (1.0000, 1.00000),
        ),
        "v": (
            (0.0000, 0.00000),
            (0.0625, 0.27485),
            (0.0703, 0.29012),
            (0.0781, 0.30353),
            (0.0938, 0.32627),
            (0.1563, 0.37095),
            (0.2266, 0.33075),
            (0.2344, 0.32235),
            (0.5000, 0.02526),
            (0.8047, -0.31966),
            (0.8594, -0.42665),
            (0.9063, -0.51550),
            (0.9453, -0.39188),
            (0.9531, -0.33714),
            (0.9609, -0.27669),
            (0.9688, -0.21388),
            (1.0000, 0.00000),
        ),
    },
    5000: {
        "u": (
            (0.0000, 0.00000),
            (0.0547, -0.41165),
            (0.0625, -0.42901),
            (0.0703, -0.43643),
            (0.1016, -0.40435),
            (0.1719, -0.33050),
            (0.2813, -0.22855),
            (0.4531, -0.07404),
            (0.5000, -0.03039),
            (0.6172, 0.08183),
            (0.7344, 0.20087),
            (0.8516, 0.33556),
            (0.9531, 0.46036),
            (0.9609, 0.45992),
            (0.9688, 0.46120),
            (0.9766, 0.48223),
            (1.0000, 1.00000),
        ),
        "v": (
            (0.0000, 0.00000),
            (0.0625, 0.42447),
            (0.0703, 0.43329),
            (0.0781, 0.43648),
            (0.0938, 0.42951),
            (0.1563, 0.35368),
            (0.2266, 0.28066),
            (0.2344, 0.27280),
            (0.5000, 0.00945),
            (0.8047, -0.30018),
            (0.8594, -0.36214),
            (0.9063, -0.41442),
            (0.9453, -0.52876),
            (0.9531, -0.55408),
            (0.9609, -0.55069),
            (0.9688, -0.49774),
            (1.0000, 0.00000),
        ),
    },
}
"""Position and velocity by Reynolds number: u on the vertical centre line, v on the horizontal one."""


def run(
    *,
    reynolds: int = 100,
    cells: int = 64,
    out: Path = Path("results/cavity"),
    overrides: Sequence[str] = (),
    comm: MPI.Comm = MPI.COMM_WORLD,
    progress: Progress | None = None,
) -> dict[str, object]:
    """Run the flow until it is steady; write ``result.json`` and ``profiles.png``.

    Args:
        reynolds: 100, 1000 or 5000.
        cells: Cells along an edge.
        out: Folder of the results.
        overrides: ``cfl``, ``steady`` (largest change per time that counts as none) or ``t_max`` as ``key=value``.
        comm: Communicator.
        progress: Called after every step.

    Returns:
        The contents of ``result.json``.

    Raises:
        CaseError: There is no table for this Reynolds number, or a parameter cannot be.
        ConvergenceError: The flow is not steady at ``t_max``.

    Note:
        Collective.
    """
    if reynolds not in GHIA:
        raise CaseError(f"expected one of {', '.join(map(str, GHIA))}", key="reynolds", value=reynolds)
    parameters = read_parameters(PARAMETERS, overrides)
    started = time.perf_counter()
    grid, u, t, steps = march(reynolds, cells, parameters, comm, progress)
    curves = profiles(grid, u)
    table, gaps = [], {}
    for name, (at, values) in curves.items():
        place, known = np.array(GHIA[reynolds][name]).T
        gap = CubicSpline(at, values)(place) - known
        gaps[name] = float(np.abs(gap).max())
        line = "vertical" if name == "u" else "horizontal"
        table.append(row(f"{name} on the {line} centre line, largest difference", gaps[name], None, SOURCE))
        extreme = int(np.argmin(known))
        found = float(CubicSpline(at, values)(place[extreme]))
        table.append(row(f"{name} at {place[extreme]:.4f}", found, float(known[extreme]), SOURCE))
    wall = time.perf_counter() - started
    result = {
        "benchmark": "cavity",
        "parameters": parameters | {"reynolds": reynolds, "cells": cells},
        "quantities": {f"{name}_gap": gap for name, gap in gaps.items()} | {"t_steady": t},
        "reference": {"source": SOURCE, "note": NOTE},
        "table": table,
        "timing": {"steps": steps, "wall_s": wall, "cell_steps_per_s": cells**2 * steps / wall},
        "environment": environment(comm),
    }
    write_result(out, result, comm)
    if comm.rank == 0:
        from valvefsi.post.plots.decay import centre_lines

        name = f"Cavity at Re {reynolds}, {cells} x {cells} cells"
        centre_lines(Path(out) / "profiles.png", curves, GHIA[reynolds], title=name)
    comm.barrier()
    return result


def march(
    reynolds: int, cells: int, parameters: dict[str, float], comm: MPI.Comm, progress: Progress | None = None
) -> tuple[MacGrid, Faces, float, int]:
    """Run from rest until nothing changes; return grid, velocity, time and steps (collective)."""
    grid = MacGrid([0.0, 0.0], [1.0, 1.0], [cells] * 2, [False] * 2, comm)
    mu, t_max = 1.0 / reynolds, parameters["t_max"]
    dt = parameters["cfl"] / cells
    explicit = 2.0 * dt < ExplicitViscosity.limit(grid, rho=1.0, mu=mu)
    kind = ExplicitViscosity if explicit else NavierStokes
    fluid = kind(grid, Boundary(grid, {"y_upper": Wall(velocity=(1.0, 0.0))}), rho=1.0, mu=mu)
    u, p, f = fluid.fill(grid.zero_faces(), 0.0), grid.zeros(), grid.zero_faces()
    N_old, k, change = fluid.advection(u), 0, np.inf
    while change > parameters["steady"]:
        if k * dt > t_max:
            raise ConvergenceError(
                f"the flow still changes by {change:.1e} per time at t = {k * dt:.4g}; try a larger t_max"
            )
        N = fluid.advection(u)
        before, (u, p) = u, fluid.step(u, p, (N, N_old, 1.0), f, k * dt, dt)
        N_old, k = N, k + 1
        if k % 20 == 0:
            local = max(float(np.abs(a - b)[grid.owned].max()) for a, b in zip(u, before, strict=True)) / dt
            change = comm.allreduce(local, op=MPI.MAX)
            if not np.isfinite(diagnostics.kinetic_energy(grid, u, 1.0)):
                raise ConvergenceError(f"the velocity is not finite at t = {k * dt:.4g}; try a smaller cfl")
        if progress is not None:
            progress(k, min(k * dt, t_max), t_max, {"change": change})
    return grid, u, k * dt, k


def profiles(grid: MacGrid, u: Faces) -> dict[str, tuple[Array, Array]]:
    """Positions and velocity on both centre lines, walls included, on all ranks (collective)."""
    found = {}
    for d, name in enumerate("uv"):
        whole = np.zeros(grid.face_shape(d))
        block = u[d][grid.owned_faces(d)]
        whole[tuple(slice(s, s + n) for s, n in zip(grid.start, block.shape, strict=True))] = block
        whole = grid.comm.allreduce(whole)[:, :, 0]
        middle = grid.cells[d] // 2
        values = whole[middle] if d == 0 else whole[:, middle]
        at = np.concatenate([[0.0], grid.centres(1 - d), [1.0]])
        found[name] = (at, np.concatenate([[0.0], values, [1.0 if d == 0 else 0.0]]))
    return found
