"""The flow loop without space: an orifice with inertance between the upstream and the downstream circuit.

It stands in for the valve and the test section, so that a valve in three dimensions can be held against it.
Parameters are CGS; the positive direction of the flow is downstream.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from valvefsi.circulation.linear import CircuitState, check_values
from valvefsi.circulation.loop import FLOWS, Connection
from valvefsi.types import Array


@dataclass(frozen=True, kw_only=True)
class Orifice:
    """A one-way orifice, open with one effective area or shut.

        open:  L dq/dt = P_LV - P_Ao - B q^2,   B = rho / (2 EOA^2);     shut:  q = 0

    It opens when the pressure difference drives forward flow, and shuts when the flow has come to rest.

    Attributes:
        area: Effective orifice area, EOA [cm^2].
        inertance: Of the fluid in and around it, L [g/cm^4].
        rho: Density of the fluid [g/cm^3].
    """

    area: float
    inertance: float
    rho: float

    def __post_init__(self) -> None:
        check_values(self, ("area", "inertance", "rho"))

    @property
    def loss(self) -> float:
        """Pressure difference over the square of a steady flow, B [g/cm^7]."""
        return self.rho / (2.0 * self.area**2)

    def step(self, q: float, drop: float, ahead: tuple[float, float], dt: float) -> float:
        """Return the flow a step on, by the trapezoidal rule; 0 where that would be backward.

            L (q_new - q) / dt = (drop - B q^2) / 2 + (a - b q_new - B q_new^2) / 2

        Args:
            q: Flow [cm^3/s].
            drop: Pressure difference that belongs to it [dyn/cm^2].
            ahead: Pressure difference a step on where nothing flows, a [dyn/cm^2], and by how much it falls with the
                flow there, b >= 0 [dyn s/cm^5].
            dt: Step [s].
        """
        a, b = ahead
        pushed = self.inertance * q / dt + 0.5 * (drop - self.loss * q * q + a)
        if pushed <= 0.0:
            return 0.0
        held = self.inertance / dt + 0.5 * b
        return 2.0 * pushed / (held + float(np.sqrt(held * held + 2.0 * self.loss * pushed)))


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopState:
    """What the loop remembers between two steps: the two circuits, which hold the time, and the flow [cm^3/s]."""

    inlet: CircuitState
    outlet: CircuitState
    q: float


class OrificeLoop:
    """An orifice between two circuits, as a valve in three dimensions is connected to them.

    The circuits are stepped exactly for a flow that is linear over the step, the orifice by the trapezoidal rule with
    both pressures at the new flow: second order in the step, stable for any.

    Args:
        valve: The orifice.
        inlet: Circuit upstream of it, with the input q_lv.
        outlet: Circuit downstream of it, with the input q_ao.

    Raises:
        ValueError: A circuit is at the wrong end.
    """

    def __init__(self, valve: Orifice, inlet: Connection, outlet: Connection) -> None:
        self.valve, self.inlet, self.outlet = valve, inlet, outlet
        for connection, name in ((inlet, "q_lv"), (outlet, "q_ao")):
            if name not in connection.system.inputs:
                inputs = ", ".join(connection.system.inputs)
                raise ValueError(
                    f"side {connection.side}: expected a circuit with the input {name}, got {inputs}"
                )

    def begin(self, t: float = 0.0) -> LoopState:
        """Return the state at a time, with nothing flowing and the circuits where their connections start."""
        states = [
            c.system.start([c.start.get(name, 0.0) for name in c.system.states], c.inputs(t, 0.0), t)
            for c in (self.inlet, self.outlet)
        ]
        return LoopState(inlet=states[0], outlet=states[1], q=0.0)

    def pressures(self, s: LoopState) -> tuple[float, float]:
        """Return P_LV and P_Ao [dyn/cm^2]."""
        return self.inlet.system.observe(s.inlet), self.outlet.system.observe(s.outlet)

    def step(self, s: LoopState, dt: float) -> LoopState:
        """Return the state a step of ``dt`` [s] on."""
        p_lv, p_ao = self.pressures(s)
        still = self._advanced(s, 0.0, dt)
        ahead = self.pressures(still)
        falls = _rise(self.outlet, dt) - _rise(self.inlet, dt)
        q = self.valve.step(s.q, p_lv - p_ao, (ahead[0] - ahead[1], falls), dt)
        return still if q == 0.0 else self._advanced(s, q, dt)

    def run(self, s: LoopState, steps: int, dt: float) -> tuple[dict[str, Array], LoopState]:
        """Return the waveforms of some steps, their first state included, and the state after them.

        Args:
            s: State to begin with; it is not changed.
            steps: Number of steps.
            dt: Step [s].

        Returns:
            By name ``t`` [s], ``p_lv`` and ``p_ao`` [dyn/cm^2] and ``q_ao`` [cm^3/s], each ``(steps + 1,)``.
        """
        rows = [(s.inlet.t, *self.pressures(s), s.q)]
        for _ in range(steps):
            s = self.step(s, dt)
            rows.append((s.inlet.t, *self.pressures(s), s.q))
        return dict(zip(("t", "p_lv", "p_ao", "q_ao"), np.array(rows).T, strict=True)), s

    def _advanced(self, s: LoopState, q: float, dt: float) -> LoopState:
        t = s.inlet.t + dt
        inlet = self.inlet.system.advance(s.inlet, self.inlet.inputs(t, -q), dt)
        outlet = self.outlet.system.advance(s.outlet, self.outlet.inputs(t, q), dt)
        return LoopState(inlet=inlet, outlet=outlet, q=q)


def _rise(connection: Connection, dt: float) -> float:
    """Return by how much the pressure at the end of a step rises with the flow there [dyn s/cm^5]."""
    system = connection.system
    flow = next(k for k, name in enumerate(system.inputs) if name in FLOWS)
    return float(system.C @ system.propagators(dt)[2][0][:, flow] + system.D[flow])


def orifice_of(t: Array, drop: Array, q: Array, loss: float | None = None) -> tuple[float, float]:
    """Return inertance and loss that measured forward flow shows.

        int (P_LV - P_Ao) dt = L (q - q_0) + B int q |q| dt,   least squares over all times

    Args:
        t: Times of forward flow, ascending, ``(n,)`` [s].
        drop: Pressure difference P_LV - P_Ao, ``(n,)`` [dyn/cm^2].
        q: Flow, ``(n,)`` [cm^3/s].
        loss: B where it is known [g/cm^7]; it is found with L unless given.

    Returns:
        L [g/cm^4] and B [g/cm^7]; either may come out negative where the record is not of an orifice.

    Raises:
        ValueError: The flow does not change.
    """
    gained = q - q[0]
    if not np.any(gained):
        raise ValueError(f"q: expected a flow that changes, found {q[0]} throughout")
    pushed, lost = _integral(t, drop), _integral(t, q * np.abs(q))
    if loss is not None:
        return float((pushed - loss * lost) @ gained / (gained @ gained)), loss
    fit = np.linalg.lstsq(np.stack([gained, lost], axis=1), pushed)[0]
    return float(fit[0]), float(fit[1])


def _integral(t: Array, y: Array) -> Array:
    """Return the integral from the first time on, by the trapezoidal rule, ``(n,)``."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(t))])
