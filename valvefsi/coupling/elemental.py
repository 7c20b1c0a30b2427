"""Elemental coupling: forces and velocities pass through quadrature points that follow the elements, not through nodes.

The nodal force becomes a density by an L2 projection and is spread from the quadrature points; the velocity there is
projected back onto the nodes with the same matrix, so that the two are adjoint (Griffith and Luo 2017). The points
move apart as elements stretch, and the rule of each element is refined until no gap exceeds a fraction of h: a
mesh coarser than the grid does not leak.
"""

from __future__ import annotations

from typing import Protocol

from valvefsi.coupling.mirrors import Signs
from valvefsi.coupling.transfer import Coupling, Transfer
from valvefsi.errors import StabilityError, raise_together
from valvefsi.grid import MacGrid
from valvefsi.types import Array, Faces

GAP = 0.75
"""Largest gap between neighbouring points, in grid spacings.

A plug of elements of 1 to 3 h lets through as much at a gap of 1 as at 0.3 (bspline3, ib4; within some per cent), a
disk in a cavity keeps its area to 0.45 % at 0.5, 0.46 % at 0.75 and 0.48 % at 1.
"""


class Rule(Protocol):
    """Quadrature points of a body at one position of its nodes."""

    x: Array
    """Positions of this rank's points, ``(num_points, 3)`` [cm]."""

    def lift(self, F: Array) -> Array:
        """Forces of the points that stand for nodal forces F ``(num_nodes, 3)`` [dyn]: w_q sum_k phi_k M^-1 F."""
        ...

    def project(self, U: Array) -> Array:
        """Nodal velocity nearest to the points' velocity U ``(num_points, 3)``: M^-1 sum_q w_q phi_k U_q."""
        ...


class Points(Protocol):
    """A body that can be covered with quadrature points."""

    def refined(self, chi: Array, gap: float) -> Rule:
        """Points of the body at chi, no two neighbours of one element further apart than gap [cm]. Collective."""
        ...


class ElementalCoupling:
    """The regularised delta function of one solid on one grid, acting at quadrature points.

    Args:
        grid: The grid.
        kernel: Name of the kernel, see `valvefsi.coupling.kernels.KERNELS`.
        points: The body's quadrature points.
        gap: Largest gap between neighbouring points, in grid spacings.
        signs: How the fluid's velocity is reflected about sides, as in `valvefsi.coupling.transfer.Coupling`.

    Raises:
        ValueError: The kernel is not known, or the gap is not positive.
    """

    nodal = False
    """Whether the nodes themselves are the points."""

    def __init__(
        self, grid: MacGrid, kernel: str, points: Points, gap: float = GAP, signs: Signs | None = None
    ) -> None:
        if not gap > 0.0:
            raise ValueError(f"the largest gap must be positive, got {gap}")
        self.inner = Coupling(grid, kernel, signs)
        self.grid, self.name, self.kind, self.reach = grid, kernel, self.inner.kind, self.inner.reach
        self.points, self.gap = points, gap * float(min(grid.spacing[: grid.dim]))

    def at(self, chi: Array) -> ElementalTransfer:
        """Prepare spreading and interpolation for nodes at chi.

        Args:
            chi: Positions of this rank's nodes, ``(num_nodes, 3)`` [cm].

        Raises:
            StabilityError: An element is too large for any rule, or a point is lost or too near to an open side.

        Note:
            Collective.
        """
        return ElementalTransfer(self, chi)


class ElementalTransfer:
    """Spreading and interpolation for one position of the nodes; made by `ElementalCoupling.at`."""

    def __init__(self, coupling: ElementalCoupling, chi: Array) -> None:
        error = rule = None
        try:
            rule = coupling.points.refined(chi, coupling.gap)
        except StabilityError as caught:
            error = caught
        raise_together(coupling.grid.comm, error)
        assert rule is not None
        self.rule = rule
        self.transfer: Transfer = coupling.inner.at(rule.x)

    def spread(self, F: Array, out: Faces | None = None) -> Faces:
        """Spread nodal forces to the MAC faces from the quadrature points.

            f_d(x) = sum_q w_q G_d(X_q) delta_h(x - chi_q),   M G = F          (Lee2020, S13)

        Args:
            F: Force of this rank's nodes, ``(num_nodes, 3)`` [dyn].
            out: Faces to add to; new ones by default.

        Returns:
            Force density on the owned faces, one local array per axis [dyn/cm^3].

        Note:
            Collective. Away from sides it keeps the total force, and with the consistent mass the torque.
        """
        return self.transfer.spread(self.rule.lift(F), out)

    def interpolate(self, u: Faces) -> Array:
        """Interpolate a face velocity to the quadrature points and project it onto the nodes.

            M U_k = sum_q w_q phi_k(X_q) u(chi_q)          (the adjoint of `spread`; Lee2020, S14)

        Args:
            u: Velocity with filled ghosts, one local array per axis [cm/s].

        Returns:
            Velocity of this rank's nodes, ``(num_nodes, 3)`` [cm/s].

        Note:
            Collective.
        """
        return self.rule.project(self.transfer.interpolate(u))

    def smooth(self, F: Array) -> Array:
        """Return the force density that the nodes feel of their own forces, see `Transfer.smooth`. Collective."""
        return self.rule.project(self.transfer.smooth(self.rule.lift(F)))
