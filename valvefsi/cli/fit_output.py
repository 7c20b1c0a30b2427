"""What the commands of ``fit`` share: options that are read alike, progress, the table on the terminal."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from valvefsi.cli.option_groups import as_number, pairs
from valvefsi.cli.tables import print_fit, terminal

if TYPE_CHECKING:
    from rich.console import Console

    from valvefsi.fitting.least_squares import Notify
    from valvefsi.fitting.report import Report

Texts = list[str] | None
QUIET = 5.0
"""Time between two lines of progress where there is no terminal [s]."""


def console() -> Console:
    """Return the terminal, or a wide page where there is none."""
    return terminal()


@contextlib.contextmanager
def progress(title: str) -> Iterator[Notify]:
    """Show what is being done from the first moment: bars on a terminal, else a line every few seconds."""
    place = console()
    if not place.is_terminal:
        typer.echo(title)
        due = time.perf_counter() + QUIET

        def line(what: str, number: int, count: int) -> None:
            nonlocal due
            if time.perf_counter() >= due:
                typer.echo(f"{what}: {number} of {count}")
                due = time.perf_counter() + QUIET

        yield line
        return
    from rich.progress import Progress, TaskID

    with Progress(console=place, transient=True) as bars:
        tasks: dict[str, TaskID] = {title: bars.add_task(title, total=None)}

        def bar(what: str, number: int, count: int) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(what, total=count)
            bars.update(tasks[what], completed=number, total=count)

        yield bar


def show(report: Report, folder: Path | None = None) -> None:
    """Print notes, the table of a fit and what belongs to it."""
    place = () if folder is None else (f"results in {folder}",)
    print_fit(console(), report, (*report.lines(), *place))


def numbers(texts: Texts, option: str) -> dict[str, float]:
    """Return ``K=V`` texts as numbers by name."""
    return {name: as_number(text, option) for name, text in pairs(texts, option).items()}


def ranges(texts: Texts, option: str) -> dict[str, tuple[float, float]]:
    """Return ``K=A:B`` texts as pairs of numbers by name."""
    ends = {}
    for name, text in pairs(texts, option).items():
        low, colon, high = text.partition(":")
        if not colon:
            raise typer.BadParameter(f"expected K=A:B, found {text!r}", param_hint=f"--{option}")
        ends[name] = (as_number(low, option), as_number(high, option))
    return ends


def names(text: str | None) -> Sequence[str] | None:
    """Return what stands between commas, None for nothing."""
    return None if text is None else [name.strip() for name in text.split(",") if name.strip()]
