"""The errors that valvefsi raises on purpose.

Every one of them says what was found, where, and what to try. In a parallel run they are raised on all ranks
together, see `raise_together`.
"""

from __future__ import annotations

import errno
import os
import re
import time
from typing import TYPE_CHECKING, TypeVar, cast

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from mpi4py import MPI


Made = TypeVar("Made")
PATIENCE = 5.0
"""Longest time that a rank with an error waits for the others to come with theirs [s]."""
CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]+")
LONGEST = 200


class ValvefsiError(Exception):
    """Base of all errors that valvefsi raises on purpose."""


class CaseError(ValvefsiError, ValueError):
    """A case, a mesh or an option holds a value that cannot be used.

    The message is one line, ``file: key = value: what is wrong``, with the parts that are known.
    """

    def __init__(
        self, message: str, *, file: Path | str | None = None, key: str | None = None, value: object = None
    ) -> None:
        self.file, self.key, self.value, self.reason = file, key, value, message
        place = "" if key is None else (key if value is None else f"{key} = {_short(value)}")
        text = ": ".join(str(part) for part in (file, place, message) if part)
        text = CONTROL.sub(" ", text)
        super().__init__(text if len(text) <= 10 * LONGEST else f"{text[: 10 * LONGEST]} ...")


def _short(value: object) -> str:
    """Return a value as Python writes it, cut where it is long."""
    try:
        text = repr(value)
    except ValueError:  # whole numbers of thousands of digits
        return "(a number of too many digits)"
    return text if len(text) <= LONGEST else f"{text[:LONGEST]} ..."


class ConvergenceError(ValvefsiError, RuntimeError):
    """A nonlinear or linear solve did not reach its tolerance."""


class StabilityError(ValvefsiError, RuntimeError):
    """A run left the region where its numbers mean anything."""


class SurroundingsError(ValvefsiError, RuntimeError):
    """The disk, a folder, the memory or another process failed a run; the case has no part in it."""


class StudyError(ValvefsiError, RuntimeError):
    """Members of a study failed; the others are done."""


class Stopped(ValvefsiError):
    """A run was asked to stop by a signal, and has written a checkpoint.

    Attributes:
        signal: Number of the signal.
    """

    def __init__(self, message: str, signal: int) -> None:
        self.signal = signal
        super().__init__(message, signal)

    def __str__(self) -> str:
        return str(self.args[0])


def reason_of(error: OSError | MemoryError) -> str:
    """Return in one line what the system says."""
    if isinstance(error, MemoryError):
        return f"out of memory{f' ({error})' if str(error) else ''}"
    place = f"{error.filename}: " if error.filename else ""
    return f"{place}{error.strerror or ' '.join(str(error).split()) or type(error).__name__}"


FAULTS = ("ENOSPC", "EDQUOT", "EFBIG", "EROFS", "EACCES", "EPERM", "ENOENT", "ENODEV", "ESTALE")
"""What a system says of a file that cannot be written, by its names for it."""
CLASSES = {
    "ERR_NO_SPACE": errno.ENOSPC,
    "ERR_QUOTA": errno.EDQUOT,
    "ERR_READ_ONLY": errno.EROFS,
    "ERR_ACCESS": errno.EACCES,
    "ERR_NO_SUCH_FILE": errno.ENOENT,
}
"""The same as MPI says it."""


def system_error(place: Path, failure: MPI.Exception) -> OSError:
    """Return what the system said when MPI could not write: MPI hands it on within a stack of its own functions.

    Args:
        place: What it could not write.
        failure: What MPI says.
    """
    from mpi4py import MPI

    text, kind = str(failure), failure.Get_error_class()
    numbers = [getattr(errno, name) for name in FAULTS if hasattr(errno, name)]
    known = [number for number in numbers if os.strerror(number) in text]
    known += [number for name, number in CLASSES.items() if kind == getattr(MPI, name)]
    number = known[0] if known else errno.EIO
    return OSError(number, os.strerror(number), str(place))


def alone_with_error(comm: MPI.Comm) -> bool:
    """Return whether the other ranks have not come here within `PATIENCE`: they wait elsewhere and must be ended.

    Note:
        Collective with itself, and with ``comm.Ibarrier``.
    """
    if comm.size == 1:
        return False
    request, end = comm.Ibarrier(), time.monotonic() + PATIENCE
    while not (done := request.Test()) and time.monotonic() < end:
        time.sleep(0.01)
    return not done


def raise_together(comm: MPI.Comm, error: Exception | None) -> None:
    """Raise on every rank the error that any rank has, the lowest rank's first.

    Args:
        comm: Communicator of the run.
        error: This rank's error, None where all is well.

    Raises:
        Exception: The error of the lowest rank that has one.

    Note:
        Collective.
    """
    from mpi4py import MPI

    if comm.size > 1:
        first = comm.allreduce(comm.rank if error is not None else comm.size, op=MPI.MIN)
        if first < comm.size:
            raise comm.bcast(error, root=first)
    elif error is not None:
        raise error


def made_on_root(comm: MPI.Comm, make: Callable[[], Made], remedy: str) -> Made:
    """Return on every rank what rank 0 makes.

    Args:
        comm: Communicator of the run.
        make: Makes it; called on rank 0 only.
        remedy: What is kept and how to go on where disk, folder or memory fail.

    Raises:
        SurroundingsError: They did, on every rank.

    Note:
        Collective.
    """
    made, error = [], None
    if comm.rank == 0:
        try:
            made = [make()]
        except (OSError, MemoryError) as failure:
            error = SurroundingsError(f"{reason_of(failure)}; {remedy}")
    raise_together(comm, error)
    (result,) = comm.bcast(made)
    return cast("Made", result)
