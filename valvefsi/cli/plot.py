"""``valvefsi plot``: pictures of the solids that a run or a benchmark has left behind."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from valvefsi.cli.options import Out


def plot(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder of results, or one .vtu or .pvd file.")
    ],
    field: Annotated[
        str | None, typer.Option("--field", help="What is shown, such as J or 'von Mises stress'.")
    ] = None,
    t: Annotated[
        float | None, typer.Option("--time", help="Time of a series [s]; the last one if left out.")
    ] = None,
    out: Out = None,
) -> None:
    """Draw every deformed solid in a folder of results; no display is needed."""
    from mpi4py import MPI

    from valvefsi.io.solid_plots import can_render, draw_folder

    if MPI.COMM_WORLD.rank != 0:
        return
    made = draw_folder(folder, out if out is not None else folder, field=field, t=t)
    if not can_render() and made:
        typer.echo("pyvista or EGL is missing: bodies in space are drawn by matplotlib")
    for path in made:
        typer.echo(str(path))
