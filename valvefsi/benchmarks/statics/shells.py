"""Thin elastic shells that turn far, of solid-shell elements, under the full load of a published table.

The four tests of Sze, Liu and Lo (2004) that have one smooth shell each, one element through the thickness:

    cantilever      10 x 1 x 0.1, shear force 4 at the end
    slit-ring       radii 6 and 10, thickness 0.03, one side of the slit clamped, the other lifted by 0.8 per length
    hemisphere      radius 10, thickness 0.04, hole of 18 degrees, four forces of 400 in turn out and in; a quarter
    cylinder        radius 4.953, length 10.35, thickness 0.094, free ends, pulled apart by 40,000; an eighth

Lengths, forces and moduli are pure numbers there and stand for cm, dyn and dyn/cm^2 here. The material is that of Saint
Venant and Kirchhoff. The cantilever is compared with the elastica, too, a beam without shear and stretch.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from mpi4py import MPI

from valvefsi.benchmarks.options import option
from valvefsi.benchmarks.references import read
from valvefsi.benchmarks.results import Reference
from valvefsi.benchmarks.statics.study import Answer, Mesh, References, Static, StaticParts, body_of
from valvefsi.geometry.shapes import box
from valvefsi.solid import loads as solid_loads
from valvefsi.solid import statics
from valvefsi.solid.loads import DeadLoad, PointLoad
from valvefsi.solid.materials import SaintVenantKirchhoff
from valvefsi.solid.statics import Fixed, SolidShell
from valvefsi.solid.structure_stress import stress_of_equilibrium
from valvefsi.verification.closed_forms import elastica

if TYPE_CHECKING:
    from valvefsi.types import Array

SOURCES = {
    "table": "Sze et al. 2004, as tabled by MBDyn",
    "remembered": "Sze et al. 2004, remembered, not checked",
}
"""Where a published number was read."""
QUARTER = math.pi / 2


@dataclass(frozen=True, kw_only=True)
class Setting:
    """What holds and loads a shell.

    Attributes:
        fixed: Supports.
        loads: Loads.
        points: Where displacements are read, ``(n, 3)`` [cm].
        tethers: Springs.
    """

    fixed: Sequence[Fixed]
    loads: Sequence[DeadLoad | PointLoad]
    points: Array
    tethers: Sequence[solid_loads.Tether] = ()


@dataclass(frozen=True, kw_only=True)
class ThinShell(Static):
    """A shell that is a bent box of elements: along, across, one through the thickness."""

    cells = ("hexahedron",)
    refine: int = option(2, "Refine the mesh K times; gives the observed order.", least=0)

    size: ClassVar[tuple[float, float, float]]
    """Of the box: along, across, thickness; the middle of the thickness is at 0 [cm or rad]."""
    young: ClassVar[float]
    poisson: ClassVar[float]
    counts: ClassVar[tuple[int, int]]
    """Elements along and across of the coarsest mesh."""
    first_increment: ClassVar[float] = 0.25

    @property
    def material(self) -> SaintVenantKirchhoff:
        """The material."""
        E, nu = self.young, self.poisson
        return SaintVenantKirchhoff(mu=E / 2 / (1 + nu), lam=E * nu / (1 + nu) / (1 - 2 * nu))

    @abstractmethod
    def shape(self, X: Array) -> Array:
        """Return where points of the box are, ``(n, 3)`` [cm]."""

    @abstractmethod
    def setting(self) -> Setting:
        """Return supports, loads and points."""

    @abstractmethod
    def read_off(self, u: Array) -> Sequence[float]:
        """Return the quantities from the displacements of the points."""

    def elements_of(self, mesh: Mesh) -> tuple[int, int, int]:
        """Return the elements along, across and through a mesh."""
        along, across = self.counts
        return along * mesh.elements // self.coarsest, across * mesh.elements // self.coarsest, 1

    def solve(self, mesh: Mesh, comm: MPI.Comm) -> Answer:
        thickness = self.size[2]
        body = box(comm, lower=(0.0, 0.0, -thickness / 2), size=self.size, elements=self.elements_of(mesh))
        body.mesh.geometry.x[:] = self.shape(body.mesh.geometry.x)
        setting = self.setting()
        solution = statics.solve(
            body,
            self.material,
            fixed=setting.fixed,
            loads=setting.loads,
            tethers=setting.tethers,
            formulation=SolidShell(),
            options=statics.SolverOptions(first_increment=self.first_increment),
        )
        values = self.read_off(solution.displacement_at(setting.points))
        space = solution.displacement.function_space
        return Answer(
            values=dict(zip(self.units, map(float, values), strict=True)),
            unknowns=3 * space.dofmap.index_map.size_global,
            body=body_of(stress_of_equilibrium(solution, body, self.material, SolidShell())),
        )

    def references(self, comm: MPI.Comm) -> References:
        table, case = read("sze2004"), self.name.removeprefix("shells-")
        rows = {row["quantity"]: row for row in table.rows if row["case"] == case}
        return {
            name: [Reference(value=float(rows[name]["value"]), source=SOURCES[rows[name]["trust"]])]
            for name in self.units
        }


@dataclass(frozen=True, kw_only=True)
class Cantilever(ThinShell):
    """A strip with a force across its end."""

    name = "shells-cantilever"
    title = "Cantilever with end shear"
    units = {"shortening": ("", "u back"), "deflection": ("", "w")}
    size, young, poisson = (10.0, 1.0, 0.1), 1.2e6, 0.0
    counts, coarsest = (8, 1), 8
    force: ClassVar[float] = 4.0

    def shape(self, X: Array) -> Array:
        return X

    def setting(self) -> Setting:
        length, width, thickness = self.size
        load = DeadLoad(on=("x_upper",), traction=(0.0, 0.0, self.force / (width * thickness)))
        point = np.array([[length, width / 2, 0.0]])
        return Setting(fixed=[Fixed(on=("x_lower",))], loads=[load], points=point)

    def read_off(self, u: Array) -> Sequence[float]:
        return -u[0, 0], u[0, 2]

    def references(self, comm: MPI.Comm) -> References:
        length, width, thickness = self.size
        values = elastica(self.force, length, self.young * width * thickness**3 / 12)
        table = super().references(comm)
        return {
            name: [*table[name], Reference(value=value, source="elastica")]
            for name, value in zip(self.units, values, strict=True)
        }


@dataclass(frozen=True, kw_only=True)
class SlitRing(ThinShell):
    """A flat ring with a slit."""

    name = "shells-slit-ring"
    title = "Slit ring, lifted at the slit"
    units = {"lift_inner": ("", "w inside"), "lift_outer": ("", "w outside")}
    # A little less than all the way round, so that the sides of the slit do not touch.
    size, young, poisson = (2 * math.pi - 1e-5, 4.0, 0.03), 21e6, 0.0
    counts, coarsest = (40, 5), 5
    inner: ClassVar[float] = 6.0
    lift: ClassVar[float] = 0.8

    def shape(self, X: Array) -> Array:
        turn, r = -X[:, 0], self.inner + X[:, 1]
        return np.stack([r * np.cos(turn), r * np.sin(turn), X[:, 2]], axis=1)

    def setting(self) -> Setting:
        load = DeadLoad(on=("x_upper",), traction=(0.0, 0.0, self.lift / self.size[2]))
        turn, width, near = self.size[0] - 1e-6, self.size[1], 1e-5
        corners = np.array([[turn, near, 0.0], [turn, width - near, 0.0]])  # inside the flat sides
        return Setting(fixed=[Fixed(on=("x_lower",))], loads=[load], points=self.shape(corners))

    def read_off(self, u: Array) -> Sequence[float]:
        return u[0, 2], u[1, 2]


@dataclass(frozen=True, kw_only=True)
class Hemisphere(ThinShell):
    """A quarter of a hemisphere with a hole, from its equator to the hole."""

    name = "shells-hemisphere"
    title = "Hemisphere with a hole of 18 degrees, four forces"
    units = {"outward": ("", "u outward"), "inward": ("", "u inward")}
    size, young, poisson = (QUARTER, math.radians(72.0), 0.04), 6.825e7, 0.3
    counts, coarsest = (16, 16), 16
    radius: ClassVar[float] = 10.0
    force: ClassVar[float] = 400.0

    def shape(self, X: Array) -> Array:
        around, up, r = X[:, 0], X[:, 1], self.radius + X[:, 2]
        level = r * np.cos(up)
        return np.stack([level * np.cos(around), level * np.sin(around), r * np.sin(up)], axis=1)

    def setting(self) -> Setting:
        half, reach = self.force / 2, self.size[2] / 2
        radii = (self.radius - reach, self.radius + reach)
        return Setting(
            fixed=[Fixed(on=("x_lower",), components=("y",)), Fixed(on=("x_upper",), components=("x",))],
            loads=[
                PointLoad(at=tuple((r, 0.0, 0.0) for r in radii), force=(half, 0.0, 0.0)),
                PointLoad(at=tuple((0.0, r, 0.0) for r in radii), force=(0.0, -half, 0.0)),
            ],
            points=self.radius * np.eye(3)[:2] + 1e-7,
            # so weak that it only keeps the shell from floating
            tethers=[solid_loads.Tether(components=("z",), stiffness=1e-3)],
        )

    def read_off(self, u: Array) -> Sequence[float]:
        return u[0, 0], -u[1, 1]


@dataclass(frozen=True, kw_only=True)
class PulledCylinder(ThinShell):
    """An eighth of a cylinder with free ends, along y; it snaps through on the way, so the load is put on at once."""

    name = "shells-cylinder"
    title = "Cylinder with free ends, pulled apart"
    units = {"pull": ("", "w pulled"), "side_middle": ("", "u side"), "side_end": ("", "u side, end")}
    size, young, poisson = (QUARTER, 10.35 / 2, 0.094), 10.5e6, 0.3125
    counts, coarsest = (18, 12), 12
    first_increment = 1.0
    radius: ClassVar[float] = 4.953
    force: ClassVar[float] = 40_000.0

    def shape(self, X: Array) -> Array:
        around, r = X[:, 0], self.radius + X[:, 2]
        return np.stack([r * np.sin(around), X[:, 1], r * np.cos(around)], axis=1)

    def setting(self) -> Setting:
        reach, end = self.size[2] / 2, self.size[1]
        at = tuple((0.0, 0.0, r) for r in (self.radius - reach, self.radius + reach))
        R, near = self.radius, 1e-7
        return Setting(
            fixed=[
                Fixed(on=("x_lower",), components=("x",)),
                Fixed(on=("x_upper",), components=("z",)),
                Fixed(on=("y_lower",), components=("y",)),
            ],
            loads=[PointLoad(at=at, force=(0.0, 0.0, self.force / 4))],
            points=np.array([[near, near, R], [R, near, near], [R, end - near, near]]),
        )

    def read_off(self, u: Array) -> Sequence[float]:
        return u[0, 2], -u[1, 0], -u[2, 0]


@dataclass(frozen=True, kw_only=True)
class Shells(StaticParts):
    """All of them."""

    name = "shells"
    refine: int = option(2, "Refine the mesh K times; gives the observed order.", least=0)
    parts: ClassVar[Mapping[str, type[Static]]] = {
        "cantilever": Cantilever,
        "slit-ring": SlitRing,
        "hemisphere": Hemisphere,
        "cylinder": PulledCylinder,
    }
