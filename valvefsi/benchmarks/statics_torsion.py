"""Torsion of a column (Lee2020, E.2) as exactly incompressible statics, at five angles up to one turn and a quarter.

A Mooney-Rivlin column, axis y, clamped at its foot. On the top face the two displacements in the plane are those of
a rigid rotation; the axial one is free, and twisting lengthens the column (Poynting's effect).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from mpi4py import MPI

from valvefsi.benchmarks.parameters import defaults
from valvefsi.benchmarks.static_body import answer_of
from valvefsi.benchmarks.static_study import DIRECT, Answer, Benchmark, Reference, Setup, run_study
from valvefsi.geometry.shapes import box
from valvefsi.solid import statics
from valvefsi.solid.materials import MooneyRivlin

PARAMETERS = {
    "c1": (9000.0, "dyn/cm^2"),
    "c2": (9000.0, "dyn/cm^2"),
    "width": (1.0, "cm"),
    "height": (6.0, "cm"),
    "angle": (2.5 * math.pi, "1"),
}
FRACTIONS = (0.2, 0.4, 0.6, 0.8, 1.0)
"""The angles reported, as parts of the last one."""
COMPUTED = (0.0096, 0.0400, 0.0941, 0.1742, 0.2804)
"""u_y of the top centre [cm] at 0.5 ... 2.5 pi, Q2-Q1, 4 x 24 x 4 (tests/reference/torsion_statics.csv)."""
NAMES = tuple(f"u_y_{part:g}_of_angle_cm" for part in FRACTIONS)


def solve(
    values: Mapping[str, float],
    cell: str,
    elements: int,
    comm: MPI.Comm,
    setup: statics.SolverOptions = DIRECT,
) -> Answer:
    """Solve the column with ``elements`` cells across and as many to the centimetre along (collective)."""
    width, height = values["width"], values["height"]
    along = max(1, round(elements * height / width))
    mesh = box(comm, size=(width, height, width), elements=(elements, along, elements), cell=cell)
    material = MooneyRivlin(c1=values["c1"], c2=values["c2"])
    turn = statics.rotation(values["angle"], axis=(0.0, 1.0, 0.0), through=(width / 2, 0.0, width / 2))
    top = statics.Fixed(on=("y_upper",), components=("x", "z"), value=turn)
    found: dict[str, float] = {}

    def keep(part: float, solution: statics.StaticSolution) -> None:
        rise = solution.displacement_at((width / 2, height, width / 2))[1]
        found[NAMES[FRACTIONS.index(part)]] = float(rise)

    options = replace(setup, stops=FRACTIONS)
    supports = [statics.Fixed(on=("y_lower",)), top]
    solution = statics.solve(mesh, material, fixed=supports, options=options, on_stop=keep)
    return answer_of(solution, material, found)


def references(values: Mapping[str, float]) -> dict[str, Sequence[Reference]]:
    """Return what the answers are compared with where the parameters are the published ones."""
    if values != defaults(PARAMETERS):
        return {}
    source = "mixed Q2-Q1 elements, 4 x 24 x 4, another script"
    return {name: [Reference(value=u, source=source)] for name, u in zip(NAMES, COMPUTED, strict=True)}


BENCHMARK = Benchmark(
    name="statics-torsion",
    title="Torsion of a column (E.2), incompressible",
    parameters=PARAMETERS,
    cells=("tetrahedron", "hexahedron"),
    elements=2,
    solve=solve,
    iterative=True,
    references=references,
    units={name: ("cm", f"u_y, {part:g} of angle") for name, part in zip(NAMES, FRACTIONS, strict=True)},
)


def run(setup: Setup, *, out: Path, comm: MPI.Comm = MPI.COMM_WORLD) -> dict[str, object]:
    """Run the benchmark; see `static_study.run_study` (collective)."""
    return run_study(BENCHMARK, setup, out=out, comm=comm)
