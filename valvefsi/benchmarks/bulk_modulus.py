"""How much bulk modulus a leaflet needs: volume and shape under 100 mmHg, and the stable step, over kappa.

A patch of 10 x 10 mm, held at its four sides, bears 100 mmHg on one face, as a closed leaflet does. Its volume and
the deflection of its middle are compared with those of exactly incompressible Taylor-Hood elements; in a box of fluid
with h = 1 mm the largest stable step of the coupled scheme is measured, at rest and under that load.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from mpi4py import MPI

from valvefsi.benchmarks.bending import Strip
from valvefsi.benchmarks.bending import material_of as strip_material
from valvefsi.benchmarks.immersed import Numerics, immersed_model
from valvefsi.fluid.boundary import Boundary
from valvefsi.fsi import initial_state
from valvefsi.geometry.shapes import box
from valvefsi.grid import MacGrid
from valvefsi.solid import fibres, statics
from valvefsi.solid.loads import Pressure
from valvefsi.solid.statics import Fixed, SolidShell, TaylorHood
from valvefsi.solid.structure import Discretisation, Structure
from valvefsi.stable_step import measured_limit

if TYPE_CHECKING:
    from collections.abc import Sequence

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
class Patch:
    """What bears the pressure.

    Attributes:
        thickness: Thickness [cm].
        elements: Elements along each side.
        layers: Elements through the thickness.
        material: Name of a preset, its fibres along x.
    """

    thickness: float = 0.04
    elements: int = 10
    layers: int = 1
    material: str = "bovine_pericardium_lee_sacks"


def run(patch: Patch, kappas: Sequence[float], comm: MPI.Comm = MPI.COMM_WORLD) -> list[dict[str, float]]:
    """Return volume, shape and stable step for each bulk modulus [dyn/cm^2] (collective)."""
    exact = _solve(patch, (8, 8, 1), TaylorHood(), comm)
    expected = exact.displacement_at(_middle())[2]
    lines = []
    for kappa in kappas:
        counts = (patch.elements, patch.elements, patch.layers)
        solution = _solve(patch, counts, SolidShell(kappa=kappa), comm)
        rest, loaded = _stable_steps(patch, kappa, counts, solution, comm)
        lines.append(
            {
                "kappa": kappa,
                "kappa_over_mu": kappa / strip_material(Strip(material=patch.material)).shear_modulus,
                "volume_change_percent": 100 * (solution.volume_ratio() - 1),
                "deflection_cm": float(solution.displacement_at(_middle())[2]),
                "deflection_error_percent": 100
                * float(solution.displacement_at(_middle())[2] / expected - 1),
                "stable_step_us": 1e6 * rest,
                "stable_step_loaded_us": 1e6 * loaded,
            }
        )
    return lines


def _middle() -> tuple[float, float, float]:
    return EDGE / 2, EDGE / 2, 0.0


def _mesh(patch: Patch, counts: tuple[int, int, int], comm: MPI.Comm) -> object:
    lower = (0.0, 0.0, -patch.thickness / 2)
    mesh = box(comm, lower=lower, size=(EDGE, EDGE, patch.thickness), elements=counts)
    return mesh.with_fibres(fibre=fibres.constant(mesh, (1.0, 0.0, 0.0)))


def _solve(
    patch: Patch, counts: tuple[int, int, int], formulation: object, comm: MPI.Comm
) -> statics.StaticSolution:
    return statics.solve(
        _mesh(patch, counts, comm),
        strip_material(Strip(material=patch.material)),
        fixed=[Fixed(on=SIDES)],
        loads=[Pressure(on=("z_lower",), value=PRESSURE)],
        formulation=formulation,
        options=statics.SolverOptions(first_increment=0.02, smallest_increment=1e-5, quadrature_degree=5),
    )


def _stable_steps(
    patch: Patch,
    kappa: float,
    counts: tuple[int, int, int],
    solution: statics.StaticSolution,
    comm: MPI.Comm,
) -> tuple[float, float]:
    """Return the largest stable step at rest and at the equilibrium [s] (collective)."""
    h = 0.1
    lower = (EDGE / 2 - CELLS * h / 2,) * 2 + (-CELLS * h / 2,)
    grid = MacGrid(lower, tuple(x + CELLS * h for x in lower), (CELLS,) * 3, (False,) * 3, comm)
    solid = Structure(
        _mesh(patch, counts, comm),
        strip_material(Strip(material=patch.material)),
        discretisation=Discretisation(element="solid_shell", kappa=kappa),
    )
    numerics, fluid = Numerics(grid=CELLS), {"rho": 1.0, "mu": 0.035}
    model = immersed_model(grid, Boundary(grid), solid, numerics, fluid)
    u = solution.displacement.x.array.reshape(-1, 3)[: len(solid.X)]
    loaded = replace(initial_state(model, STEP), chi=(solid.X + u,))
    return measured_limit(model, STEP, 0), measured_limit(model, STEP, 0, at=loaded)
