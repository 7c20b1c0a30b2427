"""``valvefsi plot``: pictures of the solids that a run or a benchmark has left behind."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from valvefsi.cli.movie import Cut, read_plane
from valvefsi.cli.options import Out, Trust, plain
from valvefsi.errors import CaseError


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
        float | None,
        typer.Option(
            "--time", help=plain("Time of a series [s], the nearest there is; the last if left out.")
        ),
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

    if t is not None and not math.isfinite(t):
        raise CaseError("expected a finite time", key="--time", value=t)
    if fibres:
        _draw_fibres(folder, out if out is not None else Path(), trust)
        return
    if MPI.COMM_WORLD.rank == 0 and (cut is not None or _is_of_fluid(folder, field)):
        from valvefsi.post.movies import draw_plane

        where = out if out is not None else folder
        typer.echo(str(draw_plane(folder, where, plane=read_plane(cut), field=field or "speed", t=t)))
        return
    from valvefsi.post.plots.solid import can_render, draw_bodies

    if MPI.COMM_WORLD.rank != 0:
        return
    bodies = draw_bodies(folder, out if out is not None else folder, field=field, t=t)
    made = [path for path, _ in bodies]
    if field is None and t is None:
        made = [*made, *_draw_valve(folder, out if out is not None else folder, trust)]
    if any(body.dim == 3 for _, body in bodies) and not can_render():
        typer.echo("pyvista or EGL is missing: bodies in space are drawn by matplotlib")
    for path in made:
        typer.echo(str(path))


def _is_of_fluid(folder: Path, field: str | None) -> bool:
    """Whether a field is one that only the fluid of a run has; nothing is its speed where there are no solids."""
    from valvefsi.post.plots.slice import DERIVED

    known = {*DERIVED, "pressure", "mean_pressure", "turbulence_kinetic_energy"}
    series = (folder / "paraview" / "fluid.pvd").is_file()
    if field is None:
        return series and not any(folder.rglob("*.vtu"))
    averaged = field.startswith("mean_velocity_")
    return (field in known or averaged) and (series or (folder / "case.toml").is_file())


def _draw_valve(folder: Path, out: Path, trust: bool) -> list[Path]:
    """Draw the pictures of a run's valve, if it has one; a folder without a case has none."""
    if not (folder / "case.toml").is_file():
        return []
    from valvefsi.case import load_case
    from valvefsi.case.valve_report import draw_valve, has_valve

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
