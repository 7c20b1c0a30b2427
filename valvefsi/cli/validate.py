"""``valvefsi validate``: a valve in a flow loop against a measured beat, from records to the verdict."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from valvefsi.cli.fit_output import console
from valvefsi.cli.labels import LABELS
from valvefsi.cli.option_groups import options_of
from valvefsi.cli.options import Out, SetStudy, StudyFile, Trust
from valvefsi.cli.tables import print_table
from valvefsi.errors import CaseError

if TYPE_CHECKING:
    from rich.console import Console

KINDS = {"l2_percent": "L2", "linf_percent": "Linf"}


@dataclass(frozen=True, kw_only=True)
class ValidateCommand:
    """Arguments and options of ``validate``."""

    study: StudyFile
    stage: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Make this stage alone, or all of a kind: run for every grid."),
    ] = None
    again: Annotated[bool, typer.Option("--again", help="Make stages though their inputs are unchanged.")] = (
        False
    )
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace runs of another case.")] = False
    overrides: SetStudy = None
    out: Out = None
    trust: Trust = False


@options_of(ValidateCommand)
def validate(options: ValidateCommand) -> None:
    """Compare a valve with a measured beat: fit leaflet and circuits, run the valve to its periodic state, compare.

    The stages are leaflet, downstream, upstream, case, run (one for each grid), orifice and compare. Each is skipped
    while the files and values that it is made from stay as they are, and goes on where it was stopped.

    case = "porcine_valve.toml"
    grids = ["1 mm", "0.53 mm"]
    record.file = "beat.csv"

    The results go to --out, else to results/STUDY: a folder for each stage, the verdict in compare.
    """
    from mpi4py import MPI

    if MPI.COMM_WORLD.size > 1:
        raise CaseError("call it without mpirun: ranks in the study starts runs on several", key="validate")
    from valvefsi.case.study_tables import load_study
    from valvefsi.studies.validation import How, validation_stages

    study = load_study(options.study, options.overrides or [])
    folder = options.out or Path("results") / options.study.stem
    how = How(say=typer.echo, overwrite=options.overwrite, trust=options.trust)
    stages = validation_stages(study, folder, how)
    chosen = None if options.stage is None else stages.chosen(options.stage)
    stages.make(chosen, again=options.again)
    if chosen is not None and "compare" not in chosen:
        for name in chosen:
            _line(console(), f"{name}: {json.dumps((stages.record(name) or {})['result'])}")
        typer.echo(f"results in {', '.join(str(folder / name) for name in chosen)}")
        return
    show_verdict(console(), json.loads((folder / "compare" / "verdict.json").read_text(encoding="utf-8")))
    typer.echo(f"results in {folder / 'compare'}")


def show_verdict(page: Console, verdict: dict[str, Any]) -> None:
    """Print what was found: parameters, norms, targets, and what to do next."""
    for name, result in verdict["stages"].items():
        if name != "compare":
            _line(page, f"{name}: {_told(result)}")
    for key, title in (
        ("against_record", "less the record, over it"),
        ("between_grids", "coarse less fine, over it"),
    ):
        if verdict[key]:
            _norms(page, verdict[key], title)
    rows = [
        (
            f"{check['run']}: {KINDS[check['norm']]} of {LABELS[check['quantity']]}",
            f"{check['at_most']:.4g}",
            *("-" if check[key] is None else f"{check[key]:.4g}" for key in ("found", "found_shifted")),
            *(_answer(check[key]) for key in ("reached", "reached_shifted")),
            check["against"],
        )
        for check in verdict["checks"]
    ]
    headings = ("at most [%]", "found", "shifted", "reached", "reached, shifted")
    if rows:
        print_table(page, "targets", {"": "left", **dict.fromkeys(headings, "right"), "of": "left"}, rows)
    for line in verdict["next"]:
        _line(page, f"next: {line}")


def _norms(page: Console, results: list[dict[str, Any]], title: str) -> None:
    """Print the norms of several comparisons."""
    kinds = ("l2_percent", "linf_percent", "nrmse_percent")
    rows = [
        (
            f"{result['a']['name']}: {LABELS[name]}",
            *(_cell(row["as_they_are"][kind]) for kind in kinds),
            f"{result['shift_ms']:+.2f} ms",
            *(_cell(row["shifted"][kind]) for kind in kinds),
            _cell(row["repeatability_l2_percent"]["b"]),
        )
        for result in results
        for name, row in result["quantities"].items()
    ]
    headings = ["L2 [%]", "Linf [%]", "NRMSE [%]", "moved by", "L2 ", "Linf ", "NRMSE ", "repeats"]
    print_table(page, title, {"": "left", **dict.fromkeys(headings, "right")}, rows)


def _told(result: dict[str, Any]) -> str:
    """Return what came of a stage in one line."""
    flat: dict[str, Any] = {}
    for name, value in result.items():
        flat |= (
            {f"{name}.{key}": each for key, each in value.items()}
            if isinstance(value, dict)
            else {name: value}
        )
    return ", ".join(
        f"{key} {_cell(value) if isinstance(value, float) else value}" for key, value in flat.items()
    )


def _answer(value: bool | None) -> str:
    return "-" if value is None else "yes" if value else "no"


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _line(page: Console, text: str) -> None:
    page.print(text, highlight=False, soft_wrap=True, markup=False)
