"""Cook's membrane as exactly incompressible statics: its own converged value, beside the published band.

A tapered panel in plane strain, clamped at its left edge; a dead shear traction acts on the right edge. The band
0.59 ... 0.68 cm is that of immersed computations with several kernels, not of a body-fitted method.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

from valvefsi.benchmarks import references
from valvefsi.benchmarks.options import quantities
from valvefsi.benchmarks.results import Reference
from valvefsi.benchmarks.statics.study import Answer, Mesh, References, Static, answer_of
from valvefsi.geometry.benchmark_shapes import COOK, cook_membrane
from valvefsi.solid import statics
from valvefsi.solid.loads import DeadLoad
from valvefsi.solid.materials import NeoHookean

PARAMETERS = quantities("traction = 6.25 dyn/cm^2, c1 = 250/3 dyn/cm^2, scale = 1")


def band() -> tuple[float, float]:
    """Return the range of u_y of the upper right corner [cm], immersed, over kernels; second-hand."""
    table = references.read("cook_membrane")
    return table.value("u_y_corner_cm", what="band_lower"), table.value("u_y_corner_cm", what="band_upper")


@dataclass(frozen=True, kw_only=True)
class StaticCook(Static):
    """Cook's membrane as statics."""

    name = "statics-cook"
    title = "Cook's membrane, incompressible"
    parameters = PARAMETERS
    cells = ("triangle", "quadrilateral")
    coarsest = 8
    units = {"u_y_corner_cm": ("cm", "u_y of the upper right corner")}

    def solve(self, mesh: Mesh, comm: MPI.Comm) -> Answer:
        values, scale = self.values, self.values["scale"]
        body = cook_membrane(comm, elements=mesh.elements, cell=mesh.cell, scale=scale)
        material = NeoHookean(c1=values["c1"])
        load = DeadLoad(on=("right",), traction=(0.0, values["traction"]))
        fixed = [statics.Fixed(on=("left",))]
        solution = statics.solve(body, material, fixed=fixed, loads=[load], options=self.solver)
        corner = [x * scale for x in COOK[2]]
        return answer_of(solution, material, {"u_y_corner_cm": float(solution.displacement_at(corner)[1])})

    def compared_with(self) -> References:
        compared = {"u_y_corner_cm": [Reference(band=band(), source="immersed, over kernels; second-hand")]}
        return compared if self.published() else {}
