"""Flow in a plane channel between open sides: steady (Poiseuille) and oscillating (Womersley), against closed forms.

Height, density and the amplitude of the pressure gradient G are 1. With the channel between y = 0 and 1,

    Poiseuille: u = G y (1 - y) / (2 mu)
    Womersley:  u = Re{G / (i w) [1 - cosh(k (y - 1/2)) / cosh(k / 2)] exp(i w t)},  k^2 = i w / mu
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from mpi4py import MPI

from valvefsi.benchmarks.parameters import read_parameters
from valvefsi.benchmarks.results import environment, row, write_result
from valvefsi.fluid.boundary import Boundary, Open
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.grid import Array, MacGrid

Progress = Callable[[int, float, float, dict[str, float]], None]

PARAMETERS = {"womersley": (6.0, "1"), "viscosity": (0.1, "1"), "length": (2.0, "1")}
SOURCE = "closed form"


def poiseuille(y: Array, mu: float) -> Array:
    """Velocity of the steady flow at heights y."""
    return y * (1.0 - y) / (2.0 * mu)


def womersley(y: Array, t: float, number: float, mu: float) -> Array:
    """Velocity of the oscillating flow at heights y; the number is 1/2 sqrt(w / mu), half a height over the layer."""
    w = mu * (2.0 * number) ** 2
    k = np.sqrt(1j * w / mu)
    profile = (1.0 - np.cosh(k * (y - 0.5)) / np.cosh(0.5 * k)) / (1j * w)
    return np.real(profile * np.exp(1j * w * t))


def run(
    *,
    cells: int = 16,
    refine: int = 2,
    out: Path = Path("results/channel"),
    overrides: Sequence[str] = (),
    comm: MPI.Comm = MPI.COMM_WORLD,
    progress: Progress | None = None,
) -> dict[str, object]:
    """Run both flows on grids of N, 2 N, ... cells across; write ``result.json`` and ``profiles.png``.

    Args:
        cells: Cells across the channel on the coarsest grid.
        refine: Number of finer grids.
        out: Folder of the results.
        overrides: ``womersley``, ``viscosity`` or ``length`` as ``key=value``.
        comm: Communicator.
        progress: Called after every run.

    Returns:
        The contents of ``result.json``.

    Note:
        Collective.
    """
    parameters = read_parameters(PARAMETERS, overrides)
    started, sizes = time.perf_counter(), [cells * 2**k for k in range(refine + 1)]
    errors: dict[str, list[float]] = {"poiseuille": [], "womersley": []}
    curves: dict[str, list] = {}
    for number, n in enumerate(sizes):
        for kind, kept in errors.items():
            found = measure(kind, n, parameters, comm)
            kept.append(found.pop("error"))
            curves[kind] = list(found.values())
        if progress is not None:
            progress(number + 1, number + 1.0, float(len(sizes)), {"cells": n})
    table = []
    for kind, kept in errors.items():
        table += [
            row(f"{kind}, {n} across: largest error / largest speed", e)
            for n, e in zip(sizes, kept, strict=True)
        ]
        if refine:
            order = float(np.log2(kept[-2] / kept[-1]))
            table.append(row(f"{kind}: observed order", order, 2.0, "order of the scheme"))
    result = {
        "benchmark": "channel",
        "parameters": parameters | {"cells": sizes},
        "quantities": errors,
        "reference": {"source": SOURCE},
        "table": table,
        "timing": {"wall_s": time.perf_counter() - started},
        "environment": environment(comm),
    }
    write_result(out, result, comm)
    if comm.rank == 0:
        from valvefsi.post.plots.decay import profiles

        profiles(Path(out) / "profiles.png", curves, title=f"Flow in a channel, {sizes[-1]} cells across")
    comm.barrier()
    return result


def measure(kind: str, n: int, parameters: dict[str, float], comm: MPI.Comm) -> dict[str, object]:
    """Run one flow from its closed form and return its largest error and its profiles at four times (collective)."""
    mu, length = parameters["viscosity"], parameters["length"]
    number = parameters["womersley"]
    frequency = mu * (2.0 * number) ** 2
    steady = kind == "poiseuille"
    t_end = 0.5 / mu if steady else 2.0 * np.pi / frequency

    def exact(y: Array, t: float) -> Array:
        return poiseuille(y, mu) if steady else womersley(y, t, number, mu)

    def pressure(x: Array, y: Array, z: Array, t: float) -> float:
        return length * (1.0 if steady else float(np.cos(frequency * t)))

    grid = MacGrid([0.0, 0.0], [length, 1.0], [max(8, n // 4), n], [False, False], comm)
    ends = {"x_lower": Open(pressure=pressure, backflow=0.0), "x_upper": Open(backflow=0.0)}
    fluid = NavierStokes(grid, Boundary(grid, ends), rho=1.0, mu=mu)
    y = grid.points(0)[1]
    u, p = fluid.fill((exact(y, 0.0) + grid.zeros(), grid.zeros()), 0.0), grid.zeros()
    steps = 4 * max(4, n)
    dt, f, N_old = t_end / steps, grid.zero_faces(), fluid.advection(u)
    x = grid.points()[0]
    p += pressure(x, y, y, -0.5 * dt) * (1.0 - x / length)
    error, speed, shown = 0.0, 0.0, []
    own = grid.owned_faces(0)
    for k in range(steps):
        N = fluid.advection(u)
        u, p = fluid.step(u, p, (N, N_old, 1.0), f, k * dt, dt)
        N_old, t = N, (k + 1) * dt
        if (k + 1) % (steps // 4) == 0:
            here = exact(y, t) + grid.zeros()
            error = max(error, float(np.abs(u[0] - here)[own].max()))
            speed = max(speed, float(np.abs(here[own]).max()))
            shown.append((t, _profile(grid, u[0])))
    return {
        "error": comm.allreduce(error, op=MPI.MAX) / comm.allreduce(speed, op=MPI.MAX),
        "y": grid.centres(1),
        "profiles": shown,
        "exact": [exact(np.linspace(0, 1, 201), t) for t, _ in shown],
    }


def _profile(grid: MacGrid, u: Array) -> Array:
    """Mean along the channel of the velocity at every height, on all ranks."""
    whole = np.zeros(grid.cells[1])
    mine = slice(grid.start[1], grid.start[1] + grid.size[1])
    whole[mine] = u[grid.owned].sum(axis=(0, 2)) / grid.cells[0]
    grid.comm.Allreduce(MPI.IN_PLACE, whole)
    return whole
