"""Block, membrane and column as exactly incompressible statics: the answers that the immersed ones tend to.

- Compressed block (Lee2020, E.1): neo-Hookean, 20 x 10 cm, plane strain. A dead load acts on the middle half of the
  top; u_x = 0 on the whole top, the loaded part included, and u_y = 0 on the bottom.
- Cook's membrane: a tapered panel in plane strain, clamped at its left edge, a dead shear traction on the right one.
  The band 0.59 ... 0.68 cm is that of immersed computations with several kernels, not of a body-fitted method.
- Torsion of a column (Lee2020, E.2) at five angles up to one turn and a quarter: Mooney-Rivlin, axis y, clamped at its
  foot. On the top face the two displacements in the plane are those of a rigid rotation; the axial one is free, and
  twisting lengthens the column (Poynting's effect).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from mpi4py import MPI

from valvefsi.benchmarks import references
from valvefsi.benchmarks.options import quantities
from valvefsi.benchmarks.results import Reference
from valvefsi.benchmarks.statics.study import Answer, Mesh, References, Static, answer_of
from valvefsi.geometry.benchmark_shapes import COOK, cook_membrane
from valvefsi.geometry.shapes import box, compressed_block
from valvefsi.solid import statics
from valvefsi.solid.loads import DeadLoad
from valvefsi.solid.materials import MooneyRivlin, NeoHookean

FRACTIONS = (0.2, 0.4, 0.6, 0.8, 1.0)
"""The angles of torsion reported, as parts of the last one."""
NAMES = tuple(f"u_y_{part:g}_of_angle_cm" for part in FRACTIONS)


def block_displacement() -> float:
    """Return u_y of the block's top centre [cm], computed with mixed elements and refined until the digits stand."""
    return round(references.read("compression_statics").value("u_y_top_centre_cm", elements_x=128), 4)


def cook_band() -> tuple[float, float]:
    """Return the range of u_y of the membrane's corner [cm], immersed, over kernels; second-hand."""
    table = references.read("cook_membrane")
    return table.value("u_y_corner_cm", what="band_lower"), table.value("u_y_corner_cm", what="band_upper")


def column_rises() -> dict[float, float]:
    """Return u_y of the column's top centre [cm] by part of 2.5 pi, Q2-Q1, 4 x 24 x 4."""
    table = references.read("torsion_statics")
    return {part: table.value("u_y_top_centre_cm", theta_over_pi=2.5 * part) for part in FRACTIONS}


@dataclass(frozen=True, kw_only=True)
class StaticCompression(Static):
    """The compressed block as statics, ``2 elements x elements`` cells."""

    name = "statics-compression"
    title = "Compressed block (E.1), incompressible"
    parameters = quantities("""
        traction = 200 dyn/cm^2, c1 = 80.194 dyn/cm^2, width = 20 cm, height = 10 cm, load_width = 10 cm
    """)
    cells = ("triangle", "quadrilateral")
    coarsest = 16
    units = {"u_y_top_centre_cm": ("cm", "u_y of the top centre")}

    def solve(self, mesh: Mesh, comm: MPI.Comm) -> Answer:
        v, size, n = self.values, (self.values["width"], self.values["height"]), mesh.elements
        numbers = {"size": size, "elements": (2 * n, n), "load_width": v["load_width"]}
        body = compressed_block(comm, lower=(0.0, 0.0), cell=mesh.cell, **numbers)
        material, top = NeoHookean(c1=v["c1"]), ("top_loaded", "top_outer")
        fixed = [statics.Fixed(on=("bottom",), components=("y",)), statics.Fixed(on=top, components=("x",))]
        load = DeadLoad(on=("top_loaded",), traction=(0.0, -v["traction"]))
        solution = statics.solve(body, material, fixed=fixed, loads=[load], options=self.solver)
        u_y = float(solution.displacement_at((size[0] / 2, size[1]))[1])
        return answer_of(solution, material, {"u_y_top_centre_cm": u_y})

    def references(self, comm: MPI.Comm) -> References:
        source = "mixed P2-P1 elements, 128 x 64, another script"
        compared = {"u_y_top_centre_cm": [Reference(value=block_displacement(), source=source)]}
        return compared if self.published() else {}


@dataclass(frozen=True, kw_only=True)
class StaticCook(Static):
    """Cook's membrane as statics, ``elements x elements`` cells."""

    name = "statics-cook"
    title = "Cook's membrane, incompressible"
    parameters = quantities("traction = 6.25 dyn/cm^2, c1 = 250/3 dyn/cm^2, scale = 1")
    cells = ("triangle", "quadrilateral")
    coarsest = 8
    units = {"u_y_corner_cm": ("cm", "u_y of the upper right corner")}

    def solve(self, mesh: Mesh, comm: MPI.Comm) -> Answer:
        values, scale = self.values, self.values["scale"]
        body = cook_membrane(comm, elements=mesh.elements, cell=mesh.cell, scale=scale)
        material, fixed = NeoHookean(c1=values["c1"]), [statics.Fixed(on=("left",))]
        load = DeadLoad(on=("right",), traction=(0.0, values["traction"]))
        solution = statics.solve(body, material, fixed=fixed, loads=[load], options=self.solver)
        corner = [x * scale for x in COOK[2]]
        return answer_of(solution, material, {"u_y_corner_cm": float(solution.displacement_at(corner)[1])})

    def references(self, comm: MPI.Comm) -> References:
        band = Reference(band=cook_band(), source="immersed, over kernels; second-hand")
        return {"u_y_corner_cm": [band]} if self.published() else {}


@dataclass(frozen=True, kw_only=True)
class StaticTorsion(Static):
    """Torsion of a column as statics."""

    name = "statics-torsion"
    title = "Torsion of a column (E.2), incompressible"
    parameters = quantities(
        "c1 = 9000 dyn/cm^2, c2 = 9000 dyn/cm^2, width = 1 cm, height = 6 cm", angle=(2.5 * math.pi, "1")
    )
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

    def references(self, comm: MPI.Comm) -> References:
        source = "mixed Q2-Q1 elements, 4 x 24 x 4, another script"
        pairs = zip(NAMES, column_rises().values(), strict=True)
        return {name: [Reference(value=u, source=source)] for name, u in pairs} if self.published() else {}
