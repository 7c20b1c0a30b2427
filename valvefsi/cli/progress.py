"""Progress of a run: a bar on a terminal, one line that changes in a notebook, plain lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from valvefsi.cli.tables import number
from valvefsi.post.columns import Units
from valvefsi.units import format_time

if TYPE_CHECKING:
    from types import TracebackType

    from mpi4py import MPI
    from rich.console import Console
    from rich.progress import Progress as Bars
    from rich.progress import TaskID

    from valvefsi.types import Scalar

PLAIN_INTERVAL, NOTEBOOK_INTERVAL, LIVE_INTERVAL = 5.0, 0.5, 0.1
SHOWN = 3
BAR, PERCENT, LEFT = 12, 4, 16
"""Columns of the bar, of "100%" and of "12 h 02 min left", each with a space after it: these always stay."""
TITLE = 8
"""Columns that a title keeps while numbers can go in its place."""
AFTER = "drawing pictures"
"""What a bar says from its last step until it is taken away."""
ROUND_OFF = 1e-9
"""Part of the length of a run by which the sum of its steps may miss the end."""


class Progress:
    """Shows steps, simulated time and time left; a simulation calls it after every step.

    On a terminal a bar, in a notebook one line that changes, elsewhere (a file, mpirun) a plain line every few seconds,
    on rank 0.

    Args:
        comm: Communicator of the run.
        title: What is being run.
        console: Where to, standard output if left out.
        period: Length of a beat [s]; beat and phase are shown if given.
        units: Units of the numbers, those of a lab in space if left out.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        title: str,
        console: Console | None = None,
        *,
        period: float | None = None,
        units: Units | None = None,
    ) -> None:
        self.comm, self.title, self.console, self.period = comm, title, console, period
        self.units, self.ended = units or Units(), ("", "")
        self.live: Bars | None = None
        self.task: TaskID | None = None
        self.cell: Cell | None = None
        self.first: tuple[float, float] | None = None
        self.last: tuple[float, int] | None = None
        self.due = self.dt = 0.0

    def __enter__(self) -> Progress:
        """Return itself; nothing is shown before the first step."""
        return self

    def __exit__(self, *_: BaseException | type[BaseException] | TracebackType | None) -> None:
        """Take the bar away from the cursor."""
        if self.live is not None and self.task is not None:
            if self.ended[1]:
                self.live.update(self.task, description=self.ended[0], text=self.ended[1])
            self.live.stop()

    def __call__(self, step: int, t: float, t_end: float, info: Mapping[str, Scalar] | None = None) -> None:
        """Show how far the run is.

        Args:
            step: Steps taken.
            t: Simulated time [s].
            t_end: End of the run [s].
            info: What else is worth a look, by name.
        """
        if self.comm.rank != 0:
            return
        now = time.perf_counter()
        if self.last is not None and step > self.last[1]:  # not where the run went back
            self.dt = (t - self.last[0]) / (step - self.last[1])
        self.last = (t, step)
        if self.first is None:
            self.first = (now, t)
            self._open()
        elif now < self.due and t < t_end * (1.0 - ROUND_OFF):
            return
        self.due = now + self._interval()
        wall, simulated = now - self.first[0], t - self.first[1]
        left = wall * (t_end - t) / simulated if simulated > 0 else None
        share = t / t_end if t < t_end * (1.0 - ROUND_OFF) else 1.0
        numbers = [f"t = {t:.4g} of {t_end:g} s", f"step {step}"]
        if self.period:
            beat, phase = divmod(t / self.period, 1.0)
            numbers += [f"beat {beat + 1:.0f} at {100 * phase:.0f} %", f"dt {self.dt:.3g} s"]
        numbers += [self._said(name, value) for name, value in _newest(info or {})]
        end = f"{format_time(left)} left" if share < 1 else f"in {format_time(wall)}"
        if self.live is not None and self.task is not None and self.console is not None:
            title, text = fitted(self.title, numbers, self.console.width)
            if share >= 1:
                self.ended, (title, text) = (title, text), fitted(self.title, [AFTER], self.console.width)
            self.live.update(self.task, description=title, completed=share, text=text, left=end)
        elif self.console is not None and (left is not None or share >= 1):
            end = end if share < 1 else f"done {end}"
            line = f"{100 * share:5.1f} %  {', '.join(numbers)}, {end}"
            if self.cell is not None:
                self.cell.show(f"{self.title}: {line.strip()}")
                return
            self.console.print(line, highlight=False, soft_wrap=True, markup=False)
            self.console.file.flush()

    def _open(self) -> None:
        from rich.console import Console

        self.console = self.console or Console()
        if self.console.is_jupyter:
            self.cell = Cell()
        elif self.console.is_terminal and not self.console.is_dumb_terminal:
            self.live, self.task = open_bar(self.console)

    def _said(self, name: str, value: Scalar) -> str:
        """Return a number with its name and unit."""
        shown = self.units.of(name)
        value = shown.factor * value if isinstance(value, float) else value
        return f"{shown.words} {number(value)} {shown.unit}".rstrip()

    def _interval(self) -> float:
        """Return the time between two looks at it [s]."""
        if self.cell is not None:
            return NOTEBOOK_INTERVAL
        return PLAIN_INTERVAL if self.live is None else LIVE_INTERVAL


class Cell:
    """A line in the output of a notebook's cell that is written over."""

    def __init__(self) -> None:
        self.handle: Any = None

    def show(self, line: str) -> None:
        """Show a line in place of the last one."""
        from IPython.display import display

        text = {"text/plain": line}
        if self.handle is None:
            self.handle = display(text, raw=True, display_id=True)
        else:
            self.handle.update(text, raw=True)


def open_bar(console: Console, title: str = "") -> tuple[Bars, TaskID]:
    """Return a bar that has begun: its part done is of 1, its fields are ``text`` and ``left``, a time."""
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn
    from rich.progress import Progress as Bars

    heading, left, text = (
        TextColumn(text, style=style, markup=False)
        for text, style in (
            ("{task.description}", "bold"),
            ("{task.fields[left]}", "cyan"),
            ("{task.fields[text]}", ""),
        )
    )
    live = Bars(heading, BarColumn(bar_width=BAR), TaskProgressColumn(), left, text, console=console)
    task = live.add_task(title, total=1.0, text="", left="...")
    live.start()
    return live, task


def fitted(title: str, numbers: Sequence[str], width: int) -> tuple[str, str]:
    """Return title and numbers of a line with a bar, cut so that both fit into a terminal.

    Args:
        title: What is being run; it is cut first.
        numbers: The most important one first; the last ones are left out where even a short title is too much.
        width: Columns of the terminal.
    """
    rest = width - (BAR + PERCENT + LEFT + 4)
    least, text = min(len(title), TITLE), numbers[0]
    for one in numbers[1:]:
        if len(text) + 2 + len(one) + least > rest:
            break
        text += f", {one}"
    most = max(rest - len(text), 1)
    return title if len(title) <= most else f"{title[: most - 1]}…", text


def _newest(info: Mapping[str, Scalar]) -> list[tuple[str, Scalar]]:
    """Return flows and pressures of circuits and a valve's area, or the first few columns after step and time."""
    loop = [(name, value) for name, value in info.items() if name.startswith(("pdva_", "q_", "p_"))]
    return loop or [(name, value) for name, value in info.items() if name not in ("step", "t_s")][:SHOWN]
