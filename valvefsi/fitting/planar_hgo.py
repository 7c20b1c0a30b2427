"""Incompressible plane stress of the modified Holzapfel-Gasser-Ogden material (Lee2020, eqs 4-5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from valvefsi.fitting.planar import Extent, PlanarMaterial, PlanarState, angle_parameter
from valvefsi.fitting.problem import Parameter
from valvefsi.types import Array

ROUNDING = 1e-3
"""Width of the transition at I4 = 1 that a material is written with, as in `valvefsi.solid.materials.presets` [-]."""


@dataclass(frozen=True, kw_only=True)
class Place:
    """Where a family's numbers stand among the parameters: k1 (k2 follows it), kappa; sign and shift of its angle."""

    k1: int = 4
    kappa: int = 2
    sign: int = 1
    shift: float = 0.0


PLACES = {
    "1": (Place(),),
    "2": (Place(), Place(k1=6, shift=90.0)),
    "2-kappas": (Place(), Place(k1=6, kappa=8, shift=90.0)),
    "symmetric": (Place(), Place(sign=-1)),
}
KINDS, TWO = tuple(PLACES), ("2", "2-kappas")


@dataclass(frozen=True, kw_only=True)
class HGO(PlanarMaterial):
    """Exponential matrix and families of fibres.

        W = c10 {exp[c01 (I1 - 3)] - 1} + sum_f k1/(2 k2) (exp[k2 E_f^2] - 1),
        E_f = kappa (I1 - 3) + (1 - 3 kappa) (I4* - 1),    I4* = max(I4, 1)

    Args:
        families: ``1``; ``2`` at right angles with constants of their own and one kappa; ``2-kappas``: each with
            its own kappa as well; ``symmetric``: two at +angle and -angle with the same constants.
        angle: Angle of the first family to axis 1 [deg], None to fit it.
    """

    model: str = "hgo"
    families: str = "1"
    angle: float | None = None

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
        own = []
        for ending in ("_1", "_2") if self.families in TWO else ("",):
            own += [extent.modulus(f"k1{ending}"), extent.exponent(f"k2{ending}", *reach)]
        return (*common, *own, *([_dispersion("kappa_2")] if self.families == "2-kappas" else []))

    def stress(self, v: Array, state: PlanarState) -> Array:
        """Return S, ``(3, n)`` [kPa], for values ``(parameters,)``."""
        S = 2 * v[0] * v[1] * np.exp(v[1] * (state.I1 - 3)) * state.A
        for place in PLACES[self.families]:
            S = S + _Family(state, v, place).stress
        return S

    def gradient(self, v: Array, state: PlanarState) -> Array:
        """Return dS/dv, ``(parameters, 3, n)``, for values ``(parameters,)``."""
        X = state.I1 - 3
        slopes = np.zeros((len(v), 3, len(X)), dtype=np.result_type(v, X))
        matrix = 2 * np.exp(v[1] * X) * state.A
        slopes[0], slopes[1] = v[1] * matrix, v[0] * (1 + v[1] * X) * matrix
        for place in PLACES[self.families]:
            family = _Family(state, v, place)
            slopes[place.kappa] += family.by_kappa
            slopes[3] += place.sign * family.by_angle
            slopes[place.k1] += family.by_k1
            slopes[place.k1 + 1] += family.by_k2
        return slopes

    def entries(self, v: Mapping[str, float]) -> dict[str, Any]:
        """Return the entries of a material table; dispersed fibres with a rounded corner, see `ROUNDING`."""
        values, table = list(v.values()), []
        for place in PLACES[self.families]:
            constants = {"k1": values[place.k1], "k2": values[place.k1 + 1], "kappa": values[place.kappa]}
            table.append(constants | {"fibre": place.sign * v["angle"] + place.shift})
        rounded = {"width": ROUNDING} if any(family["kappa"] > 0.0 for family in table) else {}
        return {"c10": v["c10"], "c01": v["c01"], "families": table, **rounded}


def _dispersion(name: str) -> Parameter:
    return Parameter(name=name, lower=0.0, upper=1 / 3, start=(0.0, 0.25))


class _Family:
    """Stress of one family of fibres and its derivatives.

    g = dW/dE = k1 E exp(k2 E^2);  S = 2 g D,  D = kappa A + (1 - 3 kappa) a (x) a where I4 > 1
    """

    def __init__(self, state: PlanarState, v: Array, place: Place) -> None:
        k1, k2, kappa = v[place.k1], v[place.k1 + 1], v[place.kappa]
        I4, M, I4_turned, M_turned = state.along(place.sign * v[3] + place.shift)
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
