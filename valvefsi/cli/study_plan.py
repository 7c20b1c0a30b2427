"""What a study will take and how it ended, on the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from valvefsi.cli.fit_output import console
from valvefsi.cli.tables import print_table
from valvefsi.errors import StudyError
from valvefsi.units import format_time

if TYPE_CHECKING:
    from valvefsi.case import Case
    from valvefsi.studies.members import Outcome

FEW = 3
"""Failed members that the last message names."""


def print_plan(cases: Mapping[str, Case], folder: Path, jobs: int | None) -> None:
    """Print what each member will take, and all of them on some cores."""
    from mpi4py import MPI

    from valvefsi.cli.bench_progress import announced
    from valvefsi.studies.planning import plan_members, time_of_all
    from valvefsi.studies.runner import cores

    with announced(MPI.COMM_WORLD) as said:
        plans = plan_members(cases, folder, lambda name, done, total: said(name, done, total, None))
    least = {plan.name: ">= " * (cases[plan.name].time.control == "adaptive") for plan in plans}
    rows = [
        (
            plan.name,
            f"{plan.cells}",
            f"{least[plan.name]}{plan.steps}",
            f"{plan.dt:.4g}",
            format_time(plan.time),
        )
        for plan in plans
    ]
    sides = {"member": "left", "cells": "right", "steps": "right", "time step (s)": "right"}
    print_table(console(), "plan", {**sides, "expected time": "right"}, rows)
    count = jobs or cores()
    whole = format_time(time_of_all([plan.time for plan in plans], count))
    typer.echo(f"{len(plans)} members, {count} at once: {whole}, without start-up and output")


def raise_failed(outcomes: Sequence[Outcome], record: str) -> None:
    """Name the members that failed.

    Args:
        outcomes: How the members ended.
        record: The file that names all of them.

    Raises:
        StudyError: There are any.
    """
    failed = [outcome for outcome in outcomes if outcome.state == "failed"]
    if failed:
        said = "; ".join(
            f"{outcome.member.name}: {outcome.message} ({outcome.log})" for outcome in failed[:FEW]
        )
        more = f"; and more, see {record}" if len(failed) > FEW else ""
        raise StudyError(f"{len(failed)} of {len(outcomes)} members failed: {said}{more}")
