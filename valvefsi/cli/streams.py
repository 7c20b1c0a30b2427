"""``valvefsi bench taylor-green`` and ``cylinder``: flows without deformable solids."""

from __future__ import annotations

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
    from mpi4py import MPI

    from valvefsi.benchmarks import taylor_green as benchmark

    comm = MPI.COMM_WORLD
    folder = out if out is not None else Path("results/taylor-green")
    with Progress(comm, "taylor-green") as progress:
        result = benchmark.run(
            cells=grid, out=folder, overrides=overrides or [], comm=comm, progress=progress
        )
    show_result(result, comm, folder)


@streams.command("cylinder")
def cylinder(
    grid: Annotated[int, typer.Option("--grid", min=8, help="Cells across the diameter.")] = 20,
    overrides: Set = None,
    out: Out = None,
) -> None:
    """Drag, lift and shedding of a rigid cylinder at Re 100, held in a stream on a graded grid."""
    from mpi4py import MPI

    from valvefsi.benchmarks import cylinder as benchmark

    comm = MPI.COMM_WORLD
    folder = out if out is not None else Path("results/cylinder")
    with Progress(comm, "cylinder") as progress:
        result = benchmark.run(
            cells=grid, out=folder, overrides=overrides or [], comm=comm, progress=progress
        )
    show_result(result, comm, folder)


@streams.command("channel")
def channel(
    grid: Annotated[int, typer.Option("--grid", min=4, help="Cells across on the coarsest grid.")] = 16,
    refine: Annotated[int, typer.Option(min=0, help="Number of finer grids.")] = 2,
    overrides: Set = None,
    out: Out = None,
) -> None:
    """Poiseuille and Womersley flow between open sides against their closed forms."""
    from mpi4py import MPI

    from valvefsi.benchmarks import channel as benchmark

    comm = MPI.COMM_WORLD
    folder = out if out is not None else Path("results/channel")
    with Progress(comm, "channel") as progress:
        result = benchmark.run(
            cells=grid, refine=refine, out=folder, overrides=overrides or [], comm=comm, progress=progress
        )
    show_result(result, comm, folder)


@streams.command("cavity")
def cavity(
    reynolds: Annotated[int, typer.Option(help="100, 1000 or 5000.")] = 100,
    grid: Annotated[int, typer.Option("--grid", min=8, help="Cells along an edge.")] = 64,
    overrides: Set = None,
    out: Out = None,
) -> None:
    """Steady flow in a cavity with a sliding lid against a published table."""
    from mpi4py import MPI

    from valvefsi.benchmarks import cavity as benchmark

    comm = MPI.COMM_WORLD
    folder = out if out is not None else Path("results/cavity")
    with Progress(comm, "cavity") as progress:
        result = benchmark.run(
            reynolds=reynolds, cells=grid, out=folder, overrides=overrides or [], comm=comm, progress=progress
        )
    show_result(result, comm, folder)
