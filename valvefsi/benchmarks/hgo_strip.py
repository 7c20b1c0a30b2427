"""A strip of the modified HGO material, pulled flat and inflated as a ring, against the homogeneous solution.

The fitting formulas (S1-S3) eliminate the pressure of an incompressible sheet by S_33 = 0. Here the same strip is
solved by finite elements and both must agree:

1. **flat**: dead loads P_11, P_22 that the formulas give for two stretches; the elements must find those stretches;
2. **ring**: bent into a ring of plane strain with fibres around it, inflated by a follower pressure. A point at R
   moves to r with r^2 = R^2 + c and the formulas hold at every radius, p = int (s_theta - s_r)/r dr.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from mpi4py import MPI
from scipy.integrate import quad
from scipy.optimize import brentq

from valvefsi.benchmarks.results import environment, write_result
from valvefsi.benchmarks.static_body import answer_of
from valvefsi.benchmarks.static_study import Answer, Benchmark, Reference, Setup, run_study
from valvefsi.geometry.benchmark_shapes import thick_cylinder
from valvefsi.geometry.shapes import box
from valvefsi.solid import statics
from valvefsi.solid.loads import DeadLoad, Pressure
from valvefsi.solid.materials import fibres
from valvefsi.solid.materials.fibre_reinforced import HGO, FibreFamily

PARAMETERS = {
    "c10": (1.21e4, "dyn/cm^2"),
    "c01": (7.99, "1"),
    "k1": (2.426e5, "dyn/cm^2"),
    "k2": (57.62, "1"),
    "kappa": (0.1, "1"),
    "stretch_1": (1.08, "1"),
    "stretch_2": (1.15, "1"),
    "pressure": (2.0e4, "dyn/cm^2"),
    "inner": (1.0, "cm"),
    "outer": (1.2, "cm"),
}
"""The moduli are of the size of a valve leaflet's; they are parameters, not a fit and not a reference."""

CELLS = {"flat": ("tetrahedron", "hexahedron"), "ring": ("triangle", "quadrilateral")}


def material_of(values: Mapping[str, float]) -> HGO:
    """Return the material, one family along the field "fibre"."""
    family = FibreFamily(k1=values["k1"], k2=values["k2"], kappa=values["kappa"], fibre="fibre")
    return HGO(c10=values["c10"], c01=values["c01"], families=(family,))


def slopes(values: Mapping[str, float], I1: float, I4: float) -> tuple[float, float]:
    """Return dW/dI1 and dW/dI4 of the material at J = 1 [dyn/cm^2]."""
    k1, k2, kappa = values["k1"], values["k2"], values["kappa"]
    E = kappa * I1 + (1 - 3 * kappa) * max(I4, 1.0) - 1
    fibre = k1 * E * math.exp(k2 * E * E)
    matrix = values["c10"] * values["c01"] * math.exp(values["c01"] * (I1 - 3))
    return matrix + kappa * fibre, (1 - 3 * kappa) * fibre if I4 > 1 else 0.0


def sheet_stress(values: Mapping[str, float], stretches: Sequence[float]) -> tuple[float, float]:
    """Return S_11 and S_22 of an incompressible sheet, the fibres along 1 (S1-S3) [dyn/cm^2]."""
    C = np.array([stretches[0] ** 2, stretches[1] ** 2, 1 / (stretches[0] * stretches[1]) ** 2])
    W1, W4 = slopes(values, C.sum(), C[0])
    deviatoric = 2 * np.array([W1 + W4, W1, W1])
    p = deviatoric[2] * C[2]
    S = deviatoric - p / C
    return float(S[0]), float(S[1])


def ring_pressure(values: Mapping[str, float], growth: float) -> float:
    """Return the pressure of a ring whose inner radius grows by ``growth`` [dyn/cm^2]."""
    A, B = values["inner"], values["outer"]
    c = (A + growth) ** 2 - A**2

    def integrand(R: float) -> float:
        stretch = math.sqrt(R * R + c) / R
        W1, W4 = slopes(values, stretch**2 + stretch**-2 + 1, stretch**2)
        difference = 2 * W1 * (stretch**2 - stretch**-2) + 2 * W4 * stretch**2
        return difference * R / (R * R + c)  # dr/r = R dR/r^2

    return quad(integrand, A, B, epsabs=0.0, epsrel=1e-12)[0]


def ring_growth(values: Mapping[str, float]) -> float:
    """Return how far the inner surface of the ring moves [cm]."""
    high = 0.01
    while ring_pressure(values, high) < values["pressure"]:
        high *= 1.5
    return brentq(lambda g: ring_pressure(values, g) - values["pressure"], 0.0, high, xtol=1e-15)


def solve_flat(values: Mapping[str, float], cell: str, elements: int, comm: MPI.Comm) -> Answer:
    """Pull a sheet of 1 x 1 x 0.1 cm by the loads of the formulas (collective)."""
    mesh = box(comm, size=(1.0, 1.0, 0.1), elements=(2 * elements, 2 * elements, 1), cell=cell)
    mesh = mesh.with_fibres(fibre=fibres.constant(mesh, (1.0, 0.0, 0.0)))
    wanted = (values["stretch_1"], values["stretch_2"])
    S = sheet_stress(values, wanted)
    loads = [
        DeadLoad(on=("x_upper",), traction=(wanted[0] * S[0], 0.0, 0.0)),
        DeadLoad(on=("y_upper",), traction=(0.0, wanted[1] * S[1], 0.0)),
    ]
    fixed = [statics.Fixed(on=(f"{axis}_lower",), components=(axis,)) for axis in "xyz"]
    material = material_of(values)
    solution = statics.solve(mesh, material, fixed=fixed, loads=loads)
    u = solution.displacement_at((1.0, 1.0, 0.1))
    found = {"stretch_1": 1 + float(u[0]), "stretch_2": 1 + float(u[1]), "thickness_mm": 1 + 10 * float(u[2])}
    return answer_of(solution, material, found, fibres=mesh.fibres, fibre="fibre")


def solve_ring(values: Mapping[str, float], cell: str, elements: int, comm: MPI.Comm) -> Answer:
    """Inflate a quarter of the ring (collective)."""
    radii = (values["inner"], values["outer"])
    mesh = thick_cylinder(comm, radii=radii, elements=elements, cell=cell)
    mesh = mesh.with_fibres(fibre=fibres.circumferential(mesh, degree=2))
    fixed = [
        statics.Fixed(on=("x_axis",), components=("y",)),
        statics.Fixed(on=("y_axis",), components=("x",)),
    ]
    material, load = material_of(values), Pressure(on=("inner",), value=values["pressure"])
    options = statics.SolverOptions(quadrature_degree=6)
    solution = statics.solve(mesh, material, fixed=fixed, loads=[load], options=options)
    u = solution.displacement_at((values["inner"], 0.0))
    return answer_of(solution, material, {"u_r_inner_cm": float(u[0])}, fibres=mesh.fibres, fibre="fibre")


def _flat_references(values: Mapping[str, float]) -> dict[str, Sequence[Reference]]:
    wanted = {"stretch_1": values["stretch_1"], "stretch_2": values["stretch_2"]}
    wanted["thickness_mm"] = 1 / (wanted["stretch_1"] * wanted["stretch_2"])
    return {name: [Reference(value=v, source="sheet, S1-S3", exact=True)] for name, v in wanted.items()}


def _ring_references(values: Mapping[str, float]) -> dict[str, Sequence[Reference]]:
    return {
        "u_r_inner_cm": [Reference(value=ring_growth(values), source="r^2 = R^2 + c, quadrature", exact=True)]
    }


FLAT = Benchmark(
    name="hgo-strip-flat",
    title="HGO strip pulled along two axes",
    parameters=PARAMETERS,
    cells=CELLS["flat"],
    elements=1,
    solve=solve_flat,
    references=_flat_references,
    units={
        "stretch_1": ("-", "stretch 1"),
        "stretch_2": ("-", "stretch 2"),
        "thickness_mm": ("mm", "thickness"),
    },
)
RING = Benchmark(
    name="hgo-strip-ring",
    title="HGO strip inflated as a ring",
    parameters=PARAMETERS,
    cells=CELLS["ring"],
    elements=1,
    solve=solve_ring,
    references=_ring_references,
    units={"u_r_inner_cm": ("cm", "u_r inside")},
)


def run(setup: Setup, *, out: Path, comm: MPI.Comm = MPI.COMM_WORLD) -> dict[str, object]:
    """Run both parts, each in a folder of its own; their tables are put together (collective)."""
    parts = {}
    every = [*CELLS["flat"], *CELLS["ring"]]
    for name, benchmark in (("flat", FLAT), ("ring", RING)):
        cell = benchmark.cells[every.index(setup.cell) % 2] if setup.cell in every else setup.cell
        parts[name] = run_study(benchmark, replace(setup, cell=cell), out=Path(out) / name, comm=comm)
    table = [
        {**line, "quantity": line["quantity"] and f"{name}: {line['quantity']}"}
        for name, part in parts.items()
        for line in part["table"]
    ]
    result = {
        "benchmark": "hgo-strip",
        "parameters": parts["flat"]["parameters"],
        "quantities": {name: part["quantities"] for name, part in parts.items()},
        "reference": {name: part["reference"] for name, part in parts.items()},
        "table": table,
        "timing": {"wall_s": sum(part["timing"]["wall_s"] for part in parts.values())},
        "environment": environment(comm),
    }
    write_result(out, result, comm)
    return result
