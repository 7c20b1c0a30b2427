"""Torsion of a column (Lee2020, E.2) as exactly incompressible statics, at five angles up to one turn and a quarter.

A Mooney-Rivlin column, axis y, clamped at its foot. On the top face the two displacements in the plane are those of
a rigid rotation; the axial one is free, and twisting lengthens the column (Poynting's effect).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from mpi4py import MPI

from valvefsi.benchmarks import references
from valvefsi.benchmarks.options import quantities
from valvefsi.benchmarks.results import Reference
from valvefsi.benchmarks.statics.study import Answer, Mesh, References, Static, answer_of
from valvefsi.geometry.shapes import box
from valvefsi.solid import statics
from valvefsi.solid.materials import MooneyRivlin

PARAMETERS = quantities(
    "c1 = 9000 dyn/cm^2, c2 = 9000 dyn/cm^2, width = 1 cm, height = 6 cm",
    angle=(2.5 * math.pi, "1"),
)
FRACTIONS = (0.2, 0.4, 0.6, 0.8, 1.0)
"""The angles reported, as parts of the last one."""
NAMES = tuple(f"u_y_{part:g}_of_angle_cm" for part in FRACTIONS)


def computed() -> dict[float, float]:
    """Return u_y of the top centre [cm] by part of 2.5 pi, Q2-Q1, 4 x 24 x 4."""
    table = references.read("torsion_statics")
    return {part: table.value("u_y_top_centre_cm", theta_over_pi=2.5 * part) for part in FRACTIONS}


@dataclass(frozen=True, kw_only=True)
class StaticTorsion(Static):
    """Torsion of a column as statics."""

    name = "statics-torsion"
    title = "Torsion of a column (E.2), incompressible"
    parameters = PARAMETERS
    cells = ("tetrahedron", "hexahedron")
    coarsest = 2
    units = {name: ("cm", f"u_y, {part:g} of angle") for name, part in zip(NAMES, FRACTIONS, strict=True)}

    def solve(self, mesh: Mesh, comm: MPI.Comm) -> Answer:
        width, height, n = self.values["width"], self.values["height"], mesh.elements
        along = max(1, round(n * height / width))
        body = box(comm, size=(width, height, width), elements=(n, along, n), cell=mesh.cell)
        material = MooneyRivlin(c1=self.values["c1"], c2=self.values["c2"])
        axis, through = (0.0, 1.0, 0.0), (width / 2, 0.0, width / 2)
        turn = statics.rotation(self.values["angle"], axis=axis, through=through)
        top = statics.Fixed(on=("y_upper",), components=("x", "z"), value=turn)
        rises: dict[str, float] = {}

        def keep(part: float, solution: statics.StaticSolution) -> None:
            rise = solution.displacement_at((width / 2, height, width / 2))[1]
            rises[NAMES[FRACTIONS.index(part)]] = float(rise)

        options = replace(self.solver, stops=FRACTIONS)
        supports = [statics.Fixed(on=("y_lower",)), top]
        solution = statics.solve(body, material, fixed=supports, options=options, on_stop=keep)
        return answer_of(solution, material, rises)

    def compared_with(self) -> References:
        source = "mixed Q2-Q1 elements, 4 x 24 x 4, another script"
        pairs = zip(NAMES, computed().values(), strict=True)
        return {name: [Reference(value=u, source=source)] for name, u in pairs} if self.published() else {}
