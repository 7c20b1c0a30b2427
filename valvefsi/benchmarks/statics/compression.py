"""Compressed block (Lee2020, E.1) as exactly incompressible statics: the answer that the immersed block tends to.

A neo-Hookean block of 20 x 10 cm in plane strain. A dead load acts on the middle half of the top; u_x = 0 on the
whole top, the loaded part included, and u_y = 0 on the bottom.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

from valvefsi.benchmarks import references
from valvefsi.benchmarks.options import quantities
from valvefsi.benchmarks.results import Reference
from valvefsi.benchmarks.statics.study import Answer, Mesh, References, Static, answer_of
from valvefsi.geometry.shapes import compressed_block
from valvefsi.solid import statics
from valvefsi.solid.loads import DeadLoad
from valvefsi.solid.materials import NeoHookean

PARAMETERS = quantities("""
    traction = 200 dyn/cm^2, c1 = 80.194 dyn/cm^2, width = 20 cm, height = 10 cm, load_width = 10 cm
""")


def converged() -> float:
    """Return u_y of the top centre [cm], computed with mixed elements and refined until the digits stand."""
    return round(references.read("compression_statics").value("u_y_top_centre_cm", elements_x=128), 4)


@dataclass(frozen=True, kw_only=True)
class StaticCompression(Static):
    """The compressed block as statics."""

    name = "statics-compression"
    title = "Compressed block (E.1), incompressible"
    parameters = PARAMETERS
    cells = ("triangle", "quadrilateral")
    coarsest = 16
    units = {"u_y_top_centre_cm": ("cm", "u_y of the top centre")}

    def solve(self, mesh: Mesh, comm: MPI.Comm) -> Answer:
        values, n = self.values, mesh.elements
        width, height = values["width"], values["height"]
        body = compressed_block(
            comm,
            lower=(0.0, 0.0),
            size=(width, height),
            cell=mesh.cell,
            elements=(2 * n, n),
            load_width=values["load_width"],
        )
        material, top = NeoHookean(c1=values["c1"]), ("top_loaded", "top_outer")
        fixed = [statics.Fixed(on=("bottom",), components=("y",)), statics.Fixed(on=top, components=("x",))]
        load = DeadLoad(on=("top_loaded",), traction=(0.0, -values["traction"]))
        solution = statics.solve(body, material, fixed=fixed, loads=[load], options=self.solver)
        u_y = float(solution.displacement_at((width / 2, height))[1])
        return answer_of(solution, material, {"u_y_top_centre_cm": u_y})

    def compared_with(self) -> References:
        source = "mixed P2-P1 elements, 128 x 64, another script"
        compared = {"u_y_top_centre_cm": [Reference(value=converged(), source=source)]}
        return compared if self.published() else {}
