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

The forces are those of the fluid on cylinder and flag, from what holds them and the momentum of the flag,
F = d/dt (int rho u + momentum of markers) - (springs and dampers), with the integral over the flag: what holds it and
what the fluid does to its surface together accelerate the flag. Inside the cylinder nothing moves.
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
from valvefsi.benchmarks.results import row
from valvefsi.benchmarks.turek_model import CENTRE, CLAMP, RADIUS, THICKNESS, TIP, build
from valvefsi.benchmarks.turek_signals import oscillation, whole_periods
from valvefsi.coupling.kernels import KERNELS
from valvefsi.errors import CaseError, StabilityError
from valvefsi.grid import Array
from valvefsi.io.checkpoint import newest_meta
from valvefsi.post import diagnostics
from valvefsi.run.recording import Output, load_state, memory_of, refuse_to_overwrite, save_state
from valvefsi.runtime.memory import keep_freed_memory

PARAMETERS = {
    "U": (200.0, "cm/s"),
    "mu_s": (2e7, "dyn/cm^2"),
    "nu": (0.4, "1"),
    "rho": (1.0, "g/cm^3"),
    "rho_s": (1.0, "g/cm^3"),
    "mu": (10.0, "dyn*s/cm^2"),
    "ramp": (2.0, "s"),
    "nu_stab": (0.49, "1"),
    "ratio": (2.0, "1"),
    "share": (4.5, "1"),
    "hold": (0.5, "1"),
    "pace": (0.02, "1"),
}
"""Default and unit. ``ratio`` is the length of a quadratic element over h, ``share`` the step over the elastic limit
of nodes that move alone, ``hold`` the springs of cylinder and clamp over rho/dt^2 and their dampers over rho/dt,
``pace`` the part of its way back that a point of the cylinder slips through the fluid in a step: without it springs
whose forces cancel in the kernel drift, the drag with them, and the flag swings faster."""
CASES = {
    "fsi1": {"U": 20.0, "mu_s": 5e6, "rho_s": 1.0},
    "fsi2": {"U": 100.0, "mu_s": 5e6, "rho_s": 10.0},
    "fsi3": {"U": 200.0, "mu_s": 2e7, "rho_s": 1.0},
}
STEADY = (0.0, math.nan)
PUBLISHED = {
    "fsi1": {
        "ux": (0.0227, *STEADY),
        "uy": (0.8209, *STEADY),
        "drag": (14.295, *STEADY),
        "lift": (0.7638, *STEADY),
    },
    "fsi2": {
        "ux": (-14.58, 12.44, 3.8),
        "uy": (1.23, 80.6, 2.0),
        "drag": (208.83, 73.75, 3.8),
        "lift": (0.88, 234.2, 2.0),
    },
    "fsi3": {
        "ux": (-2.69, 2.53, 10.9),
        "uy": (1.48, 34.38, 5.3),
        "drag": (457.3, 22.66, 10.9),
        "lift": (2.22, 149.78, 5.3),
    },
}
"""Mean, amplitude and frequency of the displacement of A [mm] and the forces [N/m]; FSI1 is steady."""
PERIODS = {"fsi1": 0.5, "fsi2": 0.5, "fsi3": 1.0 / 5.3}
"""Published period of the flag, of FSI1 that of FSI2 [s]."""
SOURCE = "Turek and Hron 2006"
REFINEMENT, SAMPLES, SAVED = 1.5, 200, 400
"""Ratio of successive grids, rows of the history in a published period, rows between checkpoints."""


@dataclass(frozen=True, kw_only=True)
class Setup:
    """What is run.

    Attributes:
        case: "fsi1" (steady), "fsi2" (a flag ten times as dense as the fluid) or "fsi3".
        cells: Cells across the flag on the coarsest grid.
        t_end: End of the run [s].
        refine: Number of finer grids, each 1.5 times as fine.
        kernel: Kernel of the coupling.
        overrides: ``key=value``, names in `PARAMETERS`.
        resume: Whether to go on from the checkpoints of an earlier run in the folder.
    """

    case: str = "fsi3"
    cells: int = 4
    t_end: float = 8.0
    refine: int = 0
    kernel: str = "bspline3"
    overrides: Sequence[str] = ()
    resume: bool = False

    def __post_init__(self) -> None:
        """Check the names and ranges."""
        if self.case not in CASES:
            raise CaseError(f"a case is one of {', '.join(CASES)}", key="--case", value=self.case)
        if self.kernel not in KERNELS:
            raise CaseError(f"a kernel is one of {', '.join(KERNELS)}", key="--kernel", value=self.kernel)
        if not (math.isfinite(self.t_end) and self.t_end > 0.0):
            raise CaseError("expected a time above 0", key="--t-end", value=self.t_end)

    def values(self) -> dict[str, float]:
        """The parameters in CGS."""
        defaults = {k: (CASES[self.case].get(k, v), unit) for k, (v, unit) in PARAMETERS.items()}
        values = read_parameters(defaults, self.overrides)
        for key in ("nu", "nu_stab"):
            if not values[key] < 0.5 + 1e-12 * (key == "nu"):
                raise CaseError("expected at most 0.5", file="--set", key=key, value=values[key])
        if values["rho_s"] < values["rho"]:
            message = f"expected the fluid's density, {values['rho']:g} g/cm^3, or more"
            raise CaseError(message, file="--set", key="rho_s", value=values["rho_s"])
        return values


COLUMNS = (
    "t_s",
    "ux_cm",
    "uy_cm",
    "drag_dyn_per_cm",
    "lift_dyn_per_cm",
    "clamp_cm",
    "J_off",
    "speed_cm_per_s",
)
"""Columns of ``history.csv``: displacement of A, forces, largest displacement of the clamp, largest |J - 1|, speed."""
SIGNALS = {
    "ux": ("ux_cm", 10.0),
    "uy": ("uy_cm", 10.0),
    "drag": ("drag_dyn_per_cm", 1e-3),
    "lift": ("lift_dyn_per_cm", 1e-3),
}
"""Column of each published signal and the factor to mm and N/m."""
LABELS = (("ux", "ux(A)", "mm"), ("uy", "uy(A)", "mm"), ("drag", "drag", "N/m"), ("lift", "lift", "N/m"))


class Watch:
    """What is read off a run: rows of `COLUMNS`, and snapshots of vorticity and flag.

    Args:
        model: The model of `build`.

    Note:
        Collective.
    """

    def __init__(self, model: fsi.Model) -> None:
        self.model, self.flag = model, model.bodies[0].solid
        self.tip = self.flag.node_at((TIP, CENTRE[1]))
        self.root = self.flag.X[:, 0] < CLAMP + 1e-6
        self.rows: list[list[float]] = []
        self.snapshots: list[dict[str, object]] = []
        self.since: fsi.State | None = None

    def _force(self, state: fsi.State) -> Array:
        """Return the mean force of the fluid on all bodies since the last row."""
        gained = -(state.impulse - self.since.impulse).sum(axis=0)
        for sign, s in ((1.0, state), (-1.0, self.since)):
            for body, q in zip(self.model.bodies, s.bodies, strict=True):
                gained += sign * body.momentum(q, s.u, self.model.fluid.rho)
        return gained / (state.t - self.since.t)

    def begin(self, state: fsi.State) -> None:
        """Begin the first interval (collective)."""
        self.since = state

    def record(self, state: fsi.State) -> dict[str, float]:
        """Append a row, with the mean forces since the last one, and return it by name (collective).

        Raises:
            StabilityError: A velocity is not finite, or an element is inverted.
        """
        comm, chi = self.model.grid.comm, state.bodies[0]["chi"]
        F, self.since = self._force(state), state
        moved = np.linalg.norm((chi - self.flag.X)[self.root], axis=1).max(initial=0.0)
        J = np.abs(self.flag.jacobian(chi) - 1.0).max(initial=0.0)
        moved, J = comm.allreduce(float(moved), op=MPI.MAX), comm.allreduce(float(J), op=MPI.MAX)
        speed, _ = diagnostics.fastest_place(self.model.grid, state.u)
        if not (math.isfinite(speed) and J < 1.0):
            raise StabilityError(
                f"the velocity is not finite or an element is inverted, |J - 1| = {J:.3g}, t = {state.t:.4g} s; "
                "try a smaller share"
            )
        tip = self.flag.position_of(self.tip, chi) - (TIP, CENTRE[1], 0.5)
        self.rows.append([state.t, *tip[:2].tolist(), *F[:2].tolist(), moved, J, speed])
        return dict(zip(COLUMNS, self.rows[-1], strict=True))

    def snapshot(self, state: fsi.State) -> None:
        """Keep vorticity and outline of the flag for a picture (collective)."""
        grid = self.model.grid
        own = diagnostics.vorticity(grid, state.u)[:, :, 0, 2]
        whole = np.zeros(grid.cells[:2])
        whole[tuple(slice(s, s + n) for s, n in zip(grid.start[:2], own.shape, strict=True))] = own
        edges = [grid.lower[d] + np.concatenate([[0.0], np.cumsum(grid.cell_widths[d])]) for d in range(2)]
        places = np.zeros((2, self.flag.num_nodes, 3))
        places[:, self.flag.ids] = self.flag.X, state.bodies[0]["chi"]
        X, chi = grid.comm.allreduce(places)
        outline = chi[_around(X), :2]
        self.snapshots.append(
            {"t": state.t, "edges": edges, "vorticity": grid.comm.allreduce(whole), "flag": outline}
        )


def _around(X: Array) -> Array:
    """Numbers of the nodes on the flag's outline from the clamp round the tip and back."""
    y, half = X[:, 1] - CENTRE[1], 0.5 * THICKNESS
    low, high = (
        np.flatnonzero((np.abs(y - s * half) < 1e-6) & (X[:, 0] > CLAMP - 1e-6)) for s in (-1.0, 1.0)
    )
    end = np.flatnonzero((np.abs(X[:, 0] - TIP) < 1e-6) & (np.abs(y) < half - 1e-6))
    return np.concatenate(
        [low[np.argsort(X[low, 0])], end[np.argsort(y[end])], high[np.argsort(-X[high, 0])]]
    )


def march(
    run: tuple[fsi.Model, float], watch: Watch, setup: Setup, output: Output, progress: Callable | None = None
) -> tuple[int, str | None]:
    """Run from rest, or on from a checkpoint; return the last step and, where it broke down, why (collective)."""
    model, dt = run
    period = PERIODS[setup.case]
    steps, every = math.ceil(setup.t_end / dt - 1e-6), max(1, round(period / SAMPLES / dt))
    shown = {max(1, steps - round(share * period / dt)) for share in (0.5, 0.25, 0.0)}
    state = _first(model, dt, watch, setup, output)
    watch.begin(state)
    found: dict[str, float] = {}
    try:
        for k in range(state.step + 1, steps + 1):
            state = fsi.step(model, state, dt)
            if k % every == 0 or k == steps:
                found = watch.record(state)
            if k in shown:
                watch.snapshot(state)
            if k % (SAVED * every) == 0 or k == steps:
                _save(model, state, watch, output, finished=k == steps)
            if progress is not None:
                progress(k, state.t, setup.t_end, {name: found.get(name, 0.0) for name in COLUMNS[1:4]})
        if not watch.snapshots:
            watch.snapshot(state)
    except StabilityError as error:
        return state.step, str(error)
    return state.step, None


def _first(model: fsi.Model, dt: float, watch: Watch, setup: Setup, output: Output) -> fsi.State:
    """Return the first state; of a resumed run the checkpoint's, with the rows up to it (collective)."""
    comm, folder = model.grid.comm, output.directory
    meta = newest_meta(folder / "checkpoints", comm) if setup.resume else None
    if meta is None:
        refuse_to_overwrite(model, output)
        return fsi.initial_state(model, dt)
    if meta["provenance"] != dict(output.provenance):
        raise CaseError("the checkpoints there belong to another run", file=folder, key="--resume")
    state = load_state(model, output, memory_of(model, output))
    rows = np.loadtxt(folder / "history.csv", delimiter=",", skiprows=1, ndmin=2)
    watch.rows = rows[rows[:, 0] <= state.t + 0.5 * dt].tolist()
    return state


def _save(model: fsi.Model, state: fsi.State, watch: Watch, output: Output, *, finished: bool) -> None:
    if model.grid.comm.rank == 0:
        output.directory.mkdir(parents=True, exist_ok=True)
        write_rows(output.directory, watch.rows)
    save_state(model, state, output, memory_of(model, output), finished=finished)


def write_rows(folder: Path, rows: Sequence[Sequence[float]]) -> None:
    """Write ``history.csv``."""
    np.savetxt(folder / "history.csv", rows, delimiter=",", comments="", header=",".join(COLUMNS))


def numbers(rows: Sequence[Sequence[float]]) -> dict[str, tuple[float, float, float]]:
    """Mean, amplitude and frequency [1/s] of the displacements [mm] and the forces [N/m] of a history."""
    h = dict(zip(COLUMNS, np.array(rows).T, strict=True))
    t, periods = h["t_s"], whole_periods(h["t_s"], h["uy_cm"])
    return {key: oscillation(t, factor * h[column], periods) for key, (column, factor) in SIGNALS.items()}


def run(
    setup: Setup,
    *,
    out: Path,
    comm: MPI.Comm = MPI.COMM_WORLD,
    progress: Callable[[str], Callable] | None = None,
) -> dict[str, object]:
    """Run every grid; write ``result.json`` and, of each grid, ``history.csv``, pictures and checkpoints.

    Args:
        setup: What is run.
        out: Folder of the results.
        comm: Communicator.
        progress: Makes what shows a run from its name.

    Returns:
        The contents of ``result.json``.

    Raises:
        CaseError: A parameter cannot be used, or a checkpoint of another run is in the folder.

    Note:
        Collective.
    """
    keep_freed_memory()
    values = setup.values()

    def one(cells: int) -> dict[str, object]:
        name = f"{setup.case}, {cells} cells across the flag"
        return _one(setup, cells, values, (Path(out), comm), progress(name) if progress else None)

    def told(runs: Sequence[Mapping]) -> dict[str, object]:
        return {
            "benchmark": "turek-fsi",
            "parameters": values | {"case": setup.case, "t_end": setup.t_end, "kernel": setup.kernel},
            "reference": PUBLISHED[setup.case] | {"source": SOURCE},
            "table": _table(setup, values, runs),
        }

    return run_series(refined(setup.cells, setup.refine, REFINEMENT), one, told, out=out, comm=comm)


def _one(
    setup: Setup,
    cells: int,
    values: Mapping[str, float],
    where: tuple[Path, MPI.Comm],
    progress: Callable | None,
) -> dict[str, object]:
    """Run one grid and write what belongs to it alone."""
    (out, comm), begin = where, time.perf_counter()
    model, dt = build(cells, setup.kernel, values, comm)
    watch, folder = Watch(model), out / f"N{cells}"
    output = Output(directory=folder, provenance=provenance(setup, cells, values))
    steps, failed = march((model, dt), watch, setup, output, progress)
    wall = time.perf_counter() - begin
    if comm.rank == 0:
        from valvefsi.post.plots.turek import histories, vorticity

        folder.mkdir(parents=True, exist_ok=True)
        write_rows(folder, watch.rows)
        name = f"{setup.case.upper()}, {cells} cells across the flag, {setup.kernel}"
        known = PUBLISHED[setup.case] if comparable(setup, values) else {}
        h = np.array(watch.rows).T
        shown = {key: f * h[COLUMNS.index(column)] for key, (column, f) in SIGNALS.items()}
        histories(folder / "history.png", h[0], shown, known, title=name)
        if watch.snapshots:
            body = (*CENTRE, RADIUS)
            vorticity(
                folder / "vorticity.png", watch.snapshots, body, scale=4.0 * values["U"] / RADIUS, title=name
            )
    comm.barrier()
    return {
        "cells": cells,
        "grid": list(model.grid.cells[:2]),
        "h": THICKNESS / cells,
        "nodes": model.bodies[0].solid.num_nodes,
        "points": model.bodies[1].num_points,
        "dt": dt,
        "steps": steps,
        "failed": failed,
        "quantities": {
            k: dict(zip(("mean", "amplitude", "frequency"), q, strict=True))
            for k, q in numbers(watch.rows).items()
        },
        "clamp_mm": 10.0 * max(r[COLUMNS.index("clamp_cm")] for r in watch.rows),
        "J_off": max(r[COLUMNS.index("J_off")] for r in watch.rows),
        "wall_s": wall,
    }


def provenance(setup: Setup, cells: int, values: Mapping[str, float]) -> dict[str, object]:
    """Return what a checkpoint must agree with for a run to go on from it."""
    return dict(values) | {"case": setup.case, "cells": cells, "kernel": setup.kernel}


def comparable(setup: Setup, values: Mapping[str, float]) -> bool:
    """Whether the published numbers are those of this flag: nothing physical was changed."""
    physical = CASES[setup.case] | {key: PARAMETERS[key][0] for key in ("rho", "mu")}
    return all(values[key] == known for key, known in physical.items())


def _table(setup: Setup, values: Mapping[str, float], runs: Sequence[Mapping]) -> list[dict[str, object]]:
    known, lines = PUBLISHED[setup.case], []
    for r in runs:
        if r["failed"]:
            lines.append(row(f"{r['cells']} cells", "broke down", source=r["failed"][:90]))
        for key, label, unit in LABELS:
            for number, what in enumerate(("mean", "amplitude", "frequency")):
                reference = known[key][number] if comparable(setup, values) else None
                if reference is not None and not abs(reference) > 0.0:  # steady: no amplitude, no frequency
                    reference = None
                shown = f"{label}, {what}, {r['cells']} cells" if number == 0 else f"  {what}"
                source = SOURCE if reference is not None else ""
                found, unit_shown = r["quantities"][key][what], "1/s" if what == "frequency" else unit
                # no per cent of a mean that is next to nothing
                lines.append(
                    row(
                        shown,
                        found,
                        reference,
                        source,
                        unit=unit_shown,
                        relative=what != "mean" or key == "drag",
                    )
                )
        lines.append(row("  largest displacement of the clamp", r["clamp_mm"], unit="mm"))
        lines.append(row("  largest |J - 1|", r["J_off"], 0.0, "incompressible", relative=False))
        cost = f"dt = {r['dt']:.3g} s, {r['steps']} steps, {r['grid'][0]} x {r['grid'][1]} cells"
        lines.append(row("  wall-clock time of this call", r["wall_s"], source=cost, unit="s"))
    return lines
