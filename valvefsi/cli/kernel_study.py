"""``valvefsi bench kernels``: which kernel, ratio of mesh to grid, coupling and stabilisation."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valvefsi.cli.option_groups import as_number, options_of, pairs
from valvefsi.cli.options import HELP
from valvefsi.cli.progress import PLAIN_INTERVAL, format_time
from valvefsi.cli.tables import show_result
from valvefsi.errors import CaseError

if TYPE_CHECKING:
    from mpi4py import MPI


kernel_study = typer.Typer(help="The kernel study.", **HELP)


@dataclass(frozen=True, kw_only=True)
class Options:
    """What the study takes."""

    problems: Annotated[str, typer.Option(metavar="P,P", help="Some of compression, cook, shell.")] = (
        "compression,cook,shell"
    )
    kernels: Annotated[str, typer.Option(metavar="K,K|all", help="Kernels, or all.")] = "all"
    ratios: Annotated[str, typer.Option(metavar="R,R", help="Element size over grid spacing.")] = (
        "0.5,0.75,1,1.5,2"
    )
    couplings: Annotated[str, typer.Option(metavar="C,C", help="nodal, elemental, lumped.")] = (
        "nodal,elemental"
    )
    stabilised: Annotated[str, typer.Option(help="on, off or both.")] = "both"
    nu_stab: Annotated[
        float, typer.Option("--nu-stab", help="Numerical Poisson ratio of stabilised runs.")
    ] = 0.4
    grid: Annotated[
        list[str] | None,
        typer.Option("--grid", metavar="PROBLEM=N", help="Cells along the box of a problem. Repeatable."),
    ] = None
    factor: Annotated[
        float, typer.Option(help="How many times the best error a recommended choice may have.")
    ] = 3.0
    overrides: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="PROBLEM.KEY=VALUE", help="Such as cook.t_end='8 s'. Repeatable."),
    ] = None
    out: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Folder of the results.")] = None


@kernel_study.command("kernels")
@options_of(Options)
def kernels(options: Options) -> None:
    """Every kernel at several ratios of mesh to grid, both couplings; goes on where it was interrupted."""
    from mpi4py import MPI

    from valvefsi.benchmarks import kernels as benchmark
    from valvefsi.coupling.kernels import KERNELS

    comm, folder = MPI.COMM_WORLD, options.out or Path("results") / "kernels"
    setup = benchmark.Setup(
        problems=_names(options.problems),
        kernels=tuple(KERNELS) if options.kernels == "all" else _names(options.kernels),
        ratios=tuple(as_number(text, "ratios") for text in _names(options.ratios)),
        couplings=_names(options.couplings),
        stabilised=options.stabilised,
        nu_stab=options.nu_stab,
        grids={name: _cells(name, text) for name, text in pairs(options.grid, "grid").items()},
        factor=options.factor,
        overrides=options.overrides or (),
    )
    show_result(benchmark.run(setup, out=folder, comm=comm, progress=shown(comm)), comm, folder)


def shown(
    comm: MPI.Comm, *, echo: Callable[[str], None] = typer.echo, interval: float = PLAIN_INTERVAL
) -> Callable[[int, int, str, float | None], None]:
    """Return what prints a line every few seconds: runs done, the one that is next, time left (on rank 0)."""
    due = [0.0]

    def show(done: int, total: int, name: str, left: float | None) -> None:
        now = time.perf_counter()
        if comm.rank != 0 or (now < due[0] and done < total):
            return
        due[0] = now + interval
        if done == total:
            echo(f"100.0 %  {total} runs")
        else:
            echo(f"{100 * done / total:5.1f} %  run {done + 1} of {total}, {name}, {format_time(left)} left")

    return show


def _names(text: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))


def _cells(name: str, text: str) -> int:
    if not text.isdigit():
        raise CaseError("expected a whole number", key=f"--grid {name}", value=text)
    return int(text)
