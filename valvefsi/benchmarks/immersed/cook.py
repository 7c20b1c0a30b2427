"""Cook's membrane, immersed, against its exactly incompressible value, solved in the same run.

A tapered neo-Hookean panel in plane strain in a box of fluid of 10 x 10 cm. Its left edge is held by tethers; a dead
shear traction acts on its right edge and grows smoothly over the first 40 % of the run. The displacement of the upper
right corner is averaged over the last 20 %.

The size of an element is the root of its mean area; the longest edges, at the bottom, are 1.7 times as long. With
elements of one spacing they lie beyond what kernels bridge, and without the volumetric energy the fluid runs through
between the nodes: the membrane yields without end. Elements of half a spacing hold with and without it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from mpi4py import MPI

from valvefsi.benchmarks import statics_cook
from valvefsi.benchmarks.immersed import Numerics, Problem, immersed_model, late_mean, late_size
from valvefsi.benchmarks.immersed_study import Setup, Study, run_study
from valvefsi.fluid.boundary import Boundary
from valvefsi.geometry.benchmark_shapes import COOK, cook_membrane
from valvefsi.grid import MacGrid
from valvefsi.run.recording import Output, Probe
from valvefsi.run.schedule import Schedule
from valvefsi.run.simulation import Progress, Simulation
from valvefsi.solid.loads import DeadLoad, Ramp, Tether
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.structure import Discretisation, Structure

PARAMETERS = {
    "traction": (6.25, "dyn/cm^2"),
    "c1": (250.0 / 3.0, "dyn/cm^2"),
    "rho": (1.0, "g/cm^3"),
    "mu": (0.16, "dyn*s/cm^2"),
    "damping": (5.0, "dyn*s/cm^4"),
    "t_end": (20.0, "s"),
    "dt_per_h": (0.008, "s/cm"),
    "tether_stiffness": (1.0e5, "dyn/cm^3"),
}
BOX, SHIFT, RAMP = 10.0, (-2.6, -2.0), 0.4
"""Edge of the box and its lower corner [cm]; part of the run over which the load grows."""
FINE = 32
"""Elements along each edge in the static solution that is compared with."""


def elements(numerics: Numerics) -> int:
    """Elements along each edge: their size at mid-length (4.8 cm across, 3 cm high) is ``ratio`` spacings."""
    size = numerics.ratio * BOX / numerics.grid
    return max(2, round((4.8 * 3.0) ** 0.5 / size))


def simulation(numerics: Numerics, values: Mapping[str, float], folder: Path, comm: MPI.Comm) -> Simulation:
    """Return the simulation of one membrane (collective)."""
    n = numerics.grid
    mesh = cook_membrane(comm, elements=elements(numerics))
    load = DeadLoad(
        on=("right",),
        traction=(0.0, values["traction"]),
        ramp=Ramp(duration=RAMP * values["t_end"], shape="smooth"),
    )
    solid = Structure(
        mesh,
        NeoHookean(c1=values["c1"]),
        name="membrane",
        nu_stab=numerics.nu_stab,
        discretisation=Discretisation(kernel=numerics.kernel),
        damping=values["damping"],
        tethers=[Tether(on=("left",), stiffness=values["tether_stiffness"])],
        loads=[load],
    )
    grid = MacGrid(SHIFT, [s + BOX for s in SHIFT], [n, n], [False, False], comm)
    model = immersed_model(grid, Boundary(grid), solid, numerics, values)
    steps = round(values["t_end"] * n / (values["dt_per_h"] * BOX))
    probe = Probe(name="corner", body=0, at=COOK[2])
    output = Output(directory=folder, history_every=max(1, steps // 300), probes=(probe,))
    return Simulation(model, Schedule(dt=values["t_end"] / steps, t_end=values["t_end"]), output)


def quantities(history: Mapping[str, np.ndarray], values: Mapping[str, float]) -> dict[str, float]:
    """Return the means over the end of a run."""
    return {
        "u_y_corner_cm": late_mean(history, "u_y_corner_cm"),
        "change_percent": late_size(history, "membrane_area_change_percent"),
        "J_min": float(history["membrane_J_min"].min()),
        "J_max": float(history["membrane_J_max"].max()),
    }


PROBLEM = Problem(name="cook", simulation=simulation, quantities=quantities)


def reference(values: Mapping[str, float], numerics: Numerics, comm: MPI.Comm) -> tuple[float, str]:
    """Return the incompressible value, mixed elements (collective)."""
    static = {"traction": values["traction"], "c1": values["c1"], "scale": 1.0}
    answer = statics_cook.solve(static, "quadrilateral", FINE, comm)
    return answer.values["u_y_corner_cm"], f"mixed u-p statics, {FINE} x {FINE}, this run"


def elsewhere(values: Mapping[str, float]) -> list[tuple[str, str]]:
    """Return the published band, where the parameters are the published ones."""
    low, high = statics_cook.BAND
    same = all(values[key] == PARAMETERS[key][0] for key in ("traction", "c1"))
    return [(f"{low} ... {high}", "immersed, over kernels; second-hand")] if same else []


STUDY = Study(
    problem=PROBLEM,
    parameters=PARAMETERS,
    main=("u_y_corner_cm", "u_y of the corner", "cm"),
    change=("membrane_area_change_percent", "area change"),
    reference=reference,
    column="u_y_corner_cm",
    title="Cook's membrane, immersed",
    more=elsewhere,
)


def run(
    setup: Setup,
    *,
    out: Path,
    comm: MPI.Comm = MPI.COMM_WORLD,
    progress: Callable[[str], Progress | None] | None = None,
) -> dict[str, object]:
    """Run the benchmark; see `immersed_study.run_study` (collective)."""
    return run_study(STUDY, setup, out=out, comm=comm, progress=progress)
