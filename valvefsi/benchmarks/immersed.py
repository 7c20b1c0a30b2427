"""What the immersed benchmarks share: one run of a problem with given numerics, kept on disk, and series of runs."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from mpi4py import MPI

from valvefsi.bodies.elastic import Elastic
from valvefsi.coupling.elemental import ElementalCoupling
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import CaseError, StabilityError
from valvefsi.fluid.boundary import Boundary
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.fsi import Model
from valvefsi.grid import MacGrid
from valvefsi.io.history import read_history
from valvefsi.run.simulation import Progress, Simulation
from valvefsi.solid.elements.element_points import ElementPoints
from valvefsi.solid.structure import Structure

AVERAGED = 0.2
"""Part of a run at its end that is averaged over."""


@dataclass(frozen=True, kw_only=True)
class Numerics:
    """How a problem is discretised and coupled.

    Attributes:
        grid: Cells along the box, as the problem counts them.
        ratio: Element size over grid spacing.
        kernel: Name of the regularised delta function.
        coupling: "nodal", "elemental", or "lumped": elemental with the lumped mass.
        nu_stab: Numerical Poisson ratio (S22), None for no volumetric energy.
    """

    grid: int
    ratio: float = 1.0
    kernel: str = "bspline3"
    coupling: str = "nodal"
    nu_stab: float | None = 0.4

    def __post_init__(self) -> None:
        """Check the coupling."""
        if self.coupling not in ("nodal", "elemental", "lumped"):
            message = 'expected "nodal", "elemental" or "lumped"'
            raise CaseError(message, key="--coupling", value=self.coupling)

    @property
    def name(self) -> str:
        """Name of the run's folder."""
        held = "off" if self.nu_stab is None else f"{self.nu_stab:g}"
        return f"N{self.grid}-r{self.ratio:g}-{self.kernel}-{self.coupling}-{held}"


@dataclass(frozen=True, kw_only=True)
class Problem:
    """A benchmark problem.

    Attributes:
        name: Its name.
        simulation: ``simulation(numerics, values, folder, comm)`` ready to run; collective.
        quantities: ``quantities(history, values)`` what is compared, from the columns of the history.
    """

    name: str
    simulation: Callable[[Numerics, Mapping[str, float], Path, MPI.Comm], Simulation]
    quantities: Callable[[Mapping[str, np.ndarray], Mapping[str, float]], dict[str, float]]


def couple(fluid: NavierStokes, solid: Structure, numerics: Numerics) -> Coupling | ElementalCoupling:
    """Return the coupling that the numerics ask for (collective)."""
    grid, signs = fluid.grid, fluid.boundary.signs
    if numerics.coupling == "nodal":
        return Coupling(grid, numerics.kernel, signs)
    mass = "lumped" if numerics.coupling == "lumped" else "consistent"
    return ElementalCoupling(grid, numerics.kernel, ElementPoints(solid, mass), signs=signs)


def immersed_model(
    grid: MacGrid, boundary: Boundary, solid: Structure, numerics: Numerics, fluid: Mapping[str, float]
) -> Model:
    """Return the model of one solid in one box; ``fluid`` holds rho and mu (collective)."""
    flow = NavierStokes(grid, boundary, rho=fluid["rho"], mu=fluid["mu"])
    return Model(grid=grid, fluid=flow, bodies=(Elastic(solid, couple(flow, solid, numerics)),))


def run_kept(
    problem: Problem,
    numerics: Numerics,
    values: Mapping[str, float],
    folder: Path,
    *,
    comm: MPI.Comm = MPI.COMM_WORLD,
    progress: Progress | None = None,
) -> dict[str, object]:
    """Run a problem once; a run that its folder holds already, with the same numbers, is not run again.

    Args:
        problem: The problem.
        numerics: How it is discretised.
        values: Its parameters in CGS.
        folder: Folder of this run.
        comm: Communicator.
        progress: Called after every step.

    Returns:
        ``numerics``, ``values``, ``quantities``, ``history`` (columns over time), ``wall_s``, ``steps``, ``ranks``,
        ``date``; where the run broke down ``failed`` says why and the quantities are those until then.

    Note:
        Collective.
    """
    asked = {"problem": problem.name, "numerics": asdict(numerics), "values": dict(values)}
    kept = comm.bcast(_kept(folder, asked) if comm.rank == 0 else None)
    if kept is not None:
        return kept
    if comm.rank == 0:
        _clear(folder)
    comm.barrier()
    simulation = problem.simulation(numerics, values, folder, comm)
    failed, begin, steps = None, time.perf_counter(), 0
    try:
        outcome = simulation.run(progress=progress)
        steps = outcome.steps
    except StabilityError as error:
        failed = str(error)
    wall = comm.allreduce(time.perf_counter() - begin, op=MPI.MAX)
    record = None
    if comm.rank == 0:
        history = {k: np.array(v) for k, v in read_history(folder / "history.csv").items()}
        record = asked | {
            "quantities": problem.quantities(history, values) if failed is None else {},
            "history": {k: v.tolist() for k, v in history.items()},
            "failed": failed,
            "wall_s": wall,
            "steps": steps,
            "cells": int(np.prod(simulation.model.grid.cells)),
            "ranks": comm.size,
            "date": time.strftime("%Y-%m-%d"),
        }
        (folder / "run.json").write_text(json.dumps(record) + "\n")
    return comm.bcast(record)


def _kept(folder: Path, asked: Mapping[str, object]) -> dict[str, object] | None:
    """Return the record of a finished run of the same numbers."""
    try:
        record = json.loads((folder / "run.json").read_text())
    except (OSError, ValueError):
        return None
    same = all(record.get(key) == json.loads(json.dumps(value)) for key, value in asked.items())
    return record if same else None


def _clear(folder: Path) -> None:
    """Remove what an interrupted run has left, so that it can start anew."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "run.json").unlink(missing_ok=True)
    for path in [*folder.glob("checkpoints/*"), *folder.glob("history.csv")]:
        path.unlink()


def late_size(history: Mapping[str, np.ndarray], column: str) -> float:
    """Return the mean magnitude of a column over the last part of a run."""
    return late_mean({"t_s": history["t_s"], column: np.abs(history[column])}, column)


def late_mean(history: Mapping[str, np.ndarray], column: str) -> float:
    """Return the mean of a column over the last part of a run."""
    t = history["t_s"]
    return float(history[column][t >= (1.0 - AVERAGED) * t[-1]].mean())


def each_run(
    problem: Problem,
    runs: Sequence[Numerics],
    values: Mapping[str, float],
    out: Path,
    *,
    comm: MPI.Comm,
    progress: Callable[[str], Progress | None] | None = None,
) -> list[dict[str, object]]:
    """Return the records of several runs, in order; ``progress(name)`` makes what shows each (collective)."""
    return [
        run_kept(
            problem,
            numerics,
            values,
            Path(out) / problem.name / numerics.name,
            comm=comm,
            progress=progress(numerics.name) if progress else None,
        )
        for numerics in runs
    ]
