"""``valvefsi bench taylor-green``, ``cylinder``, ``channel``, ``cavity``, ``plug``, ``tube``: no deformable solids."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Annotated

import typer

from valvefsi.cli.options import HELP, Out, Set
from valvefsi.cli.progress import Progress
from valvefsi.cli.tables import show_result

streams = typer.Typer(help="Flows.", **HELP)


@streams.command("taylor-green")
def taylor_green(
    grid: Annotated[int, typer.Option("--grid", min=8, help="Cells along the edge of the eighth.")] = 48,
    overrides: Set = None,
    out: Out = None,
) -> None:
    """Decay of the Taylor-Green vortex at Re 1600, in the eighth that its symmetry leaves."""
    _run("taylor-green", out, cells=grid, overrides=overrides or ())


@streams.command("cylinder")
def cylinder(
    grid: Annotated[int, typer.Option("--grid", min=8, help="Cells across the diameter.")] = 32,
    overrides: Set = None,
    out: Out = None,
) -> None:
    """Drag, lift and shedding of a rigid cylinder at Re 100, held in a stream on a graded grid."""
    _run("cylinder", out, cells=grid, overrides=overrides or ())


@streams.command("cylinder-fitted")
def cylinder_fitted(
    size: Annotated[
        float, typer.Option("--size", help="Length of the elements at the cylinder, in diameters.")
    ] = 0.03,
    overrides: Set = None,
    out: Out = None,
) -> None:
    """The same flow on a mesh that fits the cylinder, with finite elements: an independent answer."""
    _run("cylinder-fitted", out, size=size, overrides=overrides or ())


@streams.command("channel")
def channel(
    grid: Annotated[int, typer.Option("--grid", min=4, help="Cells across on the coarsest grid.")] = 16,
    refine: Annotated[int, typer.Option(min=0, help="Number of finer grids.")] = 2,
    overrides: Set = None,
    out: Out = None,
) -> None:
    """Poiseuille and Womersley flow between open sides against their closed forms."""
    _run("channel", out, cells=grid, refine=refine, overrides=overrides or ())


@streams.command("cavity")
def cavity(
    reynolds: Annotated[int, typer.Option(help="100, 1000 or 5000.")] = 100,
    grid: Annotated[int, typer.Option("--grid", min=8, help="Cells along an edge.")] = 64,
    overrides: Set = None,
    out: Out = None,
) -> None:
    """Steady flow in a cavity with a sliding lid against a published table."""
    _run("cavity", out, reynolds=reynolds, cells=grid, overrides=overrides or ())


@streams.command("plug")
def plug(overrides: Set = None, out: Out = None) -> None:
    """What leaks through the aortic test section, shut by a plug, under 100 mmHg."""
    _run("plug", out, overrides=overrides or ())


@streams.command("tube")
def tube(
    grid: Annotated[
        str, typer.Option("--grid", metavar="H", help="Grid spacing; the tube is 25 mm wide.")
    ] = "1 mm",
    angle: Annotated[int, typer.Option(help="Angle of the tube to the grid: 0, 20 or 45 degrees.")] = 0,
    overrides: Set = None,
    out: Out = None,
) -> None:
    """Flow in a tube of held points, from rest until long after it has settled, against the closed form."""
    _run("tube", out, angle=angle, overrides=[f"h={grid}", *(overrides or ())])


def _run(name: str, out: Path | None, **options: object) -> None:
    """Run the benchmark of a command and show its table."""
    from mpi4py import MPI

    comm, folder = MPI.COMM_WORLD, out if out is not None else Path("results") / name
    benchmark = importlib.import_module(f"valvefsi.benchmarks.{name.replace('-', '_')}")
    with Progress(comm, name) as progress:
        result = benchmark.run(out=folder, comm=comm, progress=progress, **options)
    show_result(result, comm, folder)
