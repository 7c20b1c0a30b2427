"""Incompressible plane stress of the modified Holzapfel-Gasser-Ogden material (Lee2020, eqs 4-5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from valvefsi.fitting.planar import Extent, PlanarState, angle_parameter
from valvefsi.fitting.problem import Parameter
from valvefsi.types import Array

KINDS = ("1", "2", "2-kappas", "symmetric")
TWO = ("2", "2-kappas")


@dataclass(frozen=True, kw_only=True)
class HGO:
    """Exponential matrix and families of fibres.

        W = c10 {exp[c01 (I1 - 3)] - 1} + sum_f k1/(2 k2) (exp[k2 E_f^2] - 1),
        E_f = kappa (I1 - 3) + (1 - 3 kappa) (I4* - 1),    I4* = max(I4, 1)

    Args:
        families: ``1``; ``2`` at right angles with constants of their own and one kappa; ``2-kappas``: each with
            its own kappa as well; ``symmetric``: two at +angle and -angle with the same constants.
        angle: Angle of the first family to axis 1 [deg], None to fit it.
    """

    families: str = "1"
    angle: float | None = None
    model: str = "hgo"

    def parameters(self, extent: Extent) -> tuple[Parameter, ...]:
        """Return c10, c01, kappa, angle, and k1, k2 (k1_1, k2_1, k1_2, k2_2 of two families; kappa_1 and kappa_2)."""
        low, high = (-45.0, 45.0) if self.families in TWO else (0.0, 90.0)
        common = (
            extent.modulus("c10", 1e-6, 1e-1),
            extent.exponent("c01", extent.I1, extent.I1, least=3.0),
            _dispersion("kappa_1" if self.families == "2-kappas" else "kappa"),
            angle_parameter(self.angle, low=low, high=high),
        )
        reach = (extent.I4[0] ** 2, extent.I4[1] ** 2)
        found = list(common)
        for ending in ("_1", "_2") if self.families in TWO else ("",):
            found += [extent.modulus(f"k1{ending}"), extent.exponent(f"k2{ending}", *reach)]
        if self.families == "2-kappas":
            found.append(_dispersion("kappa_2"))
        return tuple(found)

    def stress(self, v: Array, state: PlanarState) -> Array:
        """Return S, components 11, 22, 12, ``(3, n)`` [kPa]."""
        c10, c01, _, angle = v[:4]
        S = 2 * c10 * c01 * np.exp(c01 * (state.I1 - 3)) * state.A
        for k1, k2, sign, shift, (_, at_kappa) in self._each(v):
            S = S + _Family(state, v[at_kappa], sign * angle + shift, k1, k2).stress
        return S

    def gradient(self, v: Array, state: PlanarState) -> Array:
        """Return dS/dv, ``(parameters, 3, n)``."""
        c10, c01, _, angle = v[:4]
        X = state.I1 - 3
        found = np.zeros((len(v), 3, len(X)), dtype=np.result_type(v, X))
        matrix = 2 * np.exp(c01 * X) * state.A
        found[0], found[1] = c01 * matrix, c10 * (1 + c01 * X) * matrix
        for k1, k2, sign, shift, (at, at_kappa) in self._each(v):
            family = _Family(state, v[at_kappa], sign * angle + shift, k1, k2)
            found[at_kappa] += family.by_kappa
            found[3] += sign * family.by_angle
            found[at] += family.by_k1
            found[at + 1] += family.by_k2
        return found

    def _each(self, v: Array) -> list[tuple]:
        """Return k1, k2, sign and shift of the angle, and the positions of k1 and kappa, of each family."""
        if self.families in TWO:
            second = 8 if self.families == "2-kappas" else 2
            return [(v[4], v[5], 1, 0.0, (4, 2)), (v[6], v[7], 1, 90.0, (6, second))]
        if self.families == "symmetric":
            return [(v[4], v[5], 1, 0.0, (4, 2)), (v[4], v[5], -1, 0.0, (4, 2))]
        return [(v[4], v[5], 1, 0.0, (4, 2))]

    def entries(self, v: Mapping[str, float]) -> dict[str, object]:
        """Return the entries of a material table."""
        table = []
        endings = {
            "1": [("", 1, 0)],
            "2": [("_1", 1, 0), ("_2", 1, 90)],
            "2-kappas": [("_1", 1, 0), ("_2", 1, 90)],
            "symmetric": [("", 1, 0), ("", -1, 0)],
        }
        for ending, sign, shift in endings[self.families]:
            kappa = v["kappa"] if "kappa" in v else v[f"kappa{ending}"]
            constants = {"k1": v[f"k1{ending}"], "k2": v[f"k2{ending}"], "kappa": kappa}
            table.append(constants | {"fibre": sign * v["angle"] + shift})
        return {"c10": v["c10"], "c01": v["c01"], "families": table}


def _dispersion(name: str) -> Parameter:
    return Parameter(name=name, lower=0.0, upper=1 / 3, start=(0.0, 0.25))


class _Family:
    """Stress of one family of fibres and its derivatives.

    g = dW/dE = k1 E exp(k2 E^2);  S = 2 g D,  D = kappa A + (1 - 3 kappa) a (x) a where I4 > 1
    """

    def __init__(self, state: PlanarState, kappa: float, angle: float, k1: float, k2: float) -> None:
        I4, M, I4_turned, M_turned = state.along(angle)
        taut = np.real(I4) > 1
        stretch = np.where(taut, I4, 1.0) - 1
        X = state.I1 - 3
        self.E = kappa * X + (1 - 3 * kappa) * stretch
        self.k1, self.k2, self.kappa = k1, k2, kappa
        self.e = 2 * np.exp(k2 * self.E**2)
        self.A, self.fibre = state.A, M * taut
        self.D = kappa * state.A + (1 - 3 * kappa) * self.fibre
        self.E_turned, self.fibre_turned = (1 - 3 * kappa) * taut * I4_turned, M_turned * taut
        self.E_by_kappa = X - 3 * stretch

    @property
    def stress(self) -> Array:
        return self.k1 * self.by_k1

    @property
    def by_k1(self) -> Array:
        return self.E * self.e * self.D

    @property
    def by_k2(self) -> Array:
        return self.k1 * self.E**3 * self.e * self.D

    @property
    def by_kappa(self) -> Array:
        change = self.A - 3 * self.fibre
        return self.k1 * self.e * (self._growth * self.E_by_kappa * self.D + self.E * change)

    @property
    def by_angle(self) -> Array:
        change = (1 - 3 * self.kappa) * self.fibre_turned
        return self.k1 * self.e * (self._growth * self.E_turned * self.D + self.E * change)

    @property
    def _growth(self) -> Array:
        """Return 1 + 2 k2 E^2, so that dg/dE = k1 exp(k2 E^2) (1 + 2 k2 E^2)."""
        return 1 + 2 * self.k2 * self.E**2
