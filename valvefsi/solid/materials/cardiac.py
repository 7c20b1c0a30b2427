"""Myocardium of the cardiac mechanics benchmarks: Guccione's energy, active tension, fibres of an ellipsoid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.runtime import dolfinx_compat  # noqa: F401  (before dolfinx)

# isort: split
import ufl
from dolfinx import fem

from valvefsi.solid.materials.parameters import check_parameters, direction, parameter

if TYPE_CHECKING:
    from ufl.core.expr import Expr

    from valvefsi.solid.materials.kinematics import Kinematics
    from valvefsi.solid.materials.laws import Material
    from valvefsi.types import Array, Mesh


@dataclass(frozen=True, kw_only=True)
class Guccione:
    """Transversely isotropic material of Guccione, McCulloch and Waldman (1991), for incompressible bodies.

        W = C/2 (exp Q - 1),  Q = bf Eff^2 + bt (Ess^2 + Enn^2 + 2 Esn^2) + 2 bfs (Efs^2 + Efn^2),  E = (F^T F - I)/2

    It is a function of E, not of its isochoric part: use it where J = 1.

    Args:
        C: Modulus, positive [dyn/cm^2].
        bf: Exponent along the fibres [-].
        bt: Exponent across them [-].
        bfs: Exponent of the shear between the two [-].
        fibre: Direction of the fibres.
    """

    C: float = parameter(above=0.0, about="modulus")
    bf: float = parameter("1", above=0.0, about="exponent along the fibres")
    bt: float = parameter("1", above=0.0, about="exponent across them")
    bfs: float = parameter("1", above=0.0, about="exponent of the shear")
    fibre: str | float | tuple[float, ...] = direction(default=0.0, about="direction of the fibres")

    def __post_init__(self) -> None:
        check_parameters(self)

    @property
    def shear_modulus(self) -> float:
        """Shear modulus across the fibres at F = I, C bt/2 [dyn/cm^2]."""
        return self.C * self.bt / 2

    def energy(self, kinematics: Kinematics) -> Expr:
        """Return W [dyn/cm^2]."""
        E = (kinematics.C - ufl.Identity(kinematics.dim)) / 2
        along = E * kinematics.vector(self.fibre)
        Eff = ufl.inner(along, kinematics.vector(self.fibre))
        mixed = ufl.inner(along, along) - Eff**2
        across = ufl.inner(E, E) - 2 * mixed - Eff**2
        Q = self.bf * Eff**2 + self.bt * across + 2 * self.bfs * mixed
        return self.C / 2 * (ufl.exp(Q) - 1)


class Contracting:
    """A material with an active tension along its fibres that grows with the load factor.

    W = W_passive + s T/2 (I4 - 1), so that S gains s T f x f. `follow` hands the load factor over: make it the
    ``value`` of a support at rest.

    Args:
        mesh: A ``SolidMesh``.
        passive: The material at rest.
        tension: T at load factor 1 [dyn/cm^2].
        fibre: Direction of the tension.
    """

    def __init__(self, mesh: Mesh, passive: Material, tension: float, fibre: str) -> None:
        self.passive, self.tension, self.fibre = passive, float(tension), fibre
        self._now = fem.Constant(mesh.mesh, 0.0)

    @property
    def shear_modulus(self) -> float:
        """Shear modulus of the material at rest [dyn/cm^2]."""
        return self.passive.shear_modulus

    def energy(self, kinematics: Kinematics) -> Expr:
        """Return W at the present tension [dyn/cm^2]."""
        return self.passive.energy(kinematics) + self._now / 2 * (kinematics.I4(self.fibre) - 1)

    def follow(self, X: Array, s: float) -> Array:
        """Take over the load factor; return no displacement."""
        self._now.value = s * self.tension
        return np.zeros((len(X), 3))


def ellipsoid_fibres(
    short: tuple[float, float], long: tuple[float, float], angles: tuple[float, float]
) -> Callable[[Array], Array]:
    """Return the fibres of a thick ellipsoid about z, their angle linear through the wall.

        a = sin(alpha) e_u + cos(alpha) e_phi,   alpha from the first angle inside to the second outside

    with e_u along the meridian away from the apex (at negative z) and e_phi around the axis (Land et al. 2015).

    Args:
        short: Inner and outer half-axes across [cm].
        long: Inner and outer half-axes along z [cm].
        angles: Angles at the inner and the outer surface [deg].

    Returns:
        A function of positions ``(n, 3)``; on the axis the direction around it is that of y.
    """

    def fibre(X: Array) -> Array:
        r, phi = np.hypot(X[:, 0], X[:, 1]), np.arctan2(X[:, 1], X[:, 0])
        t = _depth(r, X[:, 2], short, long)
        across, tall = short[0] + (short[1] - short[0]) * t, long[0] + (long[1] - long[0]) * t
        w = np.arctan2(r / across, -X[:, 2] / tall)
        outward, up = across * np.cos(w), tall * np.sin(w)
        length = np.hypot(outward, up)
        along = np.stack([outward * np.cos(phi), outward * np.sin(phi), up], axis=1) / length[:, None]
        around = np.stack([-np.sin(phi), np.cos(phi), 0 * phi], axis=1)
        alpha = np.radians(angles[0] + (angles[1] - angles[0]) * t)[:, None]
        return np.sin(alpha) * along + np.cos(alpha) * around

    return fibre


def _depth(r: Array, z: Array, short: tuple[float, float], long: tuple[float, float]) -> Array:
    """Return the t in 0 ... 1 of the ellipsoid that passes through each point, by bisection."""
    low, high = np.full_like(r, -0.5), np.full_like(r, 1.5)
    for _ in range(60):
        t = (low + high) / 2
        across, tall = short[0] + (short[1] - short[0]) * t, long[0] + (long[1] - long[0]) * t
        outside = (r / across) ** 2 + (z / tall) ** 2 > 1
        low, high = np.where(outside, t, low), np.where(outside, high, t)
    return np.clip((low + high) / 2, 0.0, 1.0)
