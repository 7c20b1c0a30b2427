"""One step of the incompressible Navier-Stokes equations (Lee2020, S11 and S12) on the staggered grid.

Crank-Nicolson viscosity, second-order Adams-Bashforth advection, incremental pressure projection with the pressure
update that is consistent with Crank-Nicolson (Brown, Cortez and Minion 2001). All solves are direct.
"""

from __future__ import annotations

import numpy as np

from valvefsi.fluid.advection import SCHEMES
from valvefsi.fluid.boundary import Boundary
from valvefsi.fluid.direct_solver import TensorSolver
from valvefsi.fluid.stencils import divergence, momentum, subtract_gradient
from valvefsi.grid import Array, Faces, MacGrid


class NavierStokes:
    """The fluid in the box: density, viscosity, sides, and the operators of one step.

    Args:
        grid: The grid.
        boundary: The sides of the box.
        rho: Density [g/cm^3].
        mu: Dynamic viscosity [dyn s/cm^2].
        advection: Scheme of the advection term, ``centred`` or ``xsppm7``.

    Raises:
        ValueError: A density that is not positive, a negative viscosity, or an unknown scheme.
    """

    def __init__(
        self, grid: MacGrid, boundary: Boundary, *, rho: float, mu: float, advection: str = "centred"
    ) -> None:
        if advection not in SCHEMES:
            raise ValueError(f"unknown advection scheme {advection!r}, one of {', '.join(SCHEMES)}")
        self.scheme = SCHEMES[advection]
        if not rho > 0.0 or not mu >= 0.0:
            raise ValueError(f"a fluid needs density > 0 and viscosity >= 0, got {rho}, {mu}")
        self.grid, self.boundary, self.rho, self.mu = grid, boundary, float(rho), float(mu)
        inside = ["periodic" if p else "dirichlet" for p in grid.periodic]
        centre = tuple("periodic" if p else "neumann" for p in grid.periodic)
        self.pressure_solver = TensorSolver(grid, centre)
        self.velocity_solvers = [
            TensorSolver(
                grid,
                tuple("faces" if e == d and k != "periodic" else k for e, k in enumerate(inside)),
            )
            for d in range(grid.dim)
        ]
        dim, shape = grid.dim, grid.shape
        self.inv_h = tuple(float(1.0 / h) for h in grid.spacing[:dim])
        self.strides = (shape[1] * shape[2], shape[2], 1)[:dim]
        self.first = sum(g * s for g, s in zip(grid.ghosts, self.strides, strict=False))
        self.last = self.first + 1 + sum((n - 1) * s for n, s in zip(grid.size, self.strides, strict=False))

    def advection(self, u: Faces) -> Faces:
        """Advection term N = div(u u) on the faces, ``(dim)`` local arrays [cm/s^2].

        Args:
            u: Velocity with filled ghosts [cm/s].

        Returns:
            N on the owned faces that are unknowns; other entries hold no meaning.
        """
        flat = tuple(c.ravel() for c in u)
        out = self.grid.zero_faces()
        for d in range(self.grid.dim):
            self.scheme(out[d].ravel(), flat, d, self.inv_h, self.strides, (self.first, self.last))
        return out

    def divergence(self, u: Faces) -> Array:
        """Divergence in the owned cells, a local array with ghosts that hold no meaning [1/s]."""
        out = self.grid.zeros()
        flat = tuple(c.ravel() for c in u)
        divergence(out.ravel(), flat, self.inv_h, self.strides, (self.first, self.last))
        return out

    def fill(self, u: Faces, t: float) -> Faces:
        """Fill all ghosts and boundary faces of a velocity at time t, in place. Collective."""
        self.boundary.set_faces(u, t)
        self.grid.exchange(u)
        self.boundary.fill(u, t)
        return u

    def step(
        self, u: Faces, p: Array, advection: tuple[Faces, Faces, float], f: Faces, t: float, dt: float
    ) -> tuple[Faces, Array]:
        """Advance velocity and pressure by one step.

            rho (u* - u)/dt + rho (a N - b N_old) = -grad p + mu lap (u* + u)/2 + f,
            lap phi = rho/dt div u*,  u_new = u* - dt/rho grad phi,  p_new = p + phi - mu/2 div u*

        Args:
            u: Velocity at t with filled ghosts [cm/s].
            p: Pressure at t - dt/2 with filled ghosts [dyn/cm^2].
            advection: N at t, N at the time before, and the ratio of this step's length to the last one's.
            f: Force density at t + dt/2 on the owned faces [dyn/cm^3].
            t: Time of u [s].
            dt: Length of the step [s].

        Returns:
            Velocity at t + dt and pressure at t + dt/2, both with filled ghosts.

        Note:
            Collective. The new velocity is solenoidal to round-off.
        """
        grid = self.grid
        u_star = self._provisional(u, p, advection, f, t, dt)
        grid.exchange(u_star, width=1)
        self.boundary.fill(u_star, t + dt)
        div = self.divergence(u_star)
        owned = grid.owned
        phi = grid.zeros()
        # lap phi = rho/dt div u*, that is (0 - (-1) lap): a = 0, b = -1
        phi[owned] = self.pressure_solver.solve(div[owned] * (self.rho / dt), 0.0, -1.0)
        p_new = grid.zeros()
        p_new[owned] = p[owned] + phi[owned] - (0.5 * self.mu) * div[owned]
        grid.exchange((phi, p_new), width=1)
        for d in range(grid.dim):
            factor = dt / self.rho * self.inv_h[d]
            bounds = (self.first, self.last, self.strides[d])
            subtract_gradient(u_star[d].ravel(), phi.ravel(), factor, bounds)
        return self.fill(u_star, t + dt), p_new

    def _provisional(
        self, u: Faces, p: Array, advection: tuple[Faces, Faces, float], f: Faces, t: float, dt: float
    ) -> Faces:
        """Velocity u* before the projection, on the unknown faces; solved for its increment u* - u."""
        grid, (N, N_old, ratio) = self.grid, advection
        a, b = self.rho * (1.0 + 0.5 * ratio), -self.rho * 0.5 * ratio
        nu = tuple(self.mu * k * k for k in self.inv_h)
        middle = u
        if self.boundary.changes_in_time:
            middle = tuple(c.copy() for c in u)
            self.boundary.fill(middle, t, t + dt)
        u_star = []
        for d, q in enumerate(middle):
            rhs = grid.zeros()
            momentum(
                rhs.ravel(),
                q.ravel(),
                p.ravel(),
                (N[d].ravel(), N_old[d].ravel(), f[d].ravel()),
                (a, b, self.inv_h[d], nu),
                (self.first, self.last, self.strides[d], self.strides),
            )
            unknown = grid.unknown_faces(d)
            increment = self.velocity_solvers[d].solve(
                np.ascontiguousarray(rhs[unknown]), self.rho / dt, 0.5 * self.mu
            )
            u_star.append(grid.zeros())
            np.add(u[d][unknown], increment, out=u_star[d][unknown])
        return tuple(u_star)
