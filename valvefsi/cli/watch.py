"""``valvefsi watch``, and the page that ``valvefsi run --view`` serves."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valvefsi.cli.options import Trust
from valvefsi.runtime.surroundings import without_launcher

if TYPE_CHECKING:
    from mpi4py import MPI

    from valvefsi.report.live import LiveRun

PATIENCE = 10.0
"""Longest time that a run waits for its page to end [s]."""


def watch(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="The folder of a run, which need not have begun.")
    ],
    trust: Trust = False,
    with_run: Annotated[
        bool, typer.Option("--with-run", hidden=True, help="End when standard input ends, as a run does.")
    ] = False,
) -> None:
    """Serve a page on a run that goes on: progress, curves, newest frame, warnings, and a button that stops it.

    The page is for this machine alone, under an address that is printed and cannot be guessed. It reads what the run
    writes, from any process and on any number of ranks. Ctrl-C ends the page, not the run.
    """
    from mpi4py import MPI

    if MPI.COMM_WORLD.rank != 0:
        return
    from valvefsi.report.writing import check_libraries

    check_libraries()
    from valvefsi.report.live import LiveRun
    from valvefsi.report.serving import PageServer

    run = LiveRun(folder, trust=trust)
    view = run.view()
    if not with_run:
        typer.echo(view.line)
        if view.state == "finished":
            return
    with PageServer(run) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        typer.echo(server.address)
        if with_run:
            sys.stdin.read()
            server.linger()
        else:
            _follow(run, view.state)


def _follow(run: LiveRun, state: str) -> None:
    """Say when the state of a run changes, until Ctrl-C."""
    from valvefsi.report.serving import PERIOD_S

    typer.echo("Ctrl-C ends the page, not the run", err=True)
    with contextlib.suppress(KeyboardInterrupt):
        while True:
            time.sleep(PERIOD_S)
            view = run.view()
            if view.state != state:
                state = view.state
                typer.echo(view.line)


@contextlib.contextmanager
def served(folder: Path, comm: MPI.Comm, *, trust: bool) -> Iterator[None]:
    """Serve the page on a run as long as this lasts, from a process of its own.

    Args:
        folder: Folder of the run.
        comm: Communicator of the run; rank 0 starts the process.
        trust: Whether Python files of materials may be run.

    Raises:
        SurroundingsError: A library that a page needs is missing.
    """
    from valvefsi.report.writing import check_libraries

    check_libraries()
    if comm.rank != 0:
        yield
        return
    words = [sys.executable, "-m", "valvefsi", "watch", str(folder), "--with-run", *["--trust"] * trust]
    with subprocess.Popen(
        words,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=without_launcher(),
        start_new_session=True,  # Ctrl-C is for the run
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            line = process.stdout.readline().strip()
            if line:
                typer.echo(f"the run can be watched at {line}")
            else:
                warnings.warn(
                    "the page of --view could not be served, the run goes on without it", stacklevel=2
                )
            yield
        finally:
            process.stdin.close()
            try:
                process.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
