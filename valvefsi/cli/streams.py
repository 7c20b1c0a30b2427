"""``valvefsi bench taylor-green``, ``cylinder``, ``channel``, ``cavity`` and ``plug``: no deformable solids."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Annotated

import typer

from valvefsi.cli.options import HELP, Out, Set
from valvefsi.cli.progress import Progress
from valvefsi.cli.tables import show_result

streams = typer.Typer(help="Flows.", **HELP)


@streams.command("cylinder")
def cylinder(
    grid: Annotated[int, typer.Option("--grid", min=8, help="Cells across the diameter.")] = 32,
    overrides: Set = None,
    out: Out = None,
) -> None:
    """Drag, lift and shedding of a rigid cylinder at Re 100, held in a stream on a graded grid."""
    _run("cylinder", out, cells=grid, overrides=overrides or ())


@streams.command("plug")
def plug(overrides: Set = None, out: Out = None) -> None:
    """What leaks through the aortic test section, shut by a plug, under 100 mmHg."""
    _run("plug", out, overrides=overrides or ())


def _run(name: str, out: Path | None, **options: object) -> None:
    """Run the benchmark of a command and show its table."""
    from mpi4py import MPI

    comm, folder = MPI.COMM_WORLD, out if out is not None else Path("results") / name
    benchmark = importlib.import_module(f"valvefsi.benchmarks.{name.replace('-', '_')}")
    with Progress(comm, name) as progress:
        result = benchmark.run(out=folder, comm=comm, progress=progress, **options)
    show_result(result, comm, folder)
