"""How much bulk modulus a leaflet needs: volume and shape under 100 mmHg, and the stable step, over kappa.

A patch of 10 x 10 mm, held at its four sides, bears 100 mmHg on one face, as a closed leaflet does. Its volume and
the deflection of its middle are compared with those of exactly incompressible Taylor-Hood elements; in a box of fluid
with h = 1 mm the largest stable step of the coupled scheme is measured, at rest and under that load.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.benchmarks.frame import Benchmark, Job, Record, Report
from valvefsi.benchmarks.options import Values, option
from valvefsi.benchmarks.results import row
from valvefsi.benchmarks.statics.bending import Strip
from valvefsi.benchmarks.statics.bending import material_of as strip_material
from valvefsi.bodies.elastic import Elastic
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import CaseError
from valvefsi.fluid.boundary import Boundary
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.geometry.shapes import box
from valvefsi.grid import MacGrid
from valvefsi.post.plots.bending import over_kappa
from valvefsi.run.stable_step import measured_limit
from valvefsi.solid import statics
from valvefsi.solid.loads import Pressure
from valvefsi.solid.materials import fibres
from valvefsi.solid.statics import Fixed, SolidShell, TaylorHood
from valvefsi.solid.structure import Discretisation, Structure

if TYPE_CHECKING:
    from valvefsi.geometry.mesh import SolidMesh
    from valvefsi.solid.materials import Material
    from valvefsi.solid.statics.formulations import Formulation

EDGE = 1.0
"""Of the patch [cm]."""
CELLS = 32
"""Fluid cells of 1 mm along each edge of the box."""
SIDES = ("x_lower", "x_upper", "y_lower", "y_upper")
PRESSURE = 133322.4
"""100 mmHg [dyn/cm^2]."""
STEP = 1e-4
"""Step at which the fluid's viscosity is taken for the stable one [s]."""


@dataclass(frozen=True, kw_only=True)
class BulkModulus(Benchmark[float, float]):
    """Volume, shape and stable step of a leaflet's patch over kappa."""

    name = "bulk-modulus"

    thickness: float = option(0.4, "Thickness of the patch [mm].")
    elements: int = option(10, "Elements along each side.", least=2)
    layers: int = option(1, "Elements through the thickness.", least=1, most=4)
    material: str = option("bovine_pericardium_lee_sacks", "Name of a preset, its fibres along x.")
    kappas: tuple[float, ...] = option(
        (1e6, 4e6, 1e7, 4e7, 1e8), "Bulk moduli [dyn/cm^2].", metavar="K,K", between=(0.0, math.inf)
    )

    @property
    def thickness_cm(self) -> float:
        """Thickness of the patch [cm]."""
        return 0.1 * self.thickness

    @property
    def counts(self) -> tuple[int, int, int]:
        """Elements along both sides and through the thickness."""
        return self.elements, self.elements, self.layers

    def check(self, values: Values) -> None:
        Strip(thickness=self.thickness_cm, material=self.material)
        if not self.kappas:
            raise CaseError("expected positive numbers, such as 1e6,1e7", key="--kappas")

    def runs(self) -> tuple[float, ...]:
        return self.kappas

    def references(self, comm: MPI.Comm) -> float:
        return self._deflection(self.solve((8, 8, 1), TaylorHood(), comm))

    def label(self, run: float) -> str:
        return f"kappa {run:.3g} dyn/cm^2"

    def one(self, run: float, job: Job) -> Record:
        solution = self.solve(self.counts, SolidShell(kappa=run), job.comm)
        rest, loaded = self.stable_steps(run, solution, job.comm)
        return {
            "kappa": run,
            "kappa_over_mu": run / self.mechanics.shear_modulus,
            "volume_change_percent": 100 * (solution.volume_ratio() - 1),
            "deflection_cm": self._deflection(solution),
            "stable_step_us": 1e6 * rest,
            "stable_step_loaded_us": 1e6 * loaded,
        }

    @property
    def mechanics(self) -> Material:
        """The material of the patch."""
        return strip_material(Strip(material=self.material))

    def mesh(self, counts: tuple[int, int, int], comm: MPI.Comm) -> SolidMesh:
        """Return the patch in so many elements (collective)."""
        lower, size = (0.0, 0.0, -self.thickness_cm / 2), (EDGE, EDGE, self.thickness_cm)
        mesh = box(comm, lower=lower, size=size, elements=counts)
        return mesh.with_fibres(fibre=fibres.constant(mesh, (1.0, 0.0, 0.0)))

    def solve(
        self, counts: tuple[int, int, int], formulation: Formulation | SolidShell, comm: MPI.Comm
    ) -> statics.StaticSolution:
        """Return the equilibrium under the pressure (collective)."""
        return statics.solve(
            self.mesh(counts, comm),
            self.mechanics,
            fixed=[Fixed(on=SIDES)],
            loads=[Pressure(on=("z_lower",), value=PRESSURE)],
            formulation=formulation,
            options=statics.SolverOptions(first_increment=0.02, smallest_increment=1e-5, quadrature_degree=5),
        )

    def _deflection(self, solution: statics.StaticSolution) -> float:
        return float(solution.displacement_at((EDGE / 2, EDGE / 2, 0.0))[2])

    def stable_steps(
        self, kappa: float, solution: statics.StaticSolution, comm: MPI.Comm
    ) -> tuple[float, float]:
        """Return the largest stable step at rest and at the equilibrium [s] (collective)."""
        h = 0.1
        lower = (EDGE / 2 - CELLS * h / 2,) * 2 + (-CELLS * h / 2,)
        grid = MacGrid(lower, tuple(x + CELLS * h for x in lower), (CELLS,) * 3, (False,) * 3, comm)
        shell = Discretisation(element="solid_shell", kappa=kappa)
        solid = Structure(self.mesh(self.counts, comm), self.mechanics, discretisation=shell)
        fluid = NavierStokes(grid, Boundary(grid), rho=1.0, mu=0.035)
        model = fsi.Model(grid=grid, fluid=fluid, bodies=(Elastic(solid, Coupling(grid, "bspline3")),))
        u = solution.displacement.x.array.reshape(-1, 3)[: len(solid.X)]
        loaded = replace(fsi.initial_state(model, STEP), bodies=({"chi": solid.X + u},))
        return measured_limit(model, STEP, 0), measured_limit(model, STEP, 0, at=loaded)

    def report(self, records: Sequence[Record], reference: float) -> Report:
        quantities, table = {}, []
        for r in records:
            name = f"kappa {r['kappa']:.3g}"
            quantities[name] = {**r, "deflection_error_percent": 100 * (r["deflection_cm"] / reference - 1)}
            table += [
                row(
                    f"{name}: deflection", r["deflection_cm"], reference, "mixed Q2-Q1, 8 x 8 x 1", unit="cm"
                ),
                row(f"{name}: change of volume", r["volume_change_percent"], unit="%"),
                row(f"{name}: stable step at rest", r["stable_step_us"], unit="us"),
                row(f"{name}: stable step under load", r["stable_step_loaded_us"], unit="us"),
            ]
        return Report(
            parameters={key: getattr(self, key) for key in ("elements", "layers", "material")}
            | {"thickness": self.thickness_cm},
            quantities=quantities,
            reference={"deflection_cm": reference},
            table=table,
        )

    def draw(self, records: Sequence[Record], reference: float, out: Path) -> None:
        keys = [key for key, value in records[0].items() if isinstance(value, float)]
        columns = {key: np.array([r[key] for r in records]) for key in keys}
        columns["deflection_error_percent"] = 100 * (columns["deflection_cm"] / reference - 1)
        over_kappa(out / "bulk_modulus.png", columns, title=f"Patch under 100 mmHg, {self.material}")
