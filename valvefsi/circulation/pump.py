"""What the inlet of the aortic test section sees: pump, viscoelastic impedance adapter (VIA), mitral position.

Positive direction of every flow is DOWNSTREAM: Q_pump out of the pump into the VIA, Q_LV out of the ventricular
chamber toward the aorta. The source uses both signs: in S4-S5 its Q_LV is positive INTO the circuit, so that
Q_LV(S4, S5) = -q_lv here, and in S7-S8 it is positive out of it, Q_LV(S7, S8) = q_lv.
Parameters are CGS; any other coherent set, such as mmHg, ml and s, gives the same numbers in that set.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_banded

from valvefsi.circulation.linear import LinearSystem, check_values, reduce
from valvefsi.types import Array


@dataclass(frozen=True, kw_only=True)
class UpstreamPorcine:
    """The three-element upstream circuit of the porcine valve (Lee2020, S4-S5), q_lv = -Q_LV(S4, S5).

        C_VIA dP_VIA/dt = (P_pump - P_VIA) / R_1 - q_lv,    P_LV = P_VIA - R_2 q_lv

    Attributes:
        R_1: Resistance between the pump and the VIA [dyn s/cm^5].
        R_2: Resistance between the VIA and the ventricular chamber [dyn s/cm^5].
        C_VIA: Compliance of the VIA, 0 for rigid [cm^5/dyn].
    """

    R_1: float
    R_2: float
    C_VIA: float

    def __post_init__(self) -> None:
        check_values(self, ("R_1",), ("R_2", "C_VIA"))

    def system(self) -> LinearSystem:
        """Return the system: state p_via, inputs p_pump and q_lv, output p_lv."""
        names = (("p_via",), ("p_pump", "q_lv"), ("p_lv",))
        return reduce([self.C_VIA], [[-1 / self.R_1]], [[1 / self.R_1, -1.0]], [1.0], [0.0, -self.R_2], names)


@dataclass(frozen=True, kw_only=True)
class UpstreamBovine:
    """The five-element upstream circuit of the bovine valve (Lee2020, S6-S8), q_lv = Q_LV(S7, S8).

        C_VIA1 dP_VIA1/dt = Q_pump - (P_VIA1 - P_VIA2) / R_VIA
        C_VIA2 dP_VIA2/dt = (P_VIA1 - P_VIA2) / R_VIA - (P_VIA2 - P_LA + q_lv R_MV) / (R_out + R_MV)
        P_LV = (P_VIA2 R_MV + P_LA R_out - q_lv R_out R_MV) / (R_out + R_MV)

    Attributes:
        C_VIA1: Compliance of the VIA's first chamber, 0 for rigid [cm^5/dyn].
        C_VIA2: Compliance of its second chamber, 0 for rigid [cm^5/dyn].
        R_VIA: Resistance between the two [dyn s/cm^5].
        R_out: Resistance between the VIA and the ventricular chamber [dyn s/cm^5].
        R_MV: Resistance at the mitral position [dyn s/cm^5].
    """

    C_VIA1: float
    C_VIA2: float
    R_VIA: float
    R_out: float
    R_MV: float

    def __post_init__(self) -> None:
        check_values(self, ("R_VIA", "R_MV"), ("C_VIA1", "C_VIA2", "R_out"))

    def system(self) -> LinearSystem:
        """Return the system: states p_via1 and p_via2, inputs q_pump, q_lv and p_la, output p_lv."""
        through, out = 1 / self.R_VIA, 1 / (self.R_out + self.R_MV)
        A = [[-through, through], [through, -through - out]]
        B = [[1.0, 0.0, 0.0], [0.0, -self.R_MV * out, out]]
        C = [0.0, self.R_MV * out]
        D = [0.0, -self.R_out * self.R_MV * out, self.R_out * out]
        names = (("p_via1", "p_via2"), ("q_pump", "q_lv", "p_la"), ("p_lv",))
        return reduce([self.C_VIA1, self.C_VIA2], A, B, C, D, names)


@dataclass(frozen=True, kw_only=True, eq=False)
class PumpPressure:
    """The pressure of the pump that a measured record asks for.

    Attributes:
        t: Times, ``(n,)`` [s].
        p_pump: Pressure of the pump there, linear in between, ``(n,)`` [dyn/cm^2].
        p_via: Pressure in the VIA, ``(n,)`` [dyn/cm^2].
    """

    t: Array
    p_pump: Array
    p_via: Array


def pump_pressure(circuit: UpstreamPorcine, t: ArrayLike, q_lv: ArrayLike, p_lv: ArrayLike) -> PumpPressure:
    """Derive the pressure of the pump from the measured flow and pressure of the ventricular chamber (S4-S5).

        P_VIA = P_LV + R_2 q_lv,    P_pump = P_VIA + R_1 (C_VIA dP_VIA/dt + q_lv)

    The derivative is the one of the exact update: P_pump is the piecewise linear input that takes P_VIA from each
    sample to the next. That leaves one number free, the first value; it is the one that makes the curve smoothest
    (smallest sum of squared second differences). The record is taken as it is; smooth it first if it is noisy.

    Args:
        circuit: The circuit.
        t: Increasing times, ``(n,)`` [s].
        q_lv: Flow out of the chamber, positive downstream, ``(n,)`` [cm^3/s].
        p_lv: Pressure in the chamber, ``(n,)`` [dyn/cm^2].

    Returns:
        The pump's pressure; driven by it, from ``p_via[0]``, the circuit gives ``p_lv`` back to round-off.
    """
    t, q_lv, p_lv = (np.asarray(part, dtype=float) for part in (t, q_lv, p_lv))
    p_via = p_lv + circuit.R_2 * q_lv
    system = circuit.system()
    if not system.states:
        return PumpPressure(t=t, p_pump=p_via + circuit.R_1 * q_lv, p_via=p_via)
    E, G0, G1 = system.propagators(np.diff(t))
    right = p_via[1:] - E[:, 0, 0] * p_via[:-1] - G0[:, 0, 1] * q_lv[:-1] - G1[:, 0, 1] * q_lv[1:]
    # P_{n+1} + ratio P_n = known: one solution with P_0 = 0, one of the homogeneous equation with P_0 = 1
    rhs = np.zeros((len(t), 2))
    rhs[1:, 0], rhs[0, 1] = right / G1[:, 0, 0], 1.0
    band = np.stack([np.ones(len(t)), np.append(G0[:, 0, 0] / G1[:, 0, 0], 0.0)])
    particular, free = solve_banded((1, 0), band, rhs).T
    bend = np.diff(np.stack([particular, free]), min(2, len(t) - 1), axis=1)
    share = -(bend[0] @ bend[1]) / (bend[1] @ bend[1])
    return PumpPressure(t=t, p_pump=particular + share * free, p_via=p_via)
