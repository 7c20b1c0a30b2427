"""Solids heavier than the fluid: every node has a twin with the excess mass, tied to it (Kim and Peskin 2007, 2016).

The fluid fills the solid and gives it its own density rho. What a node lacks, m_k = (rho_s - rho) V_k, is carried by a
twin Y_k that spring and damper tie to the node; their force acts on the fluid at the node and, the other way round, on
the twin, so that momentum is kept to round-off:

    F_k = mu_k (a (Y_k - chi_k) / dt^2 + b (V_k - U_k) / dt),   m_k dV_k/dt = -F_k,   mu_k = m_k M_k / (m_k + M_k)

with M_k = rho V_k / fill the fluid that the node moves, fill the largest value of the spread volume, S[chi] V. The
distance of the two then obeys the same recurrence at every density, every step and every mesh,

    lambda^2 - (2 - a - b) lambda + 1 - b = 0,   stable while a + 2 b < 4;

a = b = 1/2 leaves room for less fluid in motion than M_k says and for other springs, and loses 30 % a step. (What the
fluid cannot follow, twins that crowd or that jump from node to node, rings longer, by the factor m_k / mu_k.) A twin
lags its node by m_k dt^2 / (a mu_k) times the acceleration: the tie is as consistent as the step, of second order, and
there is no constant to choose. Where a step is followed by one of another length, the twins take the lag of that one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from mpi4py import MPI

from valvefsi.errors import CaseError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

SPRING, DAMPER = 0.5, 0.5
"""Constants a and b of the tie."""


class Twin(NamedTuple):
    """The excess mass of a solid's nodes."""

    Y: Array
    """Positions, ``(num_nodes, 3)`` [cm]."""
    V: Array
    """Velocities, ``(num_nodes, 3)`` [cm/s]."""


class ExcessMass:
    """The mass that a solid has over the fluid that it displaces.

    Args:
        number: Which solid of the model.
        solid: The solid: ``X``, ``weights`` (volume of each node), ``reference_volume``, ``name``.
        coupling: Its coupling.
        rho: Density of the fluid [g/cm^3].
        density: Density of the solid in its reference state, above rho [g/cm^3].

    Attributes:
        mass: Excess mass of this rank's nodes, ``(num_nodes, 1)`` [g].
        reduced: Reduced mass of the twin and the fluid that the node moves, ``(num_nodes, 1)`` [g].
        share: Largest part of a node's inertia that is excess, m / (m + M).

    Raises:
        CaseError: The density is not above the fluid's.

    Note:
        Collective.
    """

    def __init__(self, number: int, solid: object, coupling: object, *, rho: float, density: float) -> None:
        if not rho < density < np.inf:
            message = f"expected more than the fluid's density, {rho:g} g/cm^3"
            raise CaseError(message, key="density", value=density)
        self.solid, self.density = number, float(density)
        self.comm = coupling.grid.comm
        volume = solid.weights[:, None]
        self.mass: Array = (density - rho) * volume
        fluid = rho * volume / _fill(solid, coupling)
        self.reduced: Array = self.mass * fluid / (self.mass + fluid)
        here = (self.mass / (self.mass + fluid)).max(initial=0.0)
        self.share: float = self.comm.allreduce(float(here), op=MPI.MAX)

    def start(self, chi: Array, U: Array) -> Twin:
        """Return twins that move with nodes at chi with velocity U."""
        return Twin(chi.copy(), U.copy())

    def adapted(self, twin: Twin, chi: Array, ratio: float) -> Twin:
        """Return twins with the lag behind nodes at chi that steps ``ratio`` times as long have.

        Without it a change of the step would kick the nodes, as the tie grows stiffer while the lag stays.
        """
        return twin if ratio == 1.0 else Twin(chi + ratio**2 * (twin.Y - chi), twin.V)

    def pull(self, twin: Twin, chi_half: Array, U: Array, dt: float) -> Array:
        """Return the force of the twins on the nodes, ``(num_nodes, 3)`` [dyn].

        Args:
            twin: Twins at t.
            chi_half: Positions of the nodes at t + dt/2 [cm].
            U: Velocities of the nodes at t [cm/s].
            dt: Length of the step [s].
        """
        lag = twin.Y + 0.5 * dt * twin.V - chi_half
        return self.reduced * (SPRING / dt**2 * lag + DAMPER / dt * (twin.V - U))

    def moved(self, twin: Twin, F: Array, dt: float) -> Twin:
        """Return the twins a step later, after the force F on their nodes [dyn]."""
        V = twin.V - dt * F / self.mass
        return Twin(twin.Y + 0.5 * dt * (twin.V + V), V)

    def momentum(self, twin: Twin) -> Array:
        """Return the momentum of this rank's excess mass, ``(3,)`` [g cm/s]."""
        return (self.mass * twin.V).sum(axis=0)

    def kinetic_energy(self, twin: Twin) -> float:
        """Return the kinetic energy of all excess mass [erg] (collective)."""
        return self.comm.allreduce(0.5 * float((self.mass * twin.V**2).sum()))

    def lag(self, twin: Twin, chi: Array) -> float:
        """Return the largest distance of a twin from its node [cm] (collective)."""
        here = float(np.linalg.norm(twin.Y - chi, axis=1).max(initial=0.0))
        return self.comm.allreduce(here, op=MPI.MAX)

    def lag_of_acceleration(self, dt: float) -> float:
        """Return the largest lag per acceleration with steps dt [s^2] (collective)."""
        here = float((self.mass / self.reduced).max(initial=0.0))
        return dt**2 / SPRING * self.comm.allreduce(here, op=MPI.MAX)

    def stiffness(self, dt: float) -> float:
        """Return the largest stiffness of a tie with steps dt [dyn/cm] (collective)."""
        here = float(self.reduced.max(initial=0.0))
        return SPRING / dt**2 * self.comm.allreduce(here, op=MPI.MAX)

    @property
    def room(self) -> float:
        """Part of the square of the explicit step's limit that the tie leaves to other springs."""
        return 1.0 - 0.25 * (SPRING + 2.0 * DAMPER) * self.share


def _fill(solid: object, coupling: object) -> float:
    """Largest value of the spread volume: 1 in a dense body, less in a thin one, more where nodes are far apart."""
    ones = np.zeros_like(solid.X)
    ones[:, : coupling.grid.dim] = solid.weights[:, None]
    spread = coupling.at(solid.X).spread(ones)
    largest = max(float(f.max(initial=0.0)) for f in spread[: coupling.grid.dim])
    return coupling.grid.comm.allreduce(largest, op=MPI.MAX)
