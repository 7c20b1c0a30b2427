"""Tethers whose anchors move: they turn or shift a part of a solid as prescribed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from valvefsi.solid.loads import Ramp, Tether

if TYPE_CHECKING:
    from valvefsi.types import Array


@dataclass(frozen=True, kw_only=True)
class MovingTether(Tether):
    """Springs and dampers to a place that moves, kappa (X + d(X, s) - chi) - eta U with s = ramp(t).

    Args:
        motion: Displacement d of the anchors, ``motion(X (n, 3), s) -> (n, 3)`` [cm], as of `supports.rotation`.
        ramp: Factor s over time.
    """

    motion: Callable[[Array, float], Array]
    ramp: Ramp = field(default_factory=Ramp)
