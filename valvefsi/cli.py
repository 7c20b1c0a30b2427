"""The commands: run a case, print the keys of case files, run benchmarks.

Exit codes: 0 done, 2 a case or an option cannot be used, 3 the run failed (ConvergenceError, StabilityError),
130 interrupted, 143 terminated, 1 anything else. In a parallel run rank 0 speaks for all. What computes is
imported by the command that needs it, so that ``--help`` is quick.
"""

from __future__ import annotations

import os
import sys
import time
import traceback
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from valvefsi import __version__
from valvefsi.errors import CaseError, Stopped, ValvefsiError

if TYPE_CHECKING:
    from mpi4py import MPI
    from rich.console import Console

PLAIN_INTERVAL, LIVE_INTERVAL = 5.0, 0.1
PATIENCE, GRACE = 5.0, 0.5
WIDE, SHOWN, INTERRUPTED = 120, 3, 130
RANK_VARIABLES = ("PMI_RANK", "OMPI_COMM_WORLD_RANK", "PMIX_RANK", "MPI_RANKID")
OPTIONS = {"no_args_is_help": True, "context_settings": {"help_option_names": ["-h", "--help"]}}

# typer uses click, or brings its own copy of it, depending on the release.
USAGE_ERROR = next(kind for kind in typer.BadParameter.__mro__ if kind.__name__ == "ClickException")

app = typer.Typer(
    help="Heart-valve mechanics from bench data to a verified simulation.",
    epilog="In parallel: mpirun -n 2 valvefsi run CASE.toml",
    add_completion=False,
    pretty_exceptions_enable=False,
    **OPTIONS,
)
bench = typer.Typer(help="Run a published benchmark and compare.", **OPTIONS)
app.add_typer(bench, name="bench")

Out = Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Folder of the results.")]
Resume = Annotated[bool, typer.Option("--resume", help="Go on from the last checkpoint in the folder.")]
Plan = Annotated[bool, typer.Option("--plan", help="Print size, step limits and expected time; do not run.")]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Set a value, such as time.t_end='2 s'. Repeatable."),
]


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version.", is_eager=True)] = False,
) -> None:
    if version:
        typer.echo(f"valvefsi {__version__}")
        raise typer.Exit


@app.command()
def run(
    case: Annotated[Path, typer.Argument(metavar="CASE.toml", help="The case file.")],
    out: Out = None,
    resume: Resume = False,
    overrides: Set = None,
    plan: Plan = False,
) -> None:
    """Run a case; the results go to results/NAME of the case file unless --out says otherwise."""
    from mpi4py import MPI

    from valvefsi.case import load_case

    loaded = load_case(case, overrides or [])
    from valvefsi.case.build import plan_case, run_case

    comm = MPI.COMM_WORLD
    if plan:
        show_result(plan_case(loaded, comm), comm)
        return
    folder = out if out is not None else Path("results") / case.stem
    with Progress(comm, loaded.title or case.stem) as progress:
        result = run_case(loaded, out=folder, resume=resume, comm=comm, progress=progress)
    show_result(result, comm, folder)


@app.command()
def case(
    defaults: Annotated[
        bool, typer.Option("--defaults", help="A whole case with every key, as TOML.")
    ] = False,
    schema: Annotated[bool, typer.Option("--schema", help="The JSON schema of case files.")] = False,
) -> None:
    """Print what a case file may hold."""
    if defaults == schema:
        raise CaseError("expected one of --defaults and --schema", file="valvefsi case")
    import json

    from valvefsi.case import case_defaults, case_schema

    typer.echo(case_defaults() if defaults else json.dumps(case_schema(), indent=2), nl=schema)


@bench.command()
def compression(
    elements: Annotated[int, typer.Option(min=2, help="Elements along the block's 20 cm.")] = 32,
    grid: Annotated[int, typer.Option(min=4, help="Cells along each edge of the box.")] = 64,
    kernel: Annotated[str, typer.Option(help="Kernel of the coupling.")] = "bspline3",
    nu_stab: Annotated[
        str,
        typer.Option("--nu-stab", metavar="V|off", help="Numerical Poisson ratio of the volumetric term."),
    ] = "0.4",
    overrides: Set = None,
    out: Out = None,
    plan: Plan = False,
    resume: Resume = False,
) -> None:
    """Benchmark E.1: a block compressed by a load, immersed, against the incompressible statics."""
    from mpi4py import MPI

    from valvefsi.benchmarks import compression as benchmark

    comm = MPI.COMM_WORLD
    folder = (
        out if out is not None else Path("results") / f"compression-M{elements}-N{grid}-{kernel}-{nu_stab}"
    )
    with Progress(comm, "compressed block") as progress:
        setup = benchmark.Setup(
            elements=elements,
            grid=grid,
            kernel=kernel,
            nu_stab=_nu_stab(nu_stab),
            overrides=overrides or (),
        )
        result = benchmark.run(
            setup,
            out=folder,
            plan=plan,
            resume=resume,
            comm=comm,
            progress=progress,
        )
    show_result(result, comm, None if plan else folder)


@bench.command()
def speed(
    size: Annotated[
        str, typer.Option("--sizes", metavar="N,N", help="Cells per edge, one or several.")
    ] = "64,128",
    dim: Annotated[int, typer.Option(min=2, max=3, help="Dimensions.")] = 3,
    steps: Annotated[int, typer.Option(min=1, help="Steps that are timed.")] = 5,
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
    result = benchmark.run(
        sizes=sizes, dim=dim, steps=steps, out=folder, overrides=overrides or [], comm=comm
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


class Progress:
    """Shows steps, simulated time and time left; a simulation calls it after every step.

    On a terminal a bar, elsewhere (a file, mpirun) a plain line every few seconds, on rank 0.

    Args:
        comm: Communicator of the run.
        title: What is being run.
        console: Where to, standard output if left out.
    """

    def __init__(self, comm: MPI.Comm, title: str, console: Console | None = None) -> None:
        self.comm, self.title, self.console = comm, title, console
        self.live = self.task = self.first = None
        self.due = 0.0

    def __enter__(self) -> Progress:
        """Return itself; nothing is shown before the first step."""
        return self

    def __exit__(self, *error: object) -> None:
        """Take the bar away from the cursor."""
        if self.live is not None:
            self.live.stop()

    def __call__(self, step: int, t: float, t_end: float, info: Mapping[str, object] | None = None) -> None:
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
        if self.first is None:
            self.first = (now, t, step)
            self._open()
        elif now < self.due and t < t_end:
            return
        self.due = now + (PLAIN_INTERVAL if self.live is None else LIVE_INTERVAL)
        wall, simulated = now - self.first[0], t - self.first[1]
        left = wall * (t_end - t) / simulated if simulated > 0 else None
        share = t / t_end if t_end > 0 else 1.0
        numbers = f"t = {t:.4g} of {t_end:g} s, step {step}"
        more = "".join(f", {name} {_number(value)}" for name, value in _newest(info or {}))
        if self.live is not None:
            self.live.update(self.task, completed=share, text=f"{numbers}{more}", left=format_time(left))
        elif left is not None or share >= 1:
            end = f"{format_time(left)} left" if share < 1 else f"done in {format_time(wall)}"
            self.console.print(
                f"{100 * share:5.1f} %  {numbers}{more}, {end}", highlight=False, soft_wrap=True
            )
            self.console.file.flush()

    def _open(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, TaskProgressColumn, TextColumn
        from rich.progress import Progress as Bars

        self.console = self.console or Console()
        if not self.console.is_terminal:
            return
        title, text, left = (
            TextColumn(style)
            for style in ("[bold]{task.description}", "{task.fields[text]}", "[cyan]{task.fields[left]} left")
        )
        self.live = Bars(title, BarColumn(), TaskProgressColumn(), text, left, console=self.console)
        self.task = self.live.add_task(self.title, total=1.0, text="", left="...")
        self.live.start()


def _newest(info: Mapping[str, object]) -> list[tuple[str, object]]:
    """Return the first few columns of a row of the history after step and time."""
    return [(name, value) for name, value in info.items() if name not in ("step", "t_s")][:SHOWN]


def format_time(seconds: float | None) -> str:
    """Return a duration as people say it."""
    if seconds is None:
        return "unknown time"
    if seconds < 10:
        return f"{seconds:.1f} s"
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes, seconds = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {seconds:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"


def show_result(result: Mapping[str, Any], comm: MPI.Comm, folder: Path | None = None) -> None:
    """Print a result on rank 0: its plan or its table of what is compared, else everything by name."""
    if comm.rank != 0 or not result:
        return
    from rich.console import Console

    console = Console(width=None if sys.stdout.isatty() else WIDE)
    rest = {"timing": result.get("timing", {})}
    if "plan" in result:
        rows = [(e.quantity, _number(e.value), e.unit, e.note) for e in result["plan"]]
        _print_table(
            console, "plan", {"quantity": "left", "value": "right", "unit": "left", "": "left"}, rows
        )
    elif "table" in result:
        rows = [_compared(row) for row in result["table"]]
        headings = {"quantity": "left", "computed": "right", "reference": "right", "difference": "right"}
        _print_table(
            console, str(result.get("benchmark", "result")), {**headings, "unit": "left", "": "left"}, rows
        )
    else:
        rest = result
    for name, value in _flat(rest):
        if ".phases." not in f".{name}":
            console.print(f"{name}: {value}", highlight=False, soft_wrap=True, markup=False)
    if folder is not None:
        console.print(f"results in {folder}", highlight=False, soft_wrap=True, markup=False)


def _compared(row: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the cells of one line of a benchmark's table."""
    difference, reference = row.get("difference_percent"), row.get("reference")
    known = "" if reference is None else _number(reference)
    shown = "" if difference is None else f"{difference:+.2f} %"
    return row["quantity"], _number(row["computed"]), known, shown, row.get("unit", ""), row.get("source", "")


def _print_table(
    console: Console, title: str, columns: Mapping[str, str], rows: list[tuple[str, ...]]
) -> None:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD)
    for heading, side in columns.items():
        table.add_column(heading, justify=side)
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    console.print(table)


def _flat(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    lines = []
    for name, value in values.items():
        key = f"{prefix}{name}"
        lines += _flat(value, f"{key}.") if isinstance(value, Mapping) else [(key, _number(value))]
    return lines


def _number(value: object) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def main() -> NoReturn:
    """Run the command line and leave with its exit code."""
    if _launched_rank() > 0:
        sys.stdout = Path(os.devnull).open("w")  # noqa: SIM115 - open until the process ends
    code = 0
    try:
        code = app(standalone_mode=False) or 0
        if code == INTERRUPTED:  # some releases of typer turn Ctrl-C into this code, others raise Abort
            raise typer.Abort
    except Stopped as stop:
        code = 128 + stop.signal
        _leave_together(str(stop), code)
    except CaseError as error:
        code = 2
        _leave_together(f"error: {error}", code)
    except ValvefsiError as error:
        code = 3
        _leave_together(f"{type(error).__name__}: {error}", code)
    except USAGE_ERROR as error:
        code = error.exit_code
        if _launched_rank() == 0:
            error.show()
    except (KeyboardInterrupt, typer.Abort):
        code = INTERRUPTED
        _leave_together("interrupted", code)
    except Exception:
        sys.excepthook = _abort_all  # here, because typer sets its own
        raise
    sys.exit(code)


def _launched_rank() -> int:
    """Return this process' rank without starting MPI, from what the launcher says."""
    mpi = sys.modules.get("mpi4py.MPI")
    if mpi is not None:
        return mpi.COMM_WORLD.rank
    values = (os.environ.get(name, "") for name in RANK_VARIABLES)
    return next((int(value) for value in values if value.isdigit()), 0)


def _leave_together(message: str, code: int) -> None:
    """Say why on rank 0 when all ranks leave for the same reason; when one leaves alone, end the others."""
    mpi = sys.modules.get("mpi4py.MPI")
    comm = mpi.COMM_WORLD if mpi is not None else None
    alone = False
    if comm is not None and comm.size > 1:
        request, end = comm.Ibarrier(), time.monotonic() + PATIENCE
        while not (done := request.Test()) and time.monotonic() < end:
            time.sleep(0.01)
        alone = not done
    if alone or _launched_rank() == 0:
        print(f"rank {comm.rank}: {message}" if alone else message, file=sys.stderr, flush=True)
    if alone:
        comm.Abort(code)


def _abort_all(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Print a traceback and end all ranks: one that fails alone would leave the others waiting."""
    sys.stderr.write("".join(traceback.format_exception(kind, error, trace)))
    sys.stderr.flush()
    mpi = sys.modules.get("mpi4py.MPI")
    if mpi is not None and mpi.COMM_WORLD.size > 1:
        time.sleep(GRACE)  # so that the launcher has passed on what this rank and others had to say
        mpi.COMM_WORLD.Abort(1)
