"""What all bodies share: the answers of one that has nothing to say, and what they hand to plans and measurements."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, Self

import numpy as np

from valvefsi.types import Array, Faces, HalfStep, Indices, Table, Transfer

if TYPE_CHECKING:
    from mpi4py import MPI

    from valvefsi.grid import MacGrid
    from valvefsi.io.series import Frames
    from valvefsi.solid.structure import Structure


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One line of a plan.

    Attributes:
        quantity: What it is.
        value: Its value.
        unit: Unit of the value.
        note: What to make of it.
        wall: Whether it is a wall-clock time, which is shown as people say it.
    """

    quantity: str
    value: float | int | str
    unit: str = ""
    note: str = ""
    wall: bool = False


@dataclass(frozen=True, kw_only=True)
class SmallMotion:
    """A body as a small displacement of its points sees it, for `valvefsi.run.stable_step`.

    Attributes:
        transfer: Spreading and interpolation where it is.
        stiffness: The product (K + 2 C / dt) d for displacements d, both ``(n, 3)``.
        slip: 2 / dt times the velocity at which points slip through the fluid under forces, both ``(n, 3)``.
        start: A displacement that has a part in every mode, ``(n, 3)``.
        reserve: Part of the square of the step's limit that is left to what the stiffness holds.
    """

    transfer: Transfer
    stiffness: Callable[[Array], Array]
    slip: Callable[[Array], Array]
    start: Array
    reserve: float = 1.0


class Series(Protocol):
    """Pictures of a body over time."""

    def write(self, t: float, q: Table) -> None:
        """Write the body in state q at time t [s]. Collective."""
        ...


class NoSeries:
    """Of a body that does not change."""

    def write(self, t: float, q: Table) -> None:
        """Write nothing."""


class BodyBase(ABC):
    """What a run asks of a body beside `valvefsi.types.Body`, which the step asks for; by default it has no answer.

    Attributes:
        name: Name in files.
        X: Reference positions of this rank's points, ``(n, 3)`` [cm].
        ids: Their numbers among the points of all ranks, ``(n,)``.
        num_points: Number of points on all ranks.
        solid: The deformable solid it is made of, None for a rigid one.
        derived: Tables of its state that follow from the fluid's velocity, which a checkpoint need not hold.
    """

    name: str
    X: Array
    ids: Indices
    num_points: int
    solid: Structure | None = None
    derived: frozenset[str] = frozenset()

    def rows(self, key: str) -> tuple[Indices, int]:
        """Return the numbers of this rank's rows of a table of its state, and how many all ranks have.

        Args:
            key: Which table; those of its points by default.
        """
        return self.ids, self.num_points

    @abstractmethod
    def start(self, u: Faces) -> Table:
        """Return the state at t = 0, see `valvefsi.types.Body`. Collective."""

    @abstractmethod
    def half(self, q: Table, u: Faces, t: float, dt_old: float, dt: float) -> HalfStep:
        """Move half a step with the velocity that it feels now, see `valvefsi.types.Body`. Collective."""

    def continued(self, other: BodyBase, q: Table, u: Faces) -> Table:
        """Return the state that it goes on in where another discretisation of it was left; at rest by default.

        Args:
            other: The same body on another mesh or grid, whole on this rank.
            q: Its state.
            u: Velocity on the faces of this body's grid, ghosts filled [cm/s].

        Note:
            Collective.
        """
        return self.start(u)

    def completed(self, q: Table, u: Faces) -> Table:
        """Return the state that a checkpoint holds, with derived tables that one of an earlier version lacks.

        Args:
            q: What it holds.
            u: Velocity on the faces, ghosts filled [cm/s].

        Note:
            Collective.
        """
        return q

    def timed(self, table: dict[str, float]) -> Self:
        """Return the body with a clock around its parts, which adds wall-clock time by phase to the table [s]."""
        return self

    def momentum(self, q: Table, u: Faces, rho: float) -> Array:
        """Return the momentum of the fluid in it, ``(3,)`` [g cm/s] (collective)."""
        return np.zeros(3)

    def stored(self, q: Table) -> float:
        """Return the energy it can give back: of deformation, of its springs, of its excess mass [erg] (collective)."""
        return 0.0

    def columns(self) -> list[str]:
        """Return the names of its columns in the history."""
        return []

    def row(self, q: Table) -> dict[str, float]:
        """Return its part of a row of the history (collective)."""
        return {}

    def fault(self, q: Table, row: dict[str, float]) -> str | None:
        """Return what is wrong with it, from its part of a row, None for nothing (collective)."""
        return None

    def gap(self, q: Table) -> float:
        """Return the largest distance of neighbouring points that move [cm] (collective)."""
        return 0.0

    @property
    def remedy(self) -> str:
        """What to do against points too far apart."""
        return ""

    def follow(self, at: tuple[float, ...]) -> Callable[[Table], Array]:
        """Return the displacement ``(3,)`` [cm] of the point nearest to ``at`` by state (collective)."""
        raise ValueError(f"{self.name} does not move")

    def series(self, folder: Path, comm: MPI.Comm, frames: Frames | None) -> Series:
        """Return what draws it over time, in a folder; files of frames not in ``frames`` [s] go (collective)."""
        return NoSeries()

    def small_motion(self, q: Table | None, t: float, dt: float, nudge: float) -> SmallMotion | None:
        """Return it as a small displacement sees it; None where it sets no limit that is measured (collective).

        Args:
            q: Its state; at rest without one.
            t: Time [s].
            dt: The step in question [s].
            nudge: Displacement that the stiffness is differenced with [cm].
        """
        return None

    def size(self, grid: MacGrid) -> list[Entry]:
        """Return the lines of a plan about its points (collective)."""
        return [Entry(quantity=f"points of {self.name}", value=self.num_points, note="rigid")]

    def memory(self) -> int:
        """Return the bytes that a step takes for it on this rank."""
        return 0

    def step_limits(self, h: float, rho: float) -> dict[str, float]:
        """Return bounds of a stable step by cause [s], on the safe side (collective).

        Args:
            h: Smallest spacing [cm].
            rho: Density of the fluid [g/cm^3].
        """
        return {}

    def statics(self, dt: float) -> list[Entry]:
        """Return the lines of a plan about how firmly it is held, with steps dt [s] (collective)."""
        return []
