"""Runs as the figures of several of them take them: their frames in the cycle, their beats, the instants to show."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from valvefsi.case.models import Case
from valvefsi.case.reading import load_case
from valvefsi.case.valve import find_valve
from valvefsi.case.valve_report import pump_of
from valvefsi.case.valve_runs import read_beats
from valvefsi.errors import CaseError
from valvefsi.io.grid_files import times_of
from valvefsi.io.history import read_history
from valvefsi.post.valve_beat import Beat
from valvefsi.types import Array, Indices

LOW, HIGH = 0.1, 0.9
"""Parts of the range of the open area between which the valve opens or closes."""


@dataclass(frozen=True, kw_only=True)
class FigureRun:
    """A run as a figure takes it.

    Attributes:
        name: What it is called.
        folder: Its folder.
        case: Its case.
        beat: Its last whole cycle, None without one.
        first: When the cycle begins that is shown [s].
        last: When it ends, or the run [s].
    """

    name: str
    folder: Path
    case: Case
    beat: Beat | None
    first: float
    last: float

    def frames(self, series: str) -> list[tuple[float, float, Path]]:
        """Return time in the cycle, time of the run and file of each frame of a series, in order.

        Raises:
            CaseError: The run has written no such series.
        """
        found = times_of(self.folder / "paraview" / f"{series}.pvd")
        return [(t - self.first, t, path) for t, path in found if self.first - 1e-9 <= t <= self.last + 1e-9]

    def areas(self) -> tuple[Array, Array]:
        """Return times in the cycle and the projected open area, ``(n,)`` each [s, cm^2]."""
        history = read_history(self.folder / "history.csv")
        t, area = np.array(history["t_s"]) - self.first, np.array(history["pdva_cm2"])
        inside = (t >= -1e-9) & (t <= self.last - self.first + 1e-9)
        return t[inside], area[inside]


def read_runs(paths: list[Path], *, trust: bool = False) -> list[FigureRun]:
    """Read the runs in folders; of the folder of a study those below it, from the coarsest grid to the finest.

    Raises:
        CaseError: A folder has no run of a valve.
    """
    folders: list[Path] = []
    for path in map(Path, paths):
        if (path / "case.toml").is_file():
            folders.append(path)
            continue
        below = sorted(
            file.parent for file in path.rglob("history.csv") if (file.parent / "case.toml").is_file()
        )
        if not below:
            raise CaseError(
                "no run here: expected the folder of a run, or of a study with runs in it", file=path
            )
        spacing = {folder: load_case(folder / "case.toml", trust=trust).grid.spacing for folder in below}
        folders += sorted(below, key=lambda folder: -spacing[folder])
    runs = [_read_run(folder, trust) for folder in folders]
    same = len({run.name for run in runs}) < len(runs)
    return [_named(run, f"{run.folder.resolve().parent.name}/{run.name}") for run in runs] if same else runs


def _named(run: FigureRun, name: str) -> FigureRun:
    return FigureRun(**{**vars(run), "name": name})


def _read_run(folder: Path, trust: bool) -> FigureRun:
    """Read one run; one without a whole cycle is shown from where its cycles begin."""
    if not (folder / "history.csv").is_file():
        raise CaseError("there is no run here yet, history.csv is missing", file=folder)
    case = load_case(folder / "case.toml", trust=trust)
    if find_valve(case) is None:
        raise CaseError("this run has no valve, or more than one and no stent", file=folder)
    history = read_history(folder / "history.csv")
    if not history["t_s"]:
        raise CaseError("the run has no row yet", file=folder / "history.csv")
    beat, first, last = None, float(history["t_s"][0]), float(history["t_s"][-1])
    if pump_of(case).period is not None:
        try:
            beat = read_beats(folder, trust=trust)[1][-1]
            first, last = beat.start, beat.start + beat.period
        except CaseError:  # not a whole cycle yet
            first = pump_of(case).cycles_from or first
    name = folder.resolve().name
    return FigureRun(name=name, folder=folder, case=case, beat=beat, first=first, last=last)


def opening_and_closing(run: FigureRun) -> tuple[float | None, float | None]:
    """Return when the valve of a run begins to open and to close, in the cycle, None where it does not [s]."""
    t, area = run.areas()
    if len(t) < 2 or not np.ptp(area) > 0.0:
        return None, None
    top, least = int(np.argmax(area)), float(area.min())
    low, high = (least + part * (area[top] - least) for part in (LOW, HIGH))
    before, after = np.flatnonzero(area[: top + 1] <= low), np.flatnonzero(area[top:] >= high)
    falls = area[-1] < 0.5 * (low + high)
    return (
        float(t[before[-1]]) if len(before) else None,
        float(t[top + after[-1]]) if len(after) and falls else None,
    )


def instants(times: Array, start: float, increment: float, most: int) -> Indices:
    """Choose frames from that next to a time on, an increment apart or as close as frames are, each once.

    Args:
        times: Times of the frames in the cycle, ascending, ``(n,)`` [s].
        start: First instant [s].
        increment: From one to the next [s].
        most: Largest number of them.
    """
    spacing = float(np.median(np.diff(times))) if len(times) > 1 else increment
    begin = times[int(np.abs(times - start).argmin())]
    wanted = begin + max(increment, spacing) * np.arange(most)
    wanted = wanted[wanted <= times[-1] + 0.5 * spacing]
    near = np.abs(times[:, None] - wanted).argmin(axis=0) if len(wanted) else np.zeros(0, dtype=np.int64)
    return np.unique(near)


def near(times: Array, t: float) -> int | None:
    """Return the frame nearest to an instant, None where the frames end more than a spacing from it."""
    if not len(times):
        return None
    spacing = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    k = int(np.abs(times - t).argmin())
    return k if abs(times[k] - t) <= 0.75 * spacing + 1e-9 else None
