"""``valvefsi sample``: uncertain inputs through a model, to outputs with intervals and Sobol indices."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from valvefsi.cli.fit_output import console
from valvefsi.cli.option_groups import options_of
from valvefsi.cli.options import Anew, JobsOfSamples, Out, SetStudy, StudyFile, Style, Trust
from valvefsi.cli.study_plan import print_plan, raise_failed
from valvefsi.cli.tables import print_lines, print_table
from valvefsi.errors import CaseError, StudyError

if TYPE_CHECKING:
    from valvefsi.studies.circuit_samples import Sampled
    from valvefsi.studies.members import Member, Outcome
    from valvefsi.studies.sampling import Sampling


@dataclass(frozen=True, kw_only=True)
class SampleCommand:
    """Arguments and options of ``sample``."""

    study: StudyFile
    overrides: SetStudy = None
    out: Out = None
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the samples in the folder.")] = False
    overwrite: Anew = False
    jobs: JobsOfSamples = None
    plan: Annotated[
        bool, typer.Option("--plan", help="Print what one sample and all will take; do not run.")
    ] = False
    array: Annotated[
        bool,
        typer.Option(
            "--array", help="Write members.sh, an array of jobs for sbatch with a task for each sample."
        ),
    ] = False
    member: Annotated[
        int | None,
        typer.Option("--member", metavar="K", min=0, help="Run sample K alone, as a task of the array does."),
    ] = None
    collect: Annotated[
        bool, typer.Option("--collect", help="Run nothing: make table and picture of what is done.")
    ] = False
    trust: Trust = False
    style: Style = "screen"


@options_of(SampleCommand)
def sample(options: SampleCommand) -> None:
    """Sample uncertain inputs, run a case or its circuit alone at them, and say how sure its outputs are and why.

    The study names distributions or fits, a design (sobol, latin-hypercube) and a target: the circuit alone, the
    statics of a leaflet, or runs of the case. The folder gets sample.json, samples.csv, sample.md and
    sample.png: mean, deviation and 95 % interval of each output, Sobol indices of first order and total with intervals,
    and what failed. On a cluster: --array, sbatch, then --collect.
    """
    from valvefsi.case.sample_tables import load_samples
    from valvefsi.studies.sample_report import check_samples
    from valvefsi.studies.sampling import make_sampling

    study = load_samples(options.study, options.overrides or [])
    folder = options.out or Path("results") / f"sample-{options.study.stem}"
    sampling = make_sampling(study)
    if study.target == "case":
        _runs(options, sampling, folder)
        return
    chosen = [name for name in ("plan", "array", "collect") if getattr(options, name)]
    if chosen or options.member is not None:
        word = chosen[0] if chosen else "member"
        said = {"circuit": "the circuit alone takes seconds", "statics": "statics take minutes"}
        raise CaseError(f"{said[study.target]}; this is for runs", key=f"--{word}")
    if study.target == "circuit":
        if not (options.resume or options.overwrite):
            check_samples(sampling, folder)
        _finish(options, sampling, _circuits(sampling, trust=options.trust), folder)
    else:
        _finish(options, sampling, _statics(options, sampling, folder), folder)


def _circuits(sampling: Sampling, *, trust: bool) -> Sampled:
    """Run the circuit alone."""
    from valvefsi.case import load_case
    from valvefsi.studies.circuit_samples import run_circuits

    study, inputs = sampling.study, sampling.inputs
    if study.orifice is None:
        raise CaseError("the circuit alone needs an orifice", file=study.file, key="orifice")
    typer.echo(f"{len(sampling.values)} samples of the circuit alone")
    case = load_case(study.case, study.changes, trust=trust)
    return run_circuits(case, study.orifice, inputs.keys, inputs.units, sampling.values)


def _statics(options: SampleCommand, sampling: Sampling, folder: Path) -> Sampled:
    """Solve the statics of every sample."""
    from valvefsi.studies.runner import cores
    from valvefsi.studies.static_samples import run_statics, static_samples

    samples = static_samples(sampling, trust=options.trust)

    def say(done: int, failed: int, total: int) -> None:
        typer.echo(f"{done} of {total} samples done" + (f", {failed} failed" if failed else ""))

    jobs = min(options.jobs or cores(), len(samples))
    how: Any = {"resume": options.resume, "overwrite": options.overwrite, "notify": say}
    return run_statics(samples, folder, jobs=jobs, **how)


def _runs(options: SampleCommand, sampling: Sampling, folder: Path) -> None:
    """Run, plan, write or collect the runs of a case."""
    from valvefsi.studies.members import collected
    from valvefsi.studies.runner import run_member
    from valvefsi.studies.sample_runs import outputs_of_runs, sample_members, write_job_array

    case, members = Path(sampling.study.case), sample_members(sampling)
    if options.member is not None:
        if options.member >= len(members):
            raise CaseError(f"there are {len(members)} samples", key="--member", value=options.member)
        raise_failed([run_member(case, members[options.member], folder, trust=options.trust)], "run.log")
        return
    if options.array:
        passed = [word for text in options.overrides or [] for word in ("--set", text)]
        passed += ["--trust"] if options.trust else []
        script = write_job_array(options.study, folder, len(members), options.jobs, passed)
        typer.echo(f"sbatch {script}\nthen the same command with --collect in place of --array")
        return
    if options.plan:
        _plan(options, case, members, folder)
        return
    if options.collect:
        outcomes = collected(case, members, folder, trust=options.trust)
    else:
        outcomes = _run(options, case, members, folder)
    _finish(options, sampling, outputs_of_runs(outcomes), folder)
    raise_failed(outcomes, "sample.json")


def _plan(options: SampleCommand, case: Path, members: list[Member], folder: Path) -> None:
    """Print what the first sample will take, and all of them if they are alike."""
    from valvefsi.studies.members import read_cases

    cases = read_cases(case, members, trust=options.trust)
    first = members[0].name
    print_plan({first: cases[first]}, folder, options.jobs)
    typer.echo(f"{len(members)} samples of about that size")


def _run(options: SampleCommand, case: Path, members: list[Member], folder: Path) -> list[Outcome]:
    from valvefsi.cli.study_progress import StudyProgress
    from valvefsi.studies.runner import run_members

    with StudyProgress(options.study.stem) as progress:
        return run_members(
            case,
            members,
            folder,
            jobs=options.jobs,
            resume=options.resume,
            overwrite=options.overwrite,
            trust=options.trust,
            progress=progress,
        )


def _finish(options: SampleCommand, sampling: Sampling, found: Sampled, folder: Path) -> None:
    """Write and print what was found."""
    from valvefsi.post.plots.paper import paper
    from valvefsi.studies.sample_report import draw_samples, write_samples
    from valvefsi.studies.sampling import analyse

    result = analyse(sampling, found.outputs, found.failures)
    write_samples(sampling, found.outputs, found.failures, result, folder)
    with paper(options.style == "paper"):
        picture = draw_samples(sampling, found.outputs, result, folder / "sample.png")
    _show(result)
    also = "" if picture is None else f", {picture.name}"
    typer.echo(f"results in {folder / 'sample.md'}{also}")
    if len(found.failures) == len(sampling.values):
        first = next(iter(found.failures.values()))
        raise StudyError(f"all {len(sampling.values)} samples failed, the first with: {first}")


def _show(result: Mapping[str, Any]) -> None:
    """Print notes, outputs with intervals, and the indices of each."""
    page = console()
    print_lines(page, [f"note: {note}" for note in result["notes"]])
    rows = [
        (
            row["output"],
            *(_cell(row.get(key)) for key in ("mean", "std", "low", "high")),
            row["text"],
        )
        for row in result["outputs"]
    ]
    sides = {"output": "left", "mean": "right", "std": "right", "2.5 %": "right", "97.5 %": "right"}
    print_table(page, "outputs", {**sides, "how": "left"}, rows)
    names = list(result["groups"])
    rows = [
        (row["output"], *(_index(row["indices"], name) for name in names))
        for row in result["outputs"]
        if row["indices"]
    ]
    if rows:
        title = "Sobol indices: first order / total, +- half of the 95 % interval of the total"
        print_table(page, title, {"output": "left", **dict.fromkeys(names, "right")}, rows)


def _index(rows: list[dict[str, Any]], group: str) -> str:
    one = next(row for row in rows if row["group"] == group)
    low, high = one["total_interval"]
    return f"{one['first']:.2f} / {one['total']:.2f} +- {(high - low) / 2:.2f}"


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
