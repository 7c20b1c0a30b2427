"""``valvefsi verify``: a case on several grids, and how far its numbers may be trusted."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from valvefsi.cli.fit_output import console
from valvefsi.cli.option_groups import as_number, options_of
from valvefsi.cli.options import Anew, CaseFile, JobsOfMembers, Out, PlanMembers, Set, Style, Trust
from valvefsi.cli.study_plan import print_plan, raise_failed
from valvefsi.cli.tables import print_lines, print_table
from valvefsi.verification.answers import why_no_order

if TYPE_CHECKING:
    from valvefsi.studies.grid_study import GridStudy

MOST = 12
"""Rows of a table on the terminal; the files have all."""


@dataclass(frozen=True, kw_only=True)
class VerifyCommand:
    """Arguments and options of ``verify``."""

    case: CaseFile
    grids: Annotated[
        str,
        typer.Option(
            metavar="H,H,H", help="Spacings, coarse to fine, such as 1mm,0.8mm,0.625mm: three or more."
        ),
    ]
    along: Annotated[
        list[str] | None,
        typer.Option(
            "--along",
            metavar="KEY=V,V,V",
            help="A key that goes with the grids, a value for each. Repeatable.",
        ),
    ] = None
    steps: Annotated[
        str | None,
        typer.Option(metavar="F,F", help="Factors of the time step, such as 1,0.5, on the base grid."),
    ] = None
    also: Annotated[
        list[str] | None,
        typer.Option(
            "--also",
            metavar="KEY=VALUE,...",
            help="A change of the base grid's run, alone: a kernel, or the box (two keys: A=V & B=V). Repeatable.",
        ),
    ] = None
    ranks: Annotated[
        str | None, typer.Option(metavar="N,N", help="Numbers of ranks to run the base on again, such as 2.")
    ] = None
    base: Annotated[
        str | None,
        typer.Option(metavar="H", help="Grid of --steps, --also and --ranks; the finest if left out."),
    ] = None
    order: Annotated[
        float | None,
        typer.Option(
            metavar="P", min=0.1, help="Expected order; 1 with bodies in the flow, 2 without, if left out."
        ),
    ] = None
    overrides: Set = None
    out: Out = None
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the study in the folder; more grids may join it.")
    ] = False
    overwrite: Anew = False
    jobs: JobsOfMembers = None
    plan: PlanMembers = False
    trust: Trust = False
    style: Style = "screen"


@options_of(VerifyCommand)
def verify(options: VerifyCommand) -> None:
    """Run a case on several grids: observed order, Richardson's value and uncertainty of every number and waveform.

    Smaller time steps (--steps), another box or kernel (--also) and other numbers of ranks (--ranks) are compared with
    the base, one at a time; what was not varied is said. What it will cost is printed first. The folder gets
    verification.json, verification.csv, verification.md, changes.csv and verification.png; the grid convergence index
    is that of Celik et al. (2008).
    """
    from valvefsi.studies.grid_study import Wanted, make_grid_study, too_few

    factors = [as_number(part, "steps") for part in options.steps.split(",")] if options.steps else []
    wanted = Wanted(
        grids=options.grids,
        along=options.along or [],
        steps=factors,
        also=options.also or [],
        ranks=[int(as_number(part, "ranks")) for part in options.ranks.split(",")] if options.ranks else [],
        base=options.base,
        overrides=options.overrides or [],
        order=options.order,
    )
    study = make_grid_study(options.case, wanted, trust=options.trust)
    folder = options.out or Path("results") / f"verify-{options.case.stem}"
    print_lines(console(), [f"note: {note}" for note in too_few(len(study.grids), study.expected)])
    if options.plan:
        print_plan(study.cases, folder, options.jobs)
        return
    _run(options, study, folder)


def _run(options: VerifyCommand, study: GridStudy, folder: Path) -> None:
    from valvefsi.cli.study_progress import StudyProgress
    from valvefsi.post.plots.paper import paper
    from valvefsi.studies.grid_numbers import assess
    from valvefsi.studies.grid_report import draw_verification, write_verification
    from valvefsi.studies.runner import run_members, waiting_members

    how: dict[str, Any] = {"resume": options.resume, "overwrite": options.overwrite, "trust": options.trust}
    left = waiting_members(options.case, study.members, folder, **how)
    if left:
        print_plan({member.name: study.cases[member.name] for member in left}, folder, options.jobs)
    with StudyProgress(options.case.stem) as progress:
        outcomes = run_members(
            options.case, study.members, folder, jobs=options.jobs, progress=progress, **how
        )
    result = assess(study, outcomes, trust=options.trust)
    write_verification(options.case, study, result, folder)
    title = next(iter(study.cases.values())).title
    with paper(options.style == "paper"):
        picture = draw_verification(title, result, outcomes, folder / "verification.png", study)
    _show(result)
    also = "" if picture is None else f", {picture.name}"
    typer.echo(f"results in {folder / 'verification.md'}{also}")
    raise_failed(outcomes, "verification.json")


def _show(result: dict[str, Any]) -> None:
    """Print what must be known, the numbers that change, the waveforms, and the changes of the base."""
    page = console()
    print_lines(page, [f"note: {note}" for note in result["notes"]])
    names = [grid["member"] for grid in result["grids"]]
    changing = [row for row in result["quantities"] if row["kind"] not in ("unchanged", "no order")]
    sides = {"quantity": "left", **dict.fromkeys(names, "right"), "Richardson": "right", "+-": "right"}
    rows = [
        (
            row["quantity"],
            *map(_cell, row["values"]),
            _cell(row["extrapolated"]),
            _cell(row["uncertainty"]),
            row["text"],
        )
        for row in changing[:MOST]
    ]
    _table("numbers", {**sides, "verdict": "left"}, rows, len(changing))
    waves = [row for row in result["waveforms"] if row["norm"] == "L2" and row["kind"] != "no order"]
    between = [f"{a} - {b}" for a, b in itertools.pairwise(names)]
    rows = [
        (row["quantity"], *(f"{100 * gap:.3g} %" for gap in row["differences"]), row["text"]) for row in waves
    ]
    sides = {"waveform, L2": "left", **dict.fromkeys(between, "right"), "verdict": "left"}
    _table("waveforms", sides, rows[:MOST], len(rows))
    kinds = ("unchanged", "no order")
    _show_steps([row for row in result["time_steps"] if row["kind"] not in kinds])
    _show_changes(result["changes"])
    _show_dependence(result)


def _show_steps(rows: list[dict[str, Any]]) -> None:
    """Print what smaller time steps do to the base."""
    if not rows:
        return
    sides = {
        "quantity": "left",
        **{f"dt x {factor:g}": "right" for factor in rows[0]["factors"]},
        "+-": "right",
    }
    cells = [
        (row["quantity"], *map(_cell, row["values"]), _cell(row["uncertainty"]), row["text"]) for row in rows
    ]
    _table("time steps", {**sides, "verdict": "left"}, cells[:MOST], len(cells))


def _show_changes(changes: list[dict[str, Any]]) -> None:
    """Print the largest differences that each change of the base makes."""
    known = [row for row in changes if row["difference_percent"]]
    known.sort(key=lambda row: -abs(row["difference_percent"]))
    rows = [
        (
            row["change"],
            f"{row['quantity']}{', ' + row['norm'] if 'norm' in row else ''}",
            f"{row['difference_percent']:+.3g} %",
        )
        for row in known[:MOST]
    ]
    sides = {"change": "left", "quantity": "left", "difference": "right"}
    _table("changes of the base, one at a time, largest first", sides, rows, len(known))


def _show_dependence(result: dict[str, Any]) -> None:
    """Print what else than the spacing was varied, how much that moves, and what was not."""
    if not result["dependence"]:
        return
    rows = [
        (
            row["of"],
            "-" if row["number"] is None else f"{row['number']}, {row['number_percent']:+.3g} %",
            ", ".join(row["changes"]) or row["text"],
        )
        for row in result["dependence"]
    ]
    sides = {"depends on": "left", "largest change of a number": "left", "varied": "left"}
    _table("what else moves the base", sides, rows, len(rows))
    found = result["iterations"]
    print_lines(console(), [f"iterations: {found['solves']}; {found['text']}"])
    worst = [row for row in found["beats"] if row["error_percent"] and not why_no_order(row["quantity"])]
    worst.sort(key=lambda row: -abs(row["error_percent"]))
    cells = [(row["quantity"], _cell(row["error"]), f"{row['error_percent']:.3g} %") for row in worst[:MOST]]
    sides = {"quantity": "left", "error": "right", "of its value": "right"}
    _table("error of the last beat", sides, cells, len(worst))


def _table(title: str, sides: dict[str, str], rows: Sequence[tuple[str, ...]], count: int) -> None:
    if rows:
        more = f" ({len(rows)} of {count})" if count > len(rows) else ""
        print_table(console(), f"{title}{more}", sides, rows)


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.5g}"
