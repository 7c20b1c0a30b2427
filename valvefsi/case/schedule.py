"""The steps of a case: what its plan, its first line on the terminal and its run take alike."""

from __future__ import annotations

from typing import Any

from valvefsi.case.models import Case
from valvefsi.run.schedule import AdaptiveSchedule, Schedule


def end_of(case: Case) -> float:
    """Return the end of a run [s]: time.t_end, or the beats of its target where they last longer."""
    if case.target is None:
        return case.time.t_end
    return max(case.time.t_end, case.target.beats * 60.0 / case.target.beats_per_minute)


def beat_period(case: Case) -> float | None:
    """Return the length of a beat of a run [s], None without a pump that repeats."""
    if case.target is not None:
        return 60.0 / case.target.beats_per_minute
    return next((c.pump.period for c in case.circuit if c.pump.period), None)


def schedule_of(case: Case) -> Schedule | AdaptiveSchedule:
    """Return the steps of a run."""
    limits: dict[str, Any] = {"dt": case.dt, "t_end": end_of(case), "cfl_max": case.time.cfl_max}
    if case.time.control == "fixed":
        return Schedule(**limits)
    return AdaptiveSchedule(**limits, cfl=case.time.cfl, max_recoveries=case.time.max_recoveries)
