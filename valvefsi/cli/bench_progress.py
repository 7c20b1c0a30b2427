"""Progress of a benchmark: which run of how many, and the steps of each."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING

import typer

from valvefsi.cli.progress import PLAIN_INTERVAL, Progress
from valvefsi.units import format_time

if TYPE_CHECKING:
    from mpi4py import MPI


class announced:
    """Shows the runs of a benchmark, and the steps of each where it tells them.

    Args:
        comm: Communicator of the runs; rank 0 speaks.
        echo: What prints a line.
        interval: Shortest time between two lines about runs [s].
    """

    def __init__(
        self, comm: MPI.Comm, *, echo: Callable[[str], None] = typer.echo, interval: float = PLAIN_INTERVAL
    ) -> None:
        self.comm, self.echo, self.interval = comm, echo, interval
        self.due, self.last = 0.0, Progress(comm, "")

    def __enter__(self) -> announced:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Take the last bar away from the cursor."""
        self.last.__exit__(kind, error, trace)

    def __call__(self, name: str, done: int, total: int, left: float | None) -> Progress | None:
        """Say which run is next and how long the rest may take; return what shows its steps."""
        self.last.__exit__(None, None, None)
        now = time.perf_counter()
        if self.comm.rank == 0 and total > 1 and (now >= self.due or done == total):
            self.due = now + self.interval
            if done == total:
                self.echo(f"100.0 %  {total} runs")
            else:
                share, rest = 100 * done / total, "" if left is None else f", {format_time(left)} left"
                self.echo(f"{share:5.1f} %  run {done + 1} of {total}, {name}{rest}")
        self.last = Progress(self.comm, name)
        return self.last
