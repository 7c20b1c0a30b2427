"""``valvefsi bench``: published benchmarks and the speed of this machine."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valvefsi.benchmarks.registry import ENTRIES
from valvefsi.cli.bench_command import add
from valvefsi.cli.option_groups import options_of
from valvefsi.cli.options import HELP, Out, Plan, Resume, Set
from valvefsi.cli.progress import Progress
from valvefsi.cli.tables import show_result
from valvefsi.errors import CaseError

if TYPE_CHECKING:
    from mpi4py import MPI

bench = typer.Typer(help="Run a published benchmark and compare.", **HELP)
for _entry in ENTRIES:
    add(bench, _entry)


@dataclass(frozen=True)
class Compression:
    """Options of ``bench compression``."""

    elements: Annotated[
        int | None,
        typer.Option(min=2, help="Elements along the block's 20 cm; 32, a series: as many as cells."),
    ] = None
    grid: Annotated[
        int | None, typer.Option(min=4, help="Cells along each edge of the box; 64, a series: 16 and finer.")
    ] = None
    kernel: Annotated[str, typer.Option(help="Kernel of the coupling.")] = "bspline3"
    nu_stab: Annotated[
        str,
        typer.Option("--nu-stab", metavar="V|off", help="Numerical Poisson ratio of the volumetric term."),
    ] = "0.4"
    refine: Annotated[
        int, typer.Option(min=0, max=4, help="Number of finer grids: a series, stabilised and not.")
    ] = 0
    overrides: Set = None
    out: Out = None
    plan: Plan = False
    resume: Resume = False


@bench.command()
@options_of(Compression)
def compression(given: Compression) -> None:
    """Benchmark E.1: a block compressed by a load, immersed, against the incompressible statics."""
    from mpi4py import MPI

    from valvefsi.benchmarks import compression as benchmark

    comm, out, plan = MPI.COMM_WORLD, given.out, given.plan
    numbers = {"elements": given.elements, "grid": given.grid, "kernel": given.kernel}
    numbers |= {"nu_stab": _nu_stab(given.nu_stab), "overrides": given.overrides or ()}
    if given.refine:
        if plan:
            raise CaseError("a plan is of one run", key="--plan", value="--refine")
        _compression_series(numbers | {"refine": given.refine}, out, comm)
        return
    numbers |= {"elements": given.elements or 32, "grid": given.grid or 64}
    name = "compression-M{elements}-N{grid}-{kernel}".format_map(numbers)
    folder = out if out is not None else Path("results") / f"{name}-{given.nu_stab}"
    with Progress(comm, "compressed block") as progress:
        result = benchmark.run(
            benchmark.Setup(**numbers),
            out=folder,
            plan=plan,
            resume=given.resume,
            comm=comm,
            progress=progress,
        )
    show_result(result, comm, None if plan else folder)


def _compression_series(numbers: dict[str, object], out: Path | None, comm: MPI.Comm) -> None:
    """Run the block on several grids; runs that the folder holds already are not run again."""
    from valvefsi.benchmarks import compression_study as benchmark
    from valvefsi.cli.immersed import shown

    folder = out or Path("results") / "compression-series"
    result = benchmark.run(benchmark.Series(**numbers), out=folder, comm=comm, progress=shown(comm))
    show_result(result, comm, folder)


@bench.command()
def speed(
    size: Annotated[
        str, typer.Option("--sizes", metavar="N,N", help="Cells per edge, one or several.")
    ] = "64,128",
    dim: Annotated[int, typer.Option(min=2, max=3, help="Dimensions.")] = 3,
    steps: Annotated[int, typer.Option(min=1, help="Steps that are timed.")] = 5,
    model: Annotated[bool, typer.Option("--model", help="Predict steps on many cores too.")] = False,
    overrides: Set = None,
    out: Out = None,
) -> None:
    """Time a step of the fluid against a pair of cosine transforms of the same grid."""
    from mpi4py import MPI

    from valvefsi.benchmarks import speed as benchmark

    if not all(part.strip().isdigit() and int(part) >= 4 for part in size.split(",")):
        raise CaseError("expected whole numbers of at least 4, such as 64,128", key="--sizes", value=size)
    sizes = [int(part) for part in size.split(",")]
    comm, folder = MPI.COMM_WORLD, out if out is not None else Path("results") / "speed"
    if model and dim == 2:
        raise CaseError("the cost model is of three dimensions", key="--model", value="--dim 2")
    result = benchmark.run(
        sizes=sizes, dim=dim, steps=steps, out=folder, overrides=overrides or [], comm=comm, model=model
    )
    show_result(result, comm, folder)


def _nu_stab(text: str) -> float | None:
    try:
        value = None if text == "off" else float(text)
    except ValueError:
        value = float("nan")
    if value is not None and not -1 < value < 0.5:
        raise CaseError('expected a number above -1 and below 0.5, or "off"', key="--nu-stab", value=text)
    return value
