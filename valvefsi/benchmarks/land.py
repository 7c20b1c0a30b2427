"""Cardiac mechanics benchmarks 1 to 3 of Land et al. (2015), doi 10.1098/rspa.2015.0641, as incompressible statics.

1. **beam**: 10 x 1 x 1 mm, fibres along it, clamped at one end, a pressure on its lower face that follows it;
2. **inflation**: a truncated ellipsoid, isotropic, base fixed, pressure inside;
3. **contraction**: the same ellipsoid with fibres turning by 180 degrees through the wall, pressure and active
   tension growing together.

The problems are the paper's. Its answers are curves; where a number is compared with, its source is named.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from mpi4py import MPI

from valvefsi.benchmarks.results import environment, write_result
from valvefsi.benchmarks.static_body import answer_of
from valvefsi.benchmarks.static_study import Answer, Benchmark, Reference, Setup, run_study
from valvefsi.errors import CaseError
from valvefsi.geometry.benchmark_shapes import truncated_ellipsoid
from valvefsi.geometry.shapes import box
from valvefsi.solid import statics
from valvefsi.solid.loads import Pressure
from valvefsi.solid.materials import fibres
from valvefsi.solid.materials.cardiac import Contracting, Guccione, ellipsoid_fibres

KPA = 1.0e4
FIBRE = {"bf": (8.0, "1"), "bt": (2.0, "1"), "bfs": (4.0, "1")}
BEAM = {"C": (2.0 * KPA, "dyn/cm^2"), **FIBRE, "pressure": (0.004 * KPA, "dyn/cm^2")}
INFLATION = {
    "C": (10.0 * KPA, "dyn/cm^2"),
    **dict.fromkeys(FIBRE, (1.0, "1")),
    "pressure": (10.0 * KPA, "dyn/cm^2"),
}
CONTRACTION = {
    "C": (2.0 * KPA, "dyn/cm^2"),
    **FIBRE,
    "pressure": (15.0 * KPA, "dyn/cm^2"),
    "tension": (60.0 * KPA, "dyn/cm^2"),
}
SHORT, LONG = (0.7, 1.0), (1.7, 2.0)
BEAM_BAND = (4.0, 4.2)
"""Second-hand, see tests/reference/land2015_beam.csv."""


def _material(values: Mapping[str, float]) -> Guccione:
    return Guccione(**{name: values[name] for name in ("C", "bf", "bt", "bfs")}, fibre="fibre")


def solve_beam(values: Mapping[str, float], cell: str, elements: int, comm: MPI.Comm) -> Answer:
    """Solve problem 1 with ``10 elements x elements x elements`` cells (collective)."""
    mesh = box(comm, size=(1.0, 0.1, 0.1), elements=(10 * elements, elements, elements), cell=cell)
    mesh = mesh.with_fibres(fibre=fibres.constant(mesh, (1.0, 0.0, 0.0)))
    material = _material(values)
    load = Pressure(on=("z_lower",), value=values["pressure"])
    solution = statics.solve(mesh, material, fixed=[statics.Fixed(on=("x_lower",))], loads=[load])
    z = 0.1 + float(solution.displacement_at((1.0, 0.05, 0.1))[2])
    return answer_of(solution, material, {"z_tip_mm": 10 * z}, fibres=mesh.fibres, fibre="fibre")


def solve_ellipsoid(values: Mapping[str, float], cell: str, elements: int, comm: MPI.Comm) -> Answer:
    """Solve problem 2, or 3 where there is a tension, with ``elements`` cells through the wall (collective)."""
    mesh = truncated_ellipsoid(comm, short=SHORT, long=LONG, elements=(elements, 3 * elements + 3), cell=cell)
    field = fibres.from_function(mesh, ellipsoid_fibres(SHORT, LONG, (90.0, -90.0)), degree=2)
    mesh = mesh.with_fibres(fibre=field)
    material, base = _material(values), statics.Fixed(on=("base",))
    if "tension" in values:
        material = Contracting(mesh, material, values["tension"], "fibre")
        base = statics.Fixed(on=("base",), value=material.follow)
    load = Pressure(on=("endo",), value=values["pressure"])
    options = statics.SolverOptions(first_increment=0.05)
    solution = statics.solve(mesh, material, fixed=[base], loads=[load], options=options)
    apex = [(0.0, 0.0, -LONG[0]), (0.0, 0.0, -LONG[1])]
    endo, epi = (
        10 * (point[2] + float(u[2])) for point, u in zip(apex, solution.displacement_at(apex), strict=True)
    )
    found = {"z_apex_endo_mm": endo, "z_apex_epi_mm": epi}
    return answer_of(solution, material, found, fibres=mesh.fibres, fibre="fibre")


def _published(values: Mapping[str, float], defaults: Mapping[str, tuple[float, str]]) -> bool:
    return all(values[name] == default for name, (default, _) in defaults.items())


def _beam_references(values: Mapping[str, float]) -> dict[str, Sequence[Reference]]:
    if not _published(values, BEAM):
        return {}
    return {"z_tip_mm": [Reference(band=BEAM_BAND, source="Land 2015, second-hand")]}


def _no_references(values: Mapping[str, float]) -> dict[str, Sequence[Reference]]:
    return {}


APEX = {"z_apex_endo_mm": ("mm", "z of the inner apex"), "z_apex_epi_mm": ("mm", "z of the outer apex")}
CELLS = ("tetrahedron", "hexahedron")
PROBLEMS = {
    1: Benchmark(
        name="land-1-beam",
        title="Land 2015, problem 1: beam",
        parameters=BEAM,
        cells=CELLS,
        elements=1,
        solve=solve_beam,
        references=_beam_references,
        units={"z_tip_mm": ("mm", "z of the tip")},
    ),
    2: Benchmark(
        name="land-2-inflation",
        title="Land 2015, problem 2: inflation",
        parameters=INFLATION,
        cells=CELLS,
        elements=1,
        solve=solve_ellipsoid,
        references=_no_references,
        units=APEX,
    ),
    3: Benchmark(
        name="land-3-contraction",
        title="Land 2015, problem 3: contraction",
        parameters=CONTRACTION,
        cells=CELLS,
        elements=1,
        solve=solve_ellipsoid,
        references=_no_references,
        units=APEX,
    ),
}


def run(
    setup: Setup, *, out: Path, problems: Sequence[int] = (1, 2, 3), comm: MPI.Comm = MPI.COMM_WORLD
) -> dict[str, object]:
    """Run problems, each in a folder of its own; their tables are put together (collective).

    Raises:
        CaseError: There is no such problem.
    """
    for number in problems:
        if number not in PROBLEMS:
            raise CaseError("expected 1, 2 or 3", key="--problem", value=number)
    parts = {
        PROBLEMS[n].name: run_study(PROBLEMS[n], setup, out=Path(out) / PROBLEMS[n].name, comm=comm)
        for n in problems
    }
    table = [
        {**line, "quantity": line["quantity"] and f"{name[5]}: {line['quantity']}"}
        for name, part in parts.items()
        for line in part["table"]
    ]
    result = {
        "benchmark": "land",
        "parameters": {name: part["parameters"] for name, part in parts.items()},
        "quantities": {name: part["quantities"] for name, part in parts.items()},
        "reference": {name: part["reference"] for name, part in parts.items()},
        "table": table,
        "timing": {"wall_s": sum(part["timing"]["wall_s"] for part in parts.values())},
        "environment": environment(comm),
    }
    write_result(out, result, comm)
    return result
