"""The coupled step: bodies immersed in an incompressible fluid (Lee2020, S11 to S14), with the circuits of a flow loop.

`step` is the scheme and nothing else: no files, no options, no clock, no kinds of bodies. A `State` is exactly what a
checkpoint holds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from valvefsi.bodies.body import BodyBase
from valvefsi.circulation.loop import NoCirculation
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.grid import MacGrid
from valvefsi.types import Array, Circulation, Faces, HalfStep, Table


@dataclass(frozen=True, kw_only=True)
class Model:
    """What does not change during a run.

    Attributes:
        grid: The staggered grid.
        fluid: The fluid step.
        bodies: What is immersed, see `valvefsi.bodies`.
        circulation: The circuits at open sides; those without one keep their own pressure.
    """

    grid: MacGrid
    fluid: NavierStokes
    bodies: tuple[BodyBase, ...] = ()
    circulation: Circulation = field(default_factory=NoCirculation)


@dataclass(frozen=True, kw_only=True)
class State:
    """Everything that the next step depends on, and what the bodies have given to the fluid.

    Attributes:
        t: Time [s].
        step: Number of steps taken.
        dt: Length of the last step [s].
        u: Velocity on the faces at t, ghosts filled [cm/s].
        p: Pressure in the cells at t - dt/2, ghosts filled [dyn/cm^2].
        N: Advection term at t - dt [cm/s^2].
        bodies: State of each body at t, arrays by name: of its points ``(n, 3)``, see `BodyBase.rows` for others.
        circuits: State of the circulation at t, the same on all ranks, ``(num_states,)``.
        given: What each body has given to the fluid, the same on all ranks, ``(num_bodies, 4)``: three components of
            impulse [dyn s], and work [erg]. Nothing depends on it.
        dt_stable: Largest stable step when it was last measured, see `valvefsi.run.stable_step` [s].
        measure_at: Step from which on it is measured again.
        modes: What limited it for each body then, ``(n, 3)`` each; none before the first time.
        energies: Energy stored in each body then [erg].
    """

    t: float
    step: int
    dt: float
    u: Faces
    p: Array
    N: Faces
    bodies: tuple[Table, ...]
    circuits: Array
    given: Array
    dt_stable: float = math.inf
    measure_at: int = 0
    modes: tuple[Array, ...] = ()
    energies: tuple[float, ...] = ()


def initial_state(model: Model, dt: float, u: Faces | None = None, p: Array | None = None) -> State:
    """Return the state at t = 0: the bodies in their reference positions, the fluid at rest unless given.

    Args:
        model: The model.
        dt: Length of the first step [s].
        u: Velocity on the owned faces, local arrays with ghosts [cm/s].
        p: Pressure, local array with filled ghosts [dyn/cm^2].

    Note:
        Collective.
    """
    u = model.fluid.fill(model.grid.zero_faces() if u is None else u, 0.0)
    return State(
        t=0.0,
        step=0,
        dt=dt,
        u=u,
        p=model.grid.zeros() if p is None else p,
        N=model.fluid.advection(u),
        bodies=tuple(body.start(u) for body in model.bodies),
        circuits=model.circulation.start.copy(),
        given=np.zeros((len(model.bodies), 4)),
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
        StabilityError: A point of a body has left the box or is within its kernel's reach of an open side.

    Note:
        Collective. Second order in time, first order with a circulation, dampers or Darcy mobility; the velocity is
        solenoidal to round-off.
    """
    # 1. every body half a step with the velocity it feels now, and its force there, spread to the faces
    half = [body.half(q, s.u, s.t, s.dt, dt) for body, q in zip(model.bodies, s.bodies, strict=True)]
    f = model.grid.zero_faces()
    for body in half:
        body.spread(f)
    # 2. one fluid step under that force, against the pressures of the circulation
    N, pressures = model.fluid.advection(s.u), model.circulation.pressures(s.circuits, s.t)
    u, p = model.fluid.step(s.u, s.p, (N, s.N, dt / s.dt), f, s.t, dt, pressures)
    u_half = tuple(_mean(a, b) for a, b in zip(s.u, u, strict=True))
    # 3. every body the whole step with the midpoint velocity
    U_half = [body.velocity(u_half) for body in half]
    bodies = tuple(body.whole(U) for body, U in zip(half, U_half, strict=True))
    given = s.given + dt * on_fluid(model.grid, half, U_half)
    # 4. the circulation sees the new flow
    flows = {side: model.fluid.boundary.outflow(u_half, side) for side in model.circulation.sides}
    circuits = model.circulation.step(s.circuits, flows, s.t, dt)
    at = replace(s, t=s.t + dt, step=s.step + 1, dt=dt)
    return replace(at, u=u, p=p, N=N, bodies=bodies, circuits=circuits, given=given)


def on_fluid(grid: MacGrid, half: list[HalfStep], U_half: list[Array]) -> Array:
    """Return force and power of each body on the fluid, the same on all ranks (collective).

    Args:
        grid: The grid.
        half: The bodies halfway through the step.
        U_half: Velocity of the fluid at their points, ``(n, 3)`` each [cm/s].

    Returns:
        Three components of the force [dyn] and the power [erg/s], ``(num_bodies, 4)``.
    """
    here = np.array([[*_total(b.force), np.vdot(b.force, U)] for b, U in zip(half, U_half, strict=True)])
    return grid.comm.allreduce(here) if len(here) else here.reshape(0, 4)


def _total(F: Array) -> Array:
    """Return the sum over the points, ``(3,)``: a product, for numpy adds rows up one by one."""
    total: Array = np.ones(len(F)) @ F
    return total


def _mean(a: Array, b: Array) -> Array:
    """Return the mean of two arrays, with one new one."""
    mean = a + b
    mean *= 0.5
    return mean
