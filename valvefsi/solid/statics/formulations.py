"""Formulations of static equilibrium: mixed, near-incompressible in displacements, pressure-stabilised."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from valvefsi.runtime import dolfinx_compat  # noqa: F401  (before dolfinx)

# isort: split
import ufl
from dolfinx import fem

from valvefsi.errors import CaseError
from valvefsi.solid.materials import Volumetric, stabilisation
from valvefsi.solid.materials.kinematics import Kinematics

if TYPE_CHECKING:
    from ufl.core.expr import Expr

    from valvefsi.solid.materials import Material
    from valvefsi.types import Mesh


class Formulation(Protocol):
    """What the static solver needs to know of a formulation."""

    @property
    def degrees(self) -> tuple[int, ...]:
        """Degrees of the Lagrange elements: displacement, and pressure where there is one."""

    def potential(self, mesh: Mesh, material: Material, u: Expr, p: Expr | None) -> Expr:
        """Return the potential per reference volume as a function of displacement and pressure [dyn/cm^2]."""


class DisplacementFormulation(Formulation, Protocol):
    """A formulation without a pressure of its own."""

    def pressure(self, mesh: Mesh, material: Material, u: fem.Function) -> Expr:
        """Return the pressure of a displacement [dyn/cm^2]."""


@dataclass(frozen=True)
class TaylorHood:
    """Exactly incompressible, P2-P1 on simplices and Q2-Q1 on quadrilaterals and hexahedra: W - p (J - 1)."""

    degrees: tuple[int, ...] = (2, 1)

    def potential(self, mesh: Mesh, material: Material, u: Expr, p: Expr | None) -> Expr:
        """Return W - p (J - 1)."""
        kinematics = kinematics_of(mesh, u)
        return material.energy(kinematics) - p * (kinematics.J - 1)


@dataclass(frozen=True, kw_only=True)
class EqualOrder:
    """Incompressible with equal orders P1-P1 or Q1-Q1, the pressure stabilised (Brezzi and Pitkaranta 1984).

        W - p (J - 1) - alpha h^2/(2 mu_s) |grad p|^2,    h the cell's diameter

    For linear elements without body force it is the residual-based stabilisation of Klaas, Maniatty and Shephard
    (1999) with the reference gradient; first order in the volume, second in the displacement.

    Args:
        alpha: Stabilisation factor, positive [-].
    """

    alpha: float = 0.05

    def __post_init__(self) -> None:
        if not 0 < self.alpha < math.inf:
            raise CaseError("expected a positive number", key="alpha", value=self.alpha)

    @property
    def degrees(self) -> tuple[int, ...]:
        """Degrees of displacement and pressure."""
        return (1, 1)

    def potential(self, mesh: Mesh, material: Material, u: Expr, p: Expr | None) -> Expr:
        """Return W - p (J - 1) - alpha h^2/(2 mu_s) |grad p|^2."""
        if not material.shear_modulus > 0:
            message = "this material has no stiffness at F = I to scale the stabilisation with"
            raise CaseError(message, key="formulation", value="equal_order")
        h = ufl.CellDiameter(mesh.mesh)
        slope = self.alpha / (2 * material.shear_modulus) * h**2 * ufl.inner(ufl.grad(p), ufl.grad(p))
        return TaylorHood().potential(mesh, material, u, p) - slope


@dataclass(frozen=True, kw_only=True)
class NearlyIncompressible:
    """Displacements alone, held together by the volumetric energy that the coupled solid uses: W + U(J).

    Args:
        degree: Degree of the elements, 1 or 2; 1 locks as nu_stab goes to 1/2.
        nu_stab: Numerical Poisson ratio (S22); None for off.
        kappa: The bulk modulus itself, goes before nu_stab [dyn/cm^2].
        volumetric: See `Volumetric`.
    """

    degree: int = 2
    nu_stab: float | None = 0.4
    kappa: float | None = None
    volumetric: str = "log"

    def __post_init__(self) -> None:
        if self.degree not in (1, 2):
            raise CaseError("expected 1 or 2", key="degree", value=self.degree)

    @property
    def degrees(self) -> tuple[int, ...]:
        """Degree of the displacement."""
        return (self.degree,)

    def energy(self, material: Material) -> Volumetric:
        """Return the volumetric energy."""
        return stabilisation(material, self.nu_stab, self.volumetric, self.kappa)

    def potential(self, mesh: Mesh, material: Material, u: Expr, p: Expr | None) -> Expr:
        """Return W + U(J)."""
        kinematics, U = kinematics_of(mesh, u), self.energy(material)
        W = material.energy(kinematics)
        return W + U.energy(kinematics) if U.kappa > 0 else W

    def pressure(self, mesh: Mesh, material: Material, u: fem.Function) -> Expr:
        """Return p = -dU/dJ."""
        J = ufl.variable(ufl.det(deformation(mesh, u)))
        return -ufl.diff(self.energy(material).energy(_VolumeOnly(J)), J)


class _VolumeOnly:
    """A volume ratio without the deformation that has it, see `valvefsi.solid.materials.laws.VolumeRatio`."""

    def __init__(self, J: Expr) -> None:
        self.J, self.log_J = J, ufl.ln(J)


def deformation(mesh: Mesh, u: Expr) -> Expr:
    """Return F = I + grad u."""
    return ufl.Identity(mesh.dim) + ufl.grad(u)


def kinematics_of(mesh: Mesh, u: Expr) -> Kinematics:
    """Return the kinematics of a displacement, with the mesh's fibres."""
    return Kinematics(deformation(mesh, u), mesh.fibres)
