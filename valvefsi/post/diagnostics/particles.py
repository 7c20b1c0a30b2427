"""Particles that drift with a velocity written at times, and the dose of a field along their paths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from valvefsi.types import Array, Mask

GOLDEN = np.pi * (3.0 - np.sqrt(5.0))
COURANT = 0.5
"""Cells that the fastest fluid passes in a step of the particles."""
MOST_STEPS = 2000
"""Steps from one written time to the next above which a velocity is taken for a fault."""


@dataclass(frozen=True, kw_only=True)
class Written:
    """Velocity and a scalar in the cells at one time.

    Attributes:
        t: Time [s].
        edges: Edges of the cells along each axis [cm].
        values: Velocity and the scalar, ``(nx, ny, nz, 4)`` [cm/s, the scalar's unit].
    """

    t: float
    edges: tuple[Array, Array, Array]
    values: Array

    @property
    def centres(self) -> list[Array]:
        """Centres of the cells along each axis [cm]."""
        return [0.5 * (e[1:] + e[:-1]) for e in self.edges]

    @property
    def rate(self) -> float:
        """Largest |u_d|/h_d [1/s]."""
        widths = [float(np.diff(e).min()) for e in self.edges]
        return max(float(np.abs(self.values[..., d]).max()) / h for d, h in enumerate(widths))


def seeds_on_disk(radius: float, z: float, count: int) -> Array:
    """Return points that each stand for as much of a disk about the z axis, ``(count, 3)`` [cm]."""
    k = np.arange(count) + 0.5
    r, phi = radius * np.sqrt(k / count), GOLDEN * k
    return np.stack([r * np.cos(phi), r * np.sin(phi), np.full(count, z)], axis=1)


class Particles:
    """Particles without mass.

    Attributes:
        x: Positions, ``(n, 3)`` [cm].
        dose: Integral of the scalar over the time since the particle was released, ``(n,)`` [its unit x s].
        age: That time, ``(n,)`` [s].
        inside: Which of them are still in the box, ``(n,)``; the others stay where they left it.
    """

    def __init__(self, seeds: Array) -> None:
        self.x = np.array(seeds, dtype=float)
        self.dose, self.age = np.zeros(len(self.x)), np.zeros(len(self.x))
        self.inside: Mask = np.ones(len(self.x), dtype=bool)

    def advance(self, before: Written, after: Written, since: float | None = None) -> None:
        """Carry them from one written time to the next, the velocity linear in time and space between.

        Runge-Kutta steps of fourth order in which the fastest fluid passes half a cell; the dose by Simpson's rule.

        Args:
            before: The earlier time.
            after: The later one.
            since: When they begin, between the two; with the earlier unless given [s].
        """
        start = before.t if since is None else since
        length = after.t - start
        if length <= 0.0 or not self.inside.any():
            return
        steps = max(1, int(np.ceil(length * max(before.rate, after.rate) / COURANT)))
        if steps > MOST_STEPS:
            raise ValueError(f"{steps} steps of the particles from t = {start:.6g} s to {after.t:.6g} s")
        centres = before.centres
        dt = length / steps
        for k in range(steps):
            self._step(before, after, centres, (start + k * dt, dt))

    def velocity(self, before: Written, after: Written, t: float) -> Array:
        """Return the velocity at the particles at a time between two written ones, ``(n, 3)`` [cm/s]."""
        s = (t - before.t) / (after.t - before.t)
        return _linear(before.values, after.values, s, before.centres, self.x)[:, :3]

    def _step(
        self, before: Written, after: Written, centres: Sequence[Array], time: tuple[float, float]
    ) -> None:
        """Carry them over one step, from a time on for a while."""
        (t, dt), own = time, np.flatnonzero(self.inside)
        span = after.t - before.t

        def at(x: Array, when: float) -> Array:
            s = (when - before.t) / span
            return _linear(before.values, after.values, s, centres, x)

        x = self.x[own]
        a = at(x, t)
        b = at(x + 0.5 * dt * a[:, :3], t + 0.5 * dt)
        c = at(x + 0.5 * dt * b[:, :3], t + 0.5 * dt)
        d = at(x + dt * c[:, :3], t + dt)
        mean = (a + 2.0 * b + 2.0 * c + d) / 6.0
        self.x[own] = x = x + dt * mean[:, :3]
        self.dose[own] += dt * mean[:, 3]
        self.age[own] += dt
        out = np.zeros(len(own), dtype=bool)
        for axis, e in enumerate(before.edges):
            out |= (x[:, axis] < e[0]) | (x[:, axis] > e[-1])
        self.inside[own[out]] = False


def _linear(first: Array, second: Array, s: float, centres: Sequence[Array], x: Array) -> Array:
    """Values at points, linear in time between two arrays and in space between the centres of the cells."""
    lower, parts = [], []
    for axis, at in enumerate(centres):
        k = np.clip(np.searchsorted(at, x[:, axis], side="right") - 1, 0, len(at) - 2)
        lower.append(k)
        parts.append(np.clip((x[:, axis] - at[k]) / (at[k + 1] - at[k]), 0.0, 1.0))
    found = np.zeros((len(x), first.shape[-1]))
    for corner in range(8):
        up = [(corner >> axis) & 1 for axis in range(3)]
        weight = np.ones(len(x))
        for part, one in zip(parts, up, strict=True):
            weight = weight * (part if one else 1.0 - part)
        i, j, k = (low + one for low, one in zip(lower, up, strict=True))
        found += weight[:, None] * ((1.0 - s) * first[i, j, k] + s * second[i, j, k])
    return found
