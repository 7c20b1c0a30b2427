"""A run that goes on, seen through the files that it writes: how far it is, how long it takes, its newest frame."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from valvefsi import __version__
from valvefsi.case import load_case
from valvefsi.case.origins import PROVENANCE, read_provenance
from valvefsi.case.schedule import beat_period
from valvefsi.errors import CaseError
from valvefsi.io.checkpoint import list_checkpoints, newest_meta
from valvefsi.io.folder import LOCK, Holder, holder_of, stop_requested
from valvefsi.io.history import HistoryReader
from valvefsi.report.blocks import Cell, Chapter, Figure, Note, Page, Section, Table, Text, View, missing
from valvefsi.report.results import warnings_of, waveforms
from valvefsi.report.runs import Run
from valvefsi.report.scenes import newest_frame, scene_of
from valvefsi.report.writing import blocks_html
from valvefsi.units import format_time

PARTS = ("case.toml", "history.csv", "checkpoints", LOCK)
"""What a folder in which a run was begun holds one of."""


@dataclass(frozen=True, kw_only=True)
class Pace:
    """Where a run was at some moment, from which its pace is taken.

    Attributes:
        holder: The run's process.
        wall: The moment [s].
        t: Simulated time [s].
    """

    holder: Holder
    wall: float
    t: float


class LiveRun:
    """The folder of a run, of which each look reads only what is new.

    Args:
        folder: The folder, which need not be there yet.
        trust: Whether Python files of materials may be run.

    Raises:
        CaseError: It is a file, or holds something else.
    """

    def __init__(self, folder: Path, *, trust: bool = False) -> None:
        self.folder, self.trust = Path(folder), trust
        if self.folder.is_file():
            raise CaseError("this is a file, expected the folder of a run", file=folder)
        there = self.folder.is_dir() and any(self.folder.iterdir())
        if there and not any((self.folder / name).exists() for name in PARTS):
            raise CaseError("there is no run in this folder, but other files", file=folder)
        self.history = HistoryReader(self.folder / "history.csv")
        self.run = Run(folder=self.folder, case=None, why="", history={}, summary={}, provenance={})
        self.begun = self.checked = (0.0, "")
        self.meta: Mapping[str, Any] = {}
        self.scene: Figure | None = None
        self.scene_of: tuple[float, ...] = ()
        self.frame_t = -1.0
        self.pace: Pace | None = None
        self.one_at_a_time = threading.Lock()

    def view(self) -> View:
        """Return the state of the run."""
        with self.one_at_a_time:
            self._look()
            return self._view()

    def page(self) -> tuple[Page, View]:
        """Return the page on the run, and its head."""
        with self.one_at_a_time:
            self._look()
            found = self._figures()
            sections = [
                Section(
                    title="Newest frame", blocks=[found.get("scene", missing("No frame is written yet."))]
                ),
                Section(
                    title="Curves", blocks=[found.get("chart", missing("There is no curve to draw yet."))]
                ),
            ]
            about = f"Run in the folder {self.folder.resolve()}"
            part = Chapter(title="As it goes on", about=about, sections=sections)
            made = f"valvefsi {__version__}, what the run has written so far"
            return Page(title=self.run.title, made=made, parts=[part]), self._view()

    def news(self, versions: Mapping[str, str]) -> dict[str, Any]:
        """Return the state of the run, and those figures that are not of the versions named, as the page takes them."""
        with self.one_at_a_time:
            self._look()
            view, found = self._view(), self._figures()
        figures = {
            kind: {"data": figure.data, "caption": figure.caption, "alt": figure.alt}
            for kind, figure in found.items()
            if figure.data["version"] != versions.get(kind)
        }
        share = "" if view.share is None else f"{100 * view.share:.0f} % "
        return {
            "layout": view.layout,
            "state": view.state,
            "line": view.line,
            "share": view.share,
            "title": f"{share}{self.run.title}",
            "told": blocks_html(view.told),
            "figures": figures,
        }

    def _look(self) -> None:
        """Read what is new of the case, the history and the checkpoints."""
        begun = _stamp(self.folder / "case.toml")
        if begun != self.begun:
            self.begun, self.run = begun, self._opened()
            self.scene, self.scene_of, self.frame_t = None, (), -1.0
        self.history.read()
        self.run = replace(self.run, history=self.history.columns)
        checkpoints = list_checkpoints(self.folder / "checkpoints")
        checked = _stamp(checkpoints[-1]) if checkpoints else (0.0, "")
        if checked != self.checked:
            self.checked = checked
            self.meta = newest_meta(self.folder / "checkpoints", MPI.COMM_SELF) or {}

    def _opened(self) -> Run:
        """Return the run with its case, whose files are written when it begins or goes on."""
        case, why = None, ""
        with contextlib.suppress(OSError):
            try:
                case = load_case(self.folder / "case.toml", trust=self.trust)
            except CaseError as error:
                why = str(error)
        return replace(self.run, case=case, why=why, provenance=read_provenance(self.folder))

    def _figures(self) -> dict[str, Figure]:
        """Return what can be drawn so far, the data with their version."""
        found = {}
        self._find_scene()
        if self.scene is not None:
            found["scene"] = self.scene
        chart = waveforms(self.run).blocks[0]
        if isinstance(chart, Figure):
            version = f"{self.history.inode}-{self.history.place}"
            found["chart"] = replace(chart, data={**chart.data, "version": version})
        return found

    def _find_scene(self) -> None:
        """Read the newest frame where the lists of frames have changed since the last one."""
        stamps = tuple(_stamp(path)[0] for path in sorted((self.folder / "paraview").glob("*.pvd")))
        if stamps == self.scene_of:
            return
        with contextlib.suppress(CaseError, OSError):  # it is being written, or damaged: the one before stays
            frames = newest_frame(self.run, self.frame_t)
            if frames is not None:
                figure = scene_of(frames)
                self.scene_of, self.frame_t = stamps, float(frames.times[-1])
                version = f"{self.begun[0]}-{self.frame_t}"
                self.scene = replace(figure, data={**figure.data, "version": version})

    def _view(self) -> View:
        """Return the state of the run at the last look."""
        holder, row = holder_of(self.folder), {name: c[-1] for name, c in self.run.history.items() if len(c)}
        t, t_end = row.get("t_s"), None if self.run.case is None else self.run.case.time.t_end
        share = None if t is None or not t_end else min(1.0, t / t_end)
        state = self._state(holder)
        chart, frame = len(self.run.history.get("t_s", ())) > 1, self.scene is not None
        return View(
            layout=f"{self.begun[0]} {chart} {frame}",
            state=state,
            line=self._line(state, holder, t, t_end),
            share=share,
            told=[*self._progress(holder, row, t_end), *self._warnings()],
        )

    def _state(self, holder: Holder | None) -> str:
        if holder is None:
            if self.meta.get("finished"):
                return "finished"
            return "stopped" if self.meta or self.run.history else "waiting"
        if stop_requested(self.folder):
            return "stopping"
        written = _stamp(self.history.path)[0] >= _stamp(self.folder / LOCK)[0]
        return "running" if written and self.run.history else "starting"

    def _line(self, state: str, holder: Holder | None, t: float | None, t_end: float | None) -> str:
        """Return the state in one line."""
        at = "" if t is None else f"t = {t:.4g} s" if t_end is None else f"t = {t:.4g} of {t_end:g} s"
        if state == "running":
            left = None if holder is None or t is None or not t_end else self._left(holder, t, t_end)
            percent = "" if t is None or not t_end else f" ({100 * min(1.0, t / t_end):.1f} %)"
            if t is not None and t_end and t >= t_end * (1.0 - 1e-9):
                return f"At the end, {at}: numbers and pictures are made."
            return f"Runs, {at}{percent}{'' if left is None else f', about {format_time(left)} left'}."
        saved = "no checkpoint is written"
        if self.meta:
            saved = f"--resume goes on from the checkpoint of t = {self.meta['t']:.4g} s"
        return {
            "waiting": f"There is no run in {self.folder} yet.",
            "starting": f"The run in {self.folder} is being built, {holder}.",
            "stopping": f"Asked to stop at {at}: it writes a checkpoint after its step and ends.",
            "finished": f"The run in {self.folder} is finished, {at}; valvefsi report {self.folder} writes its page.",
            "stopped": f"The run in {self.folder} is not going on, its last row is of {at or 't = 0'}; {saved}.",
        }[state]

    def _left(self, holder: Holder, t: float, t_end: float) -> float | None:
        """Return the time that a run still takes at its pace so far [s], None where that is not known yet."""
        written = _stamp(self.history.path)[0]
        if self.pace is None or self.pace.holder != holder:
            calls = self.run.provenance.get("calls", ())
            fresh = bool(calls) and "--resume" not in calls[-1].get("command", ())
            begun = _stamp(self.folder / PROVENANCE)[0]
            self.pace = Pace(holder=holder, wall=begun if fresh else written, t=0.0 if fresh else t)
        if not (t > self.pace.t and written > self.pace.wall):
            return None
        took = (written - self.pace.wall) / (t - self.pace.t)
        return max(0.0, took * (t_end - t) - (time.time() - written))

    def _progress(self, holder: Holder | None, row: Mapping[str, float], t_end: float | None) -> list[Text]:
        """Return how far the run is as a table."""
        rows: list[tuple[str, Cell]] = [("time reached [s]", float(row["t_s"]))] if "t_s" in row else []
        rows += [] if t_end is None else [("end [s]", t_end)]
        period = None if self.run.case is None else beat_period(self.run.case)
        if period and "t_s" in row:
            beat, phase = divmod(row["t_s"] / period, 1.0)
            rows.append(("beat", f"{beat + 1:.0f} at {100 * phase:.0f} %"))
        rows += [("steps", int(row["step"]))] if "step" in row else []
        if len(self.history.columns.get("step", ())) > 1 and "t_s" in row:
            steps, times = (np.diff(self.history.columns[name][-2:])[0] for name in ("step", "t_s"))
            rows.append(("mean time step between the last rows [ms]", float(1e3 * times / max(1.0, steps))))
        rows += [("Courant number", float(row["courant"]))] if "courant" in row else []
        rows += [("held by", str(holder))] if holder is not None else []
        rows += [("last row written at", _clock(self.history.path))] if row else []
        if self.meta:
            rows.append(
                ("last checkpoint", f"t = {self.meta['t']:.4g} s, at {_clock(Path(self.checked[1]))}")
            )
        told: list[Text] = [Table(caption="Progress", headings=("what", "value"), rows=rows)] if rows else []
        if self.run.why:
            told.append(missing(f"The case cannot be read: {self.run.why}"))
        return told

    def _warnings(self) -> list[Text]:
        """Return warnings and recoveries up to the last checkpoint, which holds them."""
        if not self.meta:
            return [
                missing(
                    "Warnings are read from checkpoints, and there is none yet; the run's terminal has them."
                )
            ]
        timing = {name: self.meta.get(name, ()) for name in ("warnings", "recoveries")}
        blocks = warnings_of(replace(self.run, summary={"timing": timing})).blocks
        until = Note(text=f"Warnings and recoveries up to the last checkpoint, t = {self.meta['t']:.4g} s:")
        return [until, *(block for block in blocks if not isinstance(block, Figure))]


def _stamp(path: Path) -> tuple[float, str]:
    """Return when a file was written, 0 where it is not there, and which it is."""
    try:
        return path.stat().st_mtime, str(path)
    except OSError:
        return 0.0, str(path)


def _clock(path: Path) -> str:
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(_stamp(path)[0]))
