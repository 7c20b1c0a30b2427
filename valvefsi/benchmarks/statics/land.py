"""Cardiac mechanics benchmarks 1 to 3 of Land et al. (2015), doi 10.1098/rspa.2015.0641, as incompressible statics.

1. **beam**: 10 x 1 x 1 mm, fibres along it, clamped at one end, a pressure on its lower face that follows it;
2. **inflation**: a truncated ellipsoid, isotropic, base fixed, pressure inside;
3. **contraction**: the same ellipsoid with fibres turning by 180 degrees through the wall, pressure and active
   tension growing together.

The problems are the paper's. Its answers are curves; where a number is compared with, its source is named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from valvefsi.benchmarks import references
from valvefsi.benchmarks.options import Values, option, quantities
from valvefsi.benchmarks.results import Reference
from valvefsi.benchmarks.statics.study import Answer, Mesh, References, Static, StaticParts, answer_of
from valvefsi.geometry.benchmark_shapes import truncated_ellipsoid
from valvefsi.geometry.shapes import box
from valvefsi.solid import statics
from valvefsi.solid.loads import Pressure
from valvefsi.solid.materials import fibres
from valvefsi.solid.materials.cardiac import Contracting, Guccione, ellipsoid_fibres

BEAM = quantities("C = 2e4 dyn/cm^2, bf = 8, bt = 2, bfs = 4, pressure = 40 dyn/cm^2")
INFLATION = quantities("C = 1e5 dyn/cm^2, bf = 1, bt = 1, bfs = 1, pressure = 1e5 dyn/cm^2")
CONTRACTION = quantities("""
    C = 2e4 dyn/cm^2, bf = 8, bt = 2, bfs = 4, pressure = 1.5e5 dyn/cm^2, tension = 6e5 dyn/cm^2
""")
SHORT, LONG = (0.7, 1.0), (1.7, 2.0)
APEX = {"z_apex_endo_mm": ("mm", "z of the inner apex"), "z_apex_epi_mm": ("mm", "z of the outer apex")}


def _material(values: Values) -> Guccione:
    return Guccione(**{name: values[name] for name in ("C", "bf", "bt", "bfs")}, fibre="fibre")


def beam_band() -> tuple[float, float]:
    """Return the range of the height of the beam's tip over the codes [mm]."""
    table = references.read("land2015_beam")
    return table.value("z_tip_mm", what="range_lower"), table.value("z_tip_mm", what="range_upper")


@dataclass(frozen=True, kw_only=True)
class Beam(Static):
    """Problem 1, ``10 elements x elements x elements`` cells."""

    name = "land-1-beam"
    title = "Land 2015, problem 1: beam"
    parameters = BEAM
    cells = ("tetrahedron", "hexahedron")
    units = {"z_tip_mm": ("mm", "z of the tip")}

    def solve(self, mesh: Mesh, comm: MPI.Comm) -> Answer:
        n = mesh.elements
        body = box(comm, size=(1.0, 0.1, 0.1), elements=(10 * n, n, n), cell=mesh.cell)
        body = body.with_fibres(fibre=fibres.constant(body, (1.0, 0.0, 0.0)))
        material = _material(self.values)
        load = Pressure(on=("z_lower",), value=self.values["pressure"])
        solution = statics.solve(body, material, fixed=[statics.Fixed(on=("x_lower",))], loads=[load])
        z = 0.1 + float(solution.displacement_at((1.0, 0.05, 0.1))[2])
        return answer_of(solution, material, {"z_tip_mm": 10 * z}, fibres=body.fibres, fibre="fibre")

    def references(self, comm: MPI.Comm) -> References:
        compared = {"z_tip_mm": [Reference(band=beam_band(), source="Land 2015, second-hand")]}
        return compared if self.published() else {}


@dataclass(frozen=True, kw_only=True)
class Inflation(Static):
    """Problem 2, and 3 where there is a tension, with ``elements`` cells through the wall."""

    name = "land-2-inflation"
    title = "Land 2015, problem 2: inflation"
    parameters = INFLATION
    cells = ("tetrahedron", "hexahedron")
    units = APEX

    def solve(self, mesh: Mesh, comm: MPI.Comm) -> Answer:
        counts = (mesh.elements, 3 * mesh.elements + 3)
        body = truncated_ellipsoid(comm, short=SHORT, long=LONG, elements=counts, cell=mesh.cell)
        field = fibres.from_function(body, ellipsoid_fibres(SHORT, LONG, (90.0, -90.0)), degree=2)
        body = body.with_fibres(fibre=field)
        passive, base = _material(self.values), statics.Fixed(on=("base",))
        material: Guccione | Contracting = passive
        if "tension" in self.values:
            material = active = Contracting(body, passive, self.values["tension"], "fibre")
            base = statics.Fixed(on=("base",), value=active.follow)
        load = Pressure(on=("endo",), value=self.values["pressure"])
        options = statics.SolverOptions(first_increment=0.05)
        solution = statics.solve(body, material, fixed=[base], loads=[load], options=options)
        apex = np.array([(0.0, 0.0, -LONG[0]), (0.0, 0.0, -LONG[1])])
        places = zip(apex, solution.displacement_at(apex), strict=True)
        heights = dict(zip(APEX, (10 * (point[2] + float(u[2])) for point, u in places), strict=True))
        return answer_of(solution, material, heights, fibres=body.fibres, fibre="fibre")


@dataclass(frozen=True, kw_only=True)
class Contraction(Inflation):
    """Problem 3."""

    name = "land-3-contraction"
    title = "Land 2015, problem 3: contraction"
    parameters = CONTRACTION


PROBLEMS: dict[int, type[Static]] = {1: Beam, 2: Inflation, 3: Contraction}


@dataclass(frozen=True, kw_only=True)
class Land(StaticParts):
    """The problems asked for."""

    name = "land"
    parts = {kind.name: kind for kind in PROBLEMS.values()}

    cell: str = option("hexahedron", "Kind of cell: tetrahedron, hexahedron, simplex or both.")
    problem: Sequence[int] = option((1, 2, 3), "1, 2 or 3; repeatable; all by default.", choices=(1, 2, 3))

    def selection(self) -> dict[str, type[Static]]:
        return {PROBLEMS[number].name: PROBLEMS[number] for number in self.problem}

    def title(self, part: str) -> str:
        return part[5]
