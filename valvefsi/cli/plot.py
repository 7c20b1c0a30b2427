"""``valvefsi plot``: pictures of the solids that a run or a benchmark has left behind."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from valvefsi.cli.movie import Cut, read_plane
from valvefsi.cli.options import Out, Style, Trust, plain
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
    style: Style = "screen",
) -> None:
    """Draw every deformed solid in a folder of results, a plane of its fluid, or the fibres of a case."""
    from mpi4py import MPI

    from valvefsi.post.plots.paper import paper

    if t is not None and not math.isfinite(t):
        raise CaseError("expected a finite time", key="--time", value=t)
    where = out if out is not None else Path() if fibres else folder
    with paper(style == "paper"):
        if fibres:
            made = _draw_fibres(folder, where, trust)
        elif MPI.COMM_WORLD.rank != 0:
            return
        elif cut is not None or _is_of_fluid(folder, field):
            from valvefsi.post.movies import draw_plane

            made = [draw_plane(folder, where, plane=read_plane(cut), field=field or "speed", t=t)]
        else:
            made = _draw_solids(folder, where, field, t)
            made += _draw_valve(folder, where, trust) if field is None and t is None else []
    for path in made:
        typer.echo(str(path))


def _draw_solids(folder: Path, out: Path, field: str | None, t: float | None) -> list[Path]:
    """Draw the solids of a folder of results, and say where that is plainer than it could be."""
    from valvefsi.post.plots.solid import can_render, draw_bodies

    bodies = draw_bodies(folder, out, field=field, t=t)
    if any(body.dim == 3 for _, body in bodies) and not can_render():
        typer.echo("pyvista or EGL is missing: bodies in space are drawn by matplotlib")
    return [path for path, _ in bodies]


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


def _draw_fibres(case_file: Path, out: Path, trust: bool) -> list[Path]:
    """Draw the fibre fields of a case file."""
    from valvefsi.case import load_case
    from valvefsi.case.fibre_pictures import draw_fibres

    return list(draw_fibres(load_case(case_file, trust=trust), out))
