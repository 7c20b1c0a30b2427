"""Signals that ask a run to stop, collected until it is a good moment."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator


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
