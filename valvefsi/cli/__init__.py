"""The commands: run a case or a sweep, print the keys of case files, compare runs and records, run benchmarks.

Exit codes: 0 done, 2 a case or an option cannot be used, 3 the run failed (ConvergenceError, StabilityError) or members
did (StudyError), 4 the surroundings failed (disk, folder, memory), 130 interrupted, 143 terminated (while libraries are
imported too), 1 a fault of the program itself.
In a parallel run rank 0 speaks for all. What computes is imported by the command that needs it, so that ``--help``
is quick.
"""

from __future__ import annotations

import os
import sys
import time
import traceback
import warnings
from pathlib import Path
from types import TracebackType
from typing import Annotated, Any, NoReturn

import typer

from valvefsi import __version__
from valvefsi.cli.bench import bench
from valvefsi.cli.compare import compare
from valvefsi.cli.doctor import doctor
from valvefsi.cli.fit import fit
from valvefsi.cli.mesh import mesh
from valvefsi.cli.movie import movie
from valvefsi.cli.new import new
from valvefsi.cli.numbers import numbers
from valvefsi.cli.options import HELP
from valvefsi.cli.plot import plot
from valvefsi.cli.report import report
from valvefsi.cli.run import case, run
from valvefsi.cli.sample import sample
from valvefsi.cli.sweep import sweep
from valvefsi.cli.target import target
from valvefsi.cli.validate import validate
from valvefsi.cli.verify import verify
from valvefsi.cli.watch import watch
from valvefsi.errors import (
    CaseError,
    Stopped,
    SurroundingsError,
    ValvefsiError,
    alone_with_error,
    reason_of,
)
from valvefsi.runtime.surroundings import launched_rank

GRACE = 0.5
INTERRUPTED = 130

# typer uses click, or brings its own copy of it, depending on the release.
USAGE_ERROR: Any = next(kind for kind in typer.BadParameter.__mro__ if kind.__name__ == "ClickException")

app = typer.Typer(
    help="Heart-valve mechanics from bench data to a verified simulation.",
    epilog="In parallel: mpirun -n 2 valvefsi run CASE.toml",
    pretty_exceptions_enable=False,
    **HELP,
)
app.command()(new)
app.command()(run)
app.command()(sweep)
app.command()(case)
app.command()(plot)
app.command()(movie)
app.command()(compare)
app.command()(numbers)
app.command()(target)
app.command()(report)
app.command()(watch)
app.command()(doctor)
app.command()(validate)
app.command()(verify)
app.command()(sample)
app.add_typer(bench, name="bench")
app.add_typer(fit, name="fit")
app.add_typer(mesh, name="mesh")


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version.", is_eager=True)] = False,
) -> None:
    if version:
        typer.echo(f"valvefsi {__version__}")
        raise typer.Exit


def _one_line(message: Warning | str, *_: Any, **__: Any) -> str:
    """Return a warning as a user reads it, without the place in the code that gave it."""
    return f"warning: {message}\n"


def main() -> NoReturn:
    """Run the command line and leave with its exit code."""
    if _launched_rank() > 0:
        sys.stdout = Path(os.devnull).open("w")  # noqa: SIM115 - open until the process ends
    warnings.formatwarning = _one_line
    code = 0
    try:
        code = app(standalone_mode=False, prog_name="valvefsi") or 0
        if code == INTERRUPTED:  # some releases of typer turn Ctrl-C into this code, others raise Abort
            raise typer.Abort
    except Stopped as stop:
        code = 128 + stop.signal
        _leave_together(str(stop), code)
    except CaseError as error:
        code = 2
        _leave_together(f"error: {error}", code)
    except (SurroundingsError, OSError, MemoryError) as error:
        code = 4
        said = str(error) if isinstance(error, SurroundingsError) else reason_of(error)
        _leave_together(f"error: {said}", code)
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
    """Return this process' rank without starting MPI."""
    mpi = sys.modules.get("mpi4py.MPI")
    return launched_rank() if mpi is None else mpi.COMM_WORLD.rank


def _leave_together(message: str, code: int) -> None:
    """Say why on rank 0 when all ranks leave for the same reason; when one leaves alone, end the others."""
    mpi = sys.modules.get("mpi4py.MPI")
    comm: Any = mpi.COMM_WORLD if mpi is not None else None
    alone = comm is not None and alone_with_error(comm)
    if alone or _launched_rank() == 0:
        print(f"rank {comm.rank}: {message}" if alone else message, file=sys.stderr, flush=True)
    if alone:
        time.sleep(GRACE)  # so that the launcher has passed the message on
        comm.Abort(code)


def _abort_all(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Print a traceback and end all ranks: one that fails alone would leave the others waiting."""
    sys.stderr.write("".join(traceback.format_exception(kind, error, trace)))
    sys.stderr.flush()
    mpi = sys.modules.get("mpi4py.MPI")
    if mpi is not None and mpi.COMM_WORLD.size > 1:
        time.sleep(GRACE)  # so that the launcher has passed on what this rank and others had to say
        mpi.COMM_WORLD.Abort(1)
