"""Run a case from Python as ``valvefsi run`` does, with the messages of the command in one kind of error."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from mpi4py import MPI

from valvefsi.case import Case, load_case, parse_case
from valvefsi.case.build import run_case
from valvefsi.case.overrides import Override, nearest
from valvefsi.case.schedule import beat_period
from valvefsi.cli.progress import Progress
from valvefsi.errors import (
    CaseError,
    SurroundingsError,
    ValvefsiError,
    alone_with_error,
    raise_together,
    reason_of,
)
from valvefsi.post.columns import Units
from valvefsi.scripting.result import Result


def simulate(
    case: str | Path | Mapping[str, Any],
    overrides: Mapping[str, Any] | None = None,
    *,
    out: str | Path | None = None,
    resume: bool = False,
    overwrite: bool = False,
    allow_change: bool = False,
    trust: bool = False,
    progress: bool = True,
    **keys: Any,
) -> Result:
    """Run a case and return what it left, as ``valvefsi run`` does on the command line.

        simulate("case.toml", fluid__viscosity="2 cP", time__t_end="2 s")
        simulate("case.toml", {"fluid.viscosity": "2 cP", "solid.leaflets.kappa": 1e7}, out="results/thick")

    Args:
        case: The case file, or its tables as a dictionary.
        overrides: Values of the case by their paths, as ``--set`` names them. A text may carry a unit, a plain number
            is CGS.
        out: Folder of the results; ``results/NAME`` of the case file when left out.
        resume: Go on from the last checkpoint in the folder.
        overwrite: Replace a run that the folder holds.
        allow_change: With ``resume``: go on though material, step or loads have changed.
        trust: Allow Python files that the case names (materials) to be run.
        progress: Show progress: a bar on a terminal, a line that changes in a notebook.
        keys: The same as ``overrides``, with two underscores for each dot.

    Returns:
        The run: its history, summary, pictures and fields.

    Raises:
        ValvefsiError: Everything that the command would end with, with its message: `CaseError`,
            `StabilityError` and `ConvergenceError` are of this kind, a full disk too.

    Note:
        Collective under mpirun; all ranks return the result, rank 0 shows progress.
    """
    comm = MPI.COMM_WORLD
    with _one_kind_of_error(comm):
        folder = Path(out) if out is not None else _usual_folder(case)
        loaded = _load(case, [*(overrides or {}).items(), *_dotted(keys)], trust)
        options = {"resume": resume, "overwrite": overwrite, "allow_change": allow_change}
        units = Units(system=loaded.output.units, dim=loaded.grid.dim)
        title, period = loaded.title or folder.name, beat_period(loaded)
        with Progress(comm, title, period=period, units=units) as shown:
            run_case(loaded, out=folder, comm=comm, progress=shown if progress else None, **options)
    return Result(folder)


def open_run(folder: str | Path) -> Result:
    """Return a run that is finished, or on its way, from its folder.

    Args:
        folder: The folder of a run.

    Raises:
        CaseError: It holds no run.
    """
    return Result(folder)


def _load(case: str | Path | Mapping[str, Any], overrides: list[Override], trust: bool) -> Case:
    if isinstance(case, Mapping):
        return parse_case(case, overrides, trust=trust)
    return load_case(case, overrides, trust=trust)


def _usual_folder(case: str | Path | Mapping[str, Any]) -> Path:
    if isinstance(case, Mapping):
        raise CaseError("a case without a file needs a folder for its results", key="out")
    return Path("results") / Path(case).stem


def _dotted(keys: Mapping[str, Any]) -> list[Override]:
    """Return paths of keys and values of keywords; refuse one that is neither an option nor a key of a case.

    Raises:
        CaseError: There is no such option.
    """
    options = ["out", "resume", "overwrite", "allow_change", "trust", "progress"]
    for name, value in keys.items():
        if "__" not in name and name not in Case.model_fields:
            known = [*options, *Case.model_fields]
            raise CaseError(f"no such option or key{nearest(name, known)}", key=name, value=value)
    return [(name.replace("__", "."), value) for name, value in keys.items()]


@contextlib.contextmanager
def _one_kind_of_error(comm: MPI.Comm) -> Iterator[None]:
    """Raise what goes wrong as a `ValvefsiError`, on all ranks together; end them where they wait for this one."""
    error: ValvefsiError | None = None
    try:
        yield
    except ValvefsiError as failure:
        error = failure
    except (OSError, MemoryError) as failure:
        error = SurroundingsError(reason_of(failure))
    if error is None and comm.size > 1:
        comm.Ibarrier().Wait()
    elif error is not None and alone_with_error(comm):
        print(f"rank {comm.rank}: {error}", file=sys.stderr, flush=True)
        comm.Abort(1)
    raise_together(comm, error)
