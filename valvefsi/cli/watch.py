"""``valvefsi watch``, and the page that ``valvefsi run --view`` serves."""

from __future__ import annotations

import contextlib
import os
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
NICE = 5
"""How much lower than that of a run the priority of its page is."""


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
    if with_run:
        _with_run(folder, trust=trust)
        return
    from mpi4py import MPI

    if MPI.COMM_WORLD.rank != 0:
        return
    from valvefsi.report.writing import check_libraries

    check_libraries()
    from valvefsi.report.serving import PageServer

    with PageServer(folder, trust=trust) as server:
        view = server.run.view()
        typer.echo(view.line)
        if view.state == "finished":
            return
        threading.Thread(target=server.serve_forever, daemon=True).start()
        typer.echo(server.address)
        _follow(server.run, view.state)


def _with_run(folder: Path, *, trust: bool) -> None:
    """Serve the page until standard input ends, behind the run: what is loaded is loaded when a browser asks."""
    from valvefsi.report.serving import PageServer

    os.nice(NICE)
    with PageServer(folder, trust=trust) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        typer.echo(server.address)
        sys.stdin.read()
        server.linger()


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
    """Serve the page on a run as long as this lasts, from a process of its own at a lower priority.

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
