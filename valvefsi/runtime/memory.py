"""How the process keeps its memory."""

from __future__ import annotations

import ctypes
import gc
import itertools
import os

TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
LARGE = 2**31 - 1
KEPT_RUNS = 16
"""Runs of one process after which what they have left is freed; each may hold some twenty MPI communicators."""
_runs = itertools.count(1)


def forget_earlier_runs() -> None:
    """Free now and then what earlier runs of this process have left in cycles; called where a run is made.

    What sets formulas in pictures keeps exceptions, and with them the frames of the run that drew, its meshes and their
    MPI communicators, of which a library has some two thousand. Python by itself looks for such cycles too rarely.

    Note:
        Collective: freeing a communicator is, and all ranks count alike.
    """
    if next(_runs) % KEPT_RUNS == 0:
        gc.collect()


def keep_freed_memory() -> bool:
    """Make the C library keep freed arrays for the next ones instead of handing them back to the system.

    A step allocates the same arrays again and again; pages that come fresh from the system are cleared first, which
    took up to half of a step (256 x 256 cells: 8.7 ms before, 4.9 ms after).

    Returns:
        Whether the C library has this setting; without it nothing changes.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    return bool(mallopt(MMAP_THRESHOLD, LARGE)) and bool(mallopt(TRIM_THRESHOLD, LARGE))


def machine_memory() -> float:
    """Return the memory of this machine [bytes], infinite where the system does not say."""
    try:
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (ValueError, OSError, AttributeError):
        return float("inf")
