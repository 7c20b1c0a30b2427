"""One step of the incompressible Navier-Stokes equations (Lee2020, S11 and S12) on the staggered grid.

Second-order Adams-Bashforth advection, viscosity by Crank-Nicolson (`NavierStokes`) or with the advection
(`ExplicitViscosity`: three solves fewer, for steps below its limit), incremental pressure projection with the pressure
update that is consistent with Crank-Nicolson (Brown, Cortez and Minion 2001). All solves are direct.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from valvefsi.fluid import stencils
from valvefsi.fluid.boundary import Boundary, Place
from valvefsi.fluid.direct_solver import TensorSolver
from valvefsi.fluid.mixed_side import NormalVelocityCorrection, PressureCorrection
from valvefsi.fluid.operators import make_operators
from valvefsi.grid import MacGrid
from valvefsi.types import Array, Faces


class NavierStokes:
    """The fluid in the box: density, viscosity, sides, and the operators of one step.

    Args:
        grid: The grid.
        boundary: The sides of the box.
        rho: Density [g/cm^3].
        mu: Dynamic viscosity [dyn s/cm^2].
        advection: Scheme of the advection term, ``centred`` or ``xsppm7``.

    Attributes:
        dt_limit: Largest stable step as far as viscosity goes [s].

    Raises:
        ValueError: A density that is not positive, a negative viscosity, or an unknown scheme.
    """

    def __init__(
        self, grid: MacGrid, boundary: Boundary, *, rho: float, mu: float, advection: str = "centred"
    ) -> None:
        self.operators = make_operators(grid, boundary, advection)
        if not rho > 0.0 or not mu >= 0.0:
            raise ValueError(f"a fluid needs density > 0 and viscosity >= 0, got {rho}, {mu}")
        self.grid, self.boundary, self.rho, self.mu = grid, boundary, float(rho), float(mu)
        self.pressure_solver = TensorSolver(grid, boundary.kinds())
        self.mixed_pressure = (
            PressureCorrection(grid, self.pressure_solver, boundary) if boundary.mixed else None
        )
        self.dt_limit = math.inf
        self._set_up_viscosity()

    def _set_up_viscosity(self) -> None:
        grid, boundary = self.grid, self.boundary
        self.velocity_solvers = [TensorSolver(grid, boundary.kinds(d)) for d in range(grid.dim)]
        self.mixed_velocity: NormalVelocityCorrection | None = None
        if boundary.mixed:
            d = boundary.mixed[0].axis
            self.mixed_velocity = NormalVelocityCorrection(grid, self.velocity_solvers[d], boundary)

    def advection(self, u: Faces) -> Faces:
        """Advection term N = div(u u) on the faces, ``(dim)`` local arrays [cm/s^2].

        Args:
            u: Velocity with filled ghosts [cm/s].

        Returns:
            N on the owned faces that are unknowns; other entries hold no meaning.
        """
        N = self.operators.advection(u)
        self.boundary.clear_open_faces(N)
        return N

    def divergence(self, u: Faces) -> Array:
        """Divergence in the owned cells, a local array with ghosts that hold no meaning [1/s]."""
        return self.operators.divergence(u)

    def fill(self, u: Faces, t: float) -> Faces:
        """Fill all ghosts and boundary faces of a velocity at time t, in place. Collective."""
        self.boundary.set_faces(u, t)
        self.grid.exchange(u)
        self.boundary.fill(u, t)
        return u

    def project(self, u: Faces, t: float) -> Faces:
        """Return the solenoidal velocity nearest to u, u - grad phi with lap phi = div u; u is changed in place.

        Args:
            u: Velocity on the owned faces [cm/s].
            t: Time of the velocities on the sides [s].

        Note:
            Collective.
        """
        u, grid = self.fill(u, t), self.grid
        phi = grid.zeros()
        phi[grid.owned] = self._solve_pressure(np.ascontiguousarray(self.divergence(u)[grid.owned]))
        grid.exchange((phi,), width=1)
        self.boundary.fill_correction(phi)
        self.operators.subtract_gradient(u, phi, 1.0)
        return self.fill(u, t)

    def step(
        self,
        u: Faces,
        p: Array,
        advection: tuple[Faces, Faces, float],
        f: Faces,
        t: float,
        dt: float,
        pressures: Mapping[str, float] | None = None,
    ) -> tuple[Faces, Array]:
        """Advance velocity and pressure by one step.

            rho (u* - u)/dt + rho (a N - b N_old) = -grad p + mu lap (u* + u)/2 + f,
            lap phi = rho/dt div u*,  u_new = u* - dt/rho grad phi,  p_new = p + phi - mu/2 div u*

        Args:
            u: Velocity at t with filled ghosts [cm/s].
            p: Pressure at t - dt/2 with filled ghosts; those beyond open sides are set here [dyn/cm^2].
            advection: N at t, N at the time before, and the ratio of this step's length to the last one's.
            f: Force density at t + dt/2 on the owned faces [dyn/cm^3].
            t: Time of u [s].
            dt: Length of the step [s].
            pressures: Pressures on open sides at t + dt/2 by name, in place of their own [dyn/cm^2].

        Returns:
            Velocity at t + dt and pressure at t + dt/2, both with filled ghosts.

        Note:
            Collective. The new velocity is solenoidal to round-off.
        """
        grid, owned = self.grid, self.grid.owned
        missing = self.boundary.extend_pressure(p, u, self.rho, t + 0.5 * dt, pressures)
        u_star = self._provisional(u, p, advection, f, t, dt)
        grid.exchange(u_star, width=1)
        self.boundary.set_faces(u_star, t + dt)  # the divergence reads nothing beyond the sides
        div = self.divergence(u_star)
        r = div[owned] * (self.rho / dt)
        self.boundary.subtract_given(r, missing)
        x = self._solve_pressure(r)
        phi, p_new = grid.zeros(), grid.zeros()
        stencils.add_pressure(p_new[owned], phi[owned], p[owned], x, div[owned], self.implicit_viscosity)
        grid.exchange((phi, p_new), width=1)
        self.boundary.fill_correction(phi, missing)
        self.operators.subtract_gradient(u_star, phi, dt / self.rho)
        return self.fill(u_star, t + dt), p_new

    def _solve_pressure(self, r: Array) -> Array:
        """Return phi with lap phi = r, zero on open sides."""
        if self.mixed_pressure is not None:
            return self.mixed_pressure.solve(r)
        return self.pressure_solver.solve(r, 0.0, -1.0)  # 0 - (-1) lap

    @property
    def implicit_viscosity(self) -> float:
        """Viscosity that Crank-Nicolson treats: the pressure must be made consistent with it [dyn s/cm^2]."""
        return self.mu

    def _provisional(
        self, u: Faces, p: Array, advection: tuple[Faces, Faces, float], f: Faces, t: float, dt: float
    ) -> Faces:
        """Velocity u* before the projection, on the unknown faces; solved for its increment u* - u."""
        grid, (N, N_old, ratio) = self.grid, advection
        a, b = self.rho * (1.0 + 0.5 * ratio), -self.rho * 0.5 * ratio
        middle = u
        if self.boundary.changes_in_time:
            middle = tuple(c.copy() for c in u)
            self.boundary.fill(middle, t, t + dt)
        u_star = grid.zero_faces()
        for d, q in enumerate(middle):
            rhs = self.operators.momentum(q, p, (N[d], N_old[d], f[d]), (a, b, self.mu), d)
            self._add_increment(u_star[d], u[d], rhs, d, dt)
        return u_star

    def _add_increment(self, out: Array, q: Array, rhs: Array, d: int, dt: float) -> None:
        """Set out = q + x with (rho/dt - mu/2 lap) x = rhs on the unknown faces of component d."""
        unknown = self.boundary.unknown_faces(d)
        r, a, b = np.ascontiguousarray(rhs[unknown]), self.rho / dt, 0.5 * self.mu
        mixed = self.boundary.mixed
        if not mixed or mixed[0].axis != d or self.mixed_velocity is None:
            np.add(q[unknown], self.velocity_solvers[d].solve(r, a, b), out=out[unknown])
            return
        sides = [(place, self._on_side(place)) for place in mixed]
        planes = []
        for place, (local, whole) in sides:
            plane = np.zeros(place.mask.shape)
            if place.here:
                plane[whole] = rhs[local].reshape(plane[whole].shape)
            planes.append(plane)
        x, planes = self.mixed_velocity.solve(r, planes, a, b)
        np.add(q[unknown], x, out=out[unknown])
        for (place, (local, whole)), plane in zip(sides, planes, strict=True):
            if place.here:
                out[local] = q[local] + plane[whole].reshape(out[local].shape)

    def _on_side(self, place: Place) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
        """Slices of the owned faces on a side, in local arrays and in the plane of all ranks."""
        grid = self.grid
        others = [a for a in range(3) if a != place.axis]
        local = tuple(
            slice(place.face, place.face + 1) if a == place.axis else s for a, s in enumerate(grid.owned)
        )
        return local, tuple(slice(grid.start[a], grid.start[a] + grid.size[a]) for a in others)


class ExplicitViscosity(NavierStokes):
    """The fluid with the viscous term in the Adams-Bashforth terms: no viscous solves, but a limit of the step.

    The term that is carried from step to step is N - nu lap u; with second-order Adams-Bashforth it is stable for
    dt <= 1 / (nu sum_d 4 / h_d^2).
    """

    @staticmethod
    def limit(grid: MacGrid, *, rho: float, mu: float) -> float:
        """Return the largest stable step as far as viscosity goes [s]."""
        rate = mu / rho * sum(4.0 / h**2 for h in grid.spacing[: grid.dim])
        return 1.0 / rate if rate > 0.0 else math.inf

    def _set_up_viscosity(self) -> None:
        self.dt_limit = self.limit(self.grid, rho=self.rho, mu=self.mu)

    def advection(self, u: Faces) -> Faces:
        """Explicit terms N = div(u u) - nu lap u on the faces, ``(dim)`` local arrays [cm/s^2].

        Args:
            u: Velocity with filled ghosts [cm/s].

        Returns:
            N on the owned faces that are unknowns; other entries hold no meaning.
        """
        N = super().advection(u)
        for d, (term, q) in enumerate(zip(N, u, strict=True)):
            self.operators.subtract_laplacian(term, q, d, self.mu / self.rho)
        return N

    @property
    def implicit_viscosity(self) -> float:
        """None: no viscous term is implicit [dyn s/cm^2]."""
        return 0.0

    def _provisional(
        self, u: Faces, p: Array, advection: tuple[Faces, Faces, float], f: Faces, t: float, dt: float
    ) -> Faces:
        """Velocity u* before the projection, on the unknown faces."""
        N, N_old, ratio = advection
        weights = (dt / self.rho, dt * (1.0 + 0.5 * ratio), -dt * 0.5 * ratio)
        terms = zip(N, N_old, f, strict=True)
        return tuple(
            self.operators.advance(q, p, term, weights, d)
            for d, (q, term) in enumerate(zip(u, terms, strict=True))
        )


EXPLICIT_SHARE = 0.5
"""Part of the largest step of explicit viscosity up to which it is taken."""


def stable_fluid(grid: MacGrid, boundary: Boundary, dt: float, **physics: Any) -> NavierStokes:
    """Return the fluid with explicit viscosity where a step is well below its limit, else implicit (collective).

    Args:
        grid: The grid.
        boundary: Its sides.
        dt: Length of the step [s].
        physics: Further arguments of the fluid, ``rho`` and ``mu`` among them.
    """
    limit = ExplicitViscosity.limit(grid, rho=physics["rho"], mu=physics["mu"])
    return (ExplicitViscosity if dt <= EXPLICIT_SHARE * limit else NavierStokes)(grid, boundary, **physics)
