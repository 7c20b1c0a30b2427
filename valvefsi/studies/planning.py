"""What a study will take, before it is run: steps and time of each member, and of all on some cores."""

from __future__ import annotations

import gc
import heapq
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

from valvefsi.case.build import build
from valvefsi.case.models import Case
from valvefsi.case.resuming import check_start
from valvefsi.run.planning import plan


@dataclass(frozen=True, kw_only=True)
class MemberPlan:
    """What a member will take.

    Attributes:
        name: Its name.
        cells: Cells of its grid.
        steps: Its steps; the smallest number where they adapt.
        dt: Its step; the largest where they adapt [s].
        time: Expected time on one core, without output [s].
    """

    name: str
    cells: int
    steps: int
    dt: float
    time: float


def plan_members(
    cases: Mapping[str, Case], folder: Path, notify: Callable[[str, int, int], object] | None = None
) -> list[MemberPlan]:
    """Return what each member will take; each takes a few trial steps, which are thrown away.

    Args:
        cases: The case of each member by its name.
        folder: Folder of the study; nothing is written.
        notify: Called with the name of a member before it is looked at, its number, and the number of all.

    Raises:
        CaseError: A case does not go with its mesh.
    """
    plans = []
    for number, (name, case) in enumerate(cases.items()):
        if notify is not None:
            notify(name, number, len(cases))
        check_start(case)
        entries = {entry.quantity: entry.value for entry in plan(build(case, folder / name, MPI.COMM_SELF))}
        cells, steps, dt, time = (
            float(entries[key]) for key in ("cells", "steps", "time step", "expected time")
        )
        plans.append(MemberPlan(name=name, cells=round(cells), steps=round(steps), dt=dt, time=time))
        gc.collect()  # the communicators of its meshes, of which an MPI library has only some two thousand
    return plans


def time_of_all(times: list[float], jobs: int) -> float:
    """Return the time that members take on some cores, each started in turn as one is free [s]."""
    free = [0.0] * jobs
    for time in times:
        heapq.heapreplace(free, free[0] + time)
    return max(free)
