"""The circuits that can be fitted: their parameters in mmHg, ml and s, and the simulation that a fit compares."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from valvefsi.circulation.linear import STEP, LinearSystem, Sampling
from valvefsi.circulation.pump import UpstreamBovine, UpstreamPorcine
from valvefsi.circulation.windkessel import Downstream, FourElement, TwoElement
from valvefsi.errors import CaseError
from valvefsi.units import MMHG

RESISTANCE, COMPLIANCE, INERTANCE = "mmHg*s/ml", "ml/mmHg", "mmHg*s^2/ml"
SIZES = {RESISTANCE: MMHG, COMPLIANCE: 1 / MMHG, INERTANCE: MMHG, "mmHg": MMHG, "ml/s": 1.0}
"""Size in CGS of the units that parameters and initial states are given in."""
BOUNDS = {RESISTANCE: (1e-5, 100.0), COMPLIANCE: (1e-5, 100.0), INERTANCE: (1e-7, 100.0)}
STARTS = {"mmHg": (-500.0, 1000.0), "ml/s": (-5000.0, 5000.0)}
"""Bounds of initial states, by unit."""
TAIL = "_start"


@dataclass(frozen=True, kw_only=True)
class CircuitModel:
    """A circuit that can be fitted.

    Attributes:
        kind: Its class.
        parameters: Unit and range of starts of each parameter.
        inputs: What drives it.
        output: What is fitted.
        about: One line.
        together: Unit and function of combinations that data may fix where they do not fix each parameter.
    """

    kind: type
    parameters: Mapping[str, tuple[str, tuple[float, float]]]
    inputs: tuple[str, ...]
    output: str
    about: str
    together: Mapping[str, tuple[str, Callable[[Mapping[str, float]], float]]] = field(default_factory=dict)


CIRCUITS = {
    "downstream": CircuitModel(
        kind=Downstream,
        parameters={
            "R_c": (RESISTANCE, (0.01, 0.3)),
            "R_p": (RESISTANCE, (0.3, 4.0)),
            "C": (COMPLIANCE, (0.3, 4.0)),
        },
        inputs=("q_ao",),
        output="p_ao",
        about="three-element Windkessel of the outlet, S9-S10",
        together={
            "R_c + R_p": (RESISTANCE, lambda v: v["R_c"] + v["R_p"]),
            "R_p C": ("s", lambda v: v["R_p"] * v["C"]),
        },
    ),
    "two-element": CircuitModel(
        kind=TwoElement,
        parameters={"R_p": (RESISTANCE, (0.3, 4.0)), "C": (COMPLIANCE, (0.3, 4.0))},
        inputs=("q_ao",),
        output="p_ao",
        about="S9-S10 with R_c = 0",
        together={"R_p C": ("s", lambda v: v["R_p"] * v["C"])},
    ),
    "four-element": CircuitModel(
        kind=FourElement,
        parameters={
            "R_c": (RESISTANCE, (0.01, 0.3)),
            "R_p": (RESISTANCE, (0.3, 4.0)),
            "C": (COMPLIANCE, (0.3, 4.0)),
            "L": (INERTANCE, (1e-3, 0.1)),
        },
        inputs=("q_ao",),
        output="p_ao",
        about="S9-S10 with an inertance beside R_c",
        together={"R_p C": ("s", lambda v: v["R_p"] * v["C"]), "L / R_c": ("s", lambda v: v["L"] / v["R_c"])},
    ),
    "upstream-porcine": CircuitModel(
        kind=UpstreamPorcine,
        parameters={
            "R_1": (RESISTANCE, (0.02, 1.0)),
            "R_2": (RESISTANCE, (0.01, 0.3)),
            "C_VIA": (COMPLIANCE, (0.05, 2.0)),
        },
        inputs=("p_pump", "q_lv"),
        output="p_lv",
        about="R-C-R upstream circuit, S4-S5; q_lv positive downstream",
        together={
            "R_1 + R_2": (RESISTANCE, lambda v: v["R_1"] + v["R_2"]),
            "R_1 C_VIA": ("s", lambda v: v["R_1"] * v["C_VIA"]),
        },
    ),
    "upstream-bovine": CircuitModel(
        kind=UpstreamBovine,
        parameters={
            "C_VIA1": (COMPLIANCE, (0.02, 1.0)),
            "C_VIA2": (COMPLIANCE, (0.02, 1.0)),
            "R_VIA": (RESISTANCE, (0.01, 0.5)),
            "R_out": (RESISTANCE, (0.01, 0.3)),
            "R_MV": (RESISTANCE, (0.3, 20.0)),
        },
        inputs=("q_pump", "q_lv", "p_la"),
        output="p_lv",
        about="five-element upstream circuit, S6-S8; q_lv and q_pump positive downstream",
        together={
            "C_VIA1 + C_VIA2": (COMPLIANCE, lambda v: v["C_VIA1"] + v["C_VIA2"]),
            "C_VIA1 R_VIA": ("s", lambda v: v["C_VIA1"] * v["R_VIA"]),
            "C_VIA1 / R_VIA": ("ml^2/(mmHg^2*s)", lambda v: v["C_VIA1"] / v["R_VIA"]),
            "R_out R_MV / (R_out + R_MV)": (
                RESISTANCE,
                lambda v: v["R_out"] * v["R_MV"] / (v["R_out"] + v["R_MV"]),
            ),
        },
    ),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Simulator:
    """A circuit driven by a record: parameters in, pressure out.

    Attributes:
        model: The circuit.
        names: Names of the values, parameters first, then initial states (none where periodic).
        units: Their units.
        t: Times [s].
        u: Inputs, ``(n, num_inputs)``, CGS.
        periodic: Start from the periodic steady state.
    """

    model: CircuitModel
    names: tuple[str, ...]
    units: tuple[str, ...]
    t: NDArray
    u: NDArray
    periodic: bool

    def system(self, values: NDArray) -> LinearSystem:
        """Return the linear system of some values."""
        scaled = self._in_cgs(values)
        return self.model.kind(**{name: scaled[name] for name in self.model.parameters}).system()

    def states(self, values: NDArray) -> NDArray:
        """Return the states at all samples, CGS, ``(n, num_states)``."""
        return self._states(self.system(values), values)

    def curve(self, values: NDArray) -> NDArray:
        """Return the output at all samples [mmHg]."""
        system = self.system(values)
        return system.outputs(self._states(system, values), self.u) / MMHG

    @cached_property
    def sampling(self) -> Sampling:
        """The times, their intervals sorted by size."""
        return Sampling.of(self.t)

    def _states(self, system: LinearSystem, values: NDArray) -> NDArray:
        if self.periodic:
            start = system.periodic_state(self.sampling, self.u)
        else:
            scaled = self._in_cgs(values)
            start = np.array([scaled[f"{state}{TAIL}"] for state in system.states])
        return system.simulate(self.sampling, self.u, start)

    def jacobian(self, values: NDArray) -> NDArray:
        """Return the derivative of `curve` by all values, ``(n, num_values)``."""
        system = self.system(values)
        moved, place = [], []
        for i in range(len(self.model.parameters)):
            if values[i] != 0:  # held at zero, a rigid chamber: no derivative
                along = np.array(values, dtype=complex)
                along[i] += STEP * 1j
                moved.append(self.system(along))
                place.append(i)
        states = [] if self.periodic else [self.names.index(f"{state}{TAIL}") for state in system.states]
        start = np.zeros((len(system.states), len(moved) + len(states)))
        for row, i in enumerate(states):
            start[row, len(moved) + row] = SIZES[self.units[i]]
        u, x = self.u, self._states(system, values)
        slopes = system.sensitivities(self.sampling, u, x, moved, None if self.periodic else start)
        found = np.zeros((len(self.t), len(values)))
        found[:, place + states] = slopes / MMHG
        return found

    def _in_cgs(self, values: NDArray) -> dict[str, complex]:
        sizes = [SIZES[unit] for unit in self.units]
        return dict(zip(self.names, [v * s for v, s in zip(values, sizes, strict=True)], strict=True))


def find_circuit(name: str) -> CircuitModel:
    """Return a circuit by name.

    Raises:
        CaseError: There is none of that name.
    """
    if name not in CIRCUITS:
        raise CaseError(f"unknown circuit, expected one of {', '.join(CIRCUITS)}", key="circuit", value=name)
    return CIRCUITS[name]


def state_unit(state: str) -> str:
    """Return the unit of an initial state at the border."""
    return "ml/s" if state.startswith("q") else "mmHg"
