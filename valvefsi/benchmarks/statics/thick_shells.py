"""A thick cylinder (plane strain) and a thick sphere under inner pressure, against their closed forms.

Exactly incompressible and neo-Hookean: a point at R moves to r with r^2 = R^2 + c (cylinder), r^3 = R^3 + c (sphere),
and the balance of the radial stress gives the pressure as a function of c, see `valvefsi.verification.closed_forms`.
The pressure follows the deformed surface.

The sphere is computed with linear elements, too, which the energy of the coupled solid holds in volume: they are too
soft with its usual modulus, which lets the volume change, and lock with a larger one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np
from mpi4py import MPI
from scipy.optimize import brentq, minimize_scalar

from valvefsi.benchmarks.options import Values, quantities
from valvefsi.benchmarks.results import Reference
from valvefsi.benchmarks.statics.study import Answer, Mesh, References, Static, StaticParts, answer_of
from valvefsi.errors import CaseError
from valvefsi.geometry.benchmark_shapes import thick_cylinder, thick_sphere
from valvefsi.solid import statics
from valvefsi.solid.loads import Pressure
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.statics import TAYLOR_HOOD, NearlyIncompressible
from valvefsi.verification.closed_forms import cylinder_pressure, sphere_pressure

PARAMETERS = quantities("pressure = 2.5e4 dyn/cm^2, c1 = 1e5 dyn/cm^2, inner = 1 cm, outer = 1.5 cm")
DIM = {"cylinder": 2, "sphere": 3}
AXES = {"cylinder": ("x_axis", "y_axis"), "sphere": ("x_plane", "y_plane", "z_plane")}
NORMALS = {"x_axis": "y", "y_axis": "x", "x_plane": "x", "y_plane": "y", "z_plane": "z"}
LINEAR = {f", linear, nu_stab {nu:g}": nu for nu in (0.4, 0.49)}
"""What stands behind the kind of cell where its elements are linear: the numerical Poisson ratio of each."""
MESHES = {"cylinder": thick_cylinder, "sphere": thick_sphere}


def closed_form(shape: str, values: Values) -> tuple[float, float]:
    """Return the displacement of the inner and of the outer surface [cm].

    Raises:
        CaseError: The pressure is above what the shell can bear.
    """
    A, B = values["inner"], values["outer"]
    target = values["pressure"] / values["c1"]
    pressure: Callable[[float], float] = partial(
        cylinder_pressure if shape == "cylinder" else sphere_pressure, A=A, B=B
    )
    top = minimize_scalar(lambda g: -pressure(g), bounds=(0.0, 20.0 * A), method="bounded").x
    if pressure(top) <= target:
        limit = f"{pressure(top) * values['c1']:.4g} dyn/cm^2"
        message = f"the {shape} collapses below this pressure, at {limit}"
        raise CaseError(message, file="--set", key="pressure", value=values["pressure"])
    growth = brentq(lambda g: pressure(g) - target, 0.0, top, xtol=1e-15)
    n = DIM[shape]
    return growth, (B**n + (A + growth) ** n - A**n) ** (1 / n) - B


def solution_of(
    shape: str, values: Values, mesh: Mesh, comm: MPI.Comm
) -> tuple[statics.StaticSolution, NeoHookean]:
    """Return the static solution and its material (collective)."""
    radii = (values["inner"], values["outer"])
    cell, comma, kind = mesh.cell.partition(",")
    body = MESHES[shape](comm, radii=radii, elements=mesh.elements, cell=cell)
    linear = NearlyIncompressible(degree=1, nu_stab=LINEAR[comma + kind]) if kind else None
    fixed = [statics.Fixed(on=(tag,), components=(NORMALS[tag],)) for tag in AXES[shape]]
    material = NeoHookean(c1=values["c1"])
    load = Pressure(on=("inner",), value=values["pressure"])
    return statics.solve(
        body, material, fixed=fixed, loads=[load], formulation=linear or TAYLOR_HOOD
    ), material


@dataclass(frozen=True, kw_only=True)
class ThickShell(Static):
    """A thick shell under inner pressure."""

    shape: ClassVar[str]
    parameters = PARAMETERS
    units = {"u_r_inner_cm": ("cm", "u_r inside"), "u_r_outer_cm": ("cm", "u_r outside")}

    def check(self, values: Values) -> None:
        super().check(values)
        if not values["inner"] < values["outer"]:
            raise CaseError("expected inner < outer", file="--set", key="inner", value=values["inner"])
        closed_form(self.shape, values)

    def solve(self, mesh: Mesh, comm: MPI.Comm) -> Answer:
        solution, material = solution_of(self.shape, self.values, mesh, comm)
        rest = [0.0] * (DIM[self.shape] - 1)
        ends = [[self.values["inner"], *rest], [self.values["outer"], *rest]]
        inner, outer = solution.displacement_at(np.array(ends))
        return answer_of(
            solution, material, {"u_r_inner_cm": float(inner[0]), "u_r_outer_cm": float(outer[0])}
        )

    def references(self, comm: MPI.Comm) -> References:
        pairs = zip(self.units, closed_form(self.shape, self.values), strict=True)
        return {name: [Reference(value=u, source="closed form", exact=True)] for name, u in pairs}


@dataclass(frozen=True, kw_only=True)
class ThickCylinder(ThickShell):
    """A quarter of the cylinder, in plane strain."""

    name = "thick-cylinder"
    title = "Thick cylinder under pressure, incompressible"
    shape = "cylinder"
    cells = ("triangle", "quadrilateral")
    coarsest = 2


@dataclass(frozen=True, kw_only=True)
class ThickSphere(ThickShell):
    """An eighth of the sphere."""

    name = "thick-sphere"
    title = "Thick sphere under pressure, incompressible"
    shape = "sphere"
    cells = ("tetrahedron", "hexahedron")
    also = tuple(cell + kind for cell in ("tetrahedron", "hexahedron") for kind in LINEAR)


@dataclass(frozen=True, kw_only=True)
class ThickShells(StaticParts):
    """Both shells."""

    name = "thick-shells"
    parts = {"cylinder": ThickCylinder, "sphere": ThickSphere}
