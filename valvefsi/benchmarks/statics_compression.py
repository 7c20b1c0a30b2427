"""Compressed block (Lee2020, E.1) as exactly incompressible statics: the answer that the immersed block tends to.

A neo-Hookean block of 20 x 10 cm in plane strain. A dead load acts on the middle half of the top; u_x = 0 on the
whole top, the loaded part included, and u_y = 0 on the bottom.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from mpi4py import MPI

from valvefsi.benchmarks.parameters import defaults
from valvefsi.benchmarks.static_body import answer_of
from valvefsi.benchmarks.static_study import DIRECT, Answer, Benchmark, Reference, Setup, run_study
from valvefsi.geometry.shapes import compressed_block
from valvefsi.solid import statics
from valvefsi.solid.loads import DeadLoad
from valvefsi.solid.materials import NeoHookean

PARAMETERS = {
    "traction": (200.0, "dyn/cm^2"),
    "c1": (80.194, "dyn/cm^2"),
    "width": (20.0, "cm"),
    "height": (10.0, "cm"),
    "load_width": (10.0, "cm"),
}
CONVERGED = -3.9212
"""u_y of the top centre [cm], computed with mixed elements (tests/reference/compression_statics.csv)."""


def solve(
    values: Mapping[str, float],
    cell: str,
    elements: int,
    comm: MPI.Comm,
    setup: statics.SolverOptions = DIRECT,
) -> Answer:
    """Solve the block with ``2 elements x elements`` cells (collective)."""
    width, height = values["width"], values["height"]
    shape = {"elements": (2 * elements, elements), "load_width": values["load_width"]}
    mesh = compressed_block(comm, lower=(0.0, 0.0), size=(width, height), cell=cell, **shape)
    material, top = NeoHookean(c1=values["c1"]), ("top_loaded", "top_outer")
    fixed = [statics.Fixed(on=("bottom",), components=("y",)), statics.Fixed(on=top, components=("x",))]
    load = DeadLoad(on=("top_loaded",), traction=(0.0, -values["traction"]))
    solution = statics.solve(mesh, material, fixed=fixed, loads=[load], options=setup)
    u_y = float(solution.displacement_at((width / 2, height))[1])
    return answer_of(solution, material, {"u_y_top_centre_cm": u_y})


def references(values: Mapping[str, float]) -> dict[str, Sequence[Reference]]:
    """Return what the answer is compared with where the parameters are the published ones."""
    if values != defaults(PARAMETERS):
        return {}
    source = "mixed P2-P1 elements, 128 x 64, another script"
    return {"u_y_top_centre_cm": [Reference(value=CONVERGED, source=source)]}


BENCHMARK = Benchmark(
    name="statics-compression",
    title="Compressed block (E.1), incompressible",
    parameters=PARAMETERS,
    cells=("triangle", "quadrilateral"),
    elements=16,
    solve=solve,
    iterative=True,
    references=references,
    units={"u_y_top_centre_cm": ("cm", "u_y of the top centre")},
)


def run(setup: Setup, *, out: Path, comm: MPI.Comm = MPI.COMM_WORLD) -> dict[str, object]:
    """Run the benchmark; see `static_study.run_study` (collective)."""
    return run_study(BENCHMARK, setup, out=out, comm=comm)
