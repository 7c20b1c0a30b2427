"""Incompressible plane stress of the materials, with its derivative by the parameters (S1-S3).

The specimen is acted on in its plane only, so that S33 = 0 gives the pressure:

    S = S_dev - p C^-1,  S_dev = 2 dW/dC,  p = S_dev33 / (C^-1)33                  (S1-S3)

With C33 = 1/det C of the plane and W(I1, I2, I4) the stress in the plane is

    S = 2 (W1 A + W2 B + W4 a (x) a),  A = I - C33 C^-1,  B = I1 I - C - C33 (I1 - C33) C^-1

Every function here takes complex numbers too, so that a complex step can check a derivative.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from valvefsi.fitting.problem import Parameter
from valvefsi.types import Array

DEGREE = np.pi / 180
STEP = 1e-30
"""Complex step of derivatives."""


@dataclass(frozen=True, kw_only=True)
class PlanarState:
    """Deformation in the plane at n points, out of the plane incompressible.

    Attributes:
        C11, C22, C12: Right Cauchy-Green tensor, ``(n,)``.
    """

    C11: Array
    C22: Array
    C12: Array

    @classmethod
    def of(cls, F: Array) -> PlanarState:
        """Return the state of in-plane deformation gradients, ``(n, 2, 2)``."""
        C = np.einsum("nki,nkj->nij", F, F)
        return cls(C11=C[:, 0, 0], C22=C[:, 1, 1], C12=C[:, 0, 1])

    @cached_property
    def C33(self) -> Array:
        """Square of the stretch out of the plane, 1/det C."""
        return 1 / (self.C11 * self.C22 - self.C12**2)

    @cached_property
    def I1(self) -> Array:
        """First invariant."""
        return self.C11 + self.C22 + self.C33

    @cached_property
    def pressure_part(self) -> Array:
        """C33 C^-1 in the plane, components 11, 22, 12."""
        return self.C33**2 * np.array([self.C22, self.C11, -self.C12])

    @cached_property
    def A(self) -> Array:
        """Direction of the stress of W1, ``(3, n)``."""
        return _IDENTITY[:, None] - self.pressure_part

    @cached_property
    def B(self) -> Array:
        """Direction of the stress of W2, ``(3, n)``."""
        C = np.array([self.C11, self.C22, self.C12])
        return self.I1 * _IDENTITY[:, None] - C - (self.I1 - self.C33) * self.pressure_part

    def along(self, angle: float) -> tuple[Array, Array, Array, Array]:
        """Return I4 and a (x) a of a direction at ``angle`` [deg], and their derivatives by the angle."""
        c, s = np.cos(angle * DEGREE), np.sin(angle * DEGREE)
        M = np.array([c * c, s * s, c * s])
        turned = np.array([-2 * c * s, 2 * c * s, c * c - s * s]) * DEGREE
        return self._double(M), M[:, None], self._double(turned), turned[:, None]

    def _double(self, M: Array) -> Array:
        """Return C : M."""
        return self.C11 * M[0] + self.C22 * M[1] + 2 * self.C12 * M[2]


_IDENTITY = np.array([1.0, 1.0, 0.0])


@dataclass(frozen=True, kw_only=True)
class Extent:
    """How far data reach; starts and bounds are taken from it.

    Attributes:
        stress: Largest stress [kPa].
        I1: Largest I1 - 3.
        I4: Smaller and larger of the largest I4 - 1 along the two axes.
        shear: The data hold shear.
    """

    stress: float
    I1: float
    I4: tuple[float, float]
    shear: bool

    @classmethod
    def of(cls, state: PlanarState, stress: float) -> Extent:
        """Return the extent of a state and its largest stress."""
        ends = sorted(max(float(np.max(C - 1)), 1e-3) for C in (state.C11, state.C22))
        size = max(float(np.max(state.I1 - 3)), 1e-4)
        shear = bool(np.max(np.abs(state.C12)) > 1e-6)
        return cls(stress=max(stress, 1e-12), I1=size, I4=(ends[0], ends[1]), shear=shear)

    def modulus(self, name: str, low: float = 1e-4, high: float = 1.0, linear: bool = True) -> Parameter:
        """Return a positive parameter with the unit of a stress."""
        bounds = (1e-10 * self.stress, 1e4 * self.stress)
        start = (low * self.stress, high * self.stress)
        return Parameter(
            name=name, unit="kPa", lower=bounds[0], upper=bounds[1], start=start, log=True, linear=linear
        )

    def exponent(self, name: str, small: float, large: float, least: float = 0.5) -> Parameter:
        """Return a positive exponent that multiplies numbers from ``small`` to ``large``.

        Starts make the argument of the exponential ``least`` to 12 where the data end.
        """
        return Parameter(
            name=name, lower=1e-4 / large, upper=80 / small, start=(least / large, 12 / small), log=True
        )


@dataclass(frozen=True, kw_only=True)
class PlanarMaterial(ABC):
    """A material whose plane stress is known in closed form.

    Attributes:
        model: Name of the material in a case file.
    """

    model: str = ""

    @abstractmethod
    def parameters(self, extent: Extent) -> tuple[Parameter, ...]:
        """Return its parameters."""

    @abstractmethod
    def stress(self, v: Array, state: PlanarState) -> Array:
        """Return S, components 11, 22, 12, ``(3, n)`` [kPa], for values ``(parameters,)``."""

    def gradient(self, v: Array, state: PlanarState) -> Array:
        """Return dS/dv, ``(parameters, 3, n)``, for values ``(parameters,)``; by a complex step if not overridden."""
        steps = v + STEP * 1j * np.eye(len(v))
        return np.array([self.stress(along, state).imag for along in steps]) / STEP

    def entries(self, v: Mapping[str, float]) -> dict[str, Any]:
        """Return the entries of a material table: numbers in kPa, angles [deg], a list of tables for families."""
        return dict(v)


def angle_parameter(angle: float | None, *, low: float = 0.0, high: float = 90.0) -> Parameter:
    """Return the angle of the fibres to axis 1, held or free."""
    return Parameter(
        name="angle", unit="deg", lower=-360.0, upper=360.0, start=(low, high), value=angle, period=180.0
    )


@dataclass(frozen=True, kw_only=True)
class NeoHookean(PlanarMaterial):
    """W = c1/2 (I1 - 3) (S21)."""

    model: str = "neo_hookean"

    def parameters(self, extent: Extent) -> tuple[Parameter, ...]:
        """Return c1."""
        return (extent.modulus("c1", 1e-2, 10),)

    def stress(self, v: Array, state: PlanarState) -> Array:
        """Return S, ``(3, n)`` [kPa], for values ``(1,)``."""
        return v[0] * state.A


@dataclass(frozen=True, kw_only=True)
class MooneyRivlin(PlanarMaterial):
    """W = c1 (I1 - 3) + c2 (I2 - 3) (S23)."""

    model: str = "mooney_rivlin"

    def parameters(self, extent: Extent) -> tuple[Parameter, ...]:
        """Return c1, c2."""
        most, start = 1e3 * extent.stress, (0.0, 10 * extent.stress)
        return tuple(
            Parameter(name=name, unit="kPa", lower=0.0, upper=most, start=start, linear=True)
            for name in ("c1", "c2")
        )

    def stress(self, v: Array, state: PlanarState) -> Array:
        """Return S, ``(3, n)`` [kPa], for values ``(2,)``."""
        return 2 * v[0] * state.A + 2 * v[1] * state.B


@dataclass(frozen=True, kw_only=True)
class LeeSacks(PlanarMaterial):
    """W = c0/2 (I1 - 3) + c1/2 (exp[c2 (I1 - 3)^2] - 1)."""

    model: str = "lee_sacks"

    def parameters(self, extent: Extent) -> tuple[Parameter, ...]:
        """Return c0, c1, c2."""
        moduli = (extent.modulus("c0"), extent.modulus("c1"))
        return (*moduli, extent.exponent("c2", extent.I1**2, extent.I1**2))

    def stress(self, v: Array, state: PlanarState) -> Array:
        """Return S, ``(3, n)`` [kPa], for values ``(3,)``."""
        X = state.I1 - 3
        return (v[0] + 2 * v[1] * v[2] * X * np.exp(v[2] * X**2)) * state.A


@dataclass(frozen=True, kw_only=True)
class MayNewmanYin(PlanarMaterial):
    """W = c0 (exp[c1 (I1 - 3)^2 + c2 (sqrt(I4) - 1)^4] - 1).

    Args:
        angle: Angle of the fibres to axis 1 [deg], None to fit it.
    """

    model: str = "may_newman_yin"
    angle: float | None = None

    def parameters(self, extent: Extent) -> tuple[Parameter, ...]:
        """Return c0, c1, c2, angle."""
        small, large = ((np.sqrt(1 + reach) - 1) ** 4 for reach in extent.I4)
        exponents = (extent.exponent("c1", extent.I1**2, extent.I1**2), extent.exponent("c2", small, large))
        return (extent.modulus("c0"), *exponents, angle_parameter(self.angle))

    def stress(self, v: Array, state: PlanarState) -> Array:
        """Return S, ``(3, n)`` [kPa], for values ``(4,)``."""
        c0, c1, c2, angle = v
        I4, M, _, _ = state.along(angle)
        X, root = state.I1 - 3, np.sqrt(I4)
        e = 4 * c0 * np.exp(c1 * X**2 + c2 * (root - 1) ** 4)
        return e * (c1 * X * state.A + c2 * (root - 1) ** 3 / root * M)

    def entries(self, v: Mapping[str, float]) -> dict[str, Any]:
        """Return the entries of a material table."""
        return {name: v[name] for name in ("c0", "c1", "c2")} | {"fibre": v["angle"]}


@dataclass(frozen=True, kw_only=True)
class Fung(PlanarMaterial):
    """W = c/2 (exp Q - 1), Q = a1 E11^2 + a2 E22^2 + 2 a3 E11 E22 + a4 E12^2 in the axes of the tissue.

    The form is positive where a3^2 < a1 a2; the ratio r3 = a3/sqrt(a1 a2) is fitted. Data without shear say
    nothing of a4 while the axes are held; it is then that of an isotropic sheet, a1 + a2 - 2 a3.

    Args:
        angle: Angle of the tissue's first axis to axis 1 [deg], None to fit it.
        shear: Whether a4 is fitted.
    """

    model: str = "fung"
    angle: float | None = 0.0
    shear: bool = True

    def parameters(self, extent: Extent) -> tuple[Parameter, ...]:
        """Return c, a1, a2, r3, angle and, with shear, a4."""
        small, large = (reach**2 / 4 for reach in extent.I4)
        names = ("a1", "a2", "a4") if self.shear else ("a1", "a2")
        one, two, *four = (extent.exponent(name, small, large) for name in names)
        ratio = Parameter(name="r3", lower=-0.999, upper=0.999, start=(-0.2, 0.9))
        return (extent.modulus("c"), one, two, ratio, angle_parameter(self.angle), *four)

    def stress(self, v: Array, state: PlanarState) -> Array:
        """Return S, ``(3, n)`` [kPa], for values ``(5,)`` or, with shear, ``(6,)``."""
        c, a1, a2, r3, angle = v[:5]
        a3 = r3 * np.sqrt(a1 * a2)
        a4 = v[5] if self.shear else a1 + a2 - 2 * a3
        turn = np.array([[np.cos(angle * DEGREE), np.sin(angle * DEGREE)]])
        turn = np.concatenate([turn, turn[:, ::-1] * [-1, 1]])  # rows: the tissue's axes
        E = np.array([[state.C11 - 1, state.C12], [state.C12, state.C22 - 1]]) / 2
        (E1, E12), (_, E2) = np.einsum("ai,ijn,bj->abn", turn, E, turn)
        e = c * np.exp(a1 * E1**2 + a2 * E2**2 + 2 * a3 * E1 * E2 + a4 * E12**2)
        T = e * np.array([[a1 * E1 + a3 * E2, a4 * E12 / 2], [a4 * E12 / 2, a2 * E2 + a3 * E1]])
        S = np.einsum("ai,abn,bj->ijn", turn, T, turn)
        return np.array([S[0, 0], S[1, 1], S[0, 1]])

    def entries(self, v: Mapping[str, float]) -> dict[str, Any]:
        """Return the entries of a material table."""
        a3 = v["r3"] * float(np.sqrt(v["a1"] * v["a2"]))
        a4 = v["a4"] if self.shear else v["a1"] + v["a2"] - 2 * a3
        axes = {"fibre": v["angle"], "sheet": v["angle"] + 90.0}
        return {"c": v["c"], "a1": v["a1"], "a2": v["a2"], "a3": a3, "a4": a4} | axes


SIMPLE: dict[str, type[PlanarMaterial]] = {
    "neo_hookean": NeoHookean,
    "mooney_rivlin": MooneyRivlin,
    "lee_sacks": LeeSacks,
}
"""Isotropic materials by name."""
