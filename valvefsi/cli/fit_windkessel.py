"""``valvefsi fit windkessel``: parameters of a flow loop's circuit from measured pressures and flows."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valvefsi.cli.option_groups import as_number, options_of, pairs
from valvefsi.cli.tables import WIDE, print_fit, print_table
from valvefsi.errors import CaseError

if TYPE_CHECKING:
    from valvefsi.fitting.waveforms import Waveforms
    from valvefsi.fitting.windkessel import CircuitReport, Settings
    from valvefsi.fitting.windkessel_pump import PumpReport

Texts = list[str] | None


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
    bounds: Annotated[Texts, typer.Option(metavar="K=A:B", help="Bounds of a parameter. Repeatable.")] = None
    column: Annotated[
        Texts,
        typer.Option(
            metavar="NAME=HEADER[:UNIT]", help="Column of the file, such as p_ao=P1:kPa. Repeatable."
        ),
    ] = None
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
        typer.Option(metavar="SECONDS", help="Length of a cycle; found in the record if not given."),
    ] = None
    compare: Annotated[str | None, typer.Option(metavar="A,B", help="Circuits to compare with.")] = None
    starts: Annotated[int, typer.Option(min=1, max=4096, help="Number of starts.")] = 8
    seed: Annotated[int, typer.Option(min=0, help="Seed of starts and bootstrap.")] = 0
    out: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Folder of the results.")] = None


@options_of(WindkesselCommand)
def windkessel(given: WindkesselCommand) -> None:
    """Fit a circuit of the flow loop (S4-S10): table, fit.json, circuit.toml and pictures."""
    from valvefsi.fitting.windkessel import fit_windkessel
    from valvefsi.fitting.windkessel_models import find_circuit
    from valvefsi.fitting.windkessel_pump import CIRCUIT, derive_pump

    if given.repair not in (None, "outliers"):
        raise CaseError("expected outliers", key="repair", value=given.repair)
    others = [name.strip() for name in (given.compare or "").split(",") if name.strip()]
    models = [find_circuit(name) for name in (given.circuit, *others)]
    if any(model.output != models[0].output for model in models):
        message = "circuits can be compared only where they give the same pressure"
        raise CaseError(message, key="compare", value=given.compare)
    settings = _settings(given)
    folder = given.out or Path("results") / f"fit-{given.data.stem}"
    try:
        waves = _read(given, folder).flipped(given.flip or [])
        if given.circuit == CIRCUIT and "p_pump" not in waves.values:
            derived = derive_pump(waves, settings.fixed, cutoff=given.smooth)
            _write_pump(derived, folder)
            return
        if given.smooth:
            raise CaseError(
                "only the derivation of P_pump smooths; a fit takes the record as it is", key="smooth"
            )
        reports = [fit_windkessel(waves, name, _of(settings, name)) for name in (given.circuit, *others)]
        _show(reports, folder)
    except OSError as error:
        raise CaseError(f"cannot write here: {error.strerror}", key="out", value=str(folder)) from None


def _settings(given: WindkesselCommand) -> Settings:
    """Return how the circuit is fitted."""
    from valvefsi.fitting.windkessel import Settings

    bounds = {}
    for name, text in pairs(given.bounds, "bounds").items():
        low, colon, high = text.partition(":")
        if not colon:
            raise typer.BadParameter(f"expected K=A:B, found {text!r}", param_hint="--bounds")
        bounds[name] = (as_number(low, "bounds"), as_number(high, "bounds"))
    return Settings(
        fixed={name: as_number(text, "fix") for name, text in pairs(given.fix, "fix").items()},
        bounds=bounds,
        periodic=given.periodic,
        period=given.period,
        starts=given.starts,
        seed=given.seed,
    )


def _read(given: WindkesselCommand, folder: Path) -> Waveforms:
    """Read the record; list outliers, and replace them where that is asked for."""
    from valvefsi.fitting.waveform_repair import find_outliers, repair
    from valvefsi.fitting.waveforms import read_waveforms, write_waveforms

    waves = read_waveforms(given.data, columns=pairs(given.column, "column"), gaps=given.gaps)
    outliers = find_outliers(waves)
    for outlier in outliers:
        typer.echo(outlier.line())
    if given.repair is None:
        if outliers:
            typer.echo(f"{len(outliers)} outliers, left as they are; --repair outliers replaces them")
        return waves
    waves = repair(waves, outliers)
    typer.echo(f"{len(outliers)} outliers replaced")
    if outliers:
        header = [
            f"{given.data.name} with {len(outliers)} outliers replaced",
            *(each.line() for each in outliers),
        ]
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
    from rich.console import Console

    from valvefsi.fitting.windkessel import compare

    console = Console(width=None if sys.stdout.isatty() else WIDE)
    for report in reports:
        place = folder if report is reports[0] else folder / report.model
        report.write(place)
        print_fit(console, report, (*report.lines(), f"results in {place}"))
    if len(reports) > 1:
        rows = compare(reports)
        shown = [
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
        print_table(console, "comparison", sides, shown)
        (folder / "comparison.json").write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")


def _write_pump(report: PumpReport, folder: Path) -> None:
    report.write(folder)
    typer.echo(report.summary())
    typer.echo(f"results in {folder}")
