"""``valvefsi bench torsion``, ``cook``, ...: immersed benchmarks against closed forms and incompressible statics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valvefsi.cli.option_groups import options_of
from valvefsi.cli.options import HELP
from valvefsi.cli.progress import Progress
from valvefsi.cli.tables import show_result
from valvefsi.errors import CaseError

if TYPE_CHECKING:
    from mpi4py import MPI

immersed = typer.Typer(help="Immersed benchmarks.", **HELP)


@dataclass(frozen=True, kw_only=True)
class Options:
    """What the grid studies share."""

    grid: Annotated[
        int | None, typer.Option("--grid", min=4, help="Cells along the box (torsion: along its width).")
    ] = None
    kernel: Annotated[str, typer.Option(help="Kernel of the coupling.")] = "bspline3"
    coupling: Annotated[str, typer.Option(help="nodal, elemental or lumped.")] = "nodal"
    ratio: Annotated[float, typer.Option(min=0.1, max=4.0, help="Element size over grid spacing.")] = 1.0
    nu_stab: Annotated[float, typer.Option("--nu-stab", help="Numerical Poisson ratio of stabilised runs.")] = (
        0.4
    )
    stabilised: Annotated[str, typer.Option(help="on, off or both.")] = "both"
    refine: Annotated[int, typer.Option(min=0, help="Number of finer grids; gives the observed order.")] = 0
    overrides: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Set a parameter, such as t_end='2 s'. Repeatable."),
    ] = None
    out: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Folder of the results.")] = None


def shown(comm: MPI.Comm) -> Callable[[str], Callable]:
    """Return what makes the progress of each run of a series from its name."""
    last: list[Progress] = []

    def start(name: str) -> Progress:
        if last:
            last.pop().__exit__(None, None, None)
        if comm.rank == 0:
            typer.echo(name)
        last.append(Progress(comm, name))
        return last[0]

    return start


def _study(name: str, options: Options, grid: int, grids: tuple[float, ...]) -> None:
    import importlib

    from mpi4py import MPI

    from valvefsi.benchmarks.immersed import Numerics
    from valvefsi.benchmarks.immersed_study import Setup
    from valvefsi.coupling.kernels import KERNELS

    comm = MPI.COMM_WORLD
    if options.kernel not in KERNELS:
        raise CaseError(f"a kernel is one of {', '.join(KERNELS)}", key="--kernel", value=options.kernel)
    if not -1.0 < options.nu_stab < 0.5:
        raise CaseError("expected above -1 and below 0.5", key="--nu-stab", value=options.nu_stab)
    numerics = Numerics(
        grid=options.grid or grid,
        ratio=options.ratio,
        kernel=options.kernel,
        coupling=options.coupling,
        nu_stab=options.nu_stab,
    )
    setup = Setup(
        numerics=numerics,
        stabilised=options.stabilised,
        refine=options.refine,
        overrides=options.overrides or (),
        grids=grids,
    )
    folder = options.out or Path("results") / name
    benchmark = importlib.import_module(f"valvefsi.benchmarks.{name}")
    show_result(benchmark.run(setup, out=folder, comm=comm, progress=shown(comm)), comm, folder)


@immersed.command("torsion")
@options_of(Options)
def torsion(options: Options) -> None:
    """Benchmark E.2: torsion of a column, immersed; finer grids are 1.5, 2, 3 and 4 times the first."""
    _study("torsion", options, 12, (1.0, 1.5, 2.0, 3.0, 4.0))


@immersed.command("cook")
@options_of(Options)
def cook(options: Options) -> None:
    """Cook's membrane, immersed, against the incompressible statics of the same run."""
    _study("cook", options, 25, (1.0, 2.0, 4.0, 8.0))
