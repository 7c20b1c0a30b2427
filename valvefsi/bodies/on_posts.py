"""Leaflets on flexible posts: an elastic body, the wall of the posts, and the posts' own motion, in one.

The tethers of the leaflets' attached edge hold it where the posts are, and so do the springs of the posts' wall; both
load the posts with what they give the fluid, see `valvefsi.bodies.posts`. The wall's points move with the posts, and
their kernels with them: kept where they were, they would leave a slot as wide as the deflection beside the attached
edge, which leaks from about one spacing on (`valvefsi.bodies.elastic_plan.LONGEST_GAP`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np

from valvefsi.bodies.body import BodyBase, Entry, Series, SmallMotion
from valvefsi.bodies.posts import Attachment
from valvefsi.geometry.stent_posts import MEAN_SHAPE
from valvefsi.runtime.clock import TimedCoupling
from valvefsi.units import MMHG

if TYPE_CHECKING:
    from collections.abc import Collection

    from mpi4py import MPI

    from valvefsi.bodies.elastic import Elastic, ElasticHalf
    from valvefsi.bodies.posts import Oscillator
    from valvefsi.bodies.rigid import RigidSurface
    from valvefsi.coupling.transfer import Coupling
    from valvefsi.geometry.stent_posts import StentPosts
    from valvefsi.grid import MacGrid
    from valvefsi.io.series import Frames
    from valvefsi.types import Array, Faces, Indices, Table, Transfer

CLOSING = 100.0
"""Pressure difference that the plan gives the deflection of posts for [mmHg]."""
SMALL = 0.1
"""Deflection over length up to which a bar bends as its linear theory says."""


@dataclass(frozen=True)
class WallHalf:
    """The posts' wall halfway through a step, its kernels where the posts are then."""

    d: Array
    force: Array
    transfer: Transfer
    surface: RigidSurface
    dt: float

    def spread(self, f: Faces) -> None:
        """Add the forces to the force density f on the faces [dyn/cm^3]. Collective."""
        self.transfer.spread(self.force, out=f)

    def velocity(self, u_half: Faces) -> Array:
        """Return what is held of the velocity of the fluid at the points, ``(n, 3)`` [cm/s]. Collective."""
        return self.surface.held(self.transfer.interpolate(u_half))

    def whole(self, U: Array) -> Table:
        """Return the state after the step, carried by the velocity U at its middle."""
        d: Array = self.d + self.dt * U
        self.surface.slip_back(d, self.d, self.dt)
        return {"d": d}


@dataclass(frozen=True, kw_only=True)
class OnPostsHalf:
    """Leaflets on posts halfway through a step; the posts are through with it."""

    leaflets: ElasticHalf
    wall: WallHalf
    posts: Array

    @property
    def force(self) -> Array:
        """Forces on the fluid at the nodes, then at the wall's points, ``(n, 3)`` [dyn]."""
        return np.concatenate([self.leaflets.force, self.wall.force])

    def spread(self, f: Faces) -> None:
        """Add the forces to the force density f on the faces [dyn/cm^3]. Collective."""
        self.leaflets.spread(f)
        self.wall.spread(f)

    def velocity(self, u_half: Faces) -> Array:
        """Return the velocity of the fluid at nodes and points, ``(n, 3)`` [cm/s]. Collective."""
        return np.concatenate([self.leaflets.velocity(u_half), self.wall.velocity(u_half)])

    def whole(self, U: Array) -> Table:
        """Return the state after the step. Collective."""
        nodes = len(self.leaflets.chi)
        return {**self.leaflets.whole(U[:nodes]), **self.wall.whole(U[nodes:]), "posts": self.posts}


class OnPosts(BodyBase):
    """Leaflets on flexible posts.

    Its state is that of the leaflets, ``d`` of the wall (`valvefsi.bodies.rigid`), and ``posts``: how far the tip of
    each is inwards and how fast, ``(m, 2)`` [cm, cm/s], on rank 0.

    Args:
        leaflets: The leaflets, tethered at their attached edge.
        wall: The posts' part of the stent.
        coupling: Its kernel on the grid.
        places: Where the posts stand.
        oscillator: What each is.
        tags: Of the attached edge.

    Raises:
        ValueError: No tether holds the attached edge.

    Note:
        Collective.
    """

    def __init__(
        self,
        leaflets: Elastic,
        wall: RigidSurface,
        coupling: Coupling,
        *,
        places: StentPosts,
        oscillator: Oscillator,
        tags: Collection[str],
    ) -> None:
        self.leaflets, self.wall, self.coupling = leaflets, wall, coupling
        self.places, self.oscillator, self.comm = places, oscillator, wall.comm
        self.name, self.X, self.ids = leaflets.name, leaflets.X, leaflets.ids
        self.num_points, self.solid = leaflets.num_points, leaflets.solid
        self.count = len(places.azimuths)
        self.spring, self.damper = leaflets.solid.tethers_on(tags)
        if not self.comm.allreduce(float(self.spring.sum())) > 0.0:
            raise ValueError(f"no tether holds {leaflets.name} on {', '.join(tags)} alone")
        shape = places.shape(self.X)
        self.edge = self._attachment(self.X, self.spring * shape, self.damper * shape)
        shape, still = wall.held(places.shape(wall.X)), np.zeros_like(wall.X)
        self.stent = self._attachment(wall.X, wall.force(-shape, still), wall.force(still, -shape))
        self.total = self.edge.total + self.stent.total

    def _attachment(self, X: Array, springs: Array, dampers: Array) -> Attachment:
        place = self.places
        return Attachment(
            place.nearest(X), place.shape(X), springs, dampers, count=self.count, comm=self.comm
        )

    def rows(self, key: str) -> tuple[Indices, int]:
        """Return the numbers of this rank's rows of a table, and how many all ranks have, see `BodyBase`."""
        if key == "posts":
            return np.arange(self.count if self.comm.rank == 0 else 0), self.count
        return self.wall.rows(key) if key == "d" else self.leaflets.rows(key)

    def motion(self, q: Table) -> Array:
        """Return how far the tips are inwards and how fast, on all ranks, ``(m, 2)`` [cm, cm/s] (collective)."""
        motion: Array = self.comm.bcast(q["posts"])
        return motion

    def _state(self, leaflets: Table, motion: Array) -> Table:
        """Return the state with posts that have moved and a wall that nothing loads (collective)."""
        d = self.wall.held(self.stent.shift(motion))
        return {**leaflets, "d": d, "posts": motion[self.rows("posts")[0]]}

    def start(self, u: Faces) -> Table:
        """Return the state at t = 0, everything at its place. Collective."""
        return self._state(self.leaflets.start(u), np.zeros((self.count, 2)))

    def continued(self, other: BodyBase, q: Table, u: Faces) -> Table:
        """Return the state with the displacement of another mesh and its posts, see `BodyBase`. Collective."""
        if not isinstance(other, OnPosts) or other.count != self.count:
            return self._state(self.leaflets.continued(other, q, u), np.zeros((self.count, 2)))
        return self._state(self.leaflets.continued(other.leaflets, q, u), other.motion(q))

    def half(self, q: Table, u: Faces, t: float, dt_old: float, dt: float) -> OnPostsHalf:
        """Move half a step with the velocity that all feel now, the posts a whole one. Collective."""
        motion = self.motion(q)
        # 1. what the edge's tethers and the wall's springs do at the middle, were the posts at their places of rest
        leaflets = self.leaflets.half(q, u, t, dt_old, dt)
        U = 2.0 / dt * (leaflets.chi_half - leaflets.chi)
        pull = self.spring * (self.X - leaflets.chi_half) - self.damper * U
        V = self.wall.held(self._at(motion).interpolate(u))
        hold = self.wall.force(q["d"], V, 0.5 * dt)
        # 2. the posts under it, and with what there is more of it
        load = self.comm.allreduce(self.edge.load(pull) + self.stent.load(hold))
        middle = self.oscillator.midpoint(motion, load, self.total, dt)
        leaflets = replace(leaflets, force=leaflets.force + self.edge.force(middle))
        hold = hold + self.stent.force(middle)
        wall = WallHalf(q["d"], hold, self._at(middle), self.wall, dt)
        # 3. the posts after the step
        posts = (2.0 * middle - motion)[self.rows("posts")[0]]
        return OnPostsHalf(leaflets=leaflets, wall=wall, posts=posts)

    def _at(self, motion: Array) -> Transfer:
        """Return spreading and interpolation of the wall where the posts are (collective)."""
        return self.coupling.at(self.wall.X + self.stent.shift(motion))

    def timed(self, table: dict[str, float]) -> Self:
        """Return the body with clocks around its parts."""
        other = copy(self)
        other.leaflets = self.leaflets.timed(table)
        other.coupling = TimedCoupling(self.coupling, table)  # type: ignore[assignment]
        return other

    def momentum(self, q: Table, u: Faces, rho: float) -> Array:
        """Return the momentum of the fluid in the leaflets, ``(3,)`` [g cm/s] (collective)."""
        return self.leaflets.momentum(q, u, rho)

    def stored(self, q: Table) -> float:
        """Return the energy of the leaflets, of tethers and springs, and of the posts [erg] (collective)."""
        motion = self.motion(q)
        here = self.edge.energy(motion, q["chi"] - self.X) + self.stent.energy(motion, q["d"])
        still = self.leaflets.stored(q) + self.wall.stored(q)
        return still + self.comm.allreduce(here) + self.oscillator.energy(motion)

    def columns(self) -> list[str]:
        """Return the names of its columns in the history."""
        return [*self.leaflets.columns(), *post_columns(self.name, self.count)]

    def row(self, q: Table) -> dict[str, float]:
        """Return that of the leaflets, and how far the tips are inwards [mm] (collective)."""
        tips = 10.0 * self.motion(q)[:, 0]
        return self.leaflets.row(q) | dict(
            zip(post_columns(self.name, self.count), tips.tolist(), strict=True)
        )

    def fault(self, q: Table, row: dict[str, float]) -> str | None:
        """Return what is wrong with the leaflets (collective)."""
        return self.leaflets.fault(q, row)

    def gap(self, q: Table) -> float:
        """Return the largest distance of neighbouring points of the leaflets [cm] (collective)."""
        return self.leaflets.gap(q)

    @property
    def remedy(self) -> str:
        """What to do against points too far apart."""
        return self.leaflets.remedy

    def follow(self, at: tuple[float, ...]) -> Callable[[Table], Array]:
        """Return the displacement ``(3,)`` [cm] of the leaflets' node nearest to ``at`` by state (collective)."""
        return self.leaflets.follow(at)

    def series(self, folder: Path, comm: MPI.Comm, frames: Frames | None) -> Series:
        """Return what draws the leaflets over time, in a folder (collective)."""
        return self.leaflets.series(folder, comm, frames)

    def small_motion(self, q: Table | None, t: float, dt: float, nudge: float) -> SmallMotion | None:
        """Return the leaflets on posts that stand still, which are the stiffer ones (collective)."""
        return self.leaflets.small_motion(q, t, dt, nudge)

    def size(self, grid: MacGrid) -> list[Entry]:
        """Return the lines of a plan about its points (collective)."""
        note = f"flexible, {self.count} of them" if self.count > 1 else "flexible"
        posts = Entry(quantity=f"points of {self.wall.name}", value=self.wall.num_points, note=note)
        return [*self.leaflets.size(grid), posts]

    def memory(self) -> int:
        """Return the bytes that a step takes for it on this rank."""
        return self.leaflets.memory() + 8 * 12 * (len(self.X) + len(self.wall.X))

    def step_limits(self, h: float, rho: float) -> dict[str, float]:
        """Return bounds of a stable step by cause [s]: those of the leaflets (collective)."""
        return self.leaflets.step_limits(h, rho)

    def statics(self, dt: float) -> list[Entry]:
        """Return how firmly the leaflets are held, and how far the posts bend in a shut valve (collective)."""
        places, bar = self.places, self.oscillator
        load = CLOSING * MMHG * math.sqrt(3.0) * places.radii * places.lengths * MEAN_SHAPE
        most = float((load / bar.stiffness).max())
        part = float((load / bar.stiffness / places.lengths).max())
        swing = math.sqrt(bar.stiffness / bar.mass) / (2.0 * math.pi)
        note = (
            f"estimate: all of the pressure on a third of the stent's circle; {places.lengths.max() * 10:.3g} mm long, "
            f"{swing:.3g} Hz alone"
        )
        entry = Entry(
            quantity=f"deflection of posts at {CLOSING:g} mmHg", value=10.0 * most, unit="mm", note=note
        )
        if part <= SMALL:
            return [*self.leaflets.statics(dt), entry]
        text = f"posts may bend by {100 * part:.2g} % of their length; linear bars do up to {100 * SMALL:g} %"
        return [
            *self.leaflets.statics(dt),
            entry,
            Entry(quantity=f"warning, {self.name}", value="", note=text),
        ]


def post_columns(name: str, count: int) -> list[str]:
    """Return the names of the columns of the posts of a body in the history."""
    return [f"{name}_post_{k + 1}_inward_mm" for k in range(count)]
