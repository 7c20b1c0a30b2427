"""Hyperelastic materials: each states an energy per reference volume and its shear modulus, nothing else.

A material of your own takes about ten lines, and a case file uses it by its file,
``model = "gent.py:Gent"``::

    @dataclass(frozen=True, kw_only=True)
    class Gent:
        mu: float = parameter("dyn/cm^2", above=0.0)
        limit: float = parameter("1", above=0.0)

        @property
        def shear_modulus(self):
            return self.mu

        def energy(self, kinematics):
            return -self.mu * self.limit / 2 * ufl.ln(1 - (kinematics.I1_bar - 3) / self.limit)
"""

from __future__ import annotations

import importlib.util
import sys
import zlib
from dataclasses import dataclass, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Protocol

import ufl

from valvefsi.errors import CaseError
from valvefsi.solid.materials.fibre_reinforced import HGO, Fung, HolzapfelOgden, MayNewmanYin
from valvefsi.solid.materials.parameters import check_number, check_parameters, parameter

if TYPE_CHECKING:
    from ufl.core.expr import Expr

    from valvefsi.solid.materials.kinematics import Kinematics


class VolumeRatio(Protocol):
    """What a volumetric energy asks of the kinematics."""

    @property
    def J(self) -> Expr:
        """Volume ratio det F."""

    @property
    def log_J(self) -> Expr:
        """Its logarithm."""


class Material(Protocol):
    """What the solid needs to know of a material.

    A material with two fibre directions at right angles also has ``orthogonal``, the pair of them; a compressible one
    that solid-shell elements may be made of has ``thinning`` and ``normal_modulus`` as `SaintVenantKirchhoff` has.
    """

    @property
    def shear_modulus(self) -> float:
        """Shear modulus mu_s at F = I [dyn/cm^2]."""

    def energy(self, kinematics: Kinematics) -> Expr:
        """Return the energy W per reference volume as a UFL expression [dyn/cm^2].

        It is a function of the modified invariants (I1_bar, I4_bar ...) unless the material has a volumetric
        part of its own.
        """


@dataclass(frozen=True, kw_only=True)
class NeoHookean:
    """Neo-Hookean material, W = c1/2 (I1bar - 3) (S21).

    Args:
        c1: Shear modulus, positive [dyn/cm^2].
    """

    c1: float = parameter(above=0.0, about="shear modulus")

    def __post_init__(self) -> None:
        check_parameters(self)

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

    c1: float = parameter(about="first modulus")
    c2: float = parameter(about="second modulus")

    def __post_init__(self) -> None:
        check_parameters(self)
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
class LeeSacks:
    """Lee-Sacks isotropic material, W = c0/2 (I1bar - 3) + c1/2 (exp[c2 (I1bar - 3)^2] - 1).

    Args:
        c0: Shear modulus, positive [dyn/cm^2].
        c1: Modulus of the exponential [dyn/cm^2].
        c2: Exponent [-].
    """

    c0: float = parameter(above=0.0, about="shear modulus")
    c1: float = parameter(about="modulus of the exponential")
    c2: float = parameter("1", about="exponent")

    def __post_init__(self) -> None:
        check_parameters(self)

    @property
    def shear_modulus(self) -> float:
        """Shear modulus mu_s = c0 at F = I [dyn/cm^2]."""
        return self.c0

    def energy(self, kinematics: Kinematics) -> Expr:
        """Return W = c0/2 (I1bar - 3) + c1/2 (exp[c2 (I1bar - 3)^2] - 1) [dyn/cm^2]."""
        excess = kinematics.I1_bar - 3
        return self.c0 / 2 * excess + self.c1 / 2 * (ufl.exp(self.c2 * excess**2) - 1)


@dataclass(frozen=True, kw_only=True)
class SaintVenantKirchhoff:
    """Saint Venant-Kirchhoff material, W = lam/2 (tr E)^2 + mu E : E with E = (C - I)/2.

    It is not split: its volumetric part is its own, and nu_stab = "off" leaves it alone. It loses its
    stiffness in strong compression.

    Args:
        mu: Shear modulus, positive [dyn/cm^2].
        lam: First Lame parameter [dyn/cm^2].
    """

    mu: float = parameter(above=0.0, about="shear modulus")
    lam: float = parameter(about="first Lame parameter")

    def __post_init__(self) -> None:
        check_parameters(self)

    @property
    def shear_modulus(self) -> float:
        """Shear modulus mu_s = mu [dyn/cm^2]."""
        return self.mu

    def energy(self, kinematics: Kinematics) -> Expr:
        """Return W = lam/2 (tr E)^2 + mu E : E [dyn/cm^2]."""
        E = (kinematics.C - ufl.Identity(kinematics.dim)) / 2
        return self.lam / 2 * ufl.tr(E) ** 2 + self.mu * ufl.inner(E, E)

    @property
    def normal_modulus(self) -> float:
        """Modulus lam + 2 mu of a strain along one normal alone [dyn/cm^2]."""
        return self.lam + 2 * self.mu

    def thinning(self, E: Expr, normal: Expr) -> Expr:
        """Return what a strain along a unit normal must grow by so that no stress S acts along it [-]."""
        along = ufl.inner(normal, E * normal)
        return -(self.lam * ufl.tr(E) + 2 * self.mu * along) / self.normal_modulus


@dataclass(frozen=True, kw_only=True)
class Volumetric:
    """Volumetric energy of the stabilisation; each has U = U' = 0 and U'' = kappa at J = 1.

        "log":          U = kappa/2 (ln J)^2                  (S21, S23)
        "quadratic":    U = kappa/2 (J - 1)^2                 finite as J goes to 0
        "simo_taylor":  U = kappa/4 (J^2 - 1 - 2 ln J)        (Simo and Taylor 1991), convex in J

    Args:
        kappa: Numerical bulk modulus, not negative [dyn/cm^2].
        form: "log", "quadratic" or "simo_taylor".
    """

    kappa: float = parameter(about="numerical bulk modulus")
    form: str = "log"
    FORMS: ClassVar[tuple[str, ...]] = ("log", "quadratic", "simo_taylor")

    def __post_init__(self) -> None:
        check_number("kappa", self.kappa)
        if self.form not in self.FORMS:
            listed = ", ".join(self.FORMS)
            raise CaseError(f"expected one of {listed}", key="volumetric", value=self.form)

    def energy(self, kinematics: VolumeRatio) -> Expr:
        """Return U(J) [dyn/cm^2]."""
        if self.form == "log":
            return self.kappa / 2 * kinematics.log_J**2
        if self.form == "quadratic":
            return self.kappa / 2 * (kinematics.J - 1) ** 2
        return self.kappa / 4 * (kinematics.J**2 - 1 - 2 * kinematics.log_J)


MATERIALS: dict[str, type] = {
    "neo_hookean": NeoHookean,
    "mooney_rivlin": MooneyRivlin,
    "hgo": HGO,
    "holzapfel_ogden": HolzapfelOgden,
    "lee_sacks": LeeSacks,
    "fung": Fung,
    "may_newman_yin": MayNewmanYin,
    "saint_venant_kirchhoff": SaintVenantKirchhoff,
}
"""Materials by the name a case file uses."""


OWN: dict[str, type] = {}
"""Materials of files that `load_material` has run, by "FILE:CLASS"."""


def find_material(model: str) -> type:
    """Return the class of a material: a name of `MATERIALS`, or "FILE:CLASS" of `load_material`.

    Raises:
        CaseError: There is no such material.
    """
    found = MATERIALS.get(model) or OWN.get(model)
    if found is None:
        raise CaseError('no such material; one of your own is "FILE.py:CLASS"', key="model", value=model)
    return found


def load_material(file: Path, name: str) -> str:
    """Run a Python file, under a module name of its own, and register the material in it.

    Args:
        file: The file; it finds what is installed, not what lies beside it.
        name: Name of the class.

    Returns:
        Name for `find_material`.

    Raises:
        CaseError: The file cannot be run, or holds no such material.
    """
    file = file.resolve()
    model = f"{file}:{name}"
    spec = importlib.util.spec_from_file_location(f"valvefsi_own_{zlib.crc32(bytes(file)):08x}", file)
    try:
        if spec is None or spec.loader is None:
            raise ImportError("not a Python file")
        module = importlib.util.module_from_spec(spec)
        sys.modules[spec.name] = module  # dataclasses look their module up
        spec.loader.exec_module(module)
        found = getattr(module, name)
    except Exception as error:  # the file may raise whatever it likes
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        raise CaseError(f"cannot load this material ({reason})", key="model", value=model) from None
    missing = [part for part in ("energy", "shear_modulus") if not hasattr(found, part)]
    if missing or not (isinstance(found, type) and is_dataclass(found)):
        needed = "a material is a dataclass with energy and shear_modulus"
        raise CaseError(f"this is not a material: {needed}", key="model", value=model)
    OWN[model] = found
    return model


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


def stabilisation(
    material: Material, nu_stab: float | None, form: str = "log", kappa: float | None = None
) -> Volumetric:
    """Return the volumetric energy that holds a material together, with modulus 0 for none.

    Args:
        material: Its shear modulus gives kappa_stab (S22).
        nu_stab: Numerical Poisson ratio; None for off.
        form: See `Volumetric`.
        kappa: The bulk modulus itself, goes before nu_stab [dyn/cm^2].

    Raises:
        CaseError: The material has no stiffness at F = I and nu_stab is to give the bulk modulus.
    """
    if kappa is not None:
        return Volumetric(kappa=kappa, form=form)
    if nu_stab is not None and material.shear_modulus == 0:
        message = 'this material has no stiffness at F = I to multiply; state kappa, or nu_stab = "off"'
        raise CaseError(message, key="nu_stab", value=nu_stab)
    return Volumetric(kappa=kappa_stab(material.shear_modulus, nu_stab), form=form)
