"""Cook's membrane as exactly incompressible statics: its own converged value, beside the published band.

A tapered panel in plane strain, clamped at its left edge; a dead shear traction acts on the right edge. The band
0.59 ... 0.68 cm is that of immersed computations with several kernels, not of a body-fitted method.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

from valvefsi.benchmarks import references
from valvefsi.benchmarks.options import Values, option
from valvefsi.benchmarks.results import Reference
from valvefsi.benchmarks.statics.study import Answer, Mesh, References, Static, answer_of
from valvefsi.geometry.benchmark_shapes import COOK, cook_membrane
from valvefsi.solid import statics
from valvefsi.solid.loads import DeadLoad
from valvefsi.solid.materials import NeoHookean

PARAMETERS = {
    "traction": (6.25, "dyn/cm^2"),
    "c1": (250.0 / 3.0, "dyn/cm^2"),
    "scale": (1.0, "1"),
}


def band() -> tuple[float, float]:
    """Return the range of u_y of the upper right corner [cm], immersed, over kernels; second-hand."""
    table = references.read("cook_membrane")
    return table.value("u_y_corner_cm", what="band_lower"), table.value("u_y_corner_cm", what="band_upper")


def solve(values: Values, mesh: Mesh, comm: MPI.Comm, options: statics.SolverOptions | None = None) -> Answer:
    """Solve the membrane with ``elements x elements`` cells (collective)."""
    body = cook_membrane(comm, elements=mesh.elements, cell=mesh.cell, scale=values["scale"])
    material = NeoHookean(c1=values["c1"])
    load = DeadLoad(on=("right",), traction=(0.0, values["traction"]))
    fixed, options = [statics.Fixed(on=("left",))], options or statics.SolverOptions()
    solution = statics.solve(body, material, fixed=fixed, loads=[load], options=options)
    corner = [x * values["scale"] for x in COOK[2]]
    return answer_of(solution, material, {"u_y_corner_cm": float(solution.displacement_at(corner)[1])})


@dataclass(frozen=True, kw_only=True)
class StaticCook(Static):
    """Cook's membrane as statics."""

    name = "statics-cook"
    title = "Cook's membrane, incompressible"
    parameters = PARAMETERS
    cells = ("triangle", "quadrilateral")
    coarsest = 8
    units = {"u_y_corner_cm": ("cm", "u_y of the upper right corner")}

    iterative: bool = option(False, "FGMRES with multigrid instead of a factorisation, for large meshes.")

    def solve(self, mesh: Mesh, comm: MPI.Comm) -> Answer:
        return solve(self.values, mesh, comm, self.solver)

    def compared_with(self) -> References:
        known = {"u_y_corner_cm": [Reference(band=band(), source="immersed, over kernels; second-hand")]}
        return known if self.published() else {}
