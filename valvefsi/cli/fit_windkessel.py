"""``valvefsi fit windkessel``: parameters of a flow loop's circuit from measured pressures and flows."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valvefsi.cli.fit_output import Texts, console, names, numbers, progress, ranges, show
from valvefsi.cli.option_groups import options_of, pairs
from valvefsi.cli.options import MARKS, Bounds, Decimal, Out, Seed, Starts, Style
from valvefsi.cli.tables import print_table
from valvefsi.errors import CaseError

if TYPE_CHECKING:
    from valvefsi.fitting.waveforms import Waveforms
    from valvefsi.fitting.windkessel import CircuitReport, Settings


@dataclass(frozen=True, kw_only=True)
class WindkesselCommand:
    """Arguments and options of ``fit windkessel``."""

    data: Annotated[
        Path, typer.Argument(metavar="DATA.csv", help="Columns such as t_s, p_ao_mmHg, q_ao_ml_s.")
    ]
    circuit: Annotated[
        str, typer.Option(help="downstream, two-element, four-element, upstream-porcine or upstream-bovine.")
    ] = "downstream"
    fix: Annotated[Texts, typer.Option(metavar="K=V", help="Hold a parameter (mmHg, ml, s). Repeatable.")] = (
        None
    )
    bounds: Bounds = None
    column: Annotated[
        Texts,
        typer.Option(
            metavar="NAME=HEADER[:UNIT]", help="Column of the file, such as p_ao=P1:kPa. Repeatable."
        ),
    ] = None
    decimal: Decimal = "point"
    flip: Annotated[
        Texts,
        typer.Option(metavar="NAME", help="A flow recorded positive upstream, such as q_lv. Repeatable."),
    ] = None
    repair: Annotated[str | None, typer.Option(metavar="outliers", help="Replace outliers.")] = None
    gaps: Annotated[bool, typer.Option("--gaps", help="Accept gaps in time.")] = False
    smooth: Annotated[
        float,
        typer.Option(metavar="SECONDS", help="Smooth before P_pump is derived: the period that is halved."),
    ] = 0.0
    periodic: Annotated[
        bool,
        typer.Option("--periodic", help="Solve for the periodic state; else initial pressures are fitted."),
    ] = False
    period: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="Length of a cycle; else what repeats in the record, or all of it and the interval to the next beat.",
        ),
    ] = None
    lag: Annotated[
        str,
        typer.Option(
            metavar="check|fit|off",
            help="Time by which the pressure follows: look for one, fit it, or neither.",
        ),
    ] = "check"
    compare: Annotated[str | None, typer.Option(metavar="A,B", help="Circuits to compare with.")] = None
    starts: Starts = 8
    seed: Seed = 0
    out: Out = None
    style: Style = "screen"


@options_of(WindkesselCommand)
def windkessel(options: WindkesselCommand) -> None:
    """Fit a circuit of the flow loop (S4-S10): table, fit.json, circuit.toml and pictures.

    A record is a CSV file with a header line, # begins a remark.
    A heading is a quantity with its unit: time t, pressure p, flow q.
    All flows are positive downstream; other columns are passed over:

    t_s,p_ao_mmHg,q_ao_ml_s
    0.000,81.2,0.0
    0.005,81.0,3.1

    downstream, two-element, four-element: p_ao from q_ao
    upstream-porcine: p_lv from p_pump and q_lv (p_pump itself if missing)
    upstream-bovine: p_lv from q_pump, q_lv and p_la

    Units: s, ms; mmHg, kPa, Pa, bar, cmH2O; ml_s, ml_min, L_min.
    Semicolons and tabs part cells too. More: docs/records.md
    """
    if options.repair not in (None, "outliers"):
        raise CaseError("expected outliers", key="repair", value=options.repair)
    folder = options.out or Path("results") / f"fit-{options.data.stem}"
    circuits = [options.circuit, *(names(options.compare) or ())]
    reports: list[CircuitReport] = []
    with progress(f"windkessel fit, {', '.join(circuits)}: {options.data.name}") as notify:
        from valvefsi.fitting.windkessel import fit_windkessel

        settings, waves = _prepared(options, circuits, folder)
        if waves is not None:
            reports += [fit_windkessel(waves, name, _of(settings, name), notify) for name in circuits]
    with _styled(options):
        _show(reports, folder)


def _styled(options: WindkesselCommand) -> AbstractContextManager[None]:
    """Return in what pictures are saved in the style that was asked for."""
    from valvefsi.post.plots.paper import paper

    return paper(options.style == "paper")


def _prepared(
    options: WindkesselCommand, circuits: Sequence[str], folder: Path
) -> tuple[Settings, Waveforms | None]:
    """Return how circuits are fitted and the record; None where the pump's pressure was derived instead."""
    from valvefsi.fitting.windkessel import Settings
    from valvefsi.fitting.windkessel_models import find_circuit
    from valvefsi.fitting.windkessel_pump import CIRCUIT, derive_pump

    models = [find_circuit(name) for name in circuits]
    if any(model.output != models[0].output for model in models):
        message = "circuits can be compared only where they give the same pressure"
        raise CaseError(message, key="compare", value=options.compare)
    settings = Settings(
        fixed=numbers(options.fix, "fix"),
        bounds=ranges(options.bounds, "bounds"),
        periodic=options.periodic,
        period=options.period,
        lag=options.lag,
        starts=options.starts,
        seed=options.seed,
    )
    waves = _read(options, folder).flipped(options.flip or [])
    if options.circuit == CIRCUIT and "p_pump" not in waves.values:
        derived = derive_pump(waves, settings.fixed, cutoff=options.smooth)
        with _styled(options):
            derived.write(folder)
        typer.echo(f"{derived.summary()}\nresults in {folder}")
        return settings, None
    if options.smooth:
        raise CaseError(
            "only the derivation of P_pump smooths; a fit takes the record as it is", key="smooth"
        )
    return settings, waves


def _read(options: WindkesselCommand, folder: Path) -> Waveforms:
    """Read the record; list outliers, and replace them where that is asked for."""
    from valvefsi.fitting.waveform_repair import find_outliers, repair
    from valvefsi.fitting.waveforms import read_waveforms, write_waveforms

    waves = read_waveforms(
        options.data,
        columns=pairs(options.column, "column"),
        gaps=options.gaps,
        decimal=MARKS[options.decimal],
    )
    outliers = find_outliers(waves)
    lines = [outlier.line() for outlier in outliers]
    if options.repair is None:
        if outliers:
            lines.append(f"{len(outliers)} outliers, left as they are; --repair outliers replaces them")
            typer.echo("\n".join(lines))
        return waves
    waves = repair(waves, outliers)
    typer.echo("\n".join([*lines, f"{len(outliers)} outliers replaced"]))
    if outliers:
        header = [f"{options.data.name} with {len(outliers)} outliers replaced", *lines]
        typer.echo(f"repaired record in {write_waveforms(waves, folder / 'repaired.csv', header)}")
    return waves


def _of(settings: Settings, name: str) -> Settings:
    """Return the settings for one of several circuits: what is held in one may not be in another."""
    from valvefsi.fitting.windkessel_models import CIRCUITS

    every = {key for model in CIRCUITS.values() for key in model.parameters}
    strange = every - set(CIRCUITS[name].parameters)
    return replace(
        settings,
        fixed={key: value for key, value in settings.fixed.items() if key not in strange},
        bounds={key: value for key, value in settings.bounds.items() if key not in strange},
    )


def _show(reports: Sequence[CircuitReport], folder: Path) -> None:
    """Print and write every report, and the comparison where there are several."""
    from valvefsi.fitting.report import write_json
    from valvefsi.fitting.windkessel import compare

    for report in reports:
        place = folder if report is reports[0] else folder / report.model
        report.write(place)
        show(report, place)
    if len(reports) > 1:
        rows = compare(reports)
        cells: list[tuple[str, ...]] = [
            (
                str(row["circuit"]),
                str(row["n_free"]),
                f"{100 * row['relative_l2']:.3f} %",
                f"{100 * row['relative_linf']:.2f} %",
                "" if row["held_out_rmse"] is None else f"{row['held_out_rmse']:.4g} mmHg",
                f"{row['delta_aicc']:.4g}",
                f"{row['delta_bic']:.4g}",
            )
            for row in rows
        ]
        headings = ("circuit", "free", "relative L2", "Linf", "held-out error", "dAICc", "dBIC")
        sides = dict.fromkeys(headings, "right") | {"circuit": "left"}
        print_table(console(), "comparison", sides, cells)
        write_json(folder / "comparison.json", rows)
