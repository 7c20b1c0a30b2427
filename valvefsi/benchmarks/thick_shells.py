"""A thick cylinder (plane strain) and a thick sphere under inner pressure, against their closed forms.

Exactly incompressible and neo-Hookean: a point at R moves to r with r^2 = R^2 + c (cylinder), r^3 = R^3 + c (sphere),
and the balance of the radial stress gives the pressure as a function of c (Green and Zerna, Theoretical Elasticity):

    cylinder  p/c1 = ln(a B / (A b)) + c/2 (1/a^2 - 1/b^2)
    sphere    p/c1 = 2/l_b + 1/(2 l_b^4) - 2/l_a - 1/(2 l_a^4),    l = r/R

with A, B the radii at rest and a, b the deformed ones. The pressure follows the deformed surface.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from mpi4py import MPI
from scipy.optimize import brentq, minimize_scalar

from valvefsi.benchmarks.results import environment, write_result
from valvefsi.benchmarks.static_body import answer_of
from valvefsi.benchmarks.static_study import Answer, Benchmark, Reference, Setup, run_study
from valvefsi.errors import CaseError
from valvefsi.geometry.benchmark_shapes import thick_cylinder, thick_sphere
from valvefsi.solid import statics
from valvefsi.solid.loads import Pressure
from valvefsi.solid.materials import NeoHookean

PARAMETERS = {
    "pressure": (2.5e4, "dyn/cm^2"),
    "c1": (1.0e5, "dyn/cm^2"),
    "inner": (1.0, "cm"),
    "outer": (1.5, "cm"),
}
DIM = {"cylinder": 2, "sphere": 3}
CELLS = {"cylinder": ("triangle", "quadrilateral"), "sphere": ("tetrahedron", "hexahedron")}
AXES = {"cylinder": ("x_axis", "y_axis"), "sphere": ("x_plane", "y_plane", "z_plane")}
NORMALS = {"x_axis": "y", "y_axis": "x", "x_plane": "x", "y_plane": "y", "z_plane": "z"}
MESHES = {"cylinder": thick_cylinder, "sphere": thick_sphere}


def cylinder_pressure(growth: float, A: float, B: float) -> float:
    """Return p/c1 of a cylinder whose inner radius grows by ``growth`` [cm]."""
    a = A + growth
    c = a * a - A * A
    b = math.sqrt(B * B + c)
    return math.log(a * B / (A * b)) + c / 2 * (1 / a**2 - 1 / b**2)


def sphere_pressure(growth: float, A: float, B: float) -> float:
    """Return p/c1 of a sphere whose inner radius grows by ``growth`` [cm]."""
    a = A + growth
    b = (B**3 + a**3 - A**3) ** (1 / 3)
    inner, outer = a / A, b / B
    return 2 / outer + 0.5 / outer**4 - 2 / inner - 0.5 / inner**4


def closed_form(shape: str, values: Mapping[str, float]) -> tuple[float, float]:
    """Return the displacement of the inner and of the outer surface [cm].

    Raises:
        CaseError: The pressure is above what the shell can bear.
    """
    A, B = values["inner"], values["outer"]
    wanted = values["pressure"] / values["c1"]
    pressure: Callable[[float], float] = partial(
        cylinder_pressure if shape == "cylinder" else sphere_pressure, A=A, B=B
    )
    top = minimize_scalar(lambda g: -pressure(g), bounds=(0.0, 20.0 * A), method="bounded").x
    if pressure(top) <= wanted:
        limit = f"{pressure(top) * values['c1']:.4g} dyn/cm^2"
        message = f"the {shape} gives way below this pressure, at {limit}"
        raise CaseError(message, file="--set", key="pressure", value=values["pressure"])
    growth = brentq(lambda g: pressure(g) - wanted, 0.0, top, xtol=1e-15)
    n = DIM[shape]
    return growth, (B**n + (A + growth) ** n - A**n) ** (1 / n) - B


def solve_shell(shape: str, values: Mapping[str, float], cell: str, elements: int, comm: MPI.Comm) -> Answer:
    """Solve a quarter of the cylinder or an eighth of the sphere (collective)."""
    solution, material = solution_of(shape, values, cell, elements, comm)
    rest = [0.0] * (DIM[shape] - 1)
    inner, outer = solution.displacement_at([[values["inner"], *rest], [values["outer"], *rest]])
    return answer_of(solution, material, {"u_r_inner_cm": float(inner[0]), "u_r_outer_cm": float(outer[0])})


def solution_of(
    shape: str, values: Mapping[str, float], cell: str, elements: int, comm: MPI.Comm
) -> tuple[statics.StaticSolution, NeoHookean]:
    """Return the static solution and its material (collective)."""
    closed_form(shape, values)
    radii = (values["inner"], values["outer"])
    if not radii[0] < radii[1]:
        raise CaseError("expected inner < outer", file="--set", key="inner", value=radii[0])
    mesh = MESHES[shape](comm, radii=radii, elements=elements, cell=cell)
    fixed = [statics.Fixed(on=(tag,), components=(NORMALS[tag],)) for tag in AXES[shape]]
    material = NeoHookean(c1=values["c1"])
    load = Pressure(on=("inner",), value=values["pressure"])
    return statics.solve(mesh, material, fixed=fixed, loads=[load]), material


def _references(shape: str, values: Mapping[str, float]) -> dict[str, Sequence[Reference]]:
    names = ("u_r_inner_cm", "u_r_outer_cm")
    pairs = zip(names, closed_form(shape, values), strict=True)
    return {name: [Reference(value=u, source="closed form", exact=True)] for name, u in pairs}


def benchmark(shape: str) -> Benchmark:
    """Return the benchmark of the "cylinder" or the "sphere"."""
    return Benchmark(
        name=f"thick-{shape}",
        title=f"Thick {shape} under pressure, incompressible",
        parameters=PARAMETERS,
        cells=CELLS[shape],
        elements=2 if shape == "cylinder" else 1,
        solve=partial(solve_shell, shape),
        references=partial(_references, shape),
        units={"u_r_inner_cm": ("cm", "u_r inside"), "u_r_outer_cm": ("cm", "u_r outside")},
    )


def run(setup: Setup, *, out: Path, comm: MPI.Comm = MPI.COMM_WORLD) -> dict[str, object]:
    """Run both shells, each in a folder of its own; their tables are put together (collective)."""
    parts = {}
    for shape, cells in CELLS.items():
        every = [*CELLS["cylinder"], *CELLS["sphere"]]
        cell = cells[every.index(setup.cell) % 2] if setup.cell in every else setup.cell
        parts[shape] = run_study(
            benchmark(shape), replace(setup, cell=cell), out=Path(out) / shape, comm=comm
        )
    table = [
        {**line, "quantity": line["quantity"] and f"{shape}: {line['quantity']}"}
        for shape, part in parts.items()
        for line in part["table"]
    ]
    result = {
        "benchmark": "thick-shells",
        "parameters": parts["sphere"]["parameters"],
        "quantities": {shape: part["quantities"] for shape, part in parts.items()},
        "reference": {shape: part["reference"] for shape, part in parts.items()},
        "table": table,
        "timing": {"wall_s": sum(part["timing"]["wall_s"] for part in parts.values())},
        "environment": environment(comm),
    }
    write_result(out, result, comm)
    return result
