"""Cook's membrane, immersed, against its exactly incompressible value, solved in the same run.

A tapered neo-Hookean panel in plane strain in a box of fluid of 10 x 10 cm. Its left edge is held by tethers; a dead
shear traction acts on its right edge and grows smoothly over the first 40 % of the run. The displacement of the upper
right corner is averaged over the last 20 %.

The size of an element is the root of its mean area; the longest edges, at the bottom, are 1.7 times as long. With
elements of one spacing they lie beyond what kernels bridge, and without the volumetric energy the fluid runs through
between the nodes: the membrane yields without end. Elements of half a spacing hold with and without it.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

from valvefsi.benchmarks.immersed.study import Numerics, SolidStudy
from valvefsi.benchmarks.options import option, quantities, texts
from valvefsi.benchmarks.statics.solids import StaticCook, cook_band
from valvefsi.benchmarks.statics.study import Mesh
from valvefsi.geometry.benchmark_shapes import COOK, cook_membrane
from valvefsi.grid import MacGrid
from valvefsi.run.recording import Probe
from valvefsi.solid.loads import DeadLoad, Ramp, Tether
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.structure import Structure

PARAMETERS = quantities("""
    traction = 6.25 dyn/cm^2, c1 = 250/3 dyn/cm^2, rho = 1 g/cm^3, mu = 0.16 dyn*s/cm^2,
    damping = 5 dyn*s/cm^4, t_end = 20 s, dt_per_h = 0.008 s/cm, tether_stiffness = 1e5 dyn/cm^3
""")
BOX, SHIFT, RAMP = 10.0, (-2.6, -2.0), 0.4
"""Edge of the box and its lower corner [cm]; part of the run over which the load grows."""
FINE = 32
"""Elements along each edge in the static solution that is compared with."""


def elements(numerics: Numerics) -> int:
    """Elements along each edge: their size at mid-length (4.8 cm across, 3 cm high) is ``ratio`` spacings."""
    size = numerics.ratio * BOX / numerics.grid
    return max(2, round((4.8 * 3.0) ** 0.5 / size))


@dataclass(frozen=True, kw_only=True)
class Cook(SolidStudy):
    """The membrane on one or several grids."""

    name = "cook"
    title = "Cook's membrane, immersed"
    parameters = PARAMETERS
    body, width = "membrane", BOX
    probe = Probe(name="corner", body=0, at=COOK[2])

    grid: int = option(25, "Cells along the box.", least=4)

    def solid(self, numerics: Numerics, comm: MPI.Comm) -> Structure:
        values = self.values
        ramp = Ramp(duration=RAMP * values["t_end"], shape="smooth")
        return Structure(
            cook_membrane(comm, elements=elements(numerics)),
            NeoHookean(c1=values["c1"]),
            name="membrane",
            nu_stab=numerics.nu_stab,
            damping=values["damping"],
            tethers=[Tether(on=("left",), stiffness=values["tether_stiffness"])],
            loads=[DeadLoad(on=("right",), traction=(0.0, values["traction"]), ramp=ramp)],
        )

    def box(self, cells: int, comm: MPI.Comm) -> MacGrid:
        return MacGrid(SHIFT, [s + BOX for s in SHIFT], [cells] * 2, [False, False], comm)

    def incompressible(self, numerics: Numerics, comm: MPI.Comm) -> tuple[float, str]:
        static = StaticCook(overrides=texts(self.values, "traction", "c1"))
        answer = static.solve(Mesh(cell="quadrilateral", elements=FINE), comm)
        return answer.values["u_y_corner_cm"], f"mixed u-p statics, {FINE} x {FINE}, this run"

    def elsewhere(self) -> list[tuple[float | str, str]]:
        low, high = cook_band()
        source = "immersed, over kernels; second-hand"
        return [(f"{low} ... {high}", source)] if self.published("traction", "c1") else []
