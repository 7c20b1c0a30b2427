"""The plate of `plate`: its place in a periodic box of fluid, its coupled model, and the same plate without a fluid."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.benchmarks.immersed.plate_theory import ImmersedPlate
from valvefsi.bodies.elastic import Elastic
from valvefsi.coupling.transfer import Coupling
from valvefsi.fluid.boundary import Boundary
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.fluid.sides import Open
from valvefsi.geometry.shapes import box, rectangle
from valvefsi.grid import MacGrid
from valvefsi.solid import statics
from valvefsi.solid.loads import DeadLoad, Pressure, Ramp, Tether
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.structure import Discretisation, Structure
from valvefsi.types import Array

WIDTH = 4
"""Cells across the plate's plane strain, the fewest that a grid has."""
NU = {"solid_shell": 0.4, "quadratic": 0.49, "linear": 0.49}
"""Numerical Poisson ratio by element: solid shells bend alike with any."""
HOLD = 20.0
"""Stiffness of the springs at the ends, over G / h."""


@dataclass(frozen=True, kw_only=True)
class Place:
    """Where a plate is in its box, lengths in spacings.

    Attributes:
        cells: Cells of the box.
        turn: Angle of the plate to the grid's x axis, in the plane of x and z [rad].
        length: Of the plate.
        height: Distance of its images across it.
    """

    cells: tuple[int, int, int]
    turn: float
    length: float
    height: float

    @property
    def along(self) -> Array:
        """Unit vector along the span."""
        return np.array([math.cos(self.turn), 0.0, math.sin(self.turn)])

    @property
    def normal(self) -> Array:
        """Unit normal."""
        return np.array([-math.sin(self.turn), 0.0, math.cos(self.turn)])


def place_of(length: int, height: int, angle: int) -> Place:
    """Return the smallest box of a plate of about ``length`` spacings, at 0 or 45 degrees to the grid."""
    if angle == 45:
        n, root = round(length / math.sqrt(2.0)), math.sqrt(2.0)
        return Place(cells=(n, WIDTH, n), turn=math.pi / 4.0, length=n * root, height=n / root)
    return Place(cells=(length, WIDTH, height), turn=0.0, length=length, height=height)


@dataclass(frozen=True, kw_only=True)
class Discrete:
    """How a plate is discretised.

    Attributes:
        element: "solid_shell", "quadratic" or "linear".
        kernel: Name of the regularised delta function.
        ratio: Distance of the nodes over the spacing.
        layers: Elements through the thickness.
        h: Grid spacing [cm].
        shift: Of the plate against the grid, along and across it, over the spacing.
    """

    element: str
    kernel: str
    ratio: float
    layers: int
    h: float
    shift: float

    @property
    def degree(self) -> int:
        """Degree of the elements."""
        return 2 if self.element == "quadratic" else 1

    @property
    def nu_stab(self) -> float:
        """Numerical Poisson ratio."""
        return NU[self.element]

    @property
    def discretisation(self) -> Discretisation:
        """The same for the solid."""
        shell = self.element == "solid_shell"
        return Discretisation(element="solid_shell") if shell else Discretisation(degree=self.degree)

    def elements(self, plate: ImmersedPlate) -> int:
        """Return the elements along a plate, an even number: a node is in its middle."""
        return 2 * max(1, round(0.5 * plate.length / (self.h * self.ratio * self.degree)))

    def middle(self, where: Place) -> Array:
        """Return the middle of a plate, ``(3,)`` [cm]."""
        middle: Array = self.h * (0.5 * np.array(where.cells) + self.shift * (where.along + where.normal))
        return middle


@dataclass(frozen=True, kw_only=True)
class Loading:
    """What a plate at rest carries.

    Attributes:
        load: Load per area [dyn/cm^2].
        ramp: How it grows.
        damping: Body damping [dyn s/cm^4].
    """

    load: float
    ramp: Ramp
    damping: float


def model_of(
    plate: ImmersedPlate, where: Place, discrete: Discrete, comm: MPI.Comm, loading: Loading | None = None
) -> tuple[fsi.Model, Structure]:
    """Return the coupled model of a plate, and its solid; held and loaded where a load is (collective).

    A plate along the grid carries the difference of pressure of the box's open sides, one at an angle a dead load.
    """
    h, ends = discrete.h, ("x_lower", "x_upper")
    sides: dict[str, Any] = {}
    tethers = [Tether(on=ends, stiffness=HOLD * plate.modulus / h)] if loading else []
    loads: list[DeadLoad] = []
    if loading and where.turn:
        traction = tuple(loading.load * where.normal)
        loads = [DeadLoad(on=("z_lower",), traction=traction, ramp=loading.ramp)]
    elif loading:
        below = Open(pressure=lambda x, y, z, t: loading.load * loading.ramp(t))
        sides = {"z_lower": below, "z_upper": Open(pressure=0.0)}
    grid = MacGrid([0.0] * 3, [h * n for n in where.cells], where.cells, [True, True, not sides], comm)
    solid = Structure(
        _mesh(plate, where, discrete, comm),
        NeoHookean(c1=plate.modulus),
        name="plate",
        nu_stab=discrete.nu_stab,
        discretisation=discrete.discretisation,
        damping=loading.damping if loading else 0.0,
        tethers=tethers,
        loads=loads,
    )
    fluid = NavierStokes(grid, Boundary(grid, sides), rho=plate.rho, mu=plate.mu)
    body = Elastic(solid, Coupling(grid, discrete.kernel, fluid.boundary.signs))
    return fsi.Model(grid=grid, fluid=fluid, bodies=(body,)), solid


def _mesh(plate: ImmersedPlate, where: Place, discrete: Discrete, comm: MPI.Comm) -> Any:
    """Return the mesh of a plate in its place, as wide as the box (collective)."""
    size = plate.length, WIDTH * discrete.h, plate.thickness
    counts = discrete.elements(plate), WIDTH // discrete.degree, discrete.layers  # nothing varies across
    mesh = box(comm, lower=[-0.5 * edge for edge in size], size=size, elements=counts)
    X = mesh.mesh.geometry.x
    X[:] = discrete.middle(where) + X @ np.stack([where.along, (0.0, 1.0, 0.0), where.normal])
    return mesh


def own_deflection(plate: ImmersedPlate, discrete: Discrete, load: float, comm: MPI.Comm) -> float:
    """Return the deflection of the middle of a span of a plate's own elements without a fluid [cm] (collective)."""
    size = plate.length, WIDTH * discrete.h, plate.thickness
    formulation: Any = statics.NearlyIncompressible(degree=discrete.degree, nu_stab=discrete.nu_stab)
    if discrete.element == "solid_shell":
        formulation = statics.SolidShell(nu_stab=discrete.nu_stab)
    solution = statics.solve(
        box(
            comm,
            lower=[-0.5 * edge for edge in size],
            size=size,
            elements=(discrete.elements(plate), 1, discrete.layers),
        ),
        NeoHookean(c1=plate.modulus),
        fixed=[
            statics.Fixed(on=("x_lower", "x_upper")),
            statics.Fixed(on=("y_lower", "y_upper"), components=("y",)),
        ],
        loads=[Pressure(on=("z_lower",), value=load)],
        formulation=formulation,
        options=statics.SolverOptions(first_increment=1.0),
    )
    faces = np.array([[0.0, 0.0, end * plate.thickness] for end in (-0.5, 0.5)])
    return float(solution.displacement_at(faces)[:, 2].mean())


def incompressible_deflection(plate: ImmersedPlate, load: float, comm: MPI.Comm) -> float:
    """Return the deflection of the middle of an exactly incompressible span between clamps [cm] (collective)."""
    size = plate.length, plate.thickness
    counts = max(32, 2 * round(size[0] / size[1])), 4
    solution = statics.solve(
        rectangle(comm, lower=(-0.5 * size[0], -0.5 * size[1]), size=size, elements=counts),
        NeoHookean(c1=plate.modulus),
        fixed=[statics.Fixed(on=("x_lower", "x_upper"))],
        loads=[Pressure(on=("y_lower",), value=load)],
        options=statics.SolverOptions(first_increment=1.0),
    )
    return float(solution.displacement_at((0.0, 0.0))[1])
