"""Solids heavier than the fluid: every node has a marker with the excess mass (penalty IB; Kim and Peskin 2007, 2016).

The fluid fills the solid and gives it its own density rho. What a node lacks, m_k = (rho_s - rho) V_k, is carried by a
marker Y_k that spring and damper bind to the node; their force acts on the fluid at the node and, the other way round,
on the marker, so that momentum is kept to round-off:

    F_k = mu_k (a (Y_k - chi_k) / dt^2 + b (V_k - U_k) / dt),   m_k dV_k/dt = -F_k,   mu_k = m_k M_k / (m_k + M_k)

with M_k = rho V_k / fill the fluid that the node moves, fill the largest value of the spread volume, S[chi] V. The
distance of the two then obeys the same recurrence at every density, every step and every mesh,

    lambda^2 - (2 - a - b) lambda + 1 - b = 0,   stable while a + 2 b < 4;

a = b = 1/2 leaves a reserve for less fluid in motion than M_k says and for other springs, and loses 30 % a step. (What
the fluid cannot follow, markers that crowd or that jump from node to node, rings longer, by the factor m_k / mu_k.) A
marker lags its node by m_k dt^2 / (a mu_k) times the acceleration: the penalty is as consistent as the step, of second
order, and there is no constant to choose. Where a step is followed by one of another length, the markers take the lag
of that one: without it a change of the step would kick the nodes, as the spring grows stiffer while the lag stays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI

from valvefsi.bodies.body import BodyBase, Entry
from valvefsi.bodies.elastic import Elastic, ElasticHalf
from valvefsi.errors import CaseError

if TYPE_CHECKING:
    from valvefsi.bodies.slip import Slip
    from valvefsi.coupling.elemental import ElementalCoupling
    from valvefsi.coupling.transfer import Coupling
    from valvefsi.solid.structure import Structure
    from valvefsi.types import Array, Faces, Table

SPRING, DAMPER = 0.5, 0.5
"""Constants a and b of the penalty."""


@dataclass(frozen=True, kw_only=True)
class HeavyHalf(ElasticHalf):
    """A heavy body halfway through a step: its markers are through with it."""

    Y: Array
    V: Array

    def whole(self, U: Array) -> Table:
        """Return the state after the step."""
        return super().whole(U) | {"Y": self.Y, "V": self.V}


class Heavy(Elastic):
    """A hyperelastic solid of a larger density than the fluid's.

    Its state is ``chi`` and, of the markers, positions ``Y`` [cm] and velocities ``V`` [cm/s], ``(n, 3)`` each.

    Args:
        solid: The solid.
        coupling: How it and the grid see each other.
        rho: Density of the fluid [g/cm^3].
        density: Density of the solid in its reference state, above rho [g/cm^3].
        slip: How its nodes slip through the fluid; None for not.

    Attributes:
        mass: Excess mass of this rank's nodes, ``(n, 1)`` [g].
        reduced: Reduced mass of the marker and the fluid that the node moves, ``(n, 1)`` [g].
        part: Largest part of a node's inertia that is excess, m / (m + M).

    Raises:
        CaseError: The density is not above the fluid's.

    Note:
        Collective.
    """

    def __init__(
        self,
        solid: Structure,
        coupling: Coupling | ElementalCoupling,
        *,
        rho: float,
        density: float,
        slip: Slip | None = None,
    ) -> None:
        if not rho < density < np.inf:
            message = f"expected more than the fluid's density, {rho:g} g/cm^3"
            raise CaseError(message, key="density", value=density)
        super().__init__(solid, coupling, slip=slip)
        self.density = float(density)
        volume = solid.weights[:, None]
        self.mass: Array = (density - rho) * volume
        fluid = rho * volume / _fill(solid, coupling)
        self.reduced: Array = self.mass * fluid / (self.mass + fluid)
        self.part = self._largest(self.mass / (self.mass + fluid))

    def start(self, u: Faces) -> Table:
        """Return the state at t = 0: markers that move with the nodes. Collective."""
        return {"chi": self.X.copy(), "Y": self.X.copy(), "V": self.coupling.at(self.X).interpolate(u)}

    def continued(self, other: BodyBase, q: Table, u: Faces) -> Table:
        """Return the state with the displacement of another mesh, markers moving with the nodes. Collective."""
        chi = super().continued(other, q, u)["chi"]
        return {"chi": chi, "Y": chi.copy(), "V": self.coupling.at(chi).interpolate(u)}

    def half(self, q: Table, u: Faces, t: float, dt_old: float, dt: float) -> HeavyHalf:
        """Move half a step with the velocity that the nodes feel now, see `valvefsi.types.Body`. Collective."""
        chi, V = q["chi"], q["V"]
        U = self.coupling.at(chi).interpolate(u)
        chi_half = chi + 0.5 * dt * U
        transfer = self.coupling.at(chi_half)
        Y = q["Y"] if dt == dt_old else chi + (dt / dt_old) ** 2 * (q["Y"] - chi)
        lag = Y + 0.5 * dt * V - chi_half
        penalty = self.reduced * (SPRING / dt**2 * lag + DAMPER / dt * (V - U))
        force = self.solid.force(chi_half, U, t + 0.5 * dt) + penalty
        V_new = V - dt * penalty / self.mass
        return HeavyHalf(
            chi=chi,
            chi_half=chi_half,
            force=force,
            transfer=transfer,
            slip=self.slip,
            dt=dt,
            Y=Y + 0.5 * dt * (V + V_new),
            V=V_new,
        )

    def stored(self, q: Table) -> float:
        """Return the elastic energy, that of its tethers and the kinetic one of its excess mass [erg] (collective)."""
        return super().stored(q) + self.kinetic_energy(q)

    def excess_momentum(self, q: Table) -> Array:
        """Return the momentum of its excess mass, ``(3,)`` [g cm/s] (collective)."""
        return self.coupling.grid.comm.allreduce((self.mass * q["V"]).sum(axis=0))

    def kinetic_energy(self, q: Table) -> float:
        """Return the kinetic energy of its excess mass [erg] (collective)."""
        return self.coupling.grid.comm.allreduce(0.5 * float((self.mass * q["V"] ** 2).sum()))

    def lag(self, q: Table) -> float:
        """Return the largest distance of a marker from its node [cm] (collective)."""
        return self._largest(np.linalg.norm(q["Y"] - q["chi"], axis=1))

    def columns(self) -> list[str]:
        """Return the names of its columns in the history."""
        excess = [f"{self.name}_excess_kinetic_energy_erg", f"{self.name}_marker_lag_cm"]
        return [*super().columns(), *excess]

    def row(self, q: Table) -> dict[str, float]:
        """Return change of volume, extremes of J, energy and lag of the excess mass (collective)."""
        excess = (self.kinetic_energy(q), self.lag(q))
        return super().row(q) | dict(zip(self.columns()[-2:], excess, strict=True))

    def lag_of_acceleration(self, dt: float) -> float:
        """Return the largest lag per acceleration with steps dt [s^2] (collective)."""
        return dt**2 / SPRING * self._largest(self.mass / self.reduced)

    def penalty_stiffness(self, dt: float) -> float:
        """Return the largest stiffness of the penalty springs with steps dt [dyn/cm] (collective)."""
        return SPRING / dt**2 * self._largest(self.reduced)

    @property
    def reserve(self) -> float:
        """Part of the square of the explicit step's limit that the penalty leaves to other springs."""
        return 1.0 - 0.25 * (SPRING + 2.0 * DAMPER) * self.part

    def statics(self, dt: float) -> list[Entry]:
        """Return how stiffly the excess mass is bound, how far it lags, and the tethers (collective)."""
        note = f"density {self.density:g} g/cm^3; lag = {self.lag_of_acceleration(dt):.3g} s^2 times acceleration"
        quantity = f"penalty stiffness of the excess mass of {self.name}"
        entry = Entry(quantity=quantity, value=self.penalty_stiffness(dt), unit="dyn/cm", note=note)
        return [entry, *super().statics(dt)]

    def _largest(self, values: Array) -> float:
        here = float(values.max(initial=0.0))
        return self.coupling.grid.comm.allreduce(here, op=MPI.MAX)


def _fill(solid: Structure, coupling: Coupling | ElementalCoupling) -> float:
    """Largest value of the spread volume: 1 in a dense body, less in a thin one, more where nodes are far apart."""
    ones = np.zeros_like(solid.X)
    ones[:, : coupling.grid.dim] = solid.weights[:, None]
    spread = coupling.at(solid.X).spread(ones)
    largest = max(float(f.max(initial=0.0)) for f in spread[: coupling.grid.dim])
    return coupling.grid.comm.allreduce(largest, op=MPI.MAX)
