"""What the outlet of the aortic test section sees: two-, three- and four-element Windkessels.

Positive direction of the flow: Q_Ao > 0 leaves the test section downstream, INTO the Windkessel, as in S9-S10.
R_p is the peripheral (distal) resistance and R_c the characteristic (proximal) one.
Parameters are CGS; any other coherent set, such as mmHg, ml and s, gives the same numbers in that set.
"""

from __future__ import annotations

from dataclasses import dataclass

from valvefsi.circulation.linear import LinearSystem, check_values, reduce

NAMES = (("p_wk",), ("q_ao",), ("p_ao",))


@dataclass(frozen=True, kw_only=True)
class Downstream:
    """The three-element Windkessel of the outlet (Lee2020, S9-S10).

        C dP_Wk/dt = Q_Ao - P_Wk / R_p,    P_Ao = P_Wk + Q_Ao R_c

    Attributes:
        R_c: Characteristic resistance [dyn s/cm^5].
        R_p: Peripheral resistance [dyn s/cm^5].
        C: Compliance, 0 for rigid [cm^5/dyn].
    """

    R_c: float
    R_p: float
    C: float

    def __post_init__(self) -> None:
        check_values(self, ("R_p",), ("R_c", "C"))

    def system(self) -> LinearSystem:
        """Return the system: state p_wk, input q_ao, output p_ao."""
        return reduce([self.C], [[-1 / self.R_p]], [[1.0]], [1.0], [self.R_c], NAMES)


@dataclass(frozen=True, kw_only=True)
class TwoElement:
    """The two-element Windkessel, S9-S10 with R_c = 0.

        C dP_Wk/dt = Q_Ao - P_Wk / R_p,    P_Ao = P_Wk

    Attributes:
        R_p: Peripheral resistance [dyn s/cm^5].
        C: Compliance, 0 for rigid [cm^5/dyn].
    """

    R_p: float
    C: float

    def __post_init__(self) -> None:
        check_values(self, ("R_p",), ("C",))

    def system(self) -> LinearSystem:
        """Return the system: state p_wk, input q_ao, output p_ao."""
        return Downstream(R_c=0.0, R_p=self.R_p, C=self.C).system()


@dataclass(frozen=True, kw_only=True)
class FourElement:
    """The four-element Windkessel: an inertance beside R_c (Stergiopulos et al., 1999).

        C dP_Wk/dt = Q_Ao - P_Wk / R_p,    L dQ_L/dt = R_c (Q_Ao - Q_L),    P_Ao = P_Wk + R_c (Q_Ao - Q_L)

    Q_L is the flow through the inertance, positive downstream. L = 0 short-circuits R_c (two elements); a large L
    carries no flow in a cycle (three elements).

    Attributes:
        R_c: Characteristic resistance [dyn s/cm^5].
        R_p: Peripheral resistance [dyn s/cm^5].
        C: Compliance, 0 for rigid [cm^5/dyn].
        L: Inertance [dyn s^2/cm^5].
    """

    R_c: float
    R_p: float
    C: float
    L: float

    def __post_init__(self) -> None:
        check_values(self, ("R_c", "R_p"), ("C", "L"))

    def system(self) -> LinearSystem:
        """Return the system: states p_wk and q_l, input q_ao, output p_ao."""
        A = [[-1 / self.R_p, 0.0], [0.0, -self.R_c]]
        names = (("p_wk", "q_l"), ("q_ao",), ("p_ao",))
        return reduce([self.C, self.L], A, [[1.0], [self.R_c]], [1.0, -self.R_c], [self.R_c], names)
