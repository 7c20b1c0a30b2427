"""A strip of the modified HGO material, pulled flat and inflated as a ring, against the homogeneous solution.

The fitting formulas (S1-S3) eliminate the pressure of an incompressible sheet by S_33 = 0. Here the same strip is
solved by finite elements and both must agree:

1. **flat**: dead loads P_11, P_22 that the formulas give for two stretches; the elements must find those stretches;
2. **ring**: bent into a ring of plane strain with fibres around it, inflated by a follower pressure. A point at R
   moves to r with r^2 = R^2 + c and the formulas hold at every radius, p = int (s_theta - s_r)/r dr.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from scipy.integrate import quad
from scipy.optimize import brentq

from valvefsi.benchmarks.options import Values, quantities
from valvefsi.benchmarks.results import Reference
from valvefsi.benchmarks.statics.study import Answer, Mesh, References, Static, StaticParts, answer_of
from valvefsi.geometry.benchmark_shapes import thick_cylinder
from valvefsi.geometry.shapes import box
from valvefsi.solid import statics
from valvefsi.solid.loads import DeadLoad, Pressure
from valvefsi.solid.materials import fibres
from valvefsi.solid.materials.fibre_reinforced import HGO, FibreFamily

PARAMETERS = quantities("""
    c10 = 1.21e4 dyn/cm^2, c01 = 7.99, k1 = 2.426e5 dyn/cm^2, k2 = 57.62, kappa = 0.1, stretch_1 = 1.08,
    stretch_2 = 1.15, pressure = 2e4 dyn/cm^2, inner = 1 cm, outer = 1.2 cm
""")
"""The moduli are of the size of a valve leaflet's; they are parameters, not a fit and not a reference."""


def material_of(values: Values) -> HGO:
    """Return the material, one family along the field "fibre"."""
    family = FibreFamily(k1=values["k1"], k2=values["k2"], kappa=values["kappa"], fibre="fibre")
    return HGO(c10=values["c10"], c01=values["c01"], families=(family,))


def sheet_stress(values: Values, stretches: Sequence[float]) -> tuple[float, float]:
    """Return S_11 and S_22 of an incompressible sheet, the fibres along 1 (S1-S3) [dyn/cm^2].

    S = 2 (W1 + W4 a (x) a) - p C^-1, W1 = dW/dI1 and W4 = dW/dI4 at J = 1, p such that S_33 = 0.
    """
    C = np.array([stretches[0] ** 2, stretches[1] ** 2, 1 / (stretches[0] * stretches[1]) ** 2])
    I1, kappa = C.sum(), values["kappa"]
    E = kappa * I1 + (1 - 3 * kappa) * max(C[0], 1.0) - 1
    fibre = values["k1"] * E * math.exp(values["k2"] * E * E)
    W1 = values["c10"] * values["c01"] * math.exp(values["c01"] * (I1 - 3)) + kappa * fibre
    W4 = (1 - 3 * kappa) * fibre if C[0] > 1 else 0.0
    S = 2 * np.array([W1 + W4, W1]) - 2 * W1 * C[2] / C[:2]
    return float(S[0]), float(S[1])


def ring_pressure(values: Values, growth: float) -> float:
    """Return the pressure of a ring whose inner radius grows by ``growth`` [dyn/cm^2].

    Around and along the ring it is a sheet of stretches (l, 1), so that s_theta - s_r = l^2 S_11.
    """
    A, B = values["inner"], values["outer"]
    c = (A + growth) ** 2 - A**2

    def integrand(R: float) -> float:
        stretch = math.sqrt(R * R + c) / R
        return stretch**2 * sheet_stress(values, (stretch, 1.0))[0] * R / (R * R + c)  # dr/r = R dR/r^2

    return quad(integrand, A, B, epsabs=0.0, epsrel=1e-12)[0]


def ring_growth(values: Values) -> float:
    """Return how far the inner surface of the ring moves [cm]."""
    high = 0.01
    while ring_pressure(values, high) < values["pressure"]:
        high *= 1.5
    return brentq(lambda g: ring_pressure(values, g) - values["pressure"], 0.0, high, xtol=1e-15)


@dataclass(frozen=True, kw_only=True)
class Flat(Static):
    """A sheet of 1 x 1 x 0.1 cm under the loads of the formulas."""

    name = "hgo-strip-flat"
    title = "HGO strip pulled along two axes"
    parameters = PARAMETERS
    cells = ("tetrahedron", "hexahedron")
    units = {f"stretch_{k}": ("-", f"stretch {k}") for k in (1, 2)} | {"thickness_mm": ("mm", "thickness")}

    def solve(self, mesh: Mesh, comm: MPI.Comm) -> Answer:
        n, values = 2 * mesh.elements, self.values
        body = box(comm, size=(1.0, 1.0, 0.1), elements=(n, n, 1), cell=mesh.cell)
        body = body.with_fibres(fibre=fibres.constant(body, (1.0, 0.0, 0.0)))
        stretches = (values["stretch_1"], values["stretch_2"])
        S = sheet_stress(values, stretches)
        loads = [
            DeadLoad(on=("x_upper",), traction=(stretches[0] * S[0], 0.0, 0.0)),
            DeadLoad(on=("y_upper",), traction=(0.0, stretches[1] * S[1], 0.0)),
        ]
        fixed = [statics.Fixed(on=(f"{axis}_lower",), components=(axis,)) for axis in "xyz"]
        material = material_of(values)
        solution = statics.solve(body, material, fixed=fixed, loads=loads)
        u = solution.displacement_at((1.0, 1.0, 0.1))
        sizes = (1 + float(u[0]), 1 + float(u[1]), 1 + 10 * float(u[2]))
        answer = dict(zip(self.units, sizes, strict=True))
        return answer_of(solution, material, answer, fibres=body.fibres, fibre="fibre")

    def references(self, comm: MPI.Comm) -> References:
        one, two = self.values["stretch_1"], self.values["stretch_2"]
        pairs = zip(self.units, (one, two, 1 / (one * two)), strict=True)
        return {name: [Reference(value=v, source="sheet, S1-S3", exact=True)] for name, v in pairs}


@dataclass(frozen=True, kw_only=True)
class Ring(Static):
    """A quarter of a ring under inner pressure."""

    name = "hgo-strip-ring"
    title = "HGO strip inflated as a ring"
    parameters = PARAMETERS
    cells = ("triangle", "quadrilateral")
    units = {"u_r_inner_cm": ("cm", "u_r inside")}

    def solve(self, mesh: Mesh, comm: MPI.Comm) -> Answer:
        radii = (self.values["inner"], self.values["outer"])
        body = thick_cylinder(comm, radii=radii, elements=mesh.elements, cell=mesh.cell)
        body = body.with_fibres(fibre=fibres.circumferential(body, degree=2))
        fixed = [statics.Fixed(on=(f"{a}_axis",), components=(b,)) for a, b in ("xy", "yx")]
        material = material_of(self.values)
        load = Pressure(on=("inner",), value=self.values["pressure"])
        options = statics.SolverOptions(quadrature_degree=6)
        solution = statics.solve(body, material, fixed=fixed, loads=[load], options=options)
        u = solution.displacement_at((self.values["inner"], 0.0))
        return answer_of(solution, material, {"u_r_inner_cm": float(u[0])}, fibres=body.fibres, fibre="fibre")

    def references(self, comm: MPI.Comm) -> References:
        growth = ring_growth(self.values)
        return {"u_r_inner_cm": [Reference(value=growth, source="r^2 = R^2 + c, quadrature", exact=True)]}


@dataclass(frozen=True, kw_only=True)
class HgoStrip(StaticParts):
    """Both parts."""

    name = "hgo-strip"
    parts = {"flat": Flat, "ring": Ring}
