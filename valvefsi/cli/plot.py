"""``valvefsi plot``: pictures of the solids that a run or a benchmark has left behind."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from valvefsi.cli.movie import Cut, read_plane
from valvefsi.cli.option_groups import options_of
from valvefsi.cli.options import Out, Style, Trust, plain, read_seconds
from valvefsi.errors import CaseError


@dataclass(frozen=True, kw_only=True)
class PlotCommand:
    """Arguments and options of ``plot``."""

    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR", help="Folder of results, or one .vtu or .pvd file; with --fibres a case file."
        ),
    ]
    more: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[DIR2 ...]", help="With --figure: other runs, and a record (CSV) for S6 and S7."
        ),
    ] = None
    figure: Annotated[
        str | None,
        typer.Option(
            "--figure",
            metavar="S6...S19",
            help="A figure as in the supplement of Lee et al. 2020, of runs or of the runs of a study: S6, S7 "
            "waveforms and open area; S8, S9 vorticity; S10 to S13 averages of steady flow; S14, S15 leaflets; "
            "S16, S17 their stress; S18, S19 two fluids.",
        ),
    ] = None
    start: Annotated[
        str,
        typer.Option(
            metavar="TIME", help="With --figure S6, S7: time in the record at which a run's cycle begins."
        ),
    ] = "0 s"
    field: Annotated[
        str | None, typer.Option("--field", help="What is shown, such as J or 'von Mises stress'.")
    ] = None
    t: Annotated[
        float | None,
        typer.Option(
            "--time", help=plain("Time of a series [s], the nearest there is; the last if left out.")
        ),
    ] = None
    fibres: Annotated[
        bool, typer.Option("--fibres", help="Draw the fibre fields of a case file instead; nothing is run.")
    ] = False
    cut: Cut = None
    out: Out = None
    trust: Trust = False
    style: Style = "screen"


@options_of(PlotCommand)
def plot(options: PlotCommand) -> None:
    """Draw every deformed solid in a folder of results, a plane of its fluid, or the fibres of a case.

    With --figure: runs side by side at the same instants, as a figure of the supplement of Lee et al. 2020.
    """
    from valvefsi.post.plots.paper import paper

    if options.t is not None and not math.isfinite(options.t):
        raise CaseError("expected a finite time", key="--time", value=options.t)
    if options.more and options.figure is None:
        raise CaseError(
            "several folders go with --figure, such as --figure S6", key="DIR2", value=str(options.more[0])
        )
    with paper(options.style == "paper"):
        made = _drawn(options)
    for path in made:
        typer.echo(str(path))


def _drawn(options: PlotCommand) -> list[Path]:
    """Draw what is asked for; return the pictures."""
    from mpi4py import MPI

    folder, field, t, out = options.folder, options.field, options.t, options.out
    if options.fibres:
        return _draw_fibres(folder, out if out is not None else Path(), options.trust)
    if MPI.COMM_WORLD.rank != 0:
        return []
    if options.figure is not None:
        from valvefsi.studies.figures import draw_figure

        paths, start = [folder, *(options.more or [])], read_seconds(options.start, "start")
        return [draw_figure(options.figure, paths, out, start=start, trust=options.trust)]
    where = out if out is not None else folder
    if options.cut is not None or _is_of_fluid(folder, field):
        from valvefsi.post.movies import draw_plane

        return [draw_plane(folder, where, plane=read_plane(options.cut), field=field or "speed", t=t)]
    made = _draw_solids(folder, where, field, t)
    return made + (_draw_valve(folder, where, options.trust) if field is None and t is None else [])


def _draw_solids(folder: Path, out: Path, field: str | None, t: float | None) -> list[Path]:
    """Draw the solids of a folder of results, and say where that is plainer than it could be."""
    from valvefsi.post.plots.solid import can_render, draw_bodies

    bodies = draw_bodies(folder, out, field=field, t=t)
    if any(body.dim == 3 for _, body in bodies) and not can_render():
        typer.echo("pyvista or EGL is missing: bodies in space are drawn by matplotlib")
    return [path for path, _ in bodies]


def _is_of_fluid(folder: Path, field: str | None) -> bool:
    """Whether a field is one that only the fluid of a run has; nothing is its speed where there are no solids."""
    from valvefsi.post.slices import DERIVED

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
