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
from pathlib import Path

import numpy as np
from mpi4py import MPI

from valvefsi.benchmarks.frame import Job, Record
from valvefsi.benchmarks.immersed import compression, cook, shell
from valvefsi.benchmarks.immersed.numerics import Numerics, immersed_model
from valvefsi.benchmarks.immersed.study import GridStudy
from valvefsi.benchmarks.options import Parameters, Values, changed, defaults
from valvefsi.benchmarks.running import History, late_mean, late_size
from valvefsi.benchmarks.statics.compression import PARAMETERS as STATIC_BLOCK
from valvefsi.benchmarks.statics.compression import solve as solve_statics
from valvefsi.benchmarks.statics.study import Mesh
from valvefsi.errors import StabilityError
from valvefsi.fluid.boundary import Boundary
from valvefsi.geometry.shapes import compressed_block
from valvefsi.grid import MacGrid
from valvefsi.run.recording import Output, Probe
from valvefsi.run.schedule import Schedule
from valvefsi.run.simulation import Simulation
from valvefsi.solid.loads import DeadLoad, Ramp, Tether
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.structure import Structure

BOX, LOWER, SIZE, TOP = 40.0, (10.0, 15.0), (20.0, 10.0), (20.0, 25.0)
"""Edge of the box of the compressed block, the block's lower corner and edges, the centre of its top [cm]."""
STATIC = 16
"""Elements along the block's height in the static solution."""
HALVINGS = 2
"""How often a run that breaks down by its time step is tried again with half of it."""


Measures = Callable[[Mapping[str, float], float], dict[str, float | None]]
"""Error, change of area, largest |J - 1| and spurious velocity from the quantities of a run and the reference."""


@dataclass(frozen=True, kw_only=True)
class StudyProblem:
    """A problem of the study.

    Attributes:
        name: Its name.
        title: Its heading in pictures.
        parameters: Default and unit of what ``--set`` reaches.
        grid: Default number of cells along the box.
        stabilised: Whether the volumetric energy makes a difference: both kinds are run, else only one without.
        leak: Change of the solid's area from which on the run counts as leaking [%].
        floor: Error below which runs count as equally good, as their references are no better [%].
        reference: ``reference(values, comm)`` the value that the error is taken against.
        run: ``run(numerics, values, job)`` the record of one run: ``quantities``, and ``failed``.
        measures: What is put into the table.
        ratio: ``ratio(numerics)`` element size over grid spacing that whole elements give.
    """

    name: str
    title: str
    parameters: Parameters
    grid: int
    stabilised: bool
    leak: float
    floor: float
    reference: Callable[[Values, MPI.Comm], float]
    run: Callable[[Numerics, Values, Job], Record]
    measures: Measures
    ratio: Callable[[Numerics], float]


def run_halving(problem: StudyProblem, numerics: Numerics, values: Values, job: Job) -> Record:
    """Run a problem once; where the step is what it breaks down by, again with half of it, `HALVINGS` times at most.

    Args:
        problem: The problem.
        numerics: How it is discretised.
        values: Its parameters in CGS.
        job: Where it runs; shorter steps have the divisor of the step in the name of their folder.

    Returns:
        The record of the last of these runs, with ``halvings``.

    Note:
        Collective.
    """
    for k in range(HALVINGS + 1):
        folder = job.folder if k == 0 else job.folder.with_name(f"{job.folder.name}-step{2**k}")
        shorter = values | {"dt_per_h": values["dt_per_h"] / 2**k}
        record = problem.run(numerics, shorter, replace(job, folder=folder, progress=None))
        if not _by_the_step(record["failed"]):
            break
    return record | {"halvings": k}


def _by_the_step(failed: str | None) -> bool:
    return failed is not None and ("Courant number" in failed or "not finite" in failed)


def _texts(values: Values) -> list[str]:
    """Return the overrides that give these values."""
    return [f"{key}={value!r}" for key, value in values.items()]


def _study(kind: type[GridStudy]) -> Callable[[Numerics, Values, Job], Record]:
    """Return what runs a grid study's problem once."""
    return lambda numerics, values, job: kind(overrides=_texts(values)).one(numerics, job)


def block_elements(numerics: Numerics) -> int:
    """Elements along the block's 20 cm: their size is near ``ratio`` spacings, the ends of the load are on nodes."""
    return max(4, 4 * round(SIZE[0] * numerics.grid / (4 * BOX * numerics.ratio)))


class QuickBlock(compression.BlockSeries):
    """The compressed block, damped more, without a case."""

    name = "compression"
    parameters = changed(
        {key: known for key, known in compression.PARAMETERS.items() if key != "tether_damping"},
        **{"t_end": 20.0, "damping": 2.0, "mu": 0.1, "dt_per_h": 0.009, "tether_stiffness": 4.0e4},
    )

    def read(self) -> Values:
        return GridStudy.read(self)

    def check(self, values: Values) -> None:
        GridStudy.check(self, values)

    def simulation(self, numerics: Numerics, folder: Path, comm: MPI.Comm) -> Simulation:
        values = self.values
        n, along = numerics.grid, block_elements(numerics)
        load = DeadLoad(
            on=("top_loaded",),
            traction=(0.0, -values["traction"]),
            ramp=Ramp(duration=compression.RAMP * values["t_end"], shape="smooth"),
        )
        stiffness = values["tether_stiffness"]
        solid = Structure(
            compressed_block(comm, lower=LOWER, size=SIZE, elements=(along, along // 2), load_width=10.0),
            NeoHookean(c1=values["c1"]),
            name="block",
            nu_stab=numerics.nu_stab,
            damping=values["damping"],
            tethers=[
                Tether(on=("bottom",), components=("y",), stiffness=stiffness),
                Tether(on=("top_loaded", "top_outer"), components=("x",), stiffness=stiffness),
            ],
            loads=[load],
        )
        grid = MacGrid((0.0, 0.0), (BOX, BOX), [n, n], [False, False], comm)
        model = immersed_model(grid, Boundary(grid), solid, numerics, values)
        steps = round(values["t_end"] * n / (values["dt_per_h"] * BOX))
        probe = Probe(name="top_centre", body=0, at=TOP)
        output = Output(directory=folder, history_every=max(1, steps // 300), probes=(probe,))
        return Simulation(model, Schedule(dt=values["t_end"] / steps, t_end=values["t_end"]), output)

    def quantities(self, history: History) -> dict[str, float]:
        return {
            "u_y_top_centre_cm": late_mean(history, "u_y_top_centre_cm"),
            "change_percent": late_size(history, "block_area_change_percent"),
            "J_min": late_mean(history, "block_J_min"),
            "J_max": late_mean(history, "block_J_max"),
        }


class QuickCook(cook.Cook):
    """Cook's membrane, damped more."""

    parameters = changed(
        cook.PARAMETERS, t_end=16.0, damping=6.5, mu=0.16, dt_per_h=0.012, tether_stiffness=4.0e4
    )


def _block_reference(values: Values, comm: MPI.Comm) -> float:
    static = defaults(STATIC_BLOCK) | {key: values[key] for key in ("traction", "c1")}
    answer = solve_statics(static, Mesh(cell="quadrilateral", elements=STATIC), comm)
    return answer.values["u_y_top_centre_cm"]


def _cook_reference(values: Values, comm: MPI.Comm) -> float:
    return QuickCook(overrides=_texts(values)).incompressible(Numerics(grid=COOK.grid), comm)[0]


def _static_measures(key: str) -> Measures:
    """Return what measures a loaded body from its record, ``key`` naming the displacement that is compared."""

    def measures(q: Mapping[str, float], reference: float) -> dict[str, float | None]:
        return {
            "error_percent": 100.0 * (q[key] - reference) / abs(reference),
            "change_percent": q["change_percent"],
            "J_spread": max(abs(q["J_min"] - 1.0), abs(q["J_max"] - 1.0)),
            "u_max_cm_s": None,
        }

    return measures


def run_shell(numerics: Numerics, values: Values, job: Job) -> Record:
    """Return the record of one run of the shell (collective)."""
    failed, found = None, {}
    try:
        found = {k: float(value) for k, value in shell.shell_at_rest(numerics, values, job.comm).items()}
    except StabilityError as error:
        failed = str(error)
    if not all(math.isfinite(value) for value in found.values()):
        failed, found = "the velocity is not finite at the end", {}
    return {"numerics": asdict(numerics), "quantities": found, "failed": failed}


def _shell_norm(values: Values, comm: MPI.Comm) -> float:
    """Return the L2 norm of the exact pressure, which the error is divided by."""
    s = (np.arange(400) + 0.5) / 400 - 0.5
    p = shell.exact_pressure(np.hypot(*np.meshgrid(s, s)), values["radius"], values["wall"])
    return float(np.sqrt((p**2).mean()))


def _shell_measures(q: Mapping[str, float], reference: float) -> dict[str, float | None]:
    return {
        "error_percent": 100.0 * q["p_L2"] / reference,
        "change_percent": abs(q["area_change_percent"]),
        "J_spread": None,
        "u_max_cm_s": q["u_max"],
    }


def _shell_ratio(numerics: Numerics) -> float:
    wall = shell.PARAMETERS["wall"][0] * numerics.grid
    return wall / max(1, round(wall / numerics.ratio))


COMPRESSION = StudyProblem(
    name="compression",
    title="compressed block",
    parameters=QuickBlock.parameters,
    grid=48,
    stabilised=True,
    leak=1.0,
    floor=1.0,
    reference=_block_reference,
    run=_study(QuickBlock),
    measures=_static_measures("u_y_top_centre_cm"),
    ratio=lambda numerics: SIZE[0] / block_elements(numerics) * numerics.grid / BOX,
)
COOK = StudyProblem(
    name="cook",
    title="Cook's membrane",
    parameters=QuickCook.parameters,
    grid=25,
    stabilised=True,
    leak=1.0,
    floor=1.0,
    reference=_cook_reference,
    run=_study(QuickCook),
    measures=_static_measures("u_y_corner_cm"),
    ratio=lambda numerics: (4.8 * 3.0) ** 0.5 / cook.elements(numerics) * numerics.grid / cook.BOX,
)
SHELL = StudyProblem(
    name="shell",
    title="shell at rest",
    parameters=shell.PARAMETERS,
    grid=64,
    stabilised=False,
    leak=1.0e-3,
    floor=1.0,
    reference=_shell_norm,
    run=run_shell,
    measures=_shell_measures,
    ratio=_shell_ratio,
)
PROBLEMS = {problem.name: problem for problem in (COMPRESSION, COOK, SHELL)}
