"""The problems of the kernel study on coarse grids: compressed block, Cook's membrane, thick shell at rest.

The loads and the bodies are those of the benchmarks of the same names. So that some hundred runs fit into an hour, the
first two are damped so that they come to rest sooner, and their tethers are softer, which allows longer steps; neither
changes the statics they are compared with by more than about 0.5 %. The grid stays and the mesh changes: at
a larger ratio the error is also that of a coarser mesh.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np
from mpi4py import MPI

from valvefsi.benchmarks.frame import Job, Record
from valvefsi.benchmarks.immersed import compression, cook, shell
from valvefsi.benchmarks.immersed.compression import BOX, LENGTH
from valvefsi.benchmarks.immersed.study import GridStudy, Numerics
from valvefsi.benchmarks.options import Parameters, Values, changed, defaults, texts
from valvefsi.benchmarks.running import History, late_mean, late_size
from valvefsi.benchmarks.statics.solids import StaticCompression
from valvefsi.benchmarks.statics.study import Mesh
from valvefsi.errors import StabilityError

STATIC = 16
"""Elements along the block's height in the static solution."""
HALVINGS = 2
"""How often a run that breaks down by its time step is tried again with half of it."""

Measures = dict[str, float | None]
"""Error, change of area, largest |J - 1| and spurious velocity of a run."""


class StudyProblem(ABC):
    """A problem of the study.

    Attributes:
        name: Its name.
        title: Its heading in pictures.
        grid: Default number of cells along the box.
        parameters: Default and unit of what ``--set`` reaches.
        stabilised: Whether the volumetric energy makes a difference: both kinds are run, else only one without.
        leak: Change of the solid's area from which on the run counts as leaking [%].
        floor: Error below which runs count as equally good, as their references are no better [%].
    """

    name: str
    title: str
    grid: int
    parameters: Parameters
    stabilised, leak, floor = True, 1.0, 1.0

    @abstractmethod
    def ratio(self, numerics: Numerics) -> float:
        """Return element size over grid spacing that whole elements give."""

    @abstractmethod
    def reference(self, values: Values, comm: MPI.Comm) -> float:
        """Return the value that the error is taken against (collective)."""

    @abstractmethod
    def run(self, numerics: Numerics, values: Values, job: Job) -> Record:
        """Return the record of one run: ``quantities``, and ``failed`` (collective)."""

    @abstractmethod
    def measures(self, q: Mapping[str, float], reference: float) -> Measures:
        """Return what is put into the table, from the quantities of a run and the reference."""


def run_halving(problem: StudyProblem, numerics: Numerics, values: Values, job: Job) -> Record:
    """Run a problem once; where the step is what it breaks down by, again with half of it, `HALVINGS` times at most.

    Shorter steps have the divisor of the step in the name of their folder. The record is that of the last of these
    runs, with ``halvings`` (collective).
    """
    for k in range(HALVINGS + 1):
        folder = job.folder if k == 0 else job.folder.with_name(f"{job.folder.name}-step{2**k}")
        shorter = values | {"dt_per_h": values["dt_per_h"] / 2**k}
        record = problem.run(numerics, shorter, replace(job, folder=folder, progress=None))
        failed = record["failed"] or ""
        if "Courant number" not in failed and "not finite" not in failed:
            break
    return record | {"halvings": k}


def block_elements(numerics: Numerics) -> int:
    """Elements along the block's 20 cm: their size is near ``ratio`` spacings, the ends of the load are on nodes."""
    return max(4, 4 * round(LENGTH * numerics.grid / (4 * BOX * numerics.ratio)))


class QuickBlock(compression.BlockSeries):
    """The compressed block, damped more, with steps that end where the run ends and implicit viscosity."""

    parameters = changed(
        {key: default for key, default in compression.PARAMETERS.items() if key != "tether_damping"},
        **{"t_end": 20.0, "damping": 2.0, "mu": 0.1, "dt_per_h": 0.009, "tether_stiffness": 4.0e4},
    )

    def read(self) -> Values:
        return GridStudy.read(self)

    def elements(self, numerics: Numerics) -> int:
        return block_elements(numerics)

    def settings(self, numerics: Numerics) -> Values:
        values = self.values
        steps = round(values["t_end"] * numerics.grid / (values["dt_per_h"] * BOX))
        every = {"history_every": max(1, steps // 300), "checkpoint_every": 0, "frames": 0}
        more = {"time.dt": values["t_end"] / steps, "fluid.viscous": "implicit"}
        more |= {f"output.{key}": number for key, number in every.items()}
        if numerics.coupling != "nodal":
            mass = "lumped" if numerics.coupling == "lumped" else "consistent"
            more |= {"solid.block.coupling": "elemental", "solid.block.mass": mass}
        return values | more

    def quantities(self, history: History) -> dict[str, float]:
        return {
            self.key: late_mean(history, self.key),
            "change_percent": late_size(history, self.change),
            "J_min": late_mean(history, "block_J_min"),
            "J_max": late_mean(history, "block_J_max"),
        }

    def incompressible(self, numerics: Numerics, comm: MPI.Comm) -> tuple[float, str]:
        static = StaticCompression(overrides=texts(self.values, "traction", "c1"))
        answer = static.solve(Mesh(cell="quadrilateral", elements=STATIC), comm)
        return answer.values[self.key], f"mixed u-p statics, {2 * STATIC} x {STATIC}"


class QuickCook(cook.Cook):
    """Cook's membrane, damped more."""

    parameters = changed(
        cook.PARAMETERS, t_end=16.0, damping=6.5, mu=0.16, dt_per_h=0.012, tether_stiffness=4.0e4
    )


@dataclass
class Loaded(StudyProblem):
    """The problem of a grid study.

    Attributes:
        study: The grid study.
        elements: Number of elements along a length.
        edges: That length, and edge of the box [cm].
    """

    study: type[GridStudy]
    grid: int
    edges: tuple[float, float]
    elements: Callable[[Numerics], int]
    title: str

    def __post_init__(self) -> None:
        self.name, self.parameters = self.study.name, self.study.parameters

    def ratio(self, numerics: Numerics) -> float:
        return self.edges[0] / self.elements(numerics) * numerics.grid / self.edges[1]

    def reference(self, values: Values, comm: MPI.Comm) -> float:
        return self.study(overrides=texts(values)).incompressible(Numerics(grid=self.grid), comm)[0]

    def run(self, numerics: Numerics, values: Values, job: Job) -> Record:
        return self.study(overrides=texts(values)).one(numerics, job)

    def measures(self, q: Mapping[str, float], reference: float) -> Measures:
        return {
            "error_percent": 100.0 * (q[self.study().key] - reference) / abs(reference),
            "change_percent": q["change_percent"],
            "J_spread": max(abs(q["J_min"] - 1.0), abs(q["J_max"] - 1.0)),
            "u_max_cm_s": None,
        }


class ShellAtRest(StudyProblem):
    """The thick shell."""

    name, title, grid, parameters = "shell", "shell at rest", 64, shell.PARAMETERS
    stabilised, leak = False, 1.0e-3

    def ratio(self, numerics: Numerics) -> float:
        wall = defaults(shell.PARAMETERS)["wall"] * numerics.grid
        return wall / max(1, round(wall / numerics.ratio))

    def reference(self, values: Values, comm: MPI.Comm) -> float:
        """Return the L2 norm of the exact pressure [dyn/cm^2]."""
        s = (np.arange(400) + 0.5) / 400 - 0.5
        p = shell.exact_pressure(np.hypot(*np.meshgrid(s, s)), values["radius"], values["wall"])
        return float(np.sqrt((p**2).mean()))

    def run(self, numerics: Numerics, values: Values, job: Job) -> Record:
        failed, q = None, {}
        try:
            q = {k: float(value) for k, value in shell.shell_at_rest(numerics, values, job.comm).items()}
        except StabilityError as error:
            failed = str(error)
        if not all(math.isfinite(value) for value in q.values()):
            failed, q = "the velocity is not finite at the end", {}
        return {"numerics": asdict(numerics), "quantities": q, "failed": failed}

    def measures(self, q: Mapping[str, float], reference: float) -> Measures:
        error, change = 100.0 * q["p_L2"] / reference, abs(q["area_change_percent"])
        return {"error_percent": error, "change_percent": change, "J_spread": None, "u_max_cm_s": q["u_max"]}


COMPRESSION = Loaded(QuickBlock, 48, (LENGTH, BOX), block_elements, "compressed block")
COOK = Loaded(QuickCook, 25, ((4.8 * 3.0) ** 0.5, cook.BOX), cook.elements, "Cook's membrane")
SHELL = ShellAtRest()
PROBLEMS = {problem.name: problem for problem in (COMPRESSION, COOK, SHELL)}
