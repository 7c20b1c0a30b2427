"""The kinds of sides of the box of fluid."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from valvefsi.types import Array, Mask

Velocity = Callable[[Array, Array, Array, float], Sequence[Array | float]]
Pressure = Callable[[Array, Array, Array, float], Array | float]
Where = Callable[[Array, Array, Array], Mask]


@dataclass(frozen=True, kw_only=True)
class Wall:
    """A side with prescribed velocity.

    Attributes:
        velocity: Constant, one entry per dimension [cm/s], or a function of x, y, z [cm] and t [s] that returns
            one array (or number) per dimension.
    """

    velocity: tuple[float, ...] | Velocity = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class FreeSlip:
    """A side that nothing passes and that does not hold the fluid back: u_n = 0, du_t/dn = 0."""


@dataclass(frozen=True, kw_only=True)
class Open:
    """A side with prescribed normal traction -p and no velocity along it, so that du_n/dn = 0.

    Where fluid comes in, the pressure is lowered by the fraction ``backflow`` of its dynamic pressure,
    p - backflow rho/2 min(u_n, 0)^2 with u_n outward: with 1 no kinetic energy enters unpaid (p is then the total
    pressure of what comes in), with 0 p is the pressure on the side itself. With ``mean_pressure`` the mean of what is
    lost over the open part is given back to all of it: p is then the mean of the pressure there, an even inflow loses
    nothing, and jets that come in faster than the rest still do not gain on them.

    Attributes:
        pressure: Constant [dyn/cm^2], or a function of x, y, z [cm] and t [s].
        backflow: Fraction beta of the dynamic pressure, 0 to 1.
        mean_pressure: Whether the pressure is the mean over the open part.

    Raises:
        ValueError: ``backflow`` is not from 0 to 1.
    """

    pressure: float | Pressure = 0.0
    backflow: float = 1.0
    mean_pressure: bool = False

    def __post_init__(self) -> None:
        """Check the fraction."""
        if not 0.0 <= self.backflow <= 1.0:
            raise ValueError(f"backflow must be from 0 to 1, got {self.backflow}")


@dataclass(frozen=True, kw_only=True)
class Mixed:
    """A side that is open on a part and a wall at rest elsewhere.

    Attributes:
        open: What holds on the open part.
        where: Function of x, y, z [cm] of the faces on the side, true on the open part.
    """

    open: Open
    where: Where


@dataclass(frozen=True, kw_only=True)
class Disk:
    """The points of a side that are nearer to a centre than a radius.

    Attributes:
        centre: Centre; its entry normal to the side is not looked at, ``(3,)`` [cm].
        radius: Radius [cm].
    """

    centre: tuple[float, float, float]
    radius: float

    def __call__(self, x: Array, y: Array, z: Array) -> Mask:
        """Return whether points lie on the disk; along an axis with one entry they are not told apart."""
        square = np.zeros(())
        for points, c in zip((x, y, z), self.centre, strict=True):
            if np.size(points) > 1:
                square = square + np.square(points - c)
        return square < self.radius**2


Side = Wall | FreeSlip | Open | Mixed
