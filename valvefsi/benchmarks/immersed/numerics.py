"""What the immersed benchmarks share: how a problem is discretised and coupled, and one attempt to run it."""

from __future__ import annotations

from dataclasses import dataclass

from valvefsi.benchmarks.options import Values
from valvefsi.bodies.elastic import Elastic
from valvefsi.coupling.elemental import ElementalCoupling
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import CaseError
from valvefsi.fluid.boundary import Boundary
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.fsi import Model
from valvefsi.grid import MacGrid
from valvefsi.solid.elements.element_points import ElementPoints
from valvefsi.solid.structure import Structure

COUPLINGS = ("nodal", "elemental", "lumped")


@dataclass(frozen=True, kw_only=True)
class Numerics:
    """How a problem is discretised and coupled.

    Attributes:
        grid: Cells along the box, as the problem counts them.
        ratio: Element size over grid spacing.
        kernel: Name of the regularised delta function.
        coupling: "nodal", "elemental", or "lumped": elemental with the lumped mass.
        nu_stab: Numerical Poisson ratio (S22), None for no volumetric energy.
    """

    grid: int
    ratio: float = 1.0
    kernel: str = "bspline3"
    coupling: str = "nodal"
    nu_stab: float | None = 0.4

    def __post_init__(self) -> None:
        """Check the coupling."""
        if self.coupling not in COUPLINGS:
            message = 'expected "nodal", "elemental" or "lumped"'
            raise CaseError(message, key="--coupling", value=self.coupling)

    @property
    def name(self) -> str:
        """Name of the run's folder."""
        held = "off" if self.nu_stab is None else f"{self.nu_stab:g}"
        return f"N{self.grid}-r{self.ratio:g}-{self.kernel}-{self.coupling}-{held}"


def couple(fluid: NavierStokes, solid: Structure, numerics: Numerics) -> Coupling | ElementalCoupling:
    """Return the coupling that the numerics ask for (collective)."""
    grid, signs = fluid.grid, fluid.boundary.signs
    if numerics.coupling == "nodal":
        return Coupling(grid, numerics.kernel, signs)
    mass = "lumped" if numerics.coupling == "lumped" else "consistent"
    return ElementalCoupling(grid, numerics.kernel, ElementPoints(solid, mass), signs=signs)


def immersed_model(
    grid: MacGrid, boundary: Boundary, solid: Structure, numerics: Numerics, values: Values
) -> Model:
    """Return the model of one solid in one box; ``values`` holds rho and mu (collective)."""
    flow = NavierStokes(grid, boundary, rho=values["rho"], mu=values["mu"])
    return Model(grid=grid, fluid=flow, bodies=(Elastic(solid, couple(flow, solid, numerics)),))
