"""A fluid step without splitting error: velocity and pressure solved for together, with the projection inside FGMRES.

One projection leaves a velocity along walls that is off by dt/rho grad phi, and a layer in the pressure there. Here the
Crank-Nicolson momentum equation and the divergence hold together, at the price of about ten iterations per step, each
a little dearer than a projection. The operator is never assembled; the projection step is its preconditioner (Griffith
2009).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from petsc4py import PETSc

from valvefsi.errors import ConvergenceError
from valvefsi.fluid.boundary import Boundary, Wall
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.grid import MacGrid
from valvefsi.types import Array, Faces

TOLERANCE = 1e-10
"""Residual at which a solve ends, as a fraction of the residual of no change."""


class CoupledNavierStokes(NavierStokes):
    """The fluid in the box, stepped by a coupled solve for velocity and pressure.

    Args:
        grid: The grid.
        boundary: The sides of the box.
        rho: Density [g/cm^3].
        mu: Dynamic viscosity [dyn s/cm^2].
        advection: Scheme of the advection term, ``centred`` or ``xsppm7``.
        tolerance: Residual at which a solve ends, as a fraction of the residual of no change.
        max_iterations: Iterations after which a solve has failed.

    Attributes:
        iterations: Iterations of the last step; nothing depends on it.

    Raises:
        ValueError: As for `NavierStokes`, or the tolerance is not between 0 and 1.
    """

    def __init__(
        self,
        grid: MacGrid,
        boundary: Boundary,
        *,
        rho: float,
        mu: float,
        advection: str = "centred",
        tolerance: float = TOLERANCE,
        max_iterations: int = 50,
    ) -> None:
        super().__init__(grid, boundary, rho=rho, mu=mu, advection=advection)
        if not 0.0 < tolerance < 1.0 or max_iterations < 1:
            raise ValueError(
                f"a coupled solve needs 0 < tolerance < 1 and max_iterations > 0, got {tolerance}, {max_iterations}"
            )
        self.tolerance, self.max_iterations, self.iterations = tolerance, max_iterations, 0
        at_rest = {
            place.name: Wall() if isinstance(place.side, Wall) else place.side for place in boundary.places
        }
        self.homogeneous = Boundary(grid, at_rest)
        self.unknowns = [self._unknowns(d) for d in range(grid.dim)]
        self.sizes = [int(mask.sum()) for mask in self.unknowns]

    def _unknowns(self, d: int) -> Array:
        """Which local entries of component d are unknowns of this rank, those on mixed sides included."""
        mask = np.zeros(self.grid.shape, dtype=bool)
        mask[self.boundary.unknown_faces(d)] = True
        for place in self.boundary.mixed:
            if place.axis == d and place.here:
                local, whole = self._on_side(place)
                mask[local] = np.expand_dims(place.mask[whole], d)
        return mask

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

            rho (u_new - u)/dt + rho (a N - b N_old) = -grad p_new + mu/2 lap (u_new + u) + f,  div u_new = 0

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

        Raises:
            ConvergenceError: The solve did not reach its tolerance, on all ranks.

        Note:
            Collective. The new velocity is solenoidal to round-off: the solve ends with a projection.
        """
        grid, owned = self.grid, self.grid.owned
        self.boundary.fill_pressure(p, u, self.rho, t + 0.5 * dt, pressures)
        u_new = tuple(q.copy() for q in u)
        self.fill(u_new, t + dt)
        r = self._residual(u, p, advection, f, t, dt)
        increment, change = self._solve(r, -self._compatible(self.divergence(u_new)[owned]), u, t, dt)
        for q, x, unknown in zip(u_new, increment, self.unknowns, strict=True):
            q[unknown] += x[unknown]
        self.fill(u_new, t + dt)
        # What the tolerance leaves of the divergence where walls push; zero otherwise, as after every projection.
        phi = grid.zeros()
        phi[owned] = self._solve_pressure(self.divergence(u_new)[owned] * (self.rho / dt))
        p_new = grid.zeros()
        p_new[owned] = p[owned] + change[owned] + phi[owned]
        grid.exchange((phi, p_new), width=1)
        self.boundary.fill_correction(phi)
        self.operators.subtract_gradient(u_new, phi, dt / self.rho)
        return self.fill(u_new, t + dt), p_new

    def _residual(
        self, u: Faces, p: Array, advection: tuple[Faces, Faces, float], f: Faces, t: float, dt: float
    ) -> Faces:
        """Right-hand side of the momentum equation of the increment: what no change of u and p leaves."""
        N, N_old, ratio = advection
        weights = (self.rho * (1.0 + 0.5 * ratio), -self.rho * 0.5 * ratio, self.mu)
        middle = u
        if self.boundary.changes_in_time:
            middle = tuple(q.copy() for q in u)
            self.boundary.fill(middle, t, t + dt)
        return tuple(
            self.operators.momentum(q, p, (N[d], N_old[d], f[d]), weights, d) for d, q in enumerate(middle)
        )

    def _compatible(self, r: Array) -> Array:
        """Take the mean off a divergence where no pressure is given, for no increment can change it (collective)."""
        if self.boundary.mixed or not self.pressure_solver.singular:
            return r
        volumes = self.grid.volumes()[self.grid.owned]
        total = self.grid.comm.allreduce(np.array([float((r * volumes).sum()), float(volumes.sum())]))
        return r - total[0] / total[1]

    def _solve(self, r: Faces, r_p: Array, u: Faces, t: float, dt: float) -> tuple[Faces, Array]:
        """Return the increments of velocity and pressure with the given right-hand sides (collective)."""
        system = _System(self, dt)
        local = sum(self.sizes) + r_p.size
        b = PETSc.Vec().createMPI((local, None), comm=self.grid.comm)
        x = b.duplicate()
        A = PETSc.Mat().createPython(((local, None), (local, None)), context=system, comm=self.grid.comm)
        ksp = PETSc.KSP().create(self.grid.comm)
        try:
            A.setUp()
            system.pack(b, r, r_p)
            ksp.setOperators(A)
            ksp.setType("fgmres")
            ksp.setGMRESRestart(self.max_iterations)
            pc = ksp.getPC()
            pc.setType("python")
            pc.setPythonContext(system)
            # Below the round-off of the terms of the equation there is nothing to solve for.
            squares = sum(float(np.square(q[m]).sum()) for q, m in zip(u, self.unknowns, strict=True))
            rate = self.rho / dt + self.mu * sum(4.0 / h**2 for h in self.grid.spacing[: self.grid.dim])
            size = rate * float(np.sqrt(self.grid.comm.allreduce(squares)))
            ksp.setTolerances(rtol=self.tolerance, atol=1e-15 * size, max_it=self.max_iterations)
            ksp.solve(b, x)
            self.iterations = ksp.getIterationNumber()
            if ksp.getConvergedReason() <= 0:
                fraction = ksp.getResidualNorm() / b.norm()
                raise ConvergenceError(
                    f"velocity and pressure at t = {t + dt:.6g} s: the residual is still {fraction:.1e} of its start "
                    f"after {self.iterations} iterations, wanted {self.tolerance:.1e}; try a smaller time step"
                )
            return system.unpack(x)
        finally:
            for thing in (ksp, A, x, b):
                thing.destroy()


class _System:
    """The coupled operator of one step length and its preconditioner, for PETSc.

    Rows of the divergence are multiplied by rho h/dt, which gives them the unit and size of the others.

    Args:
        fluid: The fluid.
        dt: Length of the step [s].
    """

    def __init__(self, fluid: CoupledNavierStokes, dt: float) -> None:
        self.fluid, self.dt = fluid, dt
        self.scale = fluid.rho / dt * float(min(fluid.grid.spacing[: fluid.grid.dim]))
        self.nothing = fluid.grid.zeros()

    def pack(self, v: PETSc.Vec, faces: Faces, cells: Array) -> None:
        """Write right-hand sides into a vector."""
        parts = [q[mask] for q, mask in zip(faces, self.fluid.unknowns, strict=True)]
        v.setArray(np.concatenate([*parts, self.scale * cells.ravel()]))

    def unpack(self, v: PETSc.Vec, cells_by: float = 1.0) -> tuple[Faces, Array]:
        """Read local arrays from a vector, zero where nothing is unknown; multiply those of cells by a factor."""
        grid, values = self.fluid.grid, v.getArray(readonly=True)
        *parts, rest = np.split(values, np.cumsum(self.fluid.sizes))
        faces, cells = grid.zero_faces(), grid.zeros()
        for q, mask, part in zip(faces, self.fluid.unknowns, parts, strict=True):
            q[mask] = part
        cells[grid.owned] = cells_by * rest.reshape(grid.size)
        return faces, cells

    def mult(self, _A: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y to rho/dt u - mu/2 lap u + grad p and div u (collective)."""
        fluid, grid, none = self.fluid, self.fluid.grid, self.nothing
        u, p = self.unpack(x)
        grid.exchange((*u, p), width=1)
        fluid.homogeneous.fill(u, 0.0)
        fluid.boundary.fill_correction(p)
        out = []
        for d, q in enumerate(u):
            rest = fluid.operators.momentum(q, p, (none, none, none), (0.0, 0.0, 0.5 * fluid.mu), d)
            out.append(fluid.rho / self.dt * q - rest)
        self.pack(y, tuple(out), fluid.divergence(u)[grid.owned])

    def apply(self, _pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y to velocity and pressure of one projection step with right-hand side x (collective)."""
        fluid, grid, owned, dt = self.fluid, self.fluid.grid, self.fluid.grid.owned, self.dt
        r, wanted = self.unpack(x, 1.0 / self.scale)
        u, phi = grid.zero_faces(), grid.zeros()
        for d, q in enumerate(u):
            fluid._add_increment(q, self.nothing, r[d], d, dt)
        grid.exchange(u, width=1)
        fluid.homogeneous.fill(u, 0.0)
        lack = fluid.divergence(u)
        lack[owned] -= wanted[owned]
        phi[owned] = fluid._solve_pressure(lack[owned] * (fluid.rho / dt))
        p = phi[owned].copy()
        grid.exchange((phi,), width=1)
        fluid.boundary.fill_correction(phi)
        fluid.operators.subtract_gradient(u, phi, dt / fluid.rho)
        p -= 0.5 * fluid.mu * lack[owned]
        self.pack(y, u, p / self.scale)
