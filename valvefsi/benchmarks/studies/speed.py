"""Speed of the fluid step: phases, and the ratio to a fast cosine transform of the same grid in the same run.

One pair is scipy.fft.dctn and idctn of the grid on one thread: a yardstick that moves with the machine. The bytes that
a step must move, over its time, compare with the bandwidth of a triad on all ranks at once. What a planned run would
take on other numbers of ranks follows by the cost model for the fluid, in equal shares for the solids.
"""

from __future__ import annotations

import itertools
import resource
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from valvefsi.benchmarks.frame import Benchmark, Job, Record, Report, Result, public
from valvefsi.benchmarks.options import Values, defaults, option, quantities
from valvefsi.benchmarks.results import Row, row
from valvefsi.benchmarks.running import in_turns, pace
from valvefsi.benchmarks.studies import case_speed, cost_model, elastic_speed
from valvefsi.benchmarks.studies.against import Against
from valvefsi.bodies.body import Entry
from valvefsi.errors import CaseError
from valvefsi.fluid.advection import SCHEMES
from valvefsi.fluid.boundary import Boundary, Wall
from valvefsi.fluid.navier_stokes import ExplicitViscosity, NavierStokes
from valvefsi.grid import Faces, MacGrid
from valvefsi.runtime import threads
from valvefsi.runtime.clock import Timed
from valvefsi.runtime.machine import Network, measure_network, triad_bandwidth

PARAMETERS = quantities(
    "rho = 1 g/cm^3, mu = 0.01 dyn*s/cm^2, cfl = 0.3",
    advection=("centred", tuple(SCHEMES)),
    viscous=("implicit", ("implicit", "explicit")),
)
PARTS = ("viscous solves", "pressure solve", "ghosts", "right-hand side", "projection")
CALIBRATION = 96
"""Cells along each axis of the grid from which the cost model takes the constants of one core."""


@dataclass(frozen=True, kw_only=True)
class Yardsticks:
    """What is measured beside the grids: elastic forces, and with ``--model`` one core and the network."""

    elastic: Record
    machine: cost_model.Machine | None
    network: Network | None


@dataclass(frozen=True, kw_only=True)
class Speed(Benchmark[int, Yardsticks]):
    """Fluid steps on grids of N cells along each axis, walls on all sides but one pair; or the steps of a case."""

    name = "speed"
    parameters = PARAMETERS

    sizes: tuple[int, ...] = option((64, 128), "Cells per edge, one or several.", metavar="N,N", least=4)
    dim: int = option(3, "Dimensions.", least=2, most=3)
    steps: int = option(5, "Steps that are timed, after two that are not.", least=1)
    model: bool = option(False, "Predict steps on many cores too.")
    case: str = option(
        "", "A case instead of grids: its step by parts; --set is of the case.", metavar="CASE.toml"
    )
    state: str = option("", "With --case: begin from the newest checkpoint of this run.", metavar="FOLDER")
    against: str = option(
        "", "Another commit: its step and this one's in turns, in processes of their own.", metavar="REV"
    )
    turns: int = option(6, "With --against: processes of each of both.", least=2)

    def check(self, values: Values) -> None:
        if self.model and self.dim == 2:
            raise CaseError("the cost model is of three dimensions", key="--model", value="--dim 2")
        if self.state and not self.case:
            raise CaseError("a state is that of a case; use --case", key="--state", value=self.state)

    def read(self) -> Values:
        return defaults(self.parameters) if self.case else super().read()

    def execute(self, session: Job) -> Result:
        if self.against:
            return self.written(self._compared(session), session)
        if not self.case:
            return super().execute(session)
        folder = Path(self.state) if self.state else None
        report = case_speed.report(Path(self.case), self.overrides, folder, self.steps, session.comm)
        return self.written(report, session)

    def _compared(self, session: Job) -> Report:
        """Time the step of another commit and of this one in turns."""
        if session.comm.size > 1:
            raise CaseError(
                "the processes are of one rank: leave mpirun", key="--against", value=self.against
            )
        shared = ["--steps", str(self.steps), *(word for text in self.overrides for word in ("--set", text))]
        subjects = {f"{n}^{self.dim} cells": ["--sizes", str(n), "--dim", str(self.dim)] for n in self.sizes}
        if self.case:
            state = ["--state", str(Path(self.state).resolve())] if self.state else []
            subjects = {Path(self.case).name: ["--case", str(Path(self.case).resolve()), *state]}
        commits = Against(rev=self.against, turns=self.turns)
        whole = {name: [*words, *shared] for name, words in subjects.items()}
        return commits.compare(whole, session.announce)

    @property
    def solves(self) -> int:
        """Direct solves in a step."""
        return solves_of(self.values)

    def runs(self) -> tuple[int, ...]:
        return self.sizes

    def references(self, comm: MPI.Comm) -> Yardsticks:
        machine = machine_here(self.values, comm, self.steps) if self.model else None
        network = measure_network(comm) if self.model else None
        return Yardsticks(elastic=elastic_speed.measure(comm), machine=machine, network=network)

    def one(self, run: int, job: Job) -> Record:
        return measure((run,) * self.dim, self.steps, self.values, job.comm)

    def report(self, records: Sequence[Record], reference: Yardsticks) -> Report:
        elastic = dict(reference.elastic)
        table = [_row(r, self.dim, self.values["advection"] == "xsppm7") for r in records]
        table.append(elastic.pop("row"))
        model, rows = self._model(records, reference)
        return Report(
            parameters=self.values | {"sizes": list(self.sizes), "dim": self.dim, "steps": self.steps},
            quantities={r["N"]: {"pairs_per_step": r["pairs_per_step"]} for r in records},
            more={"grids": [public(r) for r in records], "elastic_force": elastic, "cost_model": model},
            table=table + rows,
        )

    def _model(self, records: Sequence[Record], reference: Yardsticks) -> tuple[Record, list[Row]]:
        """Compare the cost model with the grids measured, and predict."""
        machine, network = reference.machine, reference.network
        if machine is None:
            return {}, []
        rows, ranks, advection = [], records[0]["ranks"], self.values["advection"]
        for grid in records:
            count = cost_model.work(grid["N"], ranks, solves=self.solves, advection=advection)
            step = cost_model.predict(count, machine, network or Network())["step"]
            name = f"model: {grid['N']}^3, {ranks} rank{'s' * (ranks > 1)}"
            rows.append(row(name, 1e3 * step, grid["step_ms"], "measured here", unit="ms"))
        lines = cost_model.table(machine, Network(), solves=self.solves, advection=advection)
        for line in lines:
            each = (
                f"per core {line['flops']:.2g} flops, {line['bytes']:.2g} bytes, {line['messages']} messages"
            )
            name = f"model: {line['N']}^3, {line['cores']} cores"
            rows.append(row(name, 1e3 * line["step_s"], None, each, unit="ms"))
        return {
            "calibration_N": CALIBRATION,
            "machine": asdict(machine),
            "network_measured": network and asdict(network),
            "network_assumed": asdict(Network()),
            "predictions": lines,
        }, rows

    def draw(self, records: Sequence[Record], reference: Yardsticks, out: Path) -> None:
        from valvefsi.post.plots.base import phase_bars  # a plan needs none

        ranks, phases = records[0]["ranks"], {f"{r['N']}^{self.dim}": r["phases_ms"] for r in records}
        phase_bars(out / "speed.png", phases, title=f"One fluid step on {ranks} rank{'s' * (ranks > 1)}")


def solves_of(parameters: Values) -> int:
    """Return the direct solves in a step."""
    return 4 if parameters["viscous"] == "implicit" else 1


def machine_here(parameters: Values, comm: MPI.Comm, steps: int = 3) -> cost_model.Machine:
    """Return the times of one core of this machine, with all of them at work. Collective."""
    alone = measure((CALIBRATION,) * 3, steps, parameters, MPI.COMM_SELF)
    phases = {k: comm.allreduce(v, op=MPI.MAX) for k, v in alone["phases_ms"].items()}
    return cost_model.calibrate(CALIBRATION, phases, solves=solves_of(parameters))


def _row(grid: Record, dim: int, upwind: bool) -> Row:
    """One line of the table; the goal is that of an xsPPM7 step of 128^3 cells on one rank."""
    each, ranks = grid["threads"], grid["ranks"]
    due = upwind and (grid["N"], dim, ranks, each) == (128, 3, 1, 1)
    name = f"{grid['N']}^{dim}, {ranks} rank{'s' * (ranks > 1)}: step / DCT pair"
    name = name.replace(":", f" of {each} threads:") if each > 1 else name
    return row(name, grid["pairs_per_step"], 8.0 if due else None, "a goal, not a bound" if due else "")


def measure(cells: tuple[int, ...], steps: int, parameters: Values, comm: MPI.Comm) -> Record:
    """Time steps on one grid: the median, its parts, pairs of transforms in turns with them (collective)."""
    n, dim = cells[0], len(cells)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    started = time.perf_counter()
    grid = MacGrid([0.0] * dim, [1.0] * dim, cells, [False] * (dim - 1) + [True], comm)
    lid = Wall(velocity=(0.0,) + (1.0,) * (dim - 1))
    physics = {key: parameters[key] for key in ("rho", "mu", "advection")}
    kind = ExplicitViscosity if parameters["viscous"] == "explicit" else NavierStokes
    fluid = kind(grid, Boundary(grid, {"x_upper": lid}), **physics)
    set_up = time.perf_counter() - started
    phases: dict[str, float] = defaultdict(float)
    dt = min(parameters["cfl"] / n, fluid.dt_limit)
    times, pairs = _march(fluid, dt, steps, phases)
    step = float(np.median(times))
    grown = comm.allreduce((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024.0)
    return {
        "N": n,
        "cells": n**dim,
        "ranks": comm.size,
        "threads": threads.count(),
        **pace(times, pairs),
        "set_up_ms": 1e3 * set_up,
        "cell_steps_per_s": n**dim / step,
        # The process grows by its largest grid so far: no number for a grid that is small beside the rest.
        "memory_growth_float64_per_cell": grown / 8.0 / n**dim if n**dim > 10**6 else None,
        "phases_ms": _exclusive({k: 1e3 * v / steps for k, v in phases.items()}),
        **_traffic(n, dim, step, parameters, comm),
    }


def _traffic(n: int, dim: int, step: float, parameters: Values, comm: MPI.Comm) -> dict[str, float]:
    """Bytes that a rank must move in a step of a cube, by the count of the cost model, and a triad's in this run."""
    if dim == 2:
        return {}
    count = cost_model.work(n, comm.size, solves=solves_of(parameters), advection=parameters["advection"])
    volume, triad = count.bytes, triad_bandwidth(comm)
    return {
        "bytes_per_step": volume,
        "gigabytes_per_s": 1e-9 * volume / step,
        "triad_gigabytes_per_s": 1e-9 * triad,
        "part_of_triad": volume / step / triad,
    }


def _march(
    fluid: NavierStokes, dt: float, steps: int, phases: dict[str, float]
) -> tuple[list[float], list[float]]:
    """Take two steps and then ``steps`` more; return their times and those of pairs after them [s]."""
    grid = fluid.grid
    clocked, count = _clock(fluid, phases), itertools.count()
    u, p, f = fluid.fill(_swirl(grid), 0.0), grid.zeros(), grid.zero_faces()
    N_old = fluid.advection(u)

    def step() -> None:
        nonlocal u, p, N_old
        if (k := next(count)) == 2:
            phases.clear()
        N = clocked.advection(u)
        u, p = clocked.step(u, p, (N, N_old, 1.0), f, k * dt, dt)
        N_old = N

    return in_turns(step, grid, steps)


def _swirl(grid: MacGrid) -> Faces:
    """A smooth flow that fills the box: a fluid at rest is no work for an upwind scheme."""
    u = grid.zero_faces()
    for d in range(grid.dim):
        a, b = (grid.points(d)[(d + k) % grid.dim] for k in (1, 2))
        u[d][...] = 0.5 * np.sin(2 * np.pi * a) + 0.5 * np.cos(4 * np.pi * b)
    return u


def _clock(fluid: NavierStokes, table: dict[str, float]) -> Timed:
    """Put clocks into the parts of a fluid step, and around the step."""
    parts: Any = fluid
    viscous = getattr(parts, "velocity_solvers", ())
    parts.velocity_solvers = [_clock_solver(s, table, "viscous solves") for s in viscous]
    parts.pressure_solver = _clock_solver(parts.pressure_solver, table, "pressure solve")
    parts.grid = Timed(parts.grid, table, {"exchange": "ghosts"})
    kernels = {"momentum": "right-hand side", "advance": "right-hand side"}
    kernels |= {"divergence": "projection", "subtract_gradient": "projection"}
    parts.operators = Timed(parts.operators, table, kernels)
    return Timed(fluid, table, {"advection": "advection", "step": "step"})


def _clock_solver(solver: Any, table: dict[str, float], phase: str) -> Timed:
    moves = dict.fromkeys(("forward", "backward"), f"transposes in {phase}")
    solver.transposes = tuple(t and Timed(t, table, moves) for t in solver.transposes)
    return Timed(solver, table, {"solve": phase})


def _exclusive(phases: dict[str, float]) -> dict[str, float]:
    """Take the parts out of the time of a whole step, and the transposes out of that of solves."""
    rest = phases.pop("step", 0.0) - sum(phases.get(name, 0.0) for name in PARTS)
    moves = 0.0
    for name in ("viscous solves", "pressure solve"):
        inside = phases.pop(f"transposes in {name}", 0.0)
        moves += inside
        if inside:
            phases[name] -= inside
    return {**phases, **({"transposes": moves} if moves else {}), "all else": rest}


RANKS = (2, 64, 512)
"""Numbers of ranks that a plan is made for."""


def on_more_ranks(
    plan: Sequence[Entry], comm: MPI.Comm, *, advection: str, viscous: str, ranks: Sequence[int] = RANKS
) -> list[Entry]:
    """Return the expected time of a planned run on other numbers of ranks, none where the grid is too small.

    The fluid's part of a step grows or shrinks as the cost model says for a cube of as many cells; the network between
    machines is assumed there. The solids' part is divided by the number of ranks, and so is the memory of the fields.

    Args:
        plan: The plan on the ranks of ``comm``, of a case in three dimensions.
        comm: Communicator of the plan.
        advection: Advection scheme.
        viscous: "implicit" or "explicit".
        ranks: Numbers of ranks.

    Note:
        Collective.
    """
    value = {entry.quantity: float(entry.value) for entry in plan if not isinstance(entry.value, str)}
    step, share = value["time of a step"], value["fluid's part of a step"] / 100.0
    n, steps = round(value["cells"] ** (1.0 / 3.0)), value["steps"]
    parameters = defaults(PARAMETERS) | {"advection": advection, "viscous": viscous}
    machine, network = machine_here(parameters, comm), Network()

    def fluid(count: int) -> float:
        work = cost_model.work(n, count, solves=solves_of(parameters), advection=advection)
        return cost_model.predict(work, machine, network)["step"]

    entries, here = [], fluid(comm.size)
    for count in ranks:
        try:
            each = step * (share * fluid(count) / here + (1.0 - share) * comm.size / count)
        except ValueError:  # too many ranks for the grid
            continue
        note = f"{1e3 * each:.3g} ms a step" + ("" if count == comm.size else ", predicted")
        entries.append(
            Entry(quantity=f"on {count} ranks", value=each * steps, unit="s", note=note, wall=True)
        )
    return entries
