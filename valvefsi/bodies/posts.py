"""Flexible posts, one oscillator each, and what hangs on them by springs and dampers.

The tip of post k is displaced inwards by q_k, and its points by q_k times their shape, a vector phi_i at point i. With
K and C what hangs on it, and F_i the forces of that on the fluid while the post stands still at its place of rest,

    F_i(q, q') = F_i + S_i q + D_i q',     S_i, D_i: springs and dampers times the shape,
    m q'' + c q' + k q = -sum_i phi_i . F_i(q, q') = Q - K q - C q',
    Q = -sum_i phi_i . F_i,   K = sum_i phi_i . S_i,   C = sum_i phi_i . D_i,

Newton's third law: the post bears what the fluid is given, and the springs store 1/2 K q^2 - q sum_i S_i . d_i + what
they stored for displacements d_i at q = 0. Mass m [g], stiffness k [dyn/cm] and damper c [dyn s/cm] are those that the
tip feels.

A step of length dt is one of the implicit midpoint rule, with everything but q and q' as it is at the middle:

    (2 m / dt + c + C + (k + K) dt / 2) w = 2 m / dt q'_0 + Q - (k + K) q_0,     w = (q_1 - q_0) / dt,

and the fluid is given the forces at q_0 + w dt / 2 and w: what post, springs and fluid exchange balances to round-off.
As the body drifts half a step before and after, it is the splitting that the rest of the step is, without a limit of
its own: on one mass of fluid it is stable whenever it is with posts that stand still, at any mass, stiffness and step.
The exact solution over the step in its place is not: it grows where the post swings by half its period in a step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI

if TYPE_CHECKING:
    from valvefsi.types import Array, Indices


@dataclass(frozen=True, kw_only=True)
class Oscillator:
    """What each post is, as its tip sees it.

    Attributes:
        mass: m, positive [g].
        stiffness: k, force at the tip over its displacement, positive [dyn/cm].
        damping: c, not negative [dyn s/cm].

    Raises:
        ValueError: One is not so.
    """

    mass: float
    stiffness: float
    damping: float = 0.0

    def __post_init__(self) -> None:
        good = 0.0 < self.mass < np.inf and 0.0 < self.stiffness < np.inf and 0.0 <= self.damping < np.inf
        if not good:
            message = "expected mass > 0, stiffness > 0 and damping >= 0"
            raise ValueError(f"{message}, got {self.mass}, {self.stiffness}, {self.damping}")

    def midpoint(self, motion: Array, load: Array, attached: Array, dt: float) -> Array:
        """Return q and q' at the middle of a step, ``(m, 2)`` [cm, cm/s].

        Args:
            motion: q and q' at its beginning, ``(m, 2)`` [cm, cm/s].
            load: Q, ``(m,)`` [dyn].
            attached: K and C, ``(m, 2)`` [dyn/cm, dyn s/cm].
            dt: Its length [s].
        """
        (q, v), inertia = motion.T, 2.0 * self.mass / dt
        k, c = self.stiffness + attached[:, 0], self.damping + attached[:, 1]
        w = (inertia * v + load - k * q) / (inertia + c + 0.5 * dt * k)
        return np.stack([q + 0.5 * dt * w, w], axis=1)

    def energy(self, motion: Array) -> float:
        """Return what posts with q and q', ``(m, 2)``, store [erg]."""
        return float(0.5 * (motion**2 @ np.array([self.stiffness, self.mass])).sum())


class Attachment:
    """What hangs on posts: this rank's points.

    Args:
        post: The post of each point, ``(n,)``.
        shape: How it moves with the tip, ``(n, 3)``.
        springs: S, force on the fluid for a tip displaced by one, ``(n, 3)`` [dyn/cm].
        dampers: D, that for a tip moving by one, ``(n, 3)`` [dyn s/cm].
        count: Number of posts.
        comm: Communicator.

    Attributes:
        total: K and C, on all ranks, ``(m, 2)`` [dyn/cm, dyn s/cm].

    Note:
        Collective.
    """

    def __init__(
        self, post: Indices, shape: Array, springs: Array, dampers: Array, *, count: int, comm: MPI.Comm
    ) -> None:
        self.post, self.shape, self.springs, self.dampers = post, shape, springs, dampers
        self.count = count
        here = np.stack([self._sums(shape, springs), self._sums(shape, dampers)], axis=1)
        self.total: Array = comm.allreduce(here)

    def _sums(self, a: Array, b: Array) -> Array:
        """Return the sums of a . b over the points of each post, ``(m,)``."""
        return np.bincount(self.post, (a * b).sum(axis=1), minlength=self.count).astype(np.float64)

    def load(self, F: Array) -> Array:
        """Return what forces on the fluid, ``(n, 3)``, load each post with, this rank's part, ``(m,)`` [dyn]."""
        return -self._sums(self.shape, F)

    def force(self, motion: Array) -> Array:
        """Return the forces on the fluid that posts with q and q' add, ``(n, 3)`` [dyn]."""
        q, v = motion[self.post].T
        F: Array = self.springs * q[:, None] + self.dampers * v[:, None]
        return F

    def shift(self, motion: Array) -> Array:
        """Return how far posts with q and q' have moved the points, ``(n, 3)`` [cm]."""
        d: Array = self.shape * motion[self.post, :1]
        return d

    def energy(self, motion: Array, d: Array) -> float:
        """Return what posts with q and q' add to what springs store, this rank's part [erg].

        Args:
            motion: q and q', ``(m, 2)``.
            d: Displacements of the points, ``(n, 3)`` [cm].
        """
        return float(np.vdot(self.springs * motion[self.post, :1], 0.5 * self.shift(motion) - d))
