"""The circuits that can be fitted: their parameters in mmHg, ml and s, and the simulation that a fit compares."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from valvefsi.circulation.linear import STEP, LinearSystem
from valvefsi.circulation.pump import UpstreamBovine, UpstreamPorcine
from valvefsi.circulation.sampling import Sampling
from valvefsi.circulation.windkessel import Downstream, FourElement, TwoElement
from valvefsi.errors import CaseError
from valvefsi.types import Array, Indices
from valvefsi.units import MMHG

RESISTANCE, COMPLIANCE, INERTANCE = "mmHg*s/ml", "ml/mmHg", "mmHg*s^2/ml"
UNITS = {"R": RESISTANCE, "C": COMPLIANCE, "L": INERTANCE, "p": "mmHg", "q": "ml/s"}
"""Unit of a parameter or a state, by the first letter of its name."""
SIZES = {RESISTANCE: MMHG, COMPLIANCE: 1 / MMHG, INERTANCE: MMHG, "mmHg": MMHG, "ml/s": 1.0, "ms": 1e-3}
"""Size in CGS of the units that parameters and initial states are given in."""
BOUNDS = {RESISTANCE: (1e-5, 100.0), COMPLIANCE: (1e-5, 100.0), INERTANCE: (1e-7, 100.0)}
STARTS = {"mmHg": (-500.0, 1000.0), "ml/s": (-5000.0, 5000.0)}
"""Bounds of initial states, by unit."""
TAIL, LAG = "_start", "lag"
"""What the name of a state is followed by where it is an initial one; name of the lag."""
EVEN = 1e-5
"""Part of an interval by which a time may be off an even grid and count as on it: far below what recorders keep."""
Named = Mapping[str, complex]


@dataclass(frozen=True, kw_only=True)
class Combination:
    """A function of parameters that data may fix where they do not fix each of them, and its unit."""

    unit: str
    function: Callable[[Named], complex]


@dataclass(frozen=True, kw_only=True)
class CircuitModel:
    """A circuit that can be fitted.

    Attributes:
        kind: Its class.
        starts: Range of starts of each parameter, in mmHg, ml and s.
        inputs: What drives it.
        output: What is fitted.
        about: One line.
        together: Combinations that data may fix where they do not fix each parameter.
    """

    kind: Callable[..., Any]
    starts: Mapping[str, tuple[float, float]]
    inputs: tuple[str, ...]
    output: str
    about: str
    together: Mapping[str, Combination] = field(default_factory=dict)

    @property
    def parameters(self) -> dict[str, str]:
        """Unit of each parameter by its name."""
        return {name: UNITS[name[0]] for name in self.starts}


def _sum(one: str, other: str) -> dict[str, Combination]:
    return {f"{one} + {other}": Combination(unit=UNITS[one[0]], function=lambda v: v[one] + v[other])}


def _time(one: str, other: str) -> dict[str, Combination]:
    return {f"{one} {other}": Combination(unit="s", function=lambda v: v[one] * v[other])}


def _ratio(one: str, other: str, unit: str) -> dict[str, Combination]:
    return {f"{one} / {other}": Combination(unit=unit, function=lambda v: v[one] / v[other])}


PARALLEL = Combination(unit=RESISTANCE, function=lambda v: v["R_out"] * v["R_MV"] / (v["R_out"] + v["R_MV"]))

CIRCUITS = {
    "downstream": CircuitModel(
        kind=Downstream,
        starts={"R_c": (0.01, 0.3), "R_p": (0.3, 4.0), "C": (0.3, 4.0)},
        inputs=("q_ao",),
        output="p_ao",
        about="three-element Windkessel of the outlet, S9-S10",
        together=_sum("R_c", "R_p") | _time("R_p", "C"),
    ),
    "two-element": CircuitModel(
        kind=TwoElement,
        starts={"R_p": (0.3, 4.0), "C": (0.3, 4.0)},
        inputs=("q_ao",),
        output="p_ao",
        about="S9-S10 with R_c = 0",
        together=_time("R_p", "C"),
    ),
    "four-element": CircuitModel(
        kind=FourElement,
        starts={"R_c": (0.01, 0.3), "R_p": (0.3, 4.0), "C": (0.3, 4.0), "L": (1e-3, 0.1)},
        inputs=("q_ao",),
        output="p_ao",
        about="S9-S10 with an inertance beside R_c",
        together=_time("R_p", "C") | _ratio("L", "R_c", "s"),
    ),
    "upstream-porcine": CircuitModel(
        kind=UpstreamPorcine,
        starts={"R_1": (0.02, 1.0), "R_2": (0.01, 0.3), "C_VIA": (0.05, 2.0)},
        inputs=("p_pump", "q_lv"),
        output="p_lv",
        about="R-C-R upstream circuit, S4-S5; q_lv positive downstream",
        together=_sum("R_1", "R_2") | _time("R_1", "C_VIA"),
    ),
    "upstream-bovine": CircuitModel(
        kind=UpstreamBovine,
        starts={
            "C_VIA1": (0.02, 1.0),
            "C_VIA2": (0.02, 1.0),
            "R_VIA": (0.01, 0.5),
            "R_out": (0.01, 0.3),
            "R_MV": (0.3, 20.0),
        },
        inputs=("q_pump", "q_lv", "p_la"),
        output="p_lv",
        about="five-element upstream circuit, S6-S8; q_lv and q_pump positive downstream",
        together=_sum("C_VIA1", "C_VIA2")
        | _time("C_VIA1", "R_VIA")
        | _ratio("C_VIA1", "R_VIA", "ml^2/(mmHg^2*s)")
        | {"R_out R_MV / (R_out + R_MV)": PARALLEL},
    ),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Simulator:
    """A circuit driven by a record: parameters in, pressure out.

    Attributes:
        model: The circuit.
        names: Names of the values: parameters, then initial states (none where periodic), then the lag if there is
            one, by which the output follows the inputs.
        units: Their units.
        t: Times, ``(n,)`` [s].
        u: Inputs, ``(n, num_inputs)``, CGS.
        kept: Numbers of the samples that are compared, ``(m,)``.
        periodic: Start from the periodic steady state.
    """

    model: CircuitModel
    names: tuple[str, ...]
    units: tuple[str, ...]
    t: Array
    u: Array
    kept: Indices
    periodic: bool
    _last: dict[str, Any] = field(default_factory=dict, repr=False)

    def system(self, values: Array) -> LinearSystem:
        """Return the linear system of some values, ``(num_values,)``."""
        scaled = self._in_cgs(values)
        system: LinearSystem = self.model.kind(**{name: scaled[name] for name in self.model.starts}).system()
        return system

    def states(self, values: Array) -> Array:
        """Return the states at all samples, CGS, ``(n, num_states)``, for values ``(num_values,)``."""
        values = np.asarray(values)
        if self._last.get("key") != values.tobytes():
            states = self._states(self.system(values), values)
            self._last.update(key=values.tobytes(), states=states)
        kept: Array = self._last["states"]
        return kept

    def curve(self, values: Array) -> Array:
        """Return the output at the samples that are compared, ``(m,)`` [mmHg], for values ``(num_values,)``."""
        system, x = self.system(values), self.states(values)
        if LAG not in self.names:
            return system.outputs(x, self.u)[self.kept] / MMHG
        return self._lagged(system, x, values)[0] / MMHG

    @cached_property
    def sampling(self) -> Sampling:
        """The times, their intervals sorted by size; times on an even grid but for their rounding are put on it."""
        even, h = np.linspace(self.t[0], self.t[-1], len(self.t), retstep=True)
        if np.abs(even - self.t).max() > EVEN * h:
            return Sampling.of(self.t)
        return Sampling(t=even, sizes=np.array([float(h)]), which=np.zeros(len(even) - 1, int))

    def jacobian(self, values: Array) -> Array:
        """Return the derivative of `curve` by all values, ``(m, num_values)``, for values ``(num_values,)``."""
        system, x = self.system(values), self.states(values)
        moved, place = [], []
        for i in range(len(self.model.starts)):
            if values[i] != 0:  # held at zero, a rigid chamber: no derivative
                along = np.array(values, dtype=complex)
                along[i] += STEP * 1j
                moved.append(self.system(along))
                place.append(i)
        states = [] if self.periodic else [self.names.index(f"{state}{TAIL}") for state in system.states]
        start = np.zeros((len(system.states), len(moved) + len(states)))
        for row, i in enumerate(states):
            start[row, len(moved) + row] = SIZES[self.units[i]]
        slopes = (
            system.sensitivities(self.sampling, self.u, x, moved, None if self.periodic else start) / MMHG
        )
        columns = np.zeros((len(self.kept), len(values)))
        if LAG not in self.names:
            columns[:, place + states] = slopes[self.kept]
            return columns
        late = self._late(values)
        columns[:, place + states] = np.array([np.interp(late, self.t, slope) for slope in slopes.T]).T
        columns[:, -1] = -self._lagged(system, x, values)[1] * SIZES[self.units[-1]] / MMHG
        return columns

    def _late(self, values: Array) -> Array:
        """Return the times that the output compared is read at, ``(m,)`` [s]."""
        late = self.t[self.kept] - values[-1].real * SIZES[self.units[-1]]
        return self.t[0] + (late - self.t[0]) % (self.t[-1] - self.t[0]) if self.periodic else late

    def _lagged(self, system: LinearSystem, x: Array, values: Array) -> tuple[Array, Array]:
        """Return the output y(t - lag), ``(m,)``, and its derivative by time.

        Between samples C x is the cubic through its values and derivatives C (A x + B u), D u is linear.
        """
        late, t = self._late(values), self.t
        k = np.clip(np.searchsorted(t, late, side="right") - 1, 0, len(t) - 2)
        h = t[k + 1] - t[k]
        s = (late - t[k]) / h
        c, slope, straight = (
            x @ system.C,
            (x @ system.A.T + self.u @ system.B.T) @ system.C,
            self.u @ system.D,
        )
        a, b, left, right = c[k], c[k + 1], h * slope[k], h * slope[k + 1]
        cubic, square = left + right - 2 * (b - a), 3 * (b - a) - 2 * left - right
        rise = straight[k + 1] - straight[k]
        y = a + s * (left + s * (square + s * cubic)) + straight[k] + s * rise
        return y, (left + s * (2 * square + 3 * s * cubic) + rise) / h

    def _states(self, system: LinearSystem, values: Array) -> Array:
        if self.periodic:
            start = system.periodic_state(self.sampling, self.u)
        else:
            scaled = self._in_cgs(values)
            start = np.array([scaled[f"{state}{TAIL}"] for state in system.states])
        return system.simulate(self.sampling, self.u, start)

    def _in_cgs(self, values: Array) -> dict[str, Any]:
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
