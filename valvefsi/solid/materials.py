"""Hyperelastic materials: each states an energy per reference volume and its shear modulus, nothing else."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, ClassVar, Protocol

from valvefsi.errors import CaseError

if TYPE_CHECKING:
    from ufl.core.expr import Expr

    from valvefsi.solid.kinematics import Kinematics


class Material(Protocol):
    """What the solid needs to know of a material."""

    @property
    def shear_modulus(self) -> float:
        """Shear modulus mu_s at F = I [dyn/cm^2]."""

    def energy(self, kinematics: Kinematics) -> Expr:
        """Return the isochoric energy W per reference volume as a UFL expression [dyn/cm^2]."""


@dataclass(frozen=True, kw_only=True)
class NeoHookean:
    """Neo-Hookean material, W = c1/2 (I1bar - 3) (S21).

    Args:
        c1: Shear modulus, positive [dyn/cm^2].
    """

    c1: float

    def __post_init__(self) -> None:
        _check_moduli(self)
        if self.c1 == 0:
            raise CaseError("a neo-Hookean material needs a positive modulus", key="c1", value=self.c1)

    @property
    def shear_modulus(self) -> float:
        """Shear modulus mu_s = c1 [dyn/cm^2]."""
        return self.c1

    def energy(self, kinematics: Kinematics) -> Expr:
        """Return W = c1/2 (I1bar - 3) (S21) [dyn/cm^2]."""
        return self.c1 / 2 * (kinematics.I1_bar - 3)


@dataclass(frozen=True, kw_only=True)
class MooneyRivlin:
    """Mooney-Rivlin material, W = c1 (I1bar - 3) + c2 (I2bar - 3) (S23).

    Args:
        c1: First modulus, not negative [dyn/cm^2].
        c2: Second modulus, not negative, c1 + c2 > 0 [dyn/cm^2].
    """

    c1: float
    c2: float

    def __post_init__(self) -> None:
        _check_moduli(self)
        if self.c1 + self.c2 == 0:
            raise CaseError("a Mooney-Rivlin material needs c1 + c2 > 0", key="c1", value=self.c1)

    @property
    def shear_modulus(self) -> float:
        """Shear modulus mu_s = 2 (c1 + c2) [dyn/cm^2]."""
        return 2 * (self.c1 + self.c2)

    def energy(self, kinematics: Kinematics) -> Expr:
        """Return W = c1 (I1bar - 3) + c2 (I2bar - 3) (S23) [dyn/cm^2]."""
        return self.c1 * (kinematics.I1_bar - 3) + self.c2 * (kinematics.I2_bar - 3)


@dataclass(frozen=True, kw_only=True)
class Volumetric:
    """Volumetric energy of the stabilisation, U(J) = kappa/2 (ln J)^2 (S21, S23).

    Args:
        kappa: Numerical bulk modulus, not negative [dyn/cm^2].
    """

    kappa: float
    DERIVATIVE: ClassVar[str] = "dU/dJ = kappa ln(J)/J, the pressure is minus that"

    def __post_init__(self) -> None:
        _check_moduli(self)

    def energy(self, kinematics: Kinematics) -> Expr:
        """Return U(J) = kappa/2 (ln J)^2 [dyn/cm^2]."""
        return self.kappa / 2 * kinematics.log_J**2


MATERIALS: dict[str, type] = {"neo_hookean": NeoHookean, "mooney_rivlin": MooneyRivlin}
"""Materials by the name a case file uses."""


def kappa_stab(shear_modulus: float, nu_stab: float | None) -> float:
    """Return the numerical bulk modulus of the stabilisation.

        kappa_stab = 2 mu_s (1 + nu_stab) / (3 (1 - 2 nu_stab))          (S22)

    Args:
        shear_modulus: Shear modulus mu_s at F = I [dyn/cm^2].
        nu_stab: Numerical Poisson ratio, -1 <= nu_stab < 0.5 [-]; None switches the stabilisation off.

    Returns:
        Numerical bulk modulus, 0 for off [dyn/cm^2].

    Raises:
        CaseError: ``nu_stab`` lies outside its range.
    """
    if nu_stab is None:
        return 0.0
    if not -1 <= nu_stab < 0.5:
        raise CaseError('expected a number from -1 to below 0.5, or "off"', key="nu_stab", value=nu_stab)
    return 2 * shear_modulus * (1 + nu_stab) / (3 * (1 - 2 * nu_stab))


def _check_moduli(material: object) -> None:
    """Refuse a modulus that is negative or not finite."""
    for field in fields(material):
        value = getattr(material, field.name)
        if not (math.isfinite(value) and value >= 0):
            raise CaseError("expected a finite modulus that is not negative", key=field.name, value=value)
