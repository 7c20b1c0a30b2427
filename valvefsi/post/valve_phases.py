"""Phases of a valve's cycle: it opens, is open, closes, is shut."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from valvefsi.post.valve_numbers import CycleNumbers
from valvefsi.types import Array, Indices

PHASES = ("opening", "open", "closing", "shut")
WHOLE = "whole"
"""What stands for a phase where a run has none, in steady flow."""


@dataclass(frozen=True, kw_only=True)
class Window:
    """Part of a run, with its phases.

    Attributes:
        start: First time [s].
        end: Last time [s].
        times: When the valve begins to open, is open, begins to close and is shut, ascending, within a cycle of this
            window's length about it; empty without phases [s].
        forward: Start and end of forward flow, the whole of it without [s].
    """

    start: float
    end: float
    times: tuple[float, ...] = ()
    forward: tuple[float, float]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its phases."""
        return PHASES if self.times else (WHOLE,)

    def phase(self, t: Array) -> Indices:
        """Return the number of the phase at each time, ``(n,)``."""
        if not self.times:
            return np.zeros(np.shape(t), dtype=np.int64)
        first, *later = self.times
        since = np.mod(np.asarray(t) - first, self.end - self.start)
        return np.searchsorted(np.array(later) - first, since, side="right")


def cycle_window(cycle: CycleNumbers, period: float, first: float, last: float) -> Window | None:
    """Return the window of a cycle in a run, None where its phases are not known.

    Times that the cycle has after the window, because it was cut elsewhere, are those a period before.

    Args:
        cycle: Its numbers.
        period: Length of a cycle [s].
        first: Start of the window [s].
        last: Its end [s].
    """
    marks = (cycle.opening_start, cycle.opening_end, cycle.closing_start, cycle.closing_end)
    flow = (cycle.forward_start, cycle.forward_end)
    if None in marks or None in flow:
        return None
    times = tuple(cycle.start + mark for mark in marks if mark is not None)
    start, end = (cycle.start + at for at in flow if at is not None)
    back = period if end > last + 1e-9 else 0.0
    return Window(start=first, end=last, times=times, forward=(max(start - back, first), end - back))
