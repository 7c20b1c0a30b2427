"""Cook's membrane as exactly incompressible statics: its own converged value, beside the published band.

A tapered panel in plane strain, clamped at its left edge; a dead shear traction acts on the right edge. The band
0.59 ... 0.68 cm is that of immersed computations with several kernels, not of a body-fitted method.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from mpi4py import MPI

from valvefsi.benchmarks.parameters import defaults
from valvefsi.benchmarks.static_body import answer_of
from valvefsi.benchmarks.static_study import DIRECT, Answer, Benchmark, Reference, Setup, run_study
from valvefsi.geometry.benchmark_shapes import COOK, cook_membrane
from valvefsi.solid import statics
from valvefsi.solid.loads import DeadLoad
from valvefsi.solid.materials import NeoHookean

PARAMETERS = {
    "traction": (6.25, "dyn/cm^2"),
    "c1": (250.0 / 3.0, "dyn/cm^2"),
    "scale": (1.0, "1"),
}
BAND = (0.59, 0.68)
"""u_y of the upper right corner [cm], immersed, over kernels; second-hand (tests/reference/cook_membrane.csv)."""


def solve(
    values: Mapping[str, float],
    cell: str,
    elements: int,
    comm: MPI.Comm,
    setup: statics.SolverOptions = DIRECT,
) -> Answer:
    """Solve the membrane with ``elements x elements`` cells (collective)."""
    mesh = cook_membrane(comm, elements=elements, cell=cell, scale=values["scale"])
    material = NeoHookean(c1=values["c1"])
    load = DeadLoad(on=("right",), traction=(0.0, values["traction"]))
    fixed = [statics.Fixed(on=("left",))]
    solution = statics.solve(mesh, material, fixed=fixed, loads=[load], options=setup)
    corner = [x * values["scale"] for x in COOK[2]]
    return answer_of(solution, material, {"u_y_corner_cm": float(solution.displacement_at(corner)[1])})


def references(values: Mapping[str, float]) -> dict[str, Sequence[Reference]]:
    """Return the published band where the parameters are the published ones."""
    if values != defaults(PARAMETERS):
        return {}
    return {"u_y_corner_cm": [Reference(band=BAND, source="immersed, over kernels; second-hand")]}


BENCHMARK = Benchmark(
    name="statics-cook",
    title="Cook's membrane, incompressible",
    parameters=PARAMETERS,
    cells=("triangle", "quadrilateral"),
    elements=8,
    solve=solve,
    iterative=True,
    references=references,
    units={"u_y_corner_cm": ("cm", "u_y of the upper right corner")},
)


def run(setup: Setup, *, out: Path, comm: MPI.Comm = MPI.COMM_WORLD) -> dict[str, object]:
    """Run the benchmark; see `static_study.run_study` (collective)."""
    return run_study(BENCHMARK, setup, out=out, comm=comm)
