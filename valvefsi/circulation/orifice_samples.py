"""Many flow loops with an orifice at once, one for each sample of their parameters: `OrificeLoop` over arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from valvefsi.circulation.linear import LinearSystem
from valvefsi.circulation.loop import FLOWS
from valvefsi.types import Array

LEAST = 1e-12
"""Change of a change below which nothing is extrapolated."""
FURTHEST = 50.0
"""Largest factor by which a change over a beat is extrapolated."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Side:
    """A circuit of each sample at one side of the orifice, and what drives it.

    Attributes:
        systems: The circuit of each sample, ``(num_samples,)``, all with the same states and inputs.
        start: Initial states, ``(num_states,)`` or ``(num_samples, num_states)``.
        drive: Inputs other than the flow at every time of a beat, both ends included, ``(num_steps + 1, num_inputs)``;
            what stands in the place of the flow does not count.
    """

    systems: Sequence[LinearSystem]
    start: Array
    drive: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Orifices:
    """An orifice of each sample, see `Orifice`.

    Attributes:
        loss: Pressure difference over the square of a steady flow, ``(num_samples,)`` [g/cm^7].
        inertance: Inertances, ``(num_samples,)`` [g/cm^4].
    """

    loss: Array
    inertance: Array

    def step(self, q: Array, drop: Array, ahead: Array, falls: Array, dt: float) -> Array:
        """Return the flows a step on; as `Orifice.step` for each sample, ``(num_samples,)`` each."""
        pushed = self.inertance * q / dt + 0.5 * (drop - self.loss * q * q + ahead)
        held = self.inertance / dt + 0.5 * falls
        forward = np.maximum(pushed, 0.0)
        return 2.0 * forward / (held + np.sqrt(held * held + 2.0 * self.loss * forward))


@dataclass(eq=False)
class _March:
    """The circuits of one side as arrays, with what has happened so far."""

    side: Side
    dt: float
    x: Array = field(init=False)

    def __post_init__(self) -> None:
        systems = self.side.systems
        propagators = [system.propagators(self.dt) for system in systems]
        self.E, self.G0, self.G1 = (np.stack([one[k][0] for one in propagators]) for k in range(3))
        self.C, self.D = np.stack([s.C for s in systems]), np.stack([s.D for s in systems])
        self.flow = next(k for k, name in enumerate(systems[0].inputs) if name in FLOWS)
        self.sign = FLOWS[systems[0].inputs[self.flow]]
        self.x = np.broadcast_to(self.side.start, (len(systems), len(systems[0].states))).copy()
        self.rise = (self.C * self.G1[:, :, self.flow]).sum(axis=1) + self.D[:, self.flow]

    def inputs(self, step: int, outflow: Array) -> Array:
        """Return the inputs of each sample at a time for flows out of the box."""
        u = np.repeat(self.side.drive[None, step], len(self.x), axis=0)
        u[:, self.flow] = self.sign * outflow
        return u

    def pressure(self, x: Array, u: Array) -> Array:
        """Return the pressures [dyn/cm^2]."""
        return (self.C * x).sum(axis=1) + (self.D * u).sum(axis=1)

    def ahead(self, u: Array, u_new: Array) -> Array:
        """Return the states a step on."""
        return _times(self.E, self.x) + _times(self.G0, u) + _times(self.G1, u_new)


def _times(matrices: Array, vectors: Array) -> Array:
    return np.asarray((matrices * vectors[:, None, :]).sum(axis=2))


class OrificeLoops:
    """Loops of an orifice between two circuits, one for each sample, each as `OrificeLoop`.

    Args:
        valves: The orifices.
        inlet: Circuits upstream, with the input q_lv.
        outlet: Circuits downstream, with the input q_ao.
        period: Length of a beat, which the drives are of [s].
    """

    def __init__(self, valves: Orifices, inlet: Side, outlet: Side, period: float) -> None:
        self.steps = len(inlet.drive) - 1
        self.dt = period / self.steps
        self.valves = valves
        self.inlet, self.outlet = _March(inlet, self.dt), _March(outlet, self.dt)
        self.q = np.zeros(len(inlet.systems))

    def beat(self) -> dict[str, Array]:
        """Go through one beat from where the last ended, and return its waveforms.

        Returns:
            ``p_lv`` and ``p_ao`` [dyn/cm^2] and ``q_ao`` [cm^3/s], each ``(num_steps + 1, num_samples)``.
        """
        rows = [self._look(0)]
        for step in range(self.steps):
            self._step(step)
            rows.append(self._look(step + 1))
        return dict(zip(("p_lv", "p_ao", "q_ao"), np.array(rows).transpose(1, 0, 2), strict=True))

    def periodic(self, most: int, tolerance: float) -> tuple[dict[str, Array], Array]:
        """Go on beat by beat until every sample repeats itself.

        The states at the ends of three beats are extrapolated to where they go, each by itself (Aitken); what counts
        is only whether a whole beat then returns to where it began.

        Args:
            most: Largest number of beats.
            tolerance: Change over a beat, relative to the range of each waveform, that counts as none.

        Returns:
            The waveforms of the last beat, and by how much each sample changed over it, ``(num_samples,)``.
        """
        states: list[Array] = [self._states()]
        for _ in range(most):
            waves = self.beat()
            states.append(self._states())
            apart = np.stack([_change(wave) for wave in waves.values()]).max(axis=0)
            if (apart <= tolerance).all():
                break
            if len(states) == 3 and (apart <= 0.2).all():
                self._set(_extrapolated(states[0], states[1], states[2], apart <= tolerance))
                states = [self._states()]
            elif len(states) == 3:
                states = states[1:]
        return waves, apart

    def _look(self, step: int) -> tuple[Array, Array, Array]:
        pressures = [m.pressure(m.x, m.inputs(step, s * self.q)) for m, s in self._sides]
        return pressures[0], pressures[1], self.q

    @property
    def _sides(self) -> tuple[tuple[_March, float], tuple[_March, float]]:
        """The circuits, and the sign of a flow downstream where it is counted out of the box."""
        return (self.inlet, -1.0), (self.outlet, 1.0)

    def _step(self, step: int) -> None:
        nothing, drops = np.zeros_like(self.q), []
        still: list[Array] = []
        for march, sign in self._sides:
            u, u_new = march.inputs(step, sign * self.q), march.inputs(step + 1, nothing)
            still.append(march.ahead(u, u_new))
            drops.append((march.pressure(march.x, u), march.pressure(still[-1], u_new)))
        now, ahead = (drops[0][k] - drops[1][k] for k in range(2))
        falls = self.outlet.rise - self.inlet.rise
        self.q = self.valves.step(self.q, now, ahead, falls, self.dt)
        for (march, sign), x in zip(self._sides, still, strict=True):
            march.x = x + march.G1[:, :, march.flow] * (march.sign * sign * self.q)[:, None]

    def _states(self) -> Array:
        return np.concatenate([self.inlet.x, self.outlet.x], axis=1)

    def _set(self, states: Array) -> None:
        count = self.inlet.x.shape[1]
        self.inlet.x, self.outlet.x = states[:, :count].copy(), states[:, count:].copy()


def _change(wave: Array) -> Array:
    """Return the change over a beat over the range, ``(num_samples,)``."""
    span = np.ptp(wave, axis=0)
    return np.abs(wave[-1] - wave[0]) / np.where(span > 0.0, span, 1.0)


def _extrapolated(a: Array, b: Array, c: Array, repeats: NDArray[np.bool_]) -> Array:
    """Return where three states of a beat's end go; of samples that repeat themselves the last."""
    first, second = b - a, c - b
    slower = first - second
    known = np.abs(slower) > LEAST * (np.abs(c) + 1.0)
    factor = np.where(known, second / np.where(known, slower, 1.0), 0.0)
    return np.where(repeats[:, None], c, c + np.clip(factor, 0.0, FURTHEST) * second)
