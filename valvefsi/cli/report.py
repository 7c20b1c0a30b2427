"""``valvefsi report``: one HTML page of what was run and how far to trust it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from valvefsi.cli.option_groups import options_of
from valvefsi.cli.options import Trust, not_a_folder, read_seconds
from valvefsi.errors import CaseError


@dataclass(frozen=True, kw_only=True)
class ReportCommand:
    """Arguments and options of ``report``."""

    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="DIR...",
            help="Folders of a run, a fit, a benchmark, a sweep, a validation, grids (verify) or samples; a record "
            "(CSV) beside a run.",
        ),
    ]
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="FILE.html",
            help="The page; report.html in the first folder.",
            callback=not_a_folder,
        ),
    ] = None
    start: Annotated[
        str,
        typer.Option(
            metavar="TIME", help="Of two: time in the cycle of the second at which the first begins."
        ),
    ] = "0 s"
    shift_max: Annotated[
        str, typer.Option(metavar="TIME", help="Of two: largest common shift in time; 0 for none.")
    ] = "7 ms"
    period: Annotated[
        str | None,
        typer.Option(metavar="TIME", help="Of two: length of a cycle, where a pump or a record says none."),
    ] = None
    trust: Trust = False


@options_of(ReportCommand)
def report(options: ReportCommand) -> None:
    """Write one HTML page on a run, a fit, a benchmark or a study: what was run, results, warnings, evidence.

    The page holds all it needs and opens from disk. Of two runs of a valve, or a run and a record, waveforms, pictures
    and scenes stand over or beside one another, with the numbers of compare.
    """
    from mpi4py import MPI

    if MPI.COMM_WORLD.rank != 0:
        return
    from valvefsi.report.writing import LARGEST, check_libraries, write_page

    check_libraries()
    from valvefsi.report.folders import Options, report

    period = None if options.period is None else read_seconds(options.period, "period")
    if period == 0.0:
        raise CaseError("expected a positive time", key="period", value=options.period)
    how = Options(
        start=read_seconds(options.start, "start"),
        shift_max=read_seconds(options.shift_max, "shift-max"),
        period=period,
        trust=options.trust,
    )
    if options.out is not None and options.out.suffix.lower() not in (".html", ".htm"):
        raise CaseError("expected a file that ends with .html", key="--out", value=str(options.out))
    path = options.out or next((p for p in options.paths if p.is_dir()), Path()) / "report.html"
    size = write_page(report(options.paths, how), path)
    large = f", more than {LARGEST / 1e6:g} MB: slow to open" if size > LARGEST else ""
    typer.echo(f"{path}, {size / 1e6:.1f} MB{large}")
