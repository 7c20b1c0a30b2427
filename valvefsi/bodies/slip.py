"""Laws by which points slip through the fluid: as porous tissue does, or where the grid does not see what they do.

Both take energy from the body and none from the fluid: the power F . V is not negative.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Protocol

import numpy as np

if TYPE_CHECKING:
    from valvefsi.types import Array, Transfer


class Slip(Protocol):
    """A law of slip, linear in the forces and symmetric.

    Attributes:
        elemental: Whether it is one for elemental coupling, too.
    """

    elemental: ClassVar[bool]

    def velocity(self, F: Array, transfer: Transfer) -> Array:
        """Return the velocity at which points slip through the fluid, ``(n, 3)`` [cm/s] (collective).

        Args:
            F: Forces of this rank's points on the fluid, ``(n, 3)`` [dyn].
            transfer: Spreading and interpolation where they are.
        """
        ...

    def largest(self, fill: float) -> float:
        """Return the largest permeability at which anything slips [cm^4/(dyn s)].

        Args:
            fill: Largest part of a kernel's volume that the body fills.
        """
        ...


@dataclass(frozen=True)
class DarcySlip:
    """Darcy's law: V = k f with the force density f = F / w (Mow et al. 1980).

    Args:
        permeability: k [cm^4/(dyn s)].
        weights: w of each point, ``(n, 1)`` [cm^3].
    """

    permeability: float
    weights: Array
    elemental: ClassVar[bool] = True

    def velocity(self, F: Array, transfer: Transfer) -> Array:
        """Return the velocity at which points slip through the fluid, see `Slip`."""
        return self.permeability / self.weights * F

    def largest(self, fill: float) -> float:
        """Return the largest permeability at which anything slips, see `Slip`."""
        return self.permeability


@dataclass(frozen=True)
class UnresolvedSlip:
    """Slip of that part of the forces which the grid does not resolve.

    What points closer than the kernel do against each other moves next to no fluid: forces that would end it all but
    cancel on the grid. A thin shell then keeps whatever thickness and shear the fluid has given it. With S*S, spreading
    and interpolation, and f = F / w,

        V = k (phi f - S*S F),    phi = S*S w,

    which is zero where f is the same at all points, so that no fluid passes under a smooth load; for waves shorter than
    the kernel it is Darcy's law with k phi. F . V = k/2 sum_ij (S*S)_ij w_i w_j |f_i - f_j|^2 is not negative.

    Args:
        permeability: k [cm^4/(dyn s)].
        weights: w of each point, ``(n, 1)`` [cm^3].
    """

    permeability: float
    weights: Array
    elemental: ClassVar[bool] = False

    def velocity(self, F: Array, transfer: Transfer) -> Array:
        """Return the velocity at which points slip through the fluid, see `Slip`."""
        phi = transfer.smooth(np.repeat(self.weights, 3, axis=1))
        return self.permeability * (phi * F / self.weights - transfer.smooth(F))

    def largest(self, fill: float) -> float:
        """Return the largest permeability at which anything slips, see `Slip`."""
        return self.permeability * fill
