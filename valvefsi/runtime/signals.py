"""Signals that ask a process to end: one line from wherever it is, or collected until it is a good moment."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from collections.abc import Iterator
from types import FrameType

from valvefsi.errors import Stopped
from valvefsi.runtime.surroundings import launched_rank

WORDS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
LEFT_ALONE = "-no_signal_handler"
"""Option of PETSc, which else takes SIGTERM for itself and ends with a stack of its own."""
AGAIN = "start it again, a run that had begun goes on with --resume"


def end_in_one_line() -> None:
    """Let SIGTERM, and SIGINT while libraries are imported, end this process in one line, with 128 + their number.

    An exception may be lost in an import, so that the process goes on: there it ends at once. Elsewhere SIGTERM raises
    `Stopped`, and SIGINT KeyboardInterrupt as ever. For the process of a command, before it imports anything large.
    """
    process = os.getpid()
    os.environ["PETSC_OPTIONS"] = f"{os.environ.get('PETSC_OPTIONS', '')} {LEFT_ALONE}".strip()

    def end(number: int, frame: FrameType | None) -> None:
        if os.getpid() != process:  # a fork that is asked to end has nothing to say
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
        word = WORDS[signal.Signals(number)]
        if _imports(frame):
            with contextlib.suppress(OSError, ValueError):
                sys.stdout.flush()
            if launched_rank() == 0:
                os.write(2, f"{word}; {AGAIN}\n".encode())
            os._exit(128 + number)
        if number == signal.SIGINT:
            raise KeyboardInterrupt
        raise Stopped(f"{word}; {AGAIN}", number)

    for number in WORDS:
        signal.signal(number, end)


def _imports(frame: FrameType | None) -> bool:
    """Whether a frame is within an import."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


@contextlib.contextmanager
def collected_signals() -> Iterator[list[int]]:
    """Collect SIGTERM and SIGINT in a list instead of letting them end the process."""
    received: list[int] = []
    old = {}
    try:
        for number in (signal.SIGTERM, signal.SIGINT):
            old[number] = signal.signal(number, lambda n, _: received.append(n))
    except ValueError:  # not the main thread: leave signals alone
        pass
    try:
        yield received
    finally:
        for number, handler in old.items():
            signal.signal(number, handler)
