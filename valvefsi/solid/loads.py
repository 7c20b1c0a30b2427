"""Loads and supports of a solid: dead loads, follower pressure, tethers, and the ramp that switches a load on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from valvefsi.errors import CaseError


@dataclass(frozen=True, kw_only=True)
class Ramp:
    """Load factor that grows from 0 to 1.

    Linear: t/duration. Smooth: 3 s^2 - 2 s^3 with s = t/duration, without jump in the rate.

    Args:
        duration: Time at which the factor reaches 1; 0 loads at once [s].
        shape: "linear" or "smooth".
    """

    duration: float = 0.0
    shape: str = "linear"

    def __post_init__(self) -> None:
        if not (math.isfinite(self.duration) and self.duration >= 0):
            raise CaseError("expected a time that is not negative", key="ramp", value=self.duration)
        if self.shape not in ("linear", "smooth"):
            raise CaseError('expected "linear" or "smooth"', key="ramp_shape", value=self.shape)

    def __call__(self, t: float) -> float:
        """Return the load factor at time ``t`` [s]."""
        if t >= self.duration:
            return 1.0
        s = max(t / self.duration, 0.0)
        return s if self.shape == "linear" else s * s * (3 - 2 * s)


@dataclass(frozen=True, kw_only=True)
class DeadLoad:
    """Traction per reference area that keeps its direction, times a ramp.

    Args:
        on: Names of the facet tags that carry it.
        traction: Components, ``(dim,)`` or ``(3,)`` [dyn/cm^2].
        ramp: Load factor over time.
    """

    on: tuple[str, ...]
    traction: tuple[float, ...]
    ramp: Ramp = Ramp()

    def __post_init__(self) -> None:
        _freeze_names(self, self.on)
        object.__setattr__(self, "traction", tuple(float(value) for value in self.traction))
        if len(self.traction) not in (2, 3) or not all(math.isfinite(value) for value in self.traction):
            raise CaseError("expected 2 or 3 finite components", key="traction", value=self.traction)


@dataclass(frozen=True, kw_only=True)
class Pressure:
    """Follower pressure: traction -p n per current area, n the outer normal of the deformed surface.

    Args:
        on: Names of the facet tags it pushes on, from outside the body.
        value: Pressure p, positive where it pushes on the surface [dyn/cm^2].
        ramp: Load factor over time.
    """

    on: tuple[str, ...]
    value: float
    ramp: Ramp = Ramp()

    def __post_init__(self) -> None:
        _freeze_names(self, self.on)
        if isinstance(self.value, bool) or not math.isfinite(self.value):
            raise CaseError("expected a finite pressure", key="pressure", value=self.value)


@dataclass(frozen=True, kw_only=True)
class PointLoad:
    """Dead force on single nodes, for statics.

    Args:
        at: Reference positions of the nodes, ``(n, dim)`` [cm].
        force: Components of the whole force, which the nodes bear in equal parts, ``(dim,)`` or ``(3,)`` [dyn].
    """

    at: tuple[tuple[float, ...], ...]
    force: tuple[float, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "at", tuple(tuple(map(float, point)) for point in self.at))
        object.__setattr__(self, "force", tuple(map(float, self.force)))
        numbers = [*self.force, *(x for point in self.at for x in point)]
        if not self.at or len(self.force) not in (2, 3) or not all(map(math.isfinite, numbers)):
            message = "expected positions, and 2 or 3 finite components"
            raise CaseError(message, key="force", value=[self.at, self.force])


@dataclass(frozen=True, kw_only=True)
class Tether:
    """Springs and dampers that hold a solid at its reference position, kappa (X - chi) - eta U.

    Args:
        on: Names of facet or cell tags; None holds the whole body.
        components: The axes it acts along, of "x", "y", "z"; empty for all of them.
        stiffness: kappa, per area of facets [dyn/cm^3] or per volume of cells [dyn/cm^4].
        damping: eta, per area of facets [dyn s/cm^3] or per volume of cells [dyn s/cm^4].
    """

    on: tuple[str, ...] | None = None
    components: tuple[str, ...] = ()
    stiffness: float
    damping: float = 0.0

    def __post_init__(self) -> None:
        if self.on is not None:
            _freeze_names(self, self.on)
        components = tuple(self.components) or ("x", "y", "z")
        object.__setattr__(self, "components", components)
        if not set(components) <= set("xyz"):
            raise CaseError('expected some of "x", "y", "z"', key="components", value=components)
        for key in ("stiffness", "damping"):
            value = getattr(self, key)
            if not (math.isfinite(value) and value >= 0):
                raise CaseError("expected a finite number that is not negative", key=key, value=value)

    @property
    def mask(self) -> tuple[float, float, float]:
        """1 for an axis it acts along, else 0."""
        x, y, z = (float(axis in self.components) for axis in "xyz")
        return x, y, z


def _freeze_names(item: DeadLoad | Pressure | Tether, names: str | Sequence[str]) -> None:
    """Store ``on`` as a tuple of names; refuse an empty one."""
    names = (names,) if isinstance(names, str) else tuple(names)
    if not names:
        raise CaseError("expected the name of at least one tag", key="on", value=list(names))
    object.__setattr__(item, "on", names)
