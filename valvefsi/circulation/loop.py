"""The flow loop around the box of fluid: circuits at its open sides, coupled by first-order splitting.

A circuit sees the mean flow of a step through its side and gives the uniform pressure outside that side for the next
one. It is stepped exactly for a constant flow and inputs that are linear over the step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from valvefsi.circulation.linear import CircuitState, LinearSystem
from valvefsi.types import Array

FLOWS = {"q_ao": 1.0, "q_lv": -1.0}
"""Inputs that are the flow through a side, with their sign for a flow out of the box: downstream leaves the test
section into the outlet's circuit, and enters it from the ventricular chamber."""


@dataclass(frozen=True, kw_only=True)
class Connection:
    """A circuit at a side of the box.

    Attributes:
        side: Name of the side.
        system: The circuit; one of its inputs is ``q_ao`` or ``q_lv``.
        start: Initial states by name, 0 where nothing is said.
        drive: Function of t [s] that returns the other inputs by name.

    Raises:
        ValueError: The circuit has no flow, or ``drive`` does not give all its other inputs.
    """

    side: str
    system: LinearSystem
    start: Mapping[str, float] = field(default_factory=dict)
    drive: Callable[[float], Mapping[str, float]] = lambda t: {}

    def __post_init__(self) -> None:
        """Check the inputs."""
        flows = [name for name in self.system.inputs if name in FLOWS]
        if len(flows) != 1:
            raise ValueError(
                f"a circuit at a side needs one flow of {', '.join(FLOWS)}, got {self.system.inputs}"
            )
        missing = set(self.system.inputs) - set(flows) - set(self.drive(0.0))
        if missing:
            raise ValueError(f"nothing drives the input {min(missing)}")

    def inputs(self, t: float, outflow: float) -> Array:
        """Inputs at a time for a flow out of the box [cm^3/s]."""
        inputs = self.drive(t)
        return np.array(
            [FLOWS[name] * outflow if name in FLOWS else inputs[name] for name in self.system.inputs]
        )


class FlowLoop:
    """Circuits at sides of the box, as the coupled step asks for them (`valvefsi.types.Circulation`).

    Its state holds, circuit by circuit, the states of the circuit and the last mean flow out of the box.

    Args:
        connections: The circuits, each at a side of its own.

    Raises:
        ValueError: Two circuits at one side.
    """

    def __init__(self, connections: Sequence[Connection]) -> None:
        self.connections = tuple(connections)
        self.sides = tuple(c.side for c in self.connections)
        if len(set(self.sides)) < len(self.sides):
            raise ValueError(f"each side takes one circuit, got {', '.join(self.sides)}")
        self.ends = np.cumsum([len(c.system.states) + 1 for c in self.connections])
        self.start = np.concatenate(
            [
                part
                for c in self.connections
                for part in ([c.start.get(name, 0.0) for name in c.system.states], [0.0])
            ]
            or [[]]
        )

    def parts(self, y: Array) -> list[tuple[Array, float]]:
        """States and last mean flow out of the box of each circuit."""
        return [(part[:-1], float(part[-1])) for part in np.split(y, self.ends[:-1])]

    def pressures(self, y: Array, t: float) -> dict[str, float]:
        """Pressure outside each side for state y at time t [dyn/cm^2]."""
        return {
            c.side: float(c.system.C @ x + c.system.D @ c.inputs(t, flow))
            for c, (x, flow) in zip(self.connections, self.parts(y), strict=True)
        }

    def step(self, y: Array, outflow: Mapping[str, float], t: float, dt: float) -> Array:
        """Return the state at t + dt.

        Args:
            y: State at t.
            outflow: Mean flow of the step out of the box through each side [cm^3/s].
            t: Time [s].
            dt: Length of the step [s].
        """
        new: list[ArrayLike] = []
        for c, (x, _) in zip(self.connections, self.parts(y), strict=True):
            flow = outflow[c.side]
            state = CircuitState(t=t, x=x, u=c.inputs(t, flow))
            new += [c.system.advance(state, c.inputs(t + dt, flow), dt).x, [flow]]
        return np.concatenate(new)


class NoCirculation:
    """No circuits: every side keeps its own pressure."""

    sides: tuple[str, ...] = ()
    start: Array = np.zeros(0)

    def pressures(self, y: Array, t: float) -> Mapping[str, float]:
        """Return no pressures."""
        return {}

    def step(self, y: Array, outflow: Mapping[str, float], t: float, dt: float) -> Array:
        """Return the state, which is empty."""
        return y
