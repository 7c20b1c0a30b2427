"""The steps of a run: fixed, or as long as the Courant number allows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from valvefsi.errors import CaseError

if TYPE_CHECKING:
    from valvefsi.fsi import State


def check_end(t: float, dt: float, t_end: float, file: Path | None = None) -> None:
    """Refuse an end that a run has passed: what was asked for can no longer be computed.

    Args:
        t: Time of the checkpoint that a run goes on from [s].
        dt: Its last step [s]; a run with fixed steps may end half a step late.
        t_end: End that is asked for [s].
        file: The case.

    Raises:
        CaseError: The time lies after the end.
    """
    if t > t_end + 0.5 * dt * (1.0 + 1e-9):
        message = (
            f"the checkpoint is of t = {t:.9g} s, after this end of {t_end:.9g} s; nothing is run: ask for a later "
            "end, or start a new run"
        )
        raise CaseError(message, file=file, key="time.t_end")


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """Steps of one length.

    Attributes:
        dt: Length of a step [s].
        t_end: End of the run [s].
        cfl_max: Largest Courant number ``|u| dt / h`` that is accepted.
        max_recoveries: Times a run may go back to its last good state; none, as the step is not to be changed.
        measure_every: Steps between measurements of the stable step; none either.
    """

    dt: float
    t_end: float
    cfl_max: float = 0.5
    max_recoveries: int = 0
    measure_every: int = 0

    def num_steps(self, t: float = 0.0) -> int:
        """Return the number of steps from a time [s] to the end, rounded to a whole one."""
        return max(1, round((self.t_end - t) / self.dt))

    def finished(self, state: State) -> bool:
        """Whether a state is the last one: the end is nearer than half a step."""
        return state.step > 0 and state.t > self.t_end - 0.5 * self.dt

    def next_dt(self, state: State, rate: float) -> float:  # what `AdaptiveSchedule` looks at
        """Return the length of the step after a state [s]."""
        return self.dt

    def spare(self, state: State) -> float:
        """Return what the stable step allows as a part of the longest step: nothing is asked of it."""
        return math.inf

    def share(self, state: State) -> float:
        """Return the part of the run that is done, 0 to 1."""
        return 1.0 if self.finished(state) else min(1.0, state.t / (self.num_steps() * self.dt))


@dataclass(frozen=True, kw_only=True)
class AdaptiveSchedule:
    """Steps limited by the Courant number and by the solids, which follow from the state alone.

    So a restart takes the same ones. The next step is the smallest of the largest step, the last one times ``growth``,
    ``cfl`` over the largest ``|u| / h``, and ``share_stable`` of the largest stable step that was last measured; the
    last two steps share what is left of the run.

    Attributes:
        dt: Largest step [s].
        t_end: End of the run [s].
        cfl: Courant number that is aimed at.
        cfl_max: Largest Courant number that is accepted.
        growth: Largest ratio of a step to the one before.
        max_recoveries: Times a run may go back to its last good state and take shorter steps.
        share_stable: Part of the measured stable step that is taken.
        measure_every: Most steps between measurements of the stable step, which cost about one step each; it is
            measured sooner where the energy stored in a body has changed, see `valvefsi.run.stable_step`. 0 for never.

    Raises:
        ValueError: ``cfl`` is above ``cfl_max``, or ``growth`` not above 1.
    """

    dt: float
    t_end: float
    cfl: float = 0.25
    cfl_max: float = 0.5
    growth: float = 1.1
    max_recoveries: int = 5
    share_stable: float = 0.8
    measure_every: int = 400

    def __post_init__(self) -> None:
        """Check the limits."""
        if not 0.0 < self.cfl <= self.cfl_max or not self.growth > 1.0:
            raise ValueError(
                f"expected 0 < cfl <= cfl_max and growth > 1, got {self.cfl}, {self.cfl_max}, {self.growth}"
            )

    def num_steps(self, t: float = 0.0) -> int:
        """Return the smallest number of steps from a time [s] to the end."""
        return max(1, math.ceil((self.t_end - t) / self.dt - 1e-9))

    def finished(self, state: State) -> bool:
        """Whether a state is the last one."""
        return state.t > self.t_end * (1.0 - 1e-12)

    def next_dt(self, state: State, rate: float) -> float:
        """Return the length of the step after a state.

        Args:
            state: The state.
            rate: Its largest ``|u_d| / h_d`` over all faces [1/s].

        Returns:
            Length of the next step [s].
        """
        dt = self.dt if state.step == 0 else min(self.dt, self.growth * state.dt)
        if rate > 0.0:
            dt = min(dt, self.cfl / rate)
        dt = min(dt, self.share_stable * state.dt_stable)
        left = self.t_end - state.t
        steps = math.ceil(left / dt - 1e-9)
        return left / steps if steps <= 2 else dt

    def spare(self, state: State) -> float:
        """Return what the stable step that was last measured allows, as a part of the longest step."""
        return self.share_stable * state.dt_stable / self.dt

    def share(self, state: State) -> float:
        """Return the part of the run that is done, 0 to 1."""
        return min(1.0, state.t / self.t_end)
