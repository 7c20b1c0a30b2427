"""The coupled step: hyperelastic solids immersed in an incompressible fluid (Lee2020, S11 to S14).

A solid has the fluid's density, or more of its own: see `valvefsi.bodies.excess_mass`.

`step` is the scheme and nothing else: no files, no options, no clock. A `State` is exactly what a checkpoint holds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from valvefsi.bodies.excess_mass import ExcessMass, Twin
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.grid import Array, Faces, MacGrid


class Solid(Protocol):
    """What the coupled step asks of a solid."""

    X: Array
    """Reference positions of this rank's nodes, ``(num_nodes, 3)`` [cm]."""

    def force(self, chi: Array, U: Array, t: float) -> Array:
        """Nodal forces at positions chi, velocities U and time t, ``(num_nodes, 3)`` [dyn]."""
        ...


class Circulation(Protocol):
    """What the coupled step asks of the circuits that drive and load the fluid."""

    sides: tuple[str, ...]
    """Names of the sides of the box whose pressure it gives."""

    start: Array
    """Its state at t = 0."""

    def pressures(self, y: Array, t: float) -> Mapping[str, float]:
        """Pressure on each of its sides for state y at time t [dyn/cm^2]."""
        ...

    def step(self, y: Array, outflow: Mapping[str, float], t: float, dt: float) -> Array:
        """Return the state at t + dt for mean flows out of the box through its sides [cm^3/s]."""
        ...


class Transfer(Protocol):
    """Spreading and interpolation for one position of the nodes, each the adjoint of the other."""

    def spread(self, F: Array, out: Faces | None = None) -> Faces:
        """Force density on the faces of nodal forces F, added to out [dyn/cm^3]."""
        ...

    def interpolate(self, u: Faces) -> Array:
        """Velocity of the nodes, ``(num_nodes, 3)`` [cm/s]."""
        ...


class Coupling(Protocol):
    """How a solid and the grid see each other: at the nodes, or at quadrature points of the elements."""

    name: str
    """Name of the kernel."""

    def at(self, chi: Array) -> Transfer:
        """Prepare the transfer for nodes at chi. Collective."""
        ...


class Held(Protocol):
    """What the coupled step asks of a rigid surface: points that stay where they are."""

    name: str
    """Name in files."""

    X: Array
    """Positions of this rank's points, ``(num_points, 3)`` [cm]."""

    slip: float
    """Rate at which a point slips back through the fluid to its place [1/s]."""

    def force(self, d: Array, U: Array) -> Array:
        """Forces on the fluid of points carried by d and moving with U, ``(num_points, 3)`` [dyn]."""
        ...


@dataclass(frozen=True, kw_only=True)
class Model:
    """What does not change during a run.

    Attributes:
        grid: The staggered grid.
        fluid: The fluid step.
        solids: The immersed solids.
        couplings: The regularised delta function of each solid.
        circulation: The circuits at open sides; those without one keep their own pressure.
        rigid: The rigid surfaces.
        transfers: Transfer of each of them, at its points.
        heavy: The excess mass of the solids that are denser than the fluid.
        seepage: For solids that the fluid can pass through, by number: how fast a node slips through it per force,
            ``(num_nodes,)`` [cm/(dyn s)].
    """

    grid: MacGrid
    fluid: NavierStokes
    solids: tuple[Solid, ...] = ()
    couplings: tuple[Coupling, ...] = ()
    circulation: Circulation | None = None
    rigid: tuple[Held, ...] = ()
    transfers: tuple[Transfer, ...] = ()
    heavy: tuple[ExcessMass, ...] = ()
    seepage: Mapping[int, Array] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class State:
    """Everything that the next step depends on.

    Attributes:
        t: Time [s].
        step: Number of steps taken.
        dt: Length of the last step [s].
        u: Velocity on the faces at t, ghosts filled [cm/s].
        p: Pressure in the cells at t - dt/2, ghosts filled [dyn/cm^2].
        N: Advection term at t - dt [cm/s^2].
        chi: Position of each solid's nodes at t, ``(num_nodes, 3)`` each [cm].
        circuits: State of the circulation at t, the same on all ranks, ``(num_states,)``.
        carried: How far the fluid has carried the points of each rigid surface, ``(num_points, 3)`` each [cm].
        twins: Positions and velocities of the excess mass of each heavy solid at t.
        dt_stable: Largest stable step when it was last measured, see `valvefsi.run.stable_step` [s].
    """

    t: float
    step: int
    dt: float
    u: Faces
    p: Array
    N: Faces
    chi: tuple[Array, ...]
    circuits: Array = field(default_factory=lambda: np.zeros(0))
    carried: tuple[Array, ...] = ()
    twins: tuple[Twin, ...] = ()
    dt_stable: float = math.inf


def initial_state(model: Model, dt: float, u: Faces | None = None, p: Array | None = None) -> State:
    """Return the state at t = 0: the solids in their reference positions, the fluid at rest unless given.

    Args:
        model: The model.
        dt: Length of the first step [s].
        u: Velocity on the owned faces, local arrays with ghosts [cm/s].
        p: Pressure, local array with filled ghosts [dyn/cm^2].
    """
    u = model.fluid.fill(model.grid.zero_faces() if u is None else u, 0.0)
    twins = []
    for body in model.heavy:
        X = model.solids[body.solid].X
        twins.append(body.start(X, model.couplings[body.solid].at(X).interpolate(u)))
    return State(
        t=0.0,
        step=0,
        dt=dt,
        u=u,
        p=model.grid.zeros() if p is None else p,
        N=model.fluid.advection(u),
        chi=tuple(solid.X.copy() for solid in model.solids),
        circuits=np.zeros(0) if model.circulation is None else model.circulation.start.copy(),
        carried=tuple(np.zeros_like(surface.X) for surface in model.rigid),
        twins=tuple(twins),
    )


def step(model: Model, s: State, dt: float) -> State:
    """Advance the coupled system from s by one step of length dt.

    Args:
        model: The model.
        s: State at t.
        dt: Length of the step [s].

    Returns:
        State at t + dt.

    Raises:
        StabilityError: A node has left the box or is within its kernel's reach of an open side.

    Note:
        Collective. Second order in time, first order with a circulation, dampers or seepage; the velocity is
        solenoidal to round-off.
    """
    # 1. move the solids half a step with the velocity they feel now
    U = [c.at(chi).interpolate(s.u) for c, chi in zip(model.couplings, s.chi, strict=True)]
    chi_half = [chi + 0.5 * dt * V for chi, V in zip(s.chi, U, strict=True)]
    T = [c.at(chi) for c, chi in zip(model.couplings, chi_half, strict=True)]
    # 2. their elastic force there and the pull of their excess mass, spread to the faces
    F = [solid.force(*at, s.t + 0.5 * dt) for solid, *at in zip(model.solids, chi_half, U, strict=True)]
    twins = []
    for body, twin in zip(model.heavy, s.twins, strict=True):
        twin = body.adapted(twin, s.chi[body.solid], dt / s.dt)
        pull = body.pull(twin, chi_half[body.solid], U[body.solid], dt)
        F[body.solid] += pull
        twins.append(body.moved(twin, pull, dt))
    f = model.grid.zero_faces()
    for transfer, force in zip(T, F, strict=True):
        transfer.spread(force, out=f)
    for surface, transfer, d in zip(model.rigid, model.transfers, s.carried, strict=True):
        V = transfer.interpolate(s.u)
        transfer.spread(surface.force(d + 0.5 * dt * V, V), out=f)
    # 3. one fluid step under that force, against the pressures of the circulation
    N = model.fluid.advection(s.u)
    pressures = model.circulation.pressures(s.circuits, s.t) if model.circulation else None
    u, p = model.fluid.step(s.u, s.p, (N, s.N, dt / s.dt), f, s.t, dt, pressures)
    # 4. move the solids the whole step with the midpoint velocity, and with what they slip through the fluid
    u_half = tuple(0.5 * (a + b) for a, b in zip(s.u, u, strict=True))
    V = [t.interpolate(u_half) for t in T]
    for k, mobility in model.seepage.items():
        V[k] += mobility[:, None] * F[k]
    chi = tuple(chi + dt * v for chi, v in zip(s.chi, V, strict=True))
    carried = tuple(
        (1.0 - dt * surface.slip) * d + dt * transfer.interpolate(u_half)
        for surface, d, transfer in zip(model.rigid, s.carried, model.transfers, strict=True)
    )
    # 5. the circulation sees the new flow
    circuits = s.circuits
    if model.circulation:
        flows = {name: model.fluid.boundary.outflow(u_half, name) for name in model.circulation.sides}
        circuits = model.circulation.step(s.circuits, flows, s.t, dt)
    moved = {"chi": chi, "circuits": circuits, "carried": carried, "twins": tuple(twins)}
    return State(t=s.t + dt, step=s.step + 1, dt=dt, u=u, p=p, N=N, dt_stable=s.dt_stable, **moved)
