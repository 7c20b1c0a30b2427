"""``valvefsi bench valve-2d``: two flexible leaflets in a channel."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from valvefsi.cli.immersed import shown
from valvefsi.cli.options import HELP, Out, Set
from valvefsi.cli.tables import show_result

valve_2d = typer.Typer(help="Leaflets in a channel.", **HELP)


@valve_2d.command("valve-2d")
def command(
    cells: Annotated[int, typer.Option("--cells", min=24, help="Cells across the channel.")] = 92,
    t_end: Annotated[float, typer.Option("--t-end", help="End of the run [s].")] = 3.0,
    refine: Annotated[
        int, typer.Option("--refine", min=0, max=4, help="Number of finer grids, each 1.5 times as fine.")
    ] = 0,
    kernel: Annotated[str, typer.Option(help="Kernel of the coupling.")] = "bspline3",
    overrides: Set = None,
    out: Out = None,
) -> None:
    """Two leaflets bent by a pulsating stream, against the tips' displacements of other codes."""
    from mpi4py import MPI

    from valvefsi.benchmarks import valve_2d as benchmark

    comm, folder = MPI.COMM_WORLD, out or Path("results") / "valve-2d"
    setup = benchmark.Setup(cells=cells, t_end=t_end, refine=refine, kernel=kernel, overrides=overrides or ())
    show_result(benchmark.run(setup, out=folder, comm=comm, progress=shown(comm)), comm, folder)
