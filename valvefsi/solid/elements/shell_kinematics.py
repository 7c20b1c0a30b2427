"""Kinematics of a solid-shell element: an eight-node hexahedron for thin, curved, incompressible bodies.

The position is trilinear, x = sum_k N_k(xi, eta, zeta) x_k, zeta through the thickness. With the base vectors g_i of
the deformed and G_i of the reference element, the metric of the energy is

    c_ab = g_a . g_b                                    (a, b = 1, 2: the layers bend and stretch),
    c_a3 = G_a . G_3 + ANS[g_a . g_3 - G_a . G_3]       (sampled in the middles of the edges of the middle surface,
                                                         as Dvorkin and Bathe 1984: no shear locking),
    c_33 so that det c = det G                          (at every point the layers thin as an incompressible body does).

No thickness strain of the nodes enters, hence no Poisson's thickness, volumetric or trapezoidal locking, and no
enhanced modes to be solved for: everything is a closed-form function of the nodes. What the nodes say of the volume is
held by U(J) alone, J the ratio of volumes of a column through the element, so that kappa stiffens neither bending nor
membrane: as kappa grows J goes to 1 and the energy becomes that of the incompressible body.

A compressible material takes the c_33 that leaves no stress through the thickness, as shells do (plane stress). What
the nodes strain beside that, sampled in the edges through the thickness (Betsch and Stein 1995: no locking of elements
that bend), bears the stress along the normal: for small strains the sum is the energy of the three-dimensional body.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

from valvefsi.runtime import dolfinx_compat  # noqa: F401  (before ufl)

# isort: split
import ufl

from valvefsi.solid.materials.kinematics import Kinematics

if TYPE_CHECKING:
    from ufl.core.expr import Expr

    from valvefsi.solid.materials.parameters import Direction


class Metric(NamedTuple):
    """Covariant components of a symmetric tensor but that through the thickness."""

    c11: Expr
    c22: Expr
    c12: Expr
    c13: Expr
    c23: Expr


class KnownRatio:
    """A volume ratio without the deformation that has it, see `valvefsi.solid.materials.laws.VolumeRatio`."""

    def __init__(self, J: Expr) -> None:
        self.J, self.log_J = J, ufl.ln(J)


def base_vectors(m: Expr, at: tuple[Expr, Expr, Expr]) -> tuple[Expr, Expr, Expr]:
    """Return g_1, g_2, g_3 at (xi, eta, zeta) from the monomials ``m (7, 3)`` of the position."""
    xi, eta, zeta = at
    x1, x2, x3, x12, x13, x23, x123 = (ufl.as_vector([m[k, d] for d in range(3)]) for k in range(7))
    g1 = x1 + eta * x12 + zeta * (x13 + eta * x123)
    g2 = x2 + xi * x12 + zeta * (x23 + xi * x123)
    g3 = x3 + xi * x13 + eta * (x23 + xi * x123)
    return g1, g2, g3


def volume_density(m: Expr, at: tuple[Expr, Expr, Expr]) -> Expr:
    """Return g_1 x g_2 . g_3."""
    g1, g2, g3 = base_vectors(m, at)
    return ufl.inner(ufl.cross(g1, g2), g3)


def assumed_shear(m: Expr, at: tuple[Expr, Expr, Expr]) -> tuple[Expr, Expr]:
    """Return g_1 . g_3 and g_2 . g_3, sampled at (0, +-1, 0) and (+-1, 0, 0) and interpolated."""
    xi, eta, _ = at
    x1, x2, x3, x12, x13, x23, _ = (ufl.as_vector([m[k, d] for d in range(3)]) for k in range(7))
    dot = ufl.inner
    c13 = dot(x1, x3) + dot(x12, x23) + eta * (dot(x1, x23) + dot(x12, x3))
    c23 = dot(x2, x3) + dot(x12, x13) + xi * (dot(x2, x13) + dot(x12, x3))
    return c13, c23


def assumed_thickness(m: Expr, at: tuple[Expr | float, Expr | float, Expr | float]) -> Expr:
    """Return g_3 . g_3, sampled at (+-1, +-1) and interpolated."""
    xi, eta, _ = at
    _, _, x3, _, x13, x23, x123 = (ufl.as_vector([m[k, d] for d in range(3)]) for k in range(7))
    sums = []
    for i, j in ((-1, -1), (1, -1), (-1, 1), (1, 1)):
        director = x3 + i * x13 + j * (x23 + i * x123)
        sums.append((1 + i * xi) * (1 + j * eta) / 4 * ufl.inner(director, director))
    return sum(sums)


def assumed_metric(m: Expr, M: Expr, at: tuple[Expr, Expr, Expr]) -> Metric:
    """Return the metric of the deformed element, ``m`` and ``M`` the monomials of its positions."""
    g1, g2, _ = base_vectors(m, at)
    G1, G2, G3 = base_vectors(M, at)
    c13, c23 = assumed_shear(m, at)
    C13, C23 = assumed_shear(M, at)
    return Metric(
        c11=ufl.inner(g1, g1),
        c22=ufl.inner(g2, g2),
        c12=ufl.inner(g1, g2),
        c13=c13 + (ufl.inner(G1, G3) - C13),
        c23=c23 + (ufl.inner(G2, G3) - C23),
    )


class ShellKinematics(Kinematics):
    """What an energy may depend on, from a metric of volume 1.

    Args:
        metric: Covariant components c_ij but c_33, which follows from det c = det G.
        frame: G_1, G_2, G_3.
        fibres: Unit vectors of the reference state by name.
    """

    def __init__(
        self, metric: Metric, frame: tuple[Expr, Expr, Expr], fibres: Mapping[str, Expr] | None = None
    ) -> None:
        self.dim, self.fibres = 3, dict(fibres or {})
        self._metric, self._frame = metric, frame

    @cached_property
    def dual(self) -> tuple[Expr, Expr, Expr]:
        """Contravariant base vectors G^i."""
        G1, G2, G3 = self._frame
        n = ufl.cross(G1, G2)
        volume = ufl.inner(n, G3)
        return ufl.cross(G2, G3) / volume, ufl.cross(G3, G1) / volume, n / volume

    @cached_property
    def _covariant(self) -> list[list[Expr]]:
        """Components c_ij."""
        c11, c22, c12, c13, c23 = self._metric
        G1, G2, G3 = self._frame
        area = c11 * c22 - c12**2
        cross = c11 * c23**2 - 2 * c12 * c13 * c23 + c22 * c13**2
        c33 = (ufl.inner(ufl.cross(G1, G2), G3) ** 2 + cross) / area
        return [[c11, c12, c13], [c12, c22, c23], [c13, c23, c33]]

    @cached_property
    def C(self) -> Expr:
        """Right Cauchy-Green tensor C = c_ij G^i (x) G^j."""
        K = ufl.as_matrix([[a[d] for d in range(3)] for a in self.dual])
        return K.T * ufl.as_matrix(self._covariant) * K

    @cached_property
    def F(self) -> Expr:
        """A deformation gradient with F^T F = C: the upper triangular one."""
        C = self.C
        f11 = ufl.sqrt(C[0, 0])
        f12, f13 = C[0, 1] / f11, C[0, 2] / f11
        f22 = ufl.sqrt(C[1, 1] - f12**2)
        f23 = (C[1, 2] - f12 * f13) / f22
        return ufl.as_matrix([[f11, f12, f13], [0, f22, f23], [0, 0, ufl.sqrt(C[2, 2] - f13**2 - f23**2)]])

    @cached_property
    def J(self) -> Expr:
        """Volume ratio, 1."""
        return ufl.as_ufl(1.0)

    @cached_property
    def log_J(self) -> Expr:
        """Logarithm of the volume ratio, 0."""
        return ufl.as_ufl(0.0)

    @cached_property
    def isochoric(self) -> Expr:
        """Factor that takes C to its isochoric part, 1."""
        return ufl.as_ufl(1.0)

    @cached_property
    def I1(self) -> Expr:
        """First invariant tr C = c_ij G^i . G^j."""
        dot, dual, c = ufl.inner, self.dual, self._covariant
        ends = sum(c[i][i] * dot(dual[i], dual[i]) for i in range(3))
        return ends + 2 * sum(c[i][j] * dot(dual[i], dual[j]) for i, j in ((0, 1), (0, 2), (1, 2)))

    @cached_property
    def I2(self) -> Expr:
        """Second invariant (I1^2 - tr C^2)/2."""
        return (self.I1**2 - ufl.inner(self.C, self.C)) / 2

    @cached_property
    def I2_bar(self) -> Expr:
        """Modified second invariant J^(-4/3) I2."""
        return self.isochoric**2 * self.I2

    def I8(self, one: Direction, other: Direction) -> Expr:
        """Product of two deformed directions, a . C b."""
        a, b = ([ufl.inner(self.vector(v), g) for g in self.dual] for v in (one, other))
        c = self._covariant
        return sum(a[i] * c[i][j] * b[j] for i in range(3) for j in range(3))


class PointKinematics(ShellKinematics):
    """What an energy may depend on at a point whose metric and base vectors are known.

    An energy sees the metric through C and invariants alone. Each is a variable, so that the energy's derivative by it
    is worked out once, and not for every component of the metric.

    Args:
        metric: Components c_11, c_22, c_33, c_12, c_13, c_23 of a metric of volume 1.
        dual: G^1, G^2, G^3 in rows.
        fibres: Unit vectors of the reference state by name.
    """

    def __init__(self, metric: Expr, dual: Expr, fibres: Mapping[str, Expr]) -> None:
        self.dim, self.fibres = 3, dict(fibres)
        self._components, self._rows = ufl.variable(metric), dual
        self._seen: dict[object, Expr] = {}

    def _variable(self, key: object, value: Expr) -> Expr:
        return self._seen.setdefault(key, ufl.variable(value))

    @cached_property
    def C(self) -> Expr:
        """Right Cauchy-Green tensor C = c_ij G^i (x) G^j."""
        return self._variable("C", super().C)

    @cached_property
    def I1(self) -> Expr:
        """First invariant tr C."""
        return self._variable("I1", super().I1)

    def I8(self, one: Direction, other: Direction) -> Expr:
        """Product of two deformed directions, a . C b."""
        return self._variable((one, other), super().I8(one, other))

    def gradient(self, W: Expr) -> Expr:
        """Return the derivative by the metric of an energy of these kinematics, ``(6,)``."""
        terms = []
        for seen in self._seen.values():
            slope, rate = ufl.diff(W, seen), ufl.diff(seen, self._components)
            i, j, k = ufl.indices(3)
            terms.append(
                slope * rate if not seen.ufl_shape else ufl.as_vector(slope[i, j] * rate[i, j, k], k)
            )
        return sum(terms)

    @cached_property
    def dual(self) -> tuple[Expr, Expr, Expr]:
        """Contravariant base vectors G^i."""
        one, two, three = (ufl.as_vector([self._rows[i, d] for d in range(3)]) for i in range(3))
        return one, two, three

    @cached_property
    def _covariant(self) -> list[list[Expr]]:
        """Components c_ij."""
        c11, c22, c33, c12, c13, c23 = (self._components[i] for i in range(6))
        return [[c11, c12, c13], [c12, c22, c23], [c13, c23, c33]]


class StressFreeKinematics(ShellKinematics):
    """What the energy of a compressible material may depend on: no stress acts through the thickness.

    Args:
        metric: Covariant components c_ij but c_33.
        frame: G_1, G_2, G_3.
        fibres: Unit vectors of the reference state by name.
        thinning: Strain along a unit normal to be added to a strain for that, see `SaintVenantKirchhoff.thinning`.
    """

    def __init__(
        self,
        metric: Metric,
        frame: tuple[Expr, Expr, Expr],
        fibres: Mapping[str, Expr] | None,
        thinning: Callable[[Expr, Expr], Expr],
    ) -> None:
        super().__init__(metric, frame, fibres)
        self._thinning = thinning

    @cached_property
    def growth(self) -> Expr:
        """Change of c_33 from rest that leaves no stress along the normal."""
        c11, c22, c12, c13, c23 = self._metric
        G3, normal = self._frame[2], self.dual[2]
        squared = ufl.inner(normal, normal)
        K = ufl.as_matrix([[a[d] for d in range(3)] for a in self.dual])
        unthinned = ufl.as_matrix([[c11, c12, c13], [c12, c22, c23], [c13, c23, ufl.inner(G3, G3)]])
        E = (K.T * unthinned * K - ufl.Identity(3)) / 2
        return 2 * self._thinning(E, normal / ufl.sqrt(squared)) / squared

    @cached_property
    def _covariant(self) -> list[list[Expr]]:
        """Components c_ij."""
        c11, c22, c12, c13, c23 = self._metric
        c33 = ufl.inner(self._frame[2], self._frame[2]) + self.growth
        return [[c11, c12, c13], [c12, c22, c23], [c13, c23, c33]]

    @cached_property
    def J(self) -> Expr:
        """Volume ratio, the root of det C."""
        G1, G2, G3 = self._frame
        return ufl.sqrt(ufl.det(ufl.as_matrix(self._covariant))) / abs(ufl.inner(ufl.cross(G1, G2), G3))

    @cached_property
    def log_J(self) -> Expr:
        """Logarithm of the volume ratio."""
        return ufl.ln(self.J)

    @cached_property
    def isochoric(self) -> Expr:
        """Factor that takes C to its isochoric part, J^(-2/3)."""
        return ufl.exp(-2 / 3 * self.log_J)
