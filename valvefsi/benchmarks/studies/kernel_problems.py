"""The problems of the kernel study on coarse grids: compressed block, Cook's membrane, thick shell at rest.

The loads and the bodies are those of the benchmarks of the same names. So that some hundred runs fit into an hour, the
first two are damped so that they come to rest sooner, and their tethers are softer, which allows longer steps; neither
changes the statics they are compared with by more than about 0.5 %. The grid stays and the mesh changes: at
a larger ratio the error is also that of a coarser mesh.
"""

from __future__ import annotations

import math
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


@dataclass(frozen=True, kw_only=True)
class StudyProblem:
    """A problem of the study, its functions among its attributes.

    Attributes:
        name: Its name.
        title: Its heading in pictures.
        grid: Default number of cells along the box.
        parameters: Default and unit of what ``--set`` reaches.
        ratio: Element size over grid spacing that whole elements give.
        reference: The value that the error is taken against (collective).
        run: The record of one run: ``quantities``, and ``failed`` (collective).
        measures: What is put into the table, from the quantities of a run and the reference.
        stabilised: Whether the volumetric energy makes a difference: both kinds are run, else only one without.
        leak: Change of the solid's area from which on the run counts as leaking [%].
        floor: Error below which runs count as equally good, as their references are no better [%].
    """

    name: str
    title: str
    grid: int
    parameters: Parameters
    ratio: Callable[[Numerics], float]
    reference: Callable[[Values, MPI.Comm], float]
    run: Callable[[Numerics, Values, Job], Record]
    measures: Callable[[Mapping[str, float], float], Measures]
    stabilised: bool = True
    leak: float = 1.0
    floor: float = 1.0


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


def loaded(
    study: type[GridStudy],
    grid: int,
    edges: tuple[float, float],
    elements: Callable[[Numerics], int],
    title: str,
) -> StudyProblem:
    """Return the problem of a grid study.

    Args:
        study: The grid study.
        grid: Default number of cells along the box.
        edges: Length along which elements are counted, and edge of the box [cm].
        elements: Number of elements along that length.
        title: Its heading in pictures.
    """

    def of(values: Values) -> GridStudy:
        return study(overrides=texts(values))

    def measures(q: Mapping[str, float], reference: float) -> Measures:
        return {
            "error_percent": 100.0 * (q[study().key] - reference) / abs(reference),
            "change_percent": q["change_percent"],
            "J_spread": max(abs(q["J_min"] - 1.0), abs(q["J_max"] - 1.0)),
            "u_max_cm_s": None,
        }

    return StudyProblem(
        name=study.name,
        title=title,
        grid=grid,
        parameters=study.parameters,
        ratio=lambda numerics: edges[0] / elements(numerics) * numerics.grid / edges[1],
        reference=lambda values, comm: of(values).incompressible(Numerics(grid=grid), comm)[0],
        run=lambda numerics, values, job: of(values).one(numerics, job),
        measures=measures,
    )


def pressure_norm(values: Values, comm: MPI.Comm) -> float:
    """Return the L2 norm of the exact pressure of the shell at rest [dyn/cm^2]."""
    s = (np.arange(400) + 0.5) / 400 - 0.5
    p = shell.exact_pressure(np.hypot(*np.meshgrid(s, s)), values["radius"], values["wall"])
    return float(np.sqrt((p**2).mean()))


def shell_run(numerics: Numerics, values: Values, job: Job) -> Record:
    """Return the record of the shell at rest (collective)."""
    failed, q = None, {}
    try:
        q = {k: float(value) for k, value in shell.shell_at_rest(numerics, values, job.comm).items()}
    except StabilityError as error:
        failed = str(error)
    if not all(math.isfinite(value) for value in q.values()):
        failed, q = "the velocity is not finite at the end", {}
    return {"numerics": asdict(numerics), "quantities": q, "failed": failed}


def shell_measures(q: Mapping[str, float], reference: float) -> Measures:
    """Return error, change of area and spurious velocity of the shell at rest."""
    error, change = 100.0 * q["p_L2"] / reference, abs(q["area_change_percent"])
    return {"error_percent": error, "change_percent": change, "J_spread": None, "u_max_cm_s": q["u_max"]}


def shell_ratio(numerics: Numerics) -> float:
    """Return element size over grid spacing of whole elements through the shell's wall."""
    wall = defaults(shell.PARAMETERS)["wall"] * numerics.grid
    return wall / max(1, round(wall / numerics.ratio))


COMPRESSION = loaded(QuickBlock, 48, (LENGTH, BOX), block_elements, "compressed block")
COOK = loaded(QuickCook, 25, ((4.8 * 3.0) ** 0.5, cook.BOX), cook.elements, "Cook's membrane")
SHELL = StudyProblem(
    name="shell",
    title="shell at rest",
    grid=64,
    parameters=shell.PARAMETERS,
    ratio=shell_ratio,
    reference=pressure_norm,
    run=shell_run,
    measures=shell_measures,
    stabilised=False,
    leak=1.0e-3,
)
PROBLEMS = {problem.name: problem for problem in (COMPRESSION, COOK, SHELL)}
