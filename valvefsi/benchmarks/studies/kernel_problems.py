"""The problems of the kernel study on coarse grids: compressed block, Cook's membrane, thick shell at rest.

The loads and the bodies are those of the benchmarks of the same names. So that some hundred runs fit into an hour, the
first two are damped so that they come to rest sooner, and their tethers are softer, which allows longer steps; neither
changes the statics they are compared with by more than about 0.5 %. The grid stays and the mesh changes: at
a larger ratio the error is also that of a coarser mesh.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from mpi4py import MPI

from valvefsi.benchmarks import compression, cook, shell, statics_compression
from valvefsi.benchmarks.immersed import Numerics, Problem, immersed_model, late_mean, late_size, run_kept
from valvefsi.benchmarks.parameters import defaults
from valvefsi.benchmarks.shell import shell_at_rest
from valvefsi.errors import StabilityError
from valvefsi.fluid.boundary import Boundary
from valvefsi.geometry.shapes import compressed_block
from valvefsi.grid import MacGrid
from valvefsi.run.recording import Output, Probe
from valvefsi.run.schedule import Schedule
from valvefsi.run.simulation import Simulation
from valvefsi.solid.loads import DeadLoad, Ramp, Tether
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.structure import Discretisation, Structure

BOX, LOWER, SIZE, TOP = 40.0, (10.0, 15.0), (20.0, 10.0), (20.0, 25.0)
"""Edge of the box of the compressed block, the block's lower corner and edges, the centre of its top [cm]."""
STATIC = 16
"""Elements along the block's height in the static solution."""
HALVINGS = 2
"""How often a run that breaks down by its time step is tried again with half of it."""

Record = dict[str, object]


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
        run: ``run(numerics, values, folder, comm)`` the record of one run, kept in its folder.
        measures: ``measures(record, reference)`` error, change of area, largest |J - 1|, spurious velocity.
        ratio: ``ratio(numerics)`` element size over grid spacing that whole elements give.
    """

    name: str
    title: str
    parameters: Mapping[str, tuple[float, str]]
    grid: int
    stabilised: bool
    leak: float
    floor: float
    reference: Callable[[Mapping[str, float], MPI.Comm], float]
    run: Callable[[Numerics, Mapping[str, float], Path, MPI.Comm], Record]
    measures: Callable[[Mapping, float], dict[str, float | None]]
    ratio: Callable[[Numerics], float]


def run_halving(
    problem: StudyProblem, numerics: Numerics, values: Mapping[str, float], folder: Path, comm: MPI.Comm
) -> Record:
    """Run a problem once; where the step is what it breaks down by, again with half of it, `HALVINGS` times at most.

    Args:
        problem: The problem.
        numerics: How it is discretised.
        values: Its parameters in CGS.
        folder: Folder of the run and, with the divisor of the step in the name, of those with shorter steps.
        comm: Communicator.

    Returns:
        The record of the last of these runs, with ``halvings``; ``wall_s`` is that of all of them.

    Note:
        Collective.
    """
    wall = 0.0
    for k in range(HALVINGS + 1):
        place = folder if k == 0 else folder.with_name(f"{folder.name}-step{2**k}")
        shorter = dict(values) | {"dt_per_h": values["dt_per_h"] / 2**k}
        record = problem.run(numerics, shorter, place, comm)
        wall += record["wall_s"]
        if not _by_the_step(record["failed"]):
            break
    return record | {"halvings": k, "wall_s": wall}


def _by_the_step(failed: str | None) -> bool:
    return failed is not None and ("Courant number" in failed or "not finite" in failed)


def block_elements(numerics: Numerics) -> int:
    """Elements along the block's 20 cm: their size is near ``ratio`` spacings, the ends of the load are on nodes."""
    return max(4, 4 * round(SIZE[0] * numerics.grid / (4 * BOX * numerics.ratio)))


def block(numerics: Numerics, values: Mapping[str, float], folder: Path, comm: MPI.Comm) -> Simulation:
    """Return the simulation of one compressed block (collective)."""
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
        discretisation=Discretisation(kernel=numerics.kernel),
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


def _block_quantities(history: Mapping[str, np.ndarray], values: Mapping[str, float]) -> dict[str, float]:
    return {
        "u_y_top_centre_cm": late_mean(history, "u_y_top_centre_cm"),
        "change_percent": late_size(history, "block_area_change_percent"),
        "J_min": late_mean(history, "block_J_min"),
        "J_max": late_mean(history, "block_J_max"),
    }


def _block_reference(values: Mapping[str, float], comm: MPI.Comm) -> float:
    static = defaults(statics_compression.PARAMETERS)
    static |= {key: values[key] for key in ("traction", "c1")}
    answer = statics_compression.solve(static, "quadrilateral", STATIC, comm)
    return answer.values["u_y_top_centre_cm"]


def _static_measures(key: str) -> Callable[[Mapping, float], dict[str, float | None]]:
    """Return what measures a loaded body from its record, ``key`` naming the displacement that is compared."""

    def measures(record: Mapping, reference: float) -> dict[str, float | None]:
        q = record["quantities"]
        return {
            "error_percent": 100.0 * (q[key] - reference) / abs(reference),
            "change_percent": q["change_percent"],
            "J_spread": max(abs(q["J_min"] - 1.0), abs(q["J_max"] - 1.0)),
            "u_max_cm_s": None,
        }

    return measures


def run_shell(numerics: Numerics, values: Mapping[str, float], folder: Path, comm: MPI.Comm) -> Record:
    """Return the record of one run of the shell; one that the folder holds already is not run again (collective)."""
    asked = {"problem": "shell", "numerics": asdict(numerics), "values": dict(values)}
    kept = comm.bcast(_kept(folder, asked) if comm.rank == 0 else None)
    if kept is not None:
        return kept
    failed, found, begin = None, {}, time.perf_counter()
    try:
        found = {key: float(value) for key, value in shell_at_rest(numerics, values, comm).items()}
    except StabilityError as error:
        failed = str(error)
    if not all(math.isfinite(value) for value in found.values()):
        failed, found = "the velocity is not finite at the end", {}
    wall = comm.allreduce(time.perf_counter() - begin, op=MPI.MAX)
    record = asked | {"quantities": found, "failed": failed, "wall_s": wall, "ranks": comm.size}
    if comm.rank == 0:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "run.json").write_text(json.dumps(record) + "\n")
    return record


def _kept(folder: Path, asked: Mapping[str, object]) -> Record | None:
    try:
        record = json.loads((folder / "run.json").read_text())
    except (OSError, ValueError):
        return None
    return record if all(record.get(key) == value for key, value in asked.items()) else None


def _shell_norm(values: Mapping[str, float], comm: MPI.Comm) -> float:
    """Return the L2 norm of the exact pressure, which the error is divided by."""
    s = (np.arange(400) + 0.5) / 400 - 0.5
    p = shell.exact_pressure(np.hypot(*np.meshgrid(s, s)), values["radius"], values["wall"])
    return float(np.sqrt((p**2).mean()))


def _shell_measures(record: Mapping, reference: float) -> dict[str, float | None]:
    q = record["quantities"]
    return {
        "error_percent": 100.0 * q["p_L2"] / reference,
        "change_percent": abs(q["area_change_percent"]),
        "J_spread": None,
        "u_max_cm_s": q["u_max"],
    }


def _shell_ratio(numerics: Numerics) -> float:
    wall = shell.PARAMETERS["wall"][0] * numerics.grid
    return wall / max(1, round(wall / numerics.ratio))


def _with(parameters: Mapping[str, tuple[float, str]], **changed: float) -> dict[str, tuple[float, str]]:
    return {key: (changed.get(key, default), unit) for key, (default, unit) in parameters.items()}


_BLOCK = Problem(name="compression", simulation=block, quantities=_block_quantities)
COMPRESSION = StudyProblem(
    name="compression",
    title="compressed block",
    parameters=_with(
        {key: known for key, known in compression.PARAMETERS.items() if key != "tether_damping"},
        **{"t_end": 20.0, "damping": 2.0, "mu": 0.1, "dt_per_h": 0.009, "tether_stiffness": 4.0e4},
    ),
    grid=48,
    stabilised=True,
    leak=1.0,
    floor=1.0,
    reference=_block_reference,
    run=lambda numerics, values, folder, comm: run_kept(_BLOCK, numerics, values, folder, comm=comm),
    measures=_static_measures("u_y_top_centre_cm"),
    ratio=lambda numerics: SIZE[0] / block_elements(numerics) * numerics.grid / BOX,
)
COOK = StudyProblem(
    name="cook",
    title="Cook's membrane",
    parameters=_with(
        cook.PARAMETERS, t_end=16.0, damping=6.5, mu=0.16, dt_per_h=0.012, tether_stiffness=4.0e4
    ),
    grid=25,
    stabilised=True,
    leak=1.0,
    floor=1.0,
    reference=lambda values, comm: cook.reference(values, None, comm)[0],
    run=lambda numerics, values, folder, comm: run_kept(cook.PROBLEM, numerics, values, folder, comm=comm),
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
