"""``valvefsi bench statics-...``: the solid alone against published values and closed forms."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valvefsi.cli.options import HELP, Out, Set
from valvefsi.cli.tables import show_result

if TYPE_CHECKING:
    from valvefsi.benchmarks.static_study import Setup

statics = typer.Typer(help="Solid benchmarks.", **HELP)

Cell = Annotated[
    str,
    typer.Option(
        "--cell", help="Kind of cell: triangle, quadrilateral, tetrahedron, hexahedron, simplex or both."
    ),
]
Refine = Annotated[
    int, typer.Option("--refine", min=0, help="Refine the mesh K times; gives the observed order.")
]
Iterative = Annotated[
    bool,
    typer.Option("--iterative", help="FGMRES with multigrid instead of a factorisation, for large meshes."),
]
Elements = Annotated[int | None, typer.Option("--elements", min=1, help="Elements of the coarsest mesh.")]


@statics.command("statics-compression")
def compression(
    cell: Cell = "both",
    refine: Refine = 0,
    elements: Elements = None,
    overrides: Set = None,
    iterative: Iterative = False,
    out: Out = None,
) -> None:
    """Benchmark E.1 as incompressible statics: u_y of the top centre is -3.9212 cm."""
    _run("statics_compression", _setup(cell, refine, elements, overrides, iterative=iterative), out)


@statics.command("statics-cook")
def cook(
    cell: Cell = "both",
    refine: Refine = 0,
    elements: Elements = None,
    overrides: Set = None,
    iterative: Iterative = False,
    out: Out = None,
) -> None:
    """Cook's membrane as incompressible statics, beside the published band."""
    _run("statics_cook", _setup(cell, refine, elements, overrides, iterative=iterative), out)


@statics.command("statics-torsion")
def torsion(
    cell: Cell = "both",
    refine: Refine = 0,
    elements: Elements = None,
    overrides: Set = None,
    iterative: Iterative = False,
    out: Out = None,
) -> None:
    """Benchmark E.2 as incompressible statics: u_y of the top centre at five angles up to 2.5 pi."""
    _run("statics_torsion", _setup(cell, refine, elements, overrides, iterative=iterative), out)


@statics.command("thick-shells")
def thick_shells(
    cell: Cell = "both", refine: Refine = 0, elements: Elements = None, overrides: Set = None, out: Out = None
) -> None:
    """A thick cylinder and a thick sphere under inner pressure, against their closed forms."""
    _run("thick_shells", _setup(cell, refine, elements, overrides), out)


@statics.command("hgo-strip")
def hgo_strip(
    cell: Cell = "both", refine: Refine = 0, elements: Elements = None, overrides: Set = None, out: Out = None
) -> None:
    """A strip of the HGO material, flat and inflated as a ring, against the homogeneous solution (S1-S3)."""
    _run("hgo_strip", _setup(cell, refine, elements, overrides), out)


@statics.command("bending")
def bending(
    thickness: Annotated[float, typer.Option(help="Thickness of the strip [mm].")] = 0.4,
    edge: Annotated[float, typer.Option(help="Edge of the elements [mm].")] = 1.0,
    layers: Annotated[int, typer.Option(min=1, max=4, help="Elements through the thickness.")] = 1,
    material: Annotated[str, typer.Option(help="Name of a preset.")] = "bovine_pericardium_lee_sacks",
    radius: Annotated[float | None, typer.Option(help="Radius at rest [mm]; flat without.")] = None,
    angle: Annotated[float, typer.Option(help="Of the fibres to the strip's length [deg].")] = 0.0,
    kappa: Annotated[float, typer.Option(help="Numerical bulk modulus [dyn/cm^2].")] = 1e8,
    out: Out = None,
) -> None:
    """Solid-shell elements: bending, stretching and twisting of a strip against incompressible elements."""
    from mpi4py import MPI

    from valvefsi.benchmarks import bending as benchmark

    strip = benchmark.Strip(
        thickness=0.1 * thickness,
        edge=0.1 * edge,
        layers=layers,
        material=material,
        radius=None if radius is None else 0.1 * radius,
        angle=angle,
        kappa=kappa,
    )
    folder = out if out is not None else Path("results") / "bending"
    show_result(benchmark.study(strip, out=folder, comm=MPI.COMM_WORLD), MPI.COMM_WORLD, folder)


@statics.command("land")
def land(
    problem: Annotated[
        list[int] | None, typer.Option("--problem", help="1, 2 or 3; repeatable; all by default.")
    ] = None,
    cell: Cell = "hexahedron",
    refine: Refine = 0,
    elements: Elements = None,
    overrides: Set = None,
    out: Out = None,
) -> None:
    """Land et al. 2015, cardiac mechanics: beam, inflation, contraction."""
    setup = _setup(cell, refine, elements, overrides)
    _run("land", setup, out, problems=tuple(problem or (1, 2, 3)))


def _setup(
    cell: str, refine: int, elements: int | None, overrides: list[str] | None, *, iterative: bool = False
) -> Setup:
    from valvefsi.benchmarks.static_study import Setup

    return Setup(cell=cell, elements=elements, refine=refine, overrides=overrides or (), iterative=iterative)


def _run(name: str, setup: Setup, out: Path | None, **more: object) -> None:
    """Run a benchmark on the meshes asked for and show its table."""
    import importlib

    from mpi4py import MPI

    benchmark = importlib.import_module(f"valvefsi.benchmarks.{name}")
    folder = out if out is not None else Path("results") / name.replace("_", "-")
    show_result(benchmark.run(setup, out=folder, comm=MPI.COMM_WORLD, **more), MPI.COMM_WORLD, folder)
