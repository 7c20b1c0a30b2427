"""``valvefsi run`` and ``valvefsi case``."""

from __future__ import annotations

import contextlib
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from valvefsi.cli.closing import show_run
from valvefsi.cli.option_groups import options_of
from valvefsi.cli.options import AllowChange, CaseFile, Out, Overwrite, Plan, Resume, Set, Trust
from valvefsi.cli.progress import Progress
from valvefsi.cli.tables import in_plan, show_result
from valvefsi.cli.watch import served
from valvefsi.errors import CaseError
from valvefsi.post.columns import Units

if TYPE_CHECKING:
    from mpi4py import MPI

    from valvefsi.case import Case


@dataclass(frozen=True, kw_only=True)
class RunCommand:
    """Arguments and options of ``run``."""

    case: CaseFile
    out: Out = None
    resume: Resume = False
    overwrite: Overwrite = False
    allow_change: AllowChange = False
    overrides: Set = None
    plan: Plan = False
    view: Annotated[
        bool, typer.Option("--view", help="Serve a page to watch the run on, as valvefsi watch does.")
    ] = False
    trust: Trust = False


@options_of(RunCommand)
def run(options: RunCommand) -> None:
    """Run a case; the results go to results/NAME of the case file unless --out says otherwise."""
    from mpi4py import MPI

    from valvefsi.case import load_case

    loaded, comm = load_case(options.case, options.overrides or [], trust=options.trust), MPI.COMM_WORLD
    name = options.case.stem
    folder = options.out if options.out is not None else Path("results") / name
    if not (options.plan or options.resume or options.overwrite):
        from valvefsi.run.checkpoints import refuse_to_overwrite

        refuse_to_overwrite(folder, comm, finished=True)
    if comm.rank == 0:
        typer.echo(first_line(loaded, name))
        sys.stdout.flush()
    from valvefsi.case.build import run_case
    from valvefsi.case.schedule import beat_period

    if options.plan:
        show_result(_plan(loaded, comm, folder), comm)
        return
    how = {"resume": options.resume, "overwrite": options.overwrite, "allow_change": options.allow_change}
    page = served(folder, comm, trust=options.trust) if options.view else contextlib.nullcontext()
    units = Units(system=loaded.output.units, dim=loaded.grid.dim)
    with page, Progress(comm, loaded.title or name, period=beat_period(loaded), units=units) as progress:
        result = run_case(loaded, out=folder, comm=comm, progress=progress, **how)
    show_run(result, comm, folder, units)


def _plan(case: Case, comm: MPI.Comm, folder: Path) -> dict[str, Any]:
    """Return the plan of a case, in three dimensions with what more ranks would bring. Collective."""
    from valvefsi.case.build import plan_case

    result: dict[str, Any] = plan_case(case, comm, folder)
    if case.grid.dim == 3:
        from valvefsi.benchmarks.studies.speed import on_more_ranks

        explicit = any("viscosity is explicit" in entry.note for entry in result["plan"])
        how: Any = {"advection": case.fluid.advection, "viscous": "explicit" if explicit else "implicit"}
        result["plan"] += on_more_ranks(result["plan"], comm, **how)
    return result


def first_line(case: Case, name: str) -> str:
    """Say how large a case is, before what takes longer: the first run of a kind compiles its loops and forms."""
    from valvefsi.case.resuming import start_time
    from valvefsi.case.schedule import schedule_of

    cells, schedule = " x ".join(str(len(edges) - 1) for edges in case.grid.edges), schedule_of(case)
    h, dt = (" ".join(in_plan(*pair)) for pair in ((case.grid.spacing, "cm"), (schedule.dt, "s")))
    of = "or more, of at most" if case.time.control == "adaptive" else "of"
    return (
        f"{case.title or name}: {cells} cells of {h}, {schedule.num_steps(start_time(case))} steps {of} {dt}\n"
        "building it; the first time this takes a minute ..."
    )


def case(
    defaults: Annotated[
        bool, typer.Option("--defaults", help="A whole case with every key, as TOML.")
    ] = False,
    schema: Annotated[bool, typer.Option("--schema", help="The JSON schema of case files.")] = False,
) -> None:
    """Print what a case file may hold."""
    if defaults == schema:
        raise CaseError("expected one of --defaults and --schema", file="valvefsi case")
    import json

    from valvefsi.case import case_defaults, case_schema

    typer.echo(case_defaults() if defaults else json.dumps(case_schema(), indent=2), nl=schema)
