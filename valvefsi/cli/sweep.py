"""``valvefsi sweep``: a case for several values of its keys."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valvefsi.cli.fit_output import console
from valvefsi.cli.option_groups import options_of
from valvefsi.cli.options import Anew, CaseFile, JobsOfMembers, Out, PlanMembers, Set, Style, Trust
from valvefsi.cli.study_plan import print_plan, raise_failed
from valvefsi.cli.tables import number, print_table
from valvefsi.post.columns import Units

if TYPE_CHECKING:
    from valvefsi.case import Case
    from valvefsi.studies.members import Outcome
    from valvefsi.studies.sweep import Sweep

MOST = 4
"""Numbers of a member that are printed."""


@dataclass(frozen=True, kw_only=True)
class SweepCommand:
    """Arguments and options of ``sweep``."""

    case: CaseFile
    over: Annotated[
        list[str],
        typer.Option(
            "--over",
            metavar="KEY=VALUE,...",
            help="The values of a key, such as time.dt='1 ms,2 ms'. Repeatable: all combinations are run.",
        ),
    ]
    overrides: Set = None
    out: Out = None
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the study in the folder; more values may join it.")
    ] = False
    overwrite: Anew = False
    jobs: JobsOfMembers = None
    plan: PlanMembers = False
    trust: Trust = False
    style: Style = "screen"


@options_of(SweepCommand)
def sweep(options: SweepCommand) -> None:
    """Run a case for several values of its keys, and put the members' numbers into one table and picture.

    Each member is a run of its own, in a folder of its name, on one core; as many run at once as there are cores. A
    member cannot have several MPI ranks: one that needs them is run alone, by mpirun -n 4 valvefsi run. The folder gets
    sweep.csv, sweep.json and sweep.png. Ctrl-C stops the members, each with a checkpoint.
    """
    from valvefsi.studies.members import read_cases
    from valvefsi.studies.sweep import make_sweep

    study = make_sweep(options.over, options.overrides or [])
    cases = read_cases(options.case, study.members, trust=options.trust)
    folder = options.out or Path("results") / f"sweep-{options.case.stem}"
    if options.plan:
        print_plan(cases, folder, options.jobs)
        return
    _run(options, study, cases, folder)


def _run(options: SweepCommand, study: Sweep, cases: Mapping[str, Case], folder: Path) -> None:
    from valvefsi.cli.study_progress import StudyProgress
    from valvefsi.post.plots.paper import paper
    from valvefsi.studies.runner import run_members
    from valvefsi.studies.sweep import write_tables
    from valvefsi.studies.sweep_picture import draw_sweep

    with StudyProgress(options.case.stem) as progress:
        outcomes = run_members(
            options.case,
            study.members,
            folder,
            jobs=options.jobs,
            resume=options.resume,
            overwrite=options.overwrite,
            trust=options.trust,
            progress=progress,
        )
    write_tables(options.case, study, outcomes, folder)
    with paper(options.style == "paper"):
        picture = draw_sweep(study, cases, outcomes, folder / "sweep.png")
    first = next(iter(cases.values()))
    _show(outcomes, Units(system=first.output.units, dim=first.grid.dim))
    also = "" if picture is None else f", {picture.name}"
    typer.echo(f"results in {folder / 'sweep.csv'}{also}")
    raise_failed(outcomes, "sweep.json")


def _show(outcomes: list[Outcome], units: Units) -> None:
    """Print the members with a few of their numbers, in the units of their case."""
    from valvefsi.studies.sweep_picture import moment, varying

    summaries = [outcome.summary for outcome in outcomes]
    numbers = dict(list(varying(summaries).items())[:MOST])
    shown = {name: units.of(name) for name in numbers}
    headings = [quantity.heading for quantity in shown.values()]
    sides = {"member": "left", "": "left", **dict.fromkeys(headings, "right")}
    rows = [
        (
            outcome.member.name,
            outcome.state,
            *(_cell(shown[name].factor * float(values[k])) for name, values in numbers.items()),
        )
        for k, outcome in enumerate(outcomes)
    ]
    title = f"members; numbers: {moment(summaries)}" if numbers else "members"
    print_table(console(), title, sides, rows)


def _cell(value: float) -> str:
    return "-" if value != value else number(value)
