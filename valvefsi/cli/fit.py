"""``valvefsi fit``: parameters of materials and circuits from bench data."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valvefsi.cli.fit_windkessel import windkessel
from valvefsi.cli.option_groups import as_number, options_of, pairs
from valvefsi.cli.options import HELP
from valvefsi.cli.tables import WIDE, print_fit
from valvefsi.errors import CaseError

if TYPE_CHECKING:
    from valvefsi.fitting.biaxial import BiaxialFit

fit = typer.Typer(help="Fit a leaflet's material or a flow loop's circuit to measurements.", **HELP)
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
    fix: Annotated[
        list[str] | None, typer.Option(metavar="K=V", help="Hold a parameter (kPa, degrees). Repeatable.")
    ] = None
    bounds: Annotated[
        list[str] | None, typer.Option(metavar="K=A:B", help="Bounds of a parameter. Repeatable.")
    ] = None
    protocols: Annotated[
        str | None, typer.Option(metavar="1,2,5", help="Protocols to fit; the others are predicted.")
    ] = None
    column: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=HEADER", help="Column of the file, such as stretch1=lx. Repeatable."),
    ] = None
    unit: Annotated[str | None, typer.Option(help="Unit of the stresses or tensions.")] = None
    thickness: Annotated[str | None, typer.Option(help="Unloaded thickness, such as '0.4 mm'.")] = None
    accept_suspect: Annotated[
        bool, typer.Option("--accept-suspect", help="Only note stress that falls, and tension while slack.")
    ] = False
    weights: Annotated[str, typer.Option(metavar="unit|balanced", help="Weights of the protocols.")] = "unit"
    loss: Annotated[str, typer.Option(help="linear, soft_l1, huber, cauchy or arctan.")] = "linear"
    loss_scale: Annotated[float, typer.Option(help="Residual where the loss turns from squares [kPa].")] = 1.0
    offsets: Annotated[
        bool, typer.Option("--offsets", help="Fit an offset of the stretch for each protocol and axis.")
    ] = False
    compare: Annotated[
        str | None, typer.Option(metavar="lee-sacks,fung", help="Materials to compare with.")
    ] = None
    starts: Annotated[int, typer.Option(help="Number of starts.")] = 32
    seed: Annotated[int, typer.Option(help="Seed of starts and bootstrap.")] = 0
    out: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Folder of the results.")] = None


@fit.command("biaxial")
@options_of(BiaxialCommand)
def biaxial(given: BiaxialCommand) -> None:
    """Fit a leaflet's material to planar biaxial tests: table, fit.json, material.toml and pictures."""
    from valvefsi.fitting.biaxial import fit_biaxial
    from valvefsi.fitting.biaxial_records import Reading

    reading = Reading(
        columns=pairs(given.column, "column"),
        unit=given.unit,
        thickness=_length(given.thickness),
        accept_suspect=given.accept_suspect,
    )
    found = fit_biaxial(
        given.data,
        given.model,
        reading=reading,
        families=given.families,
        fibre_angle=None if given.fibre_angle == "free" else as_number(given.fibre_angle, "fibre-angle"),
        fix={key: as_number(value, "fix") for key, value in pairs(given.fix, "fix").items()},
        bounds={key: _ends(value) for key, value in pairs(given.bounds, "bounds").items()},
        protocols=_names(given.protocols),
        weights=given.weights,
        loss=given.loss,
        loss_scale=given.loss_scale,
        offsets=given.offsets,
        compare=_names(given.compare) or (),
        starts=given.starts,
        seed=given.seed,
    )
    folder = given.out or Path("results") / f"fit-{given.data[0].stem}"
    try:
        found.write(folder)
    except OSError as error:
        raise CaseError(f"cannot write here: {error.strerror}", key="out", value=str(folder)) from None
    show_fit(found, folder)


def show_fit(found: BiaxialFit, folder: Path | None = None) -> None:
    """Print the table of a fit and what belongs to it."""
    from rich.console import Console

    console = Console(width=None if sys.stdout.isatty() else WIDE)
    place = () if folder is None else (f"results in {folder}",)
    print_fit(console, found.report, (*found.lines(), *place))


def _length(text: str | None) -> float | None:
    """Return a length with a unit in cm."""
    if text is None:
        return None
    from pydantic_core import PydanticCustomError

    from valvefsi.case.quantities import Quantity

    try:
        value = Quantity("cm").parse(text)
    except PydanticCustomError as error:
        raise CaseError(error.message(), key="thickness", value=text) from None
    if value <= 0:
        raise CaseError("expected a positive length", key="thickness", value=text)
    return value


def _ends(text: str) -> tuple[float, float]:
    low, mark, high = text.partition(":")
    if not mark:
        raise typer.BadParameter(f"expected K=A:B, found {text!r}", param_hint="--bounds")
    return as_number(low, "bounds"), as_number(high, "bounds")


def _names(text: str | None) -> list[str] | None:
    return None if text is None else [name.strip() for name in text.split(",") if name.strip()]
