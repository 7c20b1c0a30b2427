"""Kinematics of a finite deformation, in two dimensions as plane strain with the three-dimensional split."""

from __future__ import annotations

from functools import cached_property

from valvefsi import dolfinx_compat  # noqa: F401  (loads MPI and DOLFINx in the right order)

# isort: split
import ufl
from ufl.core.expr import Expr


class Kinematics:
    """What an energy may depend on, as UFL expressions of the deformation gradient F = dchi/dX.

    In two dimensions the deformation is plane strain, F33 = 1, and every invariant is that of the
    three-dimensional F: I1 = tr(C_2d) + 1, modified by J^(-2/3) as in S21. The powers of J are written as
    exponentials of ln J, which is computed once; J <= 0 turns into NaN or infinity.

    Args:
        F: Deformation gradient, ``(dim, dim)`` UFL expression [-].
    """

    def __init__(self, F: Expr) -> None:
        self.F = F
        self.dim = F.ufl_shape[0]

    @cached_property
    def C(self) -> Expr:
        """Right Cauchy-Green tensor C = F^T F, its in-plane part in two dimensions."""
        return self.F.T * self.F

    @cached_property
    def J(self) -> Expr:
        """Volume ratio J = det F."""
        return ufl.det(self.F)

    @cached_property
    def log_J(self) -> Expr:
        """Logarithm of the volume ratio, ln J."""
        return ufl.ln(self.J)

    @cached_property
    def I1(self) -> Expr:
        """First invariant tr C (in plane strain tr C_2d + 1)."""
        in_plane = ufl.inner(self.F, self.F)
        return in_plane + 1 if self.dim == 2 else in_plane

    @cached_property
    def I2(self) -> Expr:
        """Second invariant (I1^2 - tr C^2)/2 (in plane strain tr C_2d + J^2)."""
        if self.dim == 2:
            return ufl.inner(self.F, self.F) + self.J**2
        return (self.I1**2 - ufl.inner(self.C, self.C)) / 2

    @cached_property
    def I1_bar(self) -> Expr:
        """Modified first invariant J^(-2/3) I1 (S21)."""
        return ufl.exp(-2 / 3 * self.log_J) * self.I1

    @cached_property
    def I2_bar(self) -> Expr:
        """Modified second invariant J^(-4/3) I2 (S23)."""
        return ufl.exp(-4 / 3 * self.log_J) * self.I2
