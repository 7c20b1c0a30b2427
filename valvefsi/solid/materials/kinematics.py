"""Kinematics of a finite deformation, in two dimensions as plane strain with the three-dimensional split."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING

import ufl
from ufl.core.expr import Expr

from valvefsi.errors import CaseError

if TYPE_CHECKING:
    from valvefsi.solid.materials.parameters import Direction


class Kinematics:
    """What an energy may depend on, as UFL expressions of the deformation gradient F = dchi/dX and the fibres.

    In two dimensions the deformation is plane strain, F33 = 1, and every invariant is that of the
    three-dimensional F: I1 = tr(C_2d) + 1, modified by J^(-2/3) as in S21. The powers of J are written as
    exponentials of ln J, which is computed once; J <= 0 turns into NaN or infinity.

    Args:
        F: Deformation gradient, ``(dim, dim)`` UFL expression [-].
        fibres: Unit vector fields of the reference state by name, ``(dim,)`` UFL expressions.
    """

    def __init__(self, F: Expr, fibres: Mapping[str, Expr] | None = None) -> None:
        self.F = F
        self.dim = F.ufl_shape[0]
        self.fibres = dict(fibres or {})

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
    def isochoric(self) -> Expr:
        """Factor J^(-2/3) that takes C to its isochoric part."""
        return ufl.exp(-2 / 3 * self.log_J)

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
        return self.isochoric * self.I1

    @cached_property
    def I2_bar(self) -> Expr:
        """Modified second invariant J^(-4/3) I2 (S23)."""
        return ufl.exp(-4 / 3 * self.log_J) * self.I2

    def vector(self, direction: Direction) -> Expr:
        """Return the unit vector a of a direction: a fibre field, an angle [deg] or a vector.

        Raises:
            CaseError: There is no such fibre field, or the vector has the wrong number of components.
        """
        if isinstance(direction, str):
            if direction not in self.fibres:
                near = difflib.get_close_matches(direction, self.fibres, n=1)
                hint = f' (did you mean "{near[0]}"?)' if near else ""
                known = ", ".join(f'"{name}"' for name in self.fibres) or "none"
                raise CaseError(
                    f"no such fibre field{hint}; the mesh has {known}", key="fibre", value=direction
                )
            field = self.fibres[direction]
            return field if _is_constant_in_cells(field) else field / ufl.sqrt(ufl.inner(field, field))
        if not isinstance(direction, tuple):
            angle = math.radians(direction)
            direction = (math.cos(angle), math.sin(angle), 0.0)[: self.dim]
        if len(direction) != self.dim:
            message = f"expected {self.dim} components"
            raise CaseError(message, key="fibre", value=list(direction))
        return ufl.as_vector(direction)

    def I4(self, direction: Direction) -> Expr:
        """Square of the stretch along a direction, a . C a."""
        return self.I8(direction, direction)

    def I4_bar(self, direction: Direction) -> Expr:
        """Modified square of the stretch along a direction, J^(-2/3) a . C a."""
        return self.isochoric * self.I4(direction)

    def I8(self, one: Direction, other: Direction) -> Expr:
        """Product of two deformed directions, a . C b."""
        image = self.F * self.vector(one)
        return ufl.inner(image, image if one == other else self.F * self.vector(other))

    def I8_bar(self, one: Direction, other: Direction) -> Expr:
        """Modified product of two deformed directions, J^(-2/3) a . C b."""
        return self.isochoric * self.I8(one, other)


def _is_constant_in_cells(field: Expr) -> bool:
    """Whether a field needs no normalising between the nodes of its element."""
    space = getattr(field, "function_space", None)
    return space is None or space.ufl_element().degree == 0
