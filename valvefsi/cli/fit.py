"""``valvefsi fit``: parameters of materials and circuits from bench data."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from valvefsi.cli.fit_output import Texts, names, numbers, progress, ranges, show
from valvefsi.cli.fit_windkessel import windkessel
from valvefsi.cli.option_groups import as_number, options_of, pairs
from valvefsi.cli.options import MARKS, Bounds, Decimal, Out, Seed, Starts, Style
from valvefsi.errors import CaseError

fit = typer.Typer(
    help="Fit a leaflet's material or a flow loop's circuit to measurements.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)
fit.command("windkessel")(windkessel)


@dataclass(frozen=True, kw_only=True)
class BiaxialCommand:
    """Arguments and options of ``fit biaxial``."""

    data: Annotated[list[Path], typer.Argument(metavar="DATA.csv ...", help="Records of biaxial tests.")]
    model: Annotated[
        str, typer.Option(help="hgo, lee-sacks, fung, may-newman-yin, neo-hookean or mooney-rivlin.")
    ] = "hgo"
    families: Annotated[
        str, typer.Option(metavar="1|2|2-kappas|symmetric", help="Families of fibres of hgo.")
    ] = "1"
    fibre_angle: Annotated[
        str, typer.Option(metavar="DEG|free", help="Angle of the fibres to axis 1 of the test.")
    ] = "free"
    axis1: Annotated[
        str,
        typer.Option(
            metavar="circumferential|radial|x",
            help="Direction of the leaflet along axis 1; x for a flat sheet. material.toml refers to it.",
        ),
    ] = "circumferential"
    fix: Annotated[
        Texts, typer.Option(metavar="K=V", help="Hold a parameter (kPa, degrees). Repeatable.")
    ] = None
    bounds: Bounds = None
    protocols: Annotated[
        str | None, typer.Option(metavar="1,2,5", help="Protocols to fit; the others are predicted.")
    ] = None
    column: Annotated[
        Texts,
        typer.Option(metavar="NAME=HEADER", help="Column of the file, such as stretch1=lx. Repeatable."),
    ] = None
    decimal: Decimal = "point"
    unit: Annotated[str | None, typer.Option(help="Unit of the stresses, tensions or forces.")] = None
    thickness: Annotated[
        str | None, typer.Option(help="Unloaded thickness, such as '0.4 mm', for tensions.")
    ] = None
    area: Annotated[
        str | None,
        typer.Option(
            metavar="A[,A]",
            help="Unloaded section that the forces act on, such as '6 mm^2'; two across axes 1 and 2.",
        ),
    ] = None
    accept_suspect: Annotated[
        bool, typer.Option("--accept-suspect", help="Only note stress that falls, and tension while slack.")
    ] = False
    weights: Annotated[str, typer.Option(metavar="unit|balanced", help="Weights of the protocols.")] = "unit"
    loss: Annotated[str, typer.Option(help="linear, soft_l1, huber, cauchy or arctan.")] = "linear"
    loss_scale: Annotated[float, typer.Option(help="Residual in kPa where the loss turns from squares.")] = (
        1.0
    )
    offsets: Annotated[
        bool, typer.Option("--offsets", help="Fit an offset of the stretch for each protocol and axis.")
    ] = False
    compare: Annotated[
        str | None, typer.Option(metavar="lee-sacks,fung", help="Materials to compare with.")
    ] = None
    starts: Starts = 32
    seed: Seed = 0
    out: Out = None
    style: Style = "screen"


@fit.command("biaxial")
@options_of(BiaxialCommand)
def biaxial(options: BiaxialCommand) -> None:
    """Fit a leaflet's material to planar biaxial tests: table, fit.json, material.toml and pictures.

    A record is a CSV file with a header line, # begins a remark.
    Columns for axes 1 and 2; other columns are passed over:

    deformation: stretch1 stretch2 (1 at rest), or
    eng_strain1 eng_strain2 (stretch less 1), or
    E11 E22 (E12) (Green strain), or F11 F12 F21 F22
    stress: P11 P22 (first Piola-Kirchhoff, engineering),
    S11 S22 (second), cauchy1 cauchy2,
    tension1 tension2 (force per unloaded length) with --thickness,
    or force1 force2 with --area
    protocol: a name for each row; without it a file is one protocol

    A unit ends the name (P11_kPa, force1_N, E11_percent).
    Stress is positive in tension:

    protocol,stretch1,stretch2,P11_kPa,P22_kPa
    1,1.00,1.00,0.0,0.0
    1,1.05,1.08,12.1,10.4

    Semicolons and tabs part cells too. More: docs/records.md
    """
    with progress(f"biaxial fit, {options.model}: {', '.join(path.name for path in options.data)}") as notify:
        from valvefsi.fitting.biaxial import fit_biaxial
        from valvefsi.fitting.biaxial_records import Reading

        reading = Reading(
            columns=pairs(options.column, "column"),
            unit=options.unit,
            thickness=_size(options.thickness, "thickness", "cm"),
            areas=_areas(options.area),
            decimal=MARKS[options.decimal],
            accept_suspect=options.accept_suspect,
        )
        angle = options.fibre_angle
        result = fit_biaxial(
            options.data,
            options.model,
            reading=reading,
            notify=notify,
            families=options.families,
            fibre_angle=None if angle == "free" else as_number(angle, "fibre-angle"),
            axis1=options.axis1,
            fix=numbers(options.fix, "fix"),
            bounds=ranges(options.bounds, "bounds"),
            protocols=names(options.protocols),
            weights=options.weights,
            loss=options.loss,
            loss_scale=options.loss_scale,
            offsets=options.offsets,
            compare=names(options.compare) or (),
            starts=options.starts,
            seed=options.seed,
        )
    folder = options.out or Path("results") / f"fit-{options.data[0].stem}"
    from valvefsi.post.plots.paper import paper

    with paper(options.style == "paper"):
        result.write(folder)
    show(result.report, folder)


def _areas(text: str | None) -> tuple[float, float] | None:
    """Return the sections across axes 1 and 2 in cm^2, of one text or two."""
    parts = [] if text is None else text.split(",")
    if len(parts) > 2:
        raise CaseError("expected one section or two", key="area", value=text)
    sizes = [size for part in parts if (size := _size(part, "area", "cm^2")) is not None]
    return (sizes[0], sizes[-1]) if sizes else None


def _size(text: str | None, key: str, unit: str) -> float | None:
    """Return a positive size with a unit in the unit of CGS."""
    if text is None:
        return None
    from pydantic_core import PydanticCustomError

    from valvefsi.case.quantities import Quantity

    try:
        value = Quantity(unit).parse(text)
    except PydanticCustomError as error:
        raise CaseError(error.message(), key=key, value=text) from None
    if value <= 0:
        raise CaseError("expected a positive size", key=key, value=text)
    return value
