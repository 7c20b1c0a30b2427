"""``valvefsi plot``: pictures of the solids that a run or a benchmark has left behind."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from valvefsi.cli.movie import Cut, read_plane
from valvefsi.cli.options import Out, Trust


def plot(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR", help="Folder of results, or one .vtu or .pvd file; with --fibres a case file."
        ),
    ],
    field: Annotated[
        str | None, typer.Option("--field", help="What is shown, such as J or 'von Mises stress'.")
    ] = None,
    t: Annotated[
        float | None, typer.Option("--time", help="Time of a series [s]; the last one if left out.")
    ] = None,
    fibres: Annotated[
        bool, typer.Option("--fibres", help="Draw the fibre fields of a case file instead; nothing is run.")
    ] = False,
    cut: Cut = None,
    out: Out = None,
    trust: Trust = False,
) -> None:
    """Draw every deformed solid in a folder of results, a plane of its fluid, or the fibres of a case."""
    from mpi4py import MPI

    if fibres:
        _draw_fibres(folder, out if out is not None else Path(), trust)
        return
    if MPI.COMM_WORLD.rank == 0 and (cut is not None or _is_of_fluid(folder, field)):
        from valvefsi.post.movies import draw_plane

        where = out if out is not None else folder
        typer.echo(str(draw_plane(folder, where, plane=read_plane(cut), field=field or "speed", t=t)))
        return
    from valvefsi.post.plots.solid import can_render, draw_folder

    if MPI.COMM_WORLD.rank != 0:
        return
    made = draw_folder(folder, out if out is not None else folder, field=field, t=t)
    if field is None and t is None:
        made = [*made, *_draw_valve(folder, out if out is not None else folder, trust)]
    if not can_render() and made:
        typer.echo("pyvista or EGL is missing: bodies in space are drawn by matplotlib")
    for path in made:
        typer.echo(str(path))


def _is_of_fluid(folder: Path, field: str | None) -> bool:
    """Whether a field is one that only the fluid of a run has."""
    from valvefsi.post.plots.slice import DERIVED

    known = {*DERIVED, "pressure", "mean_pressure", "turbulence_kinetic_energy"}
    return field in known and (folder / "paraview" / "fluid.pvd").is_file()


def _draw_valve(folder: Path, out: Path, trust: bool) -> list[Path]:
    """Draw the pictures of a run's valve, if it has one; a folder without a case has none."""
    if not (folder / "case.toml").is_file():
        return []
    from valvefsi.case import load_case
    from valvefsi.case.valve_report import draw_valve, has_valve
    from valvefsi.errors import CaseError

    try:
        case = load_case(folder / "case.toml", trust=trust)
        return draw_valve(case, folder, out) if has_valve(case) else []
    except CaseError as error:
        typer.echo(f"no pictures of a valve: {error}", err=True)
        return []


def _draw_fibres(case_file: Path, out: Path, trust: bool) -> None:
    """Draw the fibre fields of a case file."""
    from valvefsi.case import load_case
    from valvefsi.case.fibre_pictures import draw_fibres

    for path in draw_fibres(load_case(case_file, trust=trust), out):
        typer.echo(str(path))
