"""``valvefsi bench torsion``, ``cook``, ...: immersed benchmarks against closed forms and incompressible statics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valvefsi.cli.option_groups import options_of
from valvefsi.cli.options import HELP, Out, Set
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
    ratio: Annotated[float, typer.Option(min=0.1, max=4.0, help="Element size over grid spacing.")] = 0.5
    nu_stab: Annotated[
        float, typer.Option("--nu-stab", help="Numerical Poisson ratio of stabilised runs.")
    ] = 0.4
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


Kernels = Annotated[str, typer.Option("--kernels", metavar="K,K|all", help="Kernels, or all.")]
Refine = Annotated[int, typer.Option("--refine", min=0, max=4, help="Number of finer grids.")]
Grid = Annotated[int, typer.Option("--grid", min=8, help="Cells along each edge of the box.")]
Elements = Annotated[
    int | None, typer.Option("--elements", min=1, help="Elements along the edge of each block of the body.")
]
Steps = Annotated[int | None, typer.Option("--steps", min=3, help="Number of steps.")]
CouplingName = Annotated[str, typer.Option("--coupling", help="nodal, elemental or lumped.")]


def _chosen(text: str) -> tuple[str, ...]:
    """Return the kernels asked for."""
    from valvefsi.coupling.kernels import KERNELS

    names = tuple(KERNELS) if text == "all" else tuple(part.strip() for part in text.split(","))
    for name in names:
        if name not in KERNELS:
            raise CaseError(f"a kernel is one of {', '.join(KERNELS)}", key="--kernels", value=name)
    return names


@immersed.command("shell")
def shell(
    grid: Grid = 32,
    refine: Refine = 2,
    kernels: Kernels = "bspline3",
    couplings: Annotated[
        str, typer.Option("--couplings", help="nodal, elemental, lumped; several.")
    ] = "nodal",
    overrides: Set = None,
    out: Out = None,
) -> None:
    """A thick shell and a closed membrane at rest: pressure and spurious velocity against closed forms."""
    from mpi4py import MPI

    from valvefsi.benchmarks import shell as benchmark

    comm, folder = MPI.COMM_WORLD, out or Path("results") / "shell"
    setup = benchmark.Setup(
        grid=grid,
        refine=refine,
        kernels=_chosen(kernels),
        couplings=tuple(part.strip() for part in couplings.split(",")),
        overrides=overrides or (),
    )
    show_result(benchmark.run(setup, out=folder, comm=comm), comm, folder)


@immersed.command("sphere-in-cavity")
def sphere_in_cavity(
    grid: Grid = 64,
    elements: Elements = 16,
    steps: Steps = 60,
    kernel: Annotated[str, typer.Option(help="Kernel of the coupling.")] = "ib4",
    coupling: CouplingName = "nodal",
    overrides: Set = None,
    out: Out = None,
) -> None:
    """A soft sphere in a lid-driven cavity: volume kept, and the speed of a coupled step."""
    _cavity(3, {"elements": elements, "steps": steps}, (grid, kernel, coupling), overrides, out)


@immersed.command("disk-in-cavity")
def disk_in_cavity(
    grid: Grid = 32,
    refine: Refine = 2,
    t_end: Annotated[float, typer.Option("--t-end", min=0.01, help="End of the run [s].")] = 10.0,
    kernel: Annotated[str, typer.Option(help="Kernel of the coupling.")] = "ib4",
    coupling: CouplingName = "nodal",
    ratio: Annotated[float, typer.Option(min=0.1, help="Size of the disk's elements over h.")] = 0.5,
    overrides: Set = None,
    out: Out = None,
) -> None:
    """A soft disk in a lid-driven cavity: path and area, on several grids; where its nodes are drawn apart it leaks."""
    more = {"steps": None, "t_end": t_end, "refine": refine}
    _cavity(2, more, (grid, kernel, coupling), overrides, out, ratio=ratio)


def _cavity(
    dim: int,
    more: dict[str, object],
    chosen: tuple[int, str, str],
    overrides: list[str] | None,
    out: Path | None,
    ratio: float = 1.0,
) -> None:
    from mpi4py import MPI

    from valvefsi.benchmarks import cavity_solids as benchmark
    from valvefsi.benchmarks.immersed import Numerics

    grid, kernel, coupling = chosen
    comm = MPI.COMM_WORLD
    chosen = {"kernel": _chosen(kernel)[0], "coupling": coupling}
    numerics = Numerics(grid=grid, ratio=ratio, nu_stab=None, **chosen)
    setup = benchmark.Setup(numerics=numerics, dim=dim, overrides=overrides or (), **more)
    folder = out or Path("results") / setup.name
    show_result(benchmark.run(setup, out=folder, comm=comm, progress=shown(comm)), comm, folder)
