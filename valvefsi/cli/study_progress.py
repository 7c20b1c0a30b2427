"""Progress of a study: members done, running and failed, and the time left."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from valvefsi.cli.progress import PLAIN_INTERVAL, open_bar
from valvefsi.units import format_time

if TYPE_CHECKING:
    from types import TracebackType

    from rich.console import Console
    from rich.progress import Progress as Bars
    from rich.progress import TaskID

    from valvefsi.studies.members import Outcome
    from valvefsi.studies.runner import Tally


class StudyProgress:
    """Shows how far a study is, and each member that ends; `valvefsi.studies.run_members` calls it.

    On a terminal a bar; elsewhere a plain line every few seconds, where something has changed.

    Args:
        title: What is being run.
        console: Where to, standard output if left out.
    """

    def __init__(self, title: str, console: Console | None = None) -> None:
        self.title, self.console = title, console
        self.live: Bars | None = None
        self.task: TaskID | None = None
        self.due, self.shown, self.stopping = 0.0, "", False

    def __enter__(self) -> StudyProgress:
        """Return itself; nothing is shown before the first call."""
        return self

    def __exit__(self, *_: BaseException | type[BaseException] | TracebackType | None) -> None:
        """Take the bar away from the cursor."""
        if self.live is not None:
            self.live.stop()

    def __call__(self, tally: Tally) -> None:
        """Show how far it is."""
        if self.console is None or not self.shown:
            self._open(tally)
        for outcome in tally.ended:
            self._line(_ended(outcome))
        if tally.stopping and not self.stopping:
            self.stopping = True
            self._line(
                f"stopping: {_members(len(tally.running))} running; once more ends them without a checkpoint"
            )
        text = f"{tally.done + tally.kept} of {tally.total} done, {len(tally.running)} running"
        text += f", {tally.failed} failed" if tally.failed else ""
        left = format_time(tally.left_s)
        if self.live is not None and self.task is not None:
            self.live.update(self.task, completed=tally.share, text=text, left=f"{left} left")
            return
        now, line = time.perf_counter(), f"{100 * tally.share:5.1f} %  {text}"
        if line != self.shown and (now >= self.due or tally.ended):
            self.due, self.shown = now + PLAIN_INTERVAL, line
            self._line(line if tally.left_s is None or not tally.running else f"{line}, {left} left")

    def _open(self, tally: Tally) -> None:
        from rich.console import Console

        self.console, self.shown = self.console or Console(), " "
        if tally.kept:
            self._line(f"{tally.kept} of {_members(tally.total)} done before")
        if self.console.is_terminal and tally.kept < tally.total:
            self.live, self.task = open_bar(self.console, self.title)

    def _line(self, text: str) -> None:
        if self.console is not None:
            self.console.print(text, highlight=False, soft_wrap=True, markup=False)
            self.console.file.flush()


def _members(count: int) -> str:
    return f"{count} member{'s' * (count != 1)}"


def _ended(outcome: Outcome) -> str:
    """Return what is said of a member that has ended."""
    if outcome.state == "failed":
        return f"{outcome.member.name}: failed, {outcome.message} ({outcome.log})"
    return f"{outcome.member.name}: done in {format_time(outcome.wall_s)}"
