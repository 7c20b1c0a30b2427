"""``valvefsi bench turek-fsi``: a flag behind a cylinder."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from valvefsi.cli.immersed import shown
from valvefsi.cli.options import HELP, Out, Resume, Set
from valvefsi.cli.tables import show_result

turek = typer.Typer(help="A flag behind a cylinder.", **HELP)


@turek.command("turek-fsi")
def command(
    case: Annotated[str, typer.Option(help="fsi1 (steady), fsi2 (a heavy flag) or fsi3.")] = "fsi3",
    cells: Annotated[int, typer.Option("--cells", min=2, help="Cells across the flag.")] = 4,
    t_end: Annotated[float, typer.Option("--t-end", help="End of the run [s].")] = 8.0,
    refine: Annotated[
        int, typer.Option("--refine", min=0, max=4, help="Number of finer grids, each 1.5 times as fine.")
    ] = 0,
    kernel: Annotated[str, typer.Option(help="Kernel of the coupling.")] = "bspline3",
    overrides: Set = None,
    out: Out = None,
    resume: Resume = False,
) -> None:
    """A flag that swings behind a cylinder (Turek and Hron 2006): displacement of its tip, drag and lift."""
    from mpi4py import MPI

    from valvefsi.benchmarks import turek as benchmark

    comm, folder = MPI.COMM_WORLD, out or Path("results") / f"turek-{case}"
    setup = benchmark.Setup(
        case=case,
        cells=cells,
        t_end=t_end,
        refine=refine,
        kernel=kernel,
        overrides=overrides or (),
        resume=resume,
    )
    show_result(benchmark.run(setup, out=folder, comm=comm, progress=shown(comm)), comm, folder)
