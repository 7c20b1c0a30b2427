"""What the immersed benchmarks share: how a problem is discretised and coupled, and one attempt to run it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from valvefsi.benchmarks.frame import Job
from valvefsi.benchmarks.options import Values
from valvefsi.bodies.elastic import Elastic
from valvefsi.coupling.elemental import ElementalCoupling
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import CaseError, StabilityError
from valvefsi.fluid.boundary import Boundary
from valvefsi.fluid.navier_stokes import ExplicitViscosity, NavierStokes
from valvefsi.fsi import Model
from valvefsi.grid import MacGrid
from valvefsi.io.checkpoint import newest_meta
from valvefsi.io.history import read_history
from valvefsi.run.simulation import Outcome, Simulation
from valvefsi.solid.elements.element_points import ElementPoints
from valvefsi.solid.structure import Structure
from valvefsi.types import Array

AVERAGED = 0.2
"""Part of a run at its end that is averaged over."""
COUPLINGS = ("nodal", "elemental", "lumped")

History = Mapping[str, Array]
"""Columns of a history over time, ``(n,)`` each."""


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
        if self.coupling not in COUPLINGS:
            message = 'expected "nodal", "elemental" or "lumped"'
            raise CaseError(message, key="--coupling", value=self.coupling)

    @property
    def name(self) -> str:
        """Name of the run's folder."""
        held = "off" if self.nu_stab is None else f"{self.nu_stab:g}"
        return f"N{self.grid}-r{self.ratio:g}-{self.kernel}-{self.coupling}-{held}"


def couple(fluid: NavierStokes, solid: Structure, numerics: Numerics) -> Coupling | ElementalCoupling:
    """Return the coupling that the numerics ask for (collective)."""
    grid, signs = fluid.grid, fluid.boundary.signs
    if numerics.coupling == "nodal":
        return Coupling(grid, numerics.kernel, signs)
    mass = "lumped" if numerics.coupling == "lumped" else "consistent"
    return ElementalCoupling(grid, numerics.kernel, ElementPoints(solid, mass), signs=signs)


def immersed_model(
    grid: MacGrid, boundary: Boundary, solid: Structure, numerics: Numerics, values: Values
) -> Model:
    """Return the model of one solid in one box; ``values`` holds rho and mu (collective)."""
    flow = NavierStokes(grid, boundary, rho=values["rho"], mu=values["mu"])
    return Model(grid=grid, fluid=flow, bodies=(Elastic(solid, couple(flow, solid, numerics)),))


def flow_of(grid: MacGrid, boundary: Boundary, dt: float, **physics: Any) -> NavierStokes:
    """Return the fluid, its viscosity explicit where half of what that allows is longer than the step (collective)."""
    limit = ExplicitViscosity.limit(grid, rho=physics["rho"], mu=physics["mu"])
    return (ExplicitViscosity if 2.0 * dt < limit else NavierStokes)(grid, boundary, **physics)


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """A run that came to its end, or as far as it could.

    Attributes:
        history: Its history, the same on all ranks.
        steps: Steps taken in this call.
        failed: Why it broke down, None where it did not.
        outcome: What it ended with, None where it broke down.
    """

    history: History
    steps: int
    failed: str | None
    outcome: Outcome | None


def attempt(simulation: Simulation, job: Job) -> Attempt:
    """Run a simulation; a run that breaks down keeps its record and says why.

    Without ``job.resume`` what an interrupted run has left in the folder is removed, with it the run goes on from the
    newest checkpoint there, if there is one.

    Raises:
        CaseError: The checkpoints belong to a run of other numbers.

    Note:
        Collective.
    """
    folder, output = job.folder, simulation.output
    meta = newest_meta(folder / "checkpoints", job.comm) if job.resume else None
    if meta is not None and meta["provenance"] != dict(output.provenance):
        raise CaseError("the checkpoints there belong to another run", file=folder, key="--resume")
    if not job.resume and job.comm.rank == 0:
        _clear(folder)
    job.comm.barrier()
    outcome, failed = None, None
    try:
        outcome = simulation.run(resume=meta is not None, progress=job.progress)
    except StabilityError as error:
        failed = str(error)
    columns = None
    if job.comm.rank == 0:
        columns = {k: np.array(v) for k, v in read_history(folder / "history.csv").items()}
    history: dict[str, Array] = job.comm.bcast(columns)
    steps = outcome.steps if outcome is not None else int(history["step"][-1])
    return Attempt(history=history, steps=steps, failed=failed, outcome=outcome)


def _clear(folder: Path) -> None:
    for path in [*folder.glob("checkpoints/*"), *folder.glob("history.csv")]:
        path.unlink()


def late_size(history: History, column: str) -> float:
    """Return the mean magnitude of a column over the last part of a run."""
    return late_mean({"t_s": history["t_s"], column: np.abs(history[column])}, column)


def late_mean(history: History, column: str) -> float:
    """Return the mean of a column over the last part of a run."""
    t = history["t_s"]
    return float(history[column][t >= (1.0 - AVERAGED) * t[-1]].mean())


def gathered(solid: Structure, comm: MPI.Comm, chi: Array) -> Array:
    """Return the positions of all nodes of a solid by number, on all ranks, ``(num_nodes, 3)`` [cm] (collective)."""
    whole = np.zeros((solid.num_nodes, 3))
    whole[solid.ids] = chi
    found: Array = comm.allreduce(whole)
    return found
