"""Files that are whole or not there, and folders that one run holds at a time."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
import re
import socket
import time
import warnings
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from valvefsi.errors import CaseError, raise_together

if TYPE_CHECKING:
    from mpi4py import MPI

LOCK = ".lock"
STOP = ".stop"


@dataclass(frozen=True, kw_only=True)
class Holder:
    """Who holds a folder.

    Attributes:
        host: Name of the host.
        process: Number of the process, rank 0's.
        since: Date and time on that host.
    """

    host: str
    process: int
    since: str

    def __str__(self) -> str:
        return f"process {self.process} on {self.host} since {self.since}"


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a name to write to, of the same ending; the file gets its own name when it is complete.

    What a process that was killed has left under such a name is removed.
    """
    path = Path(path)
    _remove_torn(path)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def _remove_torn(path: Path) -> None:
    """Remove what processes that are no more have begun to write for a file."""
    pattern = re.compile(rf"\.{re.escape(path.stem)}\.(\d{{1,18}}){re.escape(path.suffix)}")
    with contextlib.suppress(OSError):
        for entry in path.parent.iterdir():
            writer = pattern.fullmatch(entry.name)
            if writer and not _runs(int(writer[1])):
                entry.unlink()


def _runs(process: int) -> bool:
    """Whether there is such a process on this host."""
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True


def write_text(path: Path, text: str) -> None:
    """Write a text file, in one go."""
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal digits."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


@contextlib.contextmanager
def held(folder: Path, comm: MPI.Comm) -> Iterator[None]:
    """Hold a folder for one run or study; it is made where it is missing, and taken away again where it stays empty.

    The system lets a lock go when its process ends, however it ends: what is left of it is no lock.

    Raises:
        CaseError: Another run holds it; says on which host, which process, since when.
        OSError: The folder cannot be made or written.

    Note:
        Collective. Rank 0 holds it.
    """
    folder, lock, error = Path(folder), None, None
    try:
        if comm.rank == 0:
            folder.mkdir(parents=True, exist_ok=True)
            lock = _lock(folder)
            (folder / STOP).unlink(missing_ok=True)  # it was for a run before this one
    except (OSError, CaseError) as failure:
        error = failure
    raise_together(comm, error)
    try:
        yield
    finally:
        if lock is not None:
            with contextlib.suppress(OSError):
                (folder / LOCK).unlink(missing_ok=True)
                (folder / STOP).unlink(missing_ok=True)
                os.close(lock)
                folder.rmdir()  # only where it is empty


def _lock(folder: Path) -> int:
    """Return the open file of the lock, with who holds it in it."""
    path = folder / LOCK
    while True:
        lock = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            who = _holder(os.read(lock, 4096)) or "just begun"
            os.close(lock)
            raise CaseError(
                f"another run or study holds this folder, {who}; give another --out", file=folder
            ) from None
        except OSError as failure:
            warnings.warn(
                f"{folder} cannot be locked ({failure.strerror}): keep other runs out", stacklevel=2
            )
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(lock), path.stat()):
                break
        os.close(lock)  # whoever held it has just taken it away
    about = Holder(host=socket.gethostname(), process=os.getpid(), since=time.strftime("%Y-%m-%d %H:%M:%S"))
    os.ftruncate(lock, 0)
    os.write(lock, json.dumps(asdict(about)).encode())
    return lock


def _holder(text: bytes) -> Holder | None:
    """Return who a lock names, None where it is being written."""
    try:
        about = json.loads(text)
        return Holder(host=str(about["host"]), process=int(about["process"]), since=str(about["since"]))
    except (ValueError, KeyError, TypeError):
        return None


def holder_of(folder: Path) -> Holder | None:
    """Return who holds a folder, None where nobody does; a lock whose process on this host is no more is none."""
    try:
        holder = _holder((Path(folder) / LOCK).read_bytes())
    except OSError:
        return None
    gone = holder is not None and holder.host == socket.gethostname() and not _runs(holder.process)
    return None if gone else holder


def request_stop(folder: Path) -> None:
    """Ask the run that holds a folder to write a checkpoint and end, by a file that it looks for.

    The file holds what the lock holds: a later run ignores it.

    Raises:
        CaseError: No run holds the folder.
        OSError: The file cannot be written.
    """
    if holder_of(folder) is None:
        raise CaseError("no run holds this folder, there is nothing to stop", file=folder)
    write_text(Path(folder) / STOP, (Path(folder) / LOCK).read_text(encoding="utf-8"))


def stop_requested(folder: Path) -> bool:
    """Whether the run that holds a folder is asked to stop, see `request_stop`."""
    try:
        asked = (Path(folder) / STOP).read_bytes()
        return bool(asked) and asked == (Path(folder) / LOCK).read_bytes()
    except OSError:
        return False
