"""Materials with fibres: each states an energy per reference volume and its shear modulus, nothing else."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import ufl

from valvefsi.errors import CaseError
from valvefsi.solid.materials.parameters import Direction, check_parameters, direction, parameter, table

if TYPE_CHECKING:
    from ufl.core.expr import Expr

    from valvefsi.solid.materials.kinematics import Kinematics


STIFFEST = 100.0
"""Largest exponent of fibres that may still become straight."""


def in_tension(stretch_squared: Expr, width: float = 0.0) -> Expr:
    """Return I4* = max(I4, 1): fibres carry load in tension only.

    With a positive width w the corner is a parabola, 1 + (I4 - 1)^2/(2w) for I4 from 1 to 1 + w, and I4 - w/2 above.
    """
    tension = ufl.conditional(ufl.gt(stretch_squared, 1.0), stretch_squared, 1.0)
    if width == 0:
        return tension
    rounded = 1 + 0.5 / width * (tension - 1) ** 2  # its derivatives then have no divisions
    return ufl.conditional(ufl.gt(stretch_squared, 1.0 + width), stretch_squared - width / 2, rounded)


@dataclass(frozen=True, kw_only=True)
class FibreFamily:
    """A family of fibres of a modified HGO material.

    Args:
        k1: Modulus [dyn/cm^2].
        k2: Exponent [-].
        kappa: Dispersion, 0 for aligned fibres, 1/3 for isotropic ones [-].
        lam_max: Stretch at which the fibres are straight (Weiss et al. 1996): the stress grows exponentially with
            the strain up to E_f = lam_max^2 - 1 and linearly beyond; 0 for exponentially without end [-].
        fibre: Mean direction: name of a fibre field, angle to the x axis [deg], or vector.
    """

    k1: float = parameter(about="modulus")
    k2: float = parameter("1", above=0.0, about="exponent")
    kappa: float = parameter(
        "1", maximum=1 / 3, default=0.0, about="dispersion, 0 (aligned) to 1/3 (isotropic)"
    )
    lam_max: float = parameter(
        "1", default=0.0, about="stretch of straight fibres, linear beyond; 0 for none"
    )
    fibre: str | float | tuple[float, ...] = direction(about="mean direction")

    def __post_init__(self) -> None:
        check_parameters(self)
        if 0 < self.lam_max <= 1:
            raise CaseError("expected 0 or a stretch above 1", key="lam_max", value=self.lam_max)
        if self.lam_max and self.k2 * (self.lam_max**2 - 1) ** 2 > STIFFEST:
            message = f"the stress grows to more than exp({STIFFEST:g}) times that of its first slope; expected less"
            raise CaseError(message, key="lam_max", value=self.lam_max)

    def energy(self, E: Expr) -> Expr:
        """Return k1/(2 k2) (exp[k2 E^2] - 1) of the strain E, and its parabola beyond straight fibres [dyn/cm^2]."""
        W = self.k1 / (2 * self.k2) * (ufl.exp(self.k2 * E**2) - 1)
        if self.lam_max == 0:
            return W
        straight = self.lam_max**2 - 1
        growth = math.exp(self.k2 * straight**2)
        stress, modulus = self.k1 * straight * growth, self.k1 * (1 + 2 * self.k2 * straight**2) * growth
        beyond = E - straight
        parabola = self.k1 / (2 * self.k2) * (growth - 1) + stress * beyond + modulus / 2 * beyond**2
        return ufl.conditional(ufl.gt(E, straight), parabola, W)


@dataclass(frozen=True, kw_only=True)
class HGO:
    """Modified Holzapfel-Gasser-Ogden material with an exponential matrix (Lee2020, eqs 4-5).

        W = c10 {exp[c01 (I1bar - 3)] - 1} + sum_f k1/(2 k2) (exp[k2 E_f^2] - 1),
        E_f = <kappa I1bar + (1 - 3 kappa) I4bar* - 1>_+,    I4bar* = max(I4bar, 1)

    A family with ``lam_max`` continues as a parabola from E_f = lam_max^2 - 1, its stress and tangent continuous.
    The bracket needs no cut of its own: I1bar >= 3 and I4bar* >= 1 keep it from being negative. With
    dispersion (kappa > 0) the published form's stress jumps where I4bar crosses 1 away from F = I.

    Args:
        c10: Modulus of the matrix, positive [dyn/cm^2].
        c01: Exponent of the matrix, positive [-].
        families: The fibres.
        width: Of the transition from no fibre stress to all of it, in I4bar; 0 for the published corner. Statics
            of dispersed fibres needs a small one, say 0.01, because Newton's method cannot rest on a jump [-].
    """

    c10: float = parameter(above=0.0, about="modulus of the matrix")
    c01: float = parameter("1", above=0.0, about="exponent of the matrix")
    families: tuple[FibreFamily, ...] = table(FibreFamily, about="families of fibres")
    width: float = parameter("1", maximum=0.5, default=0.0, about="width of the transition at I4bar = 1")

    def __post_init__(self) -> None:
        check_parameters(self)

    @property
    def shear_modulus(self) -> float:
        """Shear modulus of the matrix at F = I, mu_s = 2 c10 c01 [dyn/cm^2]."""
        return 2 * self.c10 * self.c01

    @property
    def fibre_modulus(self) -> float:
        """Bound on what fibres add to the wave modulus at F = I, 16/9 sum k1 (1 - 3 kappa)^2 [dyn/cm^2]."""
        return 16 / 9 * sum(f.k1 * (1 - 3 * f.kappa) ** 2 for f in self.families)

    def energy(self, kinematics: Kinematics) -> Expr:
        """Return W (Lee2020, eqs 4-5) [dyn/cm^2]."""
        W = self.c10 * (ufl.exp(self.c01 * (kinematics.I1_bar - 3)) - 1)
        for family in self.families:
            stretch = in_tension(kinematics.I4_bar(family.fibre), self.width)
            E = family.kappa * (kinematics.I1_bar - 3) + (1 - 3 * family.kappa) * (stretch - 1)
            W += family.energy(E)
        return W


@dataclass(frozen=True, kw_only=True)
class HolzapfelOgden:
    """Holzapfel-Ogden material of the myocardium (Holzapfel and Ogden 2009), isochoric.

        W = a/(2b) (exp[b (I1bar - 3)] - 1) + sum_{i=f,s} a_i/(2 b_i) (exp[b_i (I4bar_i* - 1)^2] - 1)
            + a_fs/(2 b_fs) (exp[b_fs I8bar_fs^2] - 1)

    Args:
        a, b: Modulus [dyn/cm^2] and exponent [-] of the matrix.
        a_f, b_f: Along the fibres.
        a_s, b_s: Along the sheets.
        a_fs, b_fs: Shear between the two.
        fibre: Direction of the fibres.
        sheet: Direction of the sheets, at right angles to the fibres.
    """

    a: float = parameter(above=0.0, about="modulus of the matrix")
    b: float = parameter("1", above=0.0, about="exponent of the matrix")
    a_f: float = parameter(default=0.0, about="modulus along the fibres")
    b_f: float = parameter("1", above=0.0, default=1.0, about="exponent along the fibres")
    a_s: float = parameter(default=0.0, about="modulus along the sheets")
    b_s: float = parameter("1", above=0.0, default=1.0, about="exponent along the sheets")
    a_fs: float = parameter(default=0.0, about="modulus of fibre-sheet shear")
    b_fs: float = parameter("1", above=0.0, default=1.0, about="exponent of fibre-sheet shear")
    fibre: str | float | tuple[float, ...] = direction(default=0.0, about="direction of the fibres")
    sheet: str | float | tuple[float, ...] = direction(default=90.0, about="direction of the sheets")

    def __post_init__(self) -> None:
        check_parameters(self)

    @property
    def shear_modulus(self) -> float:
        """Shear modulus of the matrix at F = I, mu_s = a [dyn/cm^2]."""
        return self.a

    @property
    def fibre_modulus(self) -> float:
        """Bound on what fibres add to the wave modulus at F = I, 16/9 (a_f + a_s) + a_fs [dyn/cm^2]."""
        return 16 / 9 * (self.a_f + self.a_s) + self.a_fs

    @property
    def orthogonal(self) -> tuple[Direction, ...]:
        """Directions that must be at right angles."""
        return (self.fibre, self.sheet)

    def energy(self, kinematics: Kinematics) -> Expr:
        """Return W (Holzapfel and Ogden 2009) [dyn/cm^2]."""
        W = self.a / (2 * self.b) * (ufl.exp(self.b * (kinematics.I1_bar - 3)) - 1)
        for a, b, along in ((self.a_f, self.b_f, self.fibre), (self.a_s, self.b_s, self.sheet)):
            if a > 0:
                E = in_tension(kinematics.I4_bar(along)) - 1
                W += a / (2 * b) * (ufl.exp(b * E**2) - 1)
        if self.a_fs > 0:
            shear = kinematics.I8_bar(self.fibre, self.sheet)
            W += self.a_fs / (2 * self.b_fs) * (ufl.exp(self.b_fs * shear**2) - 1)
        return W


@dataclass(frozen=True, kw_only=True)
class MayNewmanYin:
    """May-Newman-Yin material of mitral leaflets (May-Newman and Yin 1998), isochoric.

        W = c0 (exp[c1 (I1bar - 3)^2 + c2 (sqrt(I4bar) - 1)^4] - 1)

    It has no stiffness at F = I: `shear_modulus` is 0, so that nu_stab gives no bulk modulus; state one.

    Args:
        c0: Modulus, positive [dyn/cm^2].
        c1: Exponent of the matrix, positive [-].
        c2: Exponent of the fibres [-].
        fibre: Direction of the fibres.
    """

    c0: float = parameter(above=0.0, about="modulus")
    c1: float = parameter("1", above=0.0, about="exponent of the matrix")
    c2: float = parameter("1", about="exponent of the fibres")
    fibre: str | float | tuple[float, ...] = direction(default=0.0, about="direction of the fibres")

    def __post_init__(self) -> None:
        check_parameters(self)

    @property
    def shear_modulus(self) -> float:
        """Shear modulus at F = I, which is zero [dyn/cm^2]."""
        return 0.0

    def energy(self, kinematics: Kinematics) -> Expr:
        """Return W (May-Newman and Yin 1998) [dyn/cm^2]."""
        stretch = ufl.sqrt(kinematics.I4_bar(self.fibre))
        Q = self.c1 * (kinematics.I1_bar - 3) ** 2 + self.c2 * (stretch - 1) ** 4
        return self.c0 * (ufl.exp(Q) - 1)


@dataclass(frozen=True, kw_only=True)
class Fung:
    """Orthotropic Fung material of the isochoric Green strain E = (Cbar - I)/2 in the axes of the tissue.

        W = c/2 (exp Q - 1),
        Q = a1 E11^2 + a2 E22^2 + 2 a3 E11 E22 + a4 E12^2
            + a5 E33^2 + 2 a6 E22 E33 + 2 a7 E33 E11 + a8 E23^2 + a9 E13^2

    a1 to a4 are the form for thin tissue in its plane (Tong and Fung 1976; a4 multiplies E12^2); the others are
    needed where the body can shear out of its plane.

    Args:
        c: Modulus, positive [dyn/cm^2].
        a1, a2, a3, a4: In-plane exponents [-].
        a5, a6, a7, a8, a9: Exponents with the third axis [-].
        fibre: First axis.
        sheet: Second axis, at right angles to the first.
    """

    c: float = parameter(above=0.0, about="modulus")
    a1: float = parameter("1", above=0.0, about="exponent of E11^2")
    a2: float = parameter("1", above=0.0, about="exponent of E22^2")
    a3: float = parameter("1", minimum=-np.inf, default=0.0, about="exponent of 2 E11 E22")
    a4: float = parameter("1", about="exponent of E12^2")
    a5: float = parameter("1", default=0.0, about="exponent of E33^2")
    a6: float = parameter("1", minimum=-np.inf, default=0.0, about="exponent of 2 E22 E33")
    a7: float = parameter("1", minimum=-np.inf, default=0.0, about="exponent of 2 E33 E11")
    a8: float = parameter("1", default=0.0, about="exponent of E23^2")
    a9: float = parameter("1", default=0.0, about="exponent of E13^2")
    fibre: str | float | tuple[float, ...] = direction(default=0.0, about="first axis")
    sheet: str | float | tuple[float, ...] = direction(default=90.0, about="second axis")

    def __post_init__(self) -> None:
        check_parameters(self)
        if self.a1 * self.a2 < self.a3**2:
            raise CaseError(
                f"expected a1 a2 >= a3^2, a1 a2 is {self.a1 * self.a2:g}", key="a3", value=self.a3
            )
        normal = np.array(
            [[self.a1, self.a3, self.a7], [self.a3, self.a2, self.a6], [self.a7, self.a6, self.a5]]
        )
        if np.linalg.eigvalsh(normal)[0] < -1e-9 * np.abs(normal).max():
            raise CaseError(
                "the quadratic form of E11, E22, E33 takes negative values", key="a5", value=self.a5
            )

    @property
    def shear_modulus(self) -> float:
        """Largest shear modulus at F = I, c/4 max(a4, a8, a9, a1 + a2 - 2 a3) [dyn/cm^2]."""
        return self.c / 4 * max(self.a4, self.a8, self.a9, self.a1 + self.a2 - 2 * self.a3)

    @property
    def orthogonal(self) -> tuple[Direction, ...]:
        """Directions that must be at right angles."""
        return (self.fibre, self.sheet)

    def energy(self, kinematics: Kinematics) -> Expr:
        """Return W = c/2 (exp Q - 1) [dyn/cm^2]."""
        k, one, two = kinematics, self.fibre, self.sheet
        E11, E22 = (k.I4_bar(one) - 1) / 2, (k.I4_bar(two) - 1) / 2
        E33 = (k.I1_bar - 3) / 2 - E11 - E22
        Q = self.a1 * E11**2 + self.a2 * E22**2 + 2 * self.a3 * E11 * E22
        Q += self.a4 * (k.I8_bar(one, two) / 2) ** 2
        Q += self.a5 * E33**2 + 2 * self.a6 * E22 * E33 + 2 * self.a7 * E33 * E11
        if k.dim == 3 and self.a8 + self.a9 > 0:
            a, b = k.vector(one), k.vector(two)
            across = k.F * ufl.cross(a, b)
            Q += self.a8 * (k.isochoric * ufl.inner(k.F * b, across) / 2) ** 2
            Q += self.a9 * (k.isochoric * ufl.inner(k.F * a, across) / 2) ** 2
        return self.c / 2 * (ufl.exp(Q) - 1)
