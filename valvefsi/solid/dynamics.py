"""A solid that moves in vacuum: generalised-alpha (implicit) and central differences (explicit), with their energies.

    rho a + eta v - div P = 0,   P N = traction,   P = dW/dF + dU/dF

in displacements alone, the volume held by U(J) as in the coupled solid. `GeneralisedAlpha` and
`CentralDifferences` advance a `MovingSolid`, which holds displacement, velocity and acceleration.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import ufl
from dolfinx import fem, la
from mpi4py import MPI

from valvefsi.errors import CaseError, ConvergenceError, StabilityError
from valvefsi.solid.elements.lumping import lumped_weights
from valvefsi.solid.moving_solid import Energies, MovingSolid
from valvefsi.solid.newton import Newton

if TYPE_CHECKING:
    from collections.abc import Callable

    from valvefsi.types import Array

__all__ = ["CentralDifferences", "Energies", "GeneralisedAlpha", "MovingSolid", "run"]

SAFETY = 0.8
"""Part of the critical step that an explicit solver takes by itself."""

MOST_HALVINGS = 4
"""How often an implicit step is halved before it is given up."""


class _Vector:
    """A linear form assembled into an array of owned and ghost nodes, again and again."""

    def __init__(self, form: ufl.Form | None, space: fem.FunctionSpace) -> None:
        self._form = None if form is None else compat.compile_form(form)
        self._vector = la.vector(space.dofmap.index_map, space.dofmap.index_map_bs)
        self._owned = space.dofmap.index_map.size_local * space.dofmap.index_map_bs

    def __call__(self) -> Array:
        """Return the owned part; a view that the next call overwrites (collective)."""
        array = self._vector.array
        array[:] = 0.0
        if self._form is not None:
            constants, coefficients = compat.pack_constants(self._form), compat.pack_coefficients(self._form)
            fem.assemble_vector(array, self._form, constants, coefficients)
            self._vector.scatter_reverse(la.InsertMode.add)
        return array[: self._owned]


class CentralDifferences:
    """Explicit central differences with a lumped mass (Belytschko, Liu and Moran 2000, box 6.1).

        v_half = v + dt/2 a,   u += dt v_half,   M_l a = f_loads - f_inner(u) - eta v_half,   v = v_half + dt/2 a

    The damping lags half a step behind: first order in eta dt/rho, second order without it.

    Args:
        solid: The solid; its motion is advanced in place.
        dt: Time step; None takes 0.8 of the critical step of the state at the start [s].

    Raises:
        CaseError: The step is above the critical one.

    Note:
        Collective.
    """

    def __init__(self, solid: MovingSolid, dt: float | None = None) -> None:
        self.solid = solid
        weights, _ = lumped_weights(solid.space, solid.mesh, None)
        self.weights = np.repeat(weights, solid.dim)
        self.mass = solid.density * self.weights
        self._inner, self._outer = _Vector(solid.inner, solid.space), _Vector(solid.outer, solid.space)
        self._n = len(self.mass)
        self.critical = self.critical_step()
        self.dt = SAFETY * self.critical if dt is None else dt
        if not 0 < self.dt <= self.critical:
            message = f"expected a step above 0, and not above the critical one, {self.critical:.4g} s"
            raise CaseError(message, key="dt", value=dt)
        self._forces = self._evaluate()
        self._accelerate()
        self.energies = self._first()

    def _evaluate(self) -> tuple[Array, Array]:
        """Return the inner forces and those of the loads at the present time."""
        self.solid.factor.value = self.solid.ramp(self.solid.t)
        return self._inner().copy(), self._outer().copy()

    def _accelerate(self) -> None:
        inner, outer = self._forces
        solid, n = self.solid, self._n
        solid.a.x.array[:n] = (outer - inner - solid.damping * self.weights * solid.v.x.array[:n]) / self.mass
        solid.hold(solid.a.x.array)

    def kinetic(self) -> float:
        """Return 1/2 v . M v with the lumped mass [erg] (collective)."""
        return self.solid.comm.allreduce(float(self.mass @ self.solid.v.x.array[: self._n] ** 2) / 2)

    def _first(self) -> Energies:
        kinetic, stored = self.kinetic(), self.solid.stored()
        return Energies(kinetic, stored, 0.0, 0.0, kinetic + stored)

    def critical_step(self, iterations: int = 60) -> float:
        """Return 2/omega_max of the present state, by power iteration on M_l^-1 K, K by differences (collective).

        The largest frequency is approached from below; the bound is lowered by 5 % for that.
        """
        solid, n, comm = self.solid, self._n, self.solid.comm
        start, rng = solid.u.x.array.copy(), np.random.default_rng(1)
        before, largest = self._inner().copy(), 0.0
        direction = np.zeros_like(start)
        direction[:n] = rng.uniform(-1, 1, n)
        for _ in range(iterations):
            solid.hold(direction)
            length = math.sqrt(comm.allreduce(float(self.mass @ direction[:n] ** 2)))
            direction /= length
            reach = comm.allreduce(np.abs(direction[:n]).max(initial=0.0), op=MPI.MAX)
            step = 1e-6 * solid.size / reach
            solid.u.x.array[:] = start + step * direction
            solid.u.x.scatter_forward()
            turned = (self._inner() - before) / step
            largest = max(largest, comm.allreduce(float(turned @ direction[:n])))
            direction[:n] = turned / self.mass
        solid.u.x.array[:] = start
        if not largest > 0:
            raise CaseError("the solid has no stiffness in its present state", key="dt")
        return 0.95 * 2 / math.sqrt(largest)

    def step(self) -> Energies:
        """Advance by one step; return the energies.

        Raises:
            StabilityError: A cell is inverted, or the motion is not finite.

        Note:
            Collective.
        """
        solid, n, dt = self.solid, self._n, self.dt
        u, v, a = (function.x.array for function in (solid.u, solid.v, solid.a))
        before = self._forces
        # 1. half a step of the velocity, the whole step of the position
        v[:n] += dt / 2 * a[:n]
        moved = dt * v[:n]
        u[:n] += moved
        solid.u.x.scatter_forward()
        solid.t += dt
        # 2. forces and accelerations there; the damping sees the velocity of the half step
        self._forces = self._evaluate()
        rate = solid.comm.allreduce(float(solid.damping * self.weights @ v[:n] ** 2))
        self._accelerate()
        # 3. the other half of the velocity
        v[:n] += dt / 2 * a[:n]
        solid.v.x.scatter_forward()
        # 4. energies
        given = solid.comm.allreduce(float((before[1] + self._forces[1]) @ moved) / 2)
        old = self.energies
        self.energies = Energies(
            self.kinetic(), solid.stored(), old.work + given, old.lost + dt * rate, old.start
        )
        if not math.isfinite(self.energies.balance):
            message = (
                f"a cell is inverted or the motion is not finite at t = {solid.t:.6g} s; take a smaller dt"
            )
            raise StabilityError(f"central differences: {message}, now {dt:.3g} s")
        return self.energies


class GeneralisedAlpha:
    """Generalised-alpha method (Chung and Hulbert 1993): implicit, second order, damps what it cannot resolve.

        M a_m + eta v_f + f_inner(u_f) = f_loads(u_f, t_f),   x_m = (1 - alpha_m) x_new + alpha_m x, x_f alike

    Args:
        solid: The solid; its motion is advanced in place.
        dt: Time step [s].
        rho_inf: Spectral radius at infinite frequency: 1 damps nothing, 0 the most.

    Raises:
        CaseError: A parameter lies outside its range.

    Note:
        Collective. Linear systems are solved by MUMPS.
    """

    def __init__(self, solid: MovingSolid, dt: float, rho_inf: float = 0.8) -> None:
        if not 0 < dt < math.inf:
            raise CaseError("expected a positive time step", key="dt", value=dt)
        if not 0 <= rho_inf <= 1:
            raise CaseError("expected a number from 0 to 1", key="rho_inf", value=rho_inf)
        self.solid, self.dt = solid, float(dt)
        self.alpha_m, self.alpha_f = (2 * rho_inf - 1) / (rho_inf + 1), rho_inf / (rho_inf + 1)
        self.gamma = 0.5 - self.alpha_m + self.alpha_f
        self.beta = (1 - self.alpha_m + self.alpha_f) ** 2 / 4
        self._n = solid.space.dofmap.index_map.size_local * solid.dim
        self._outer = _Vector(solid.outer, solid.space)
        self.new = fem.Function(solid.space, name="u_new")
        self._newton = self._make_newton()
        self._start()

    def _make_newton(self) -> Newton:
        solid, test = self.solid, ufl.TestFunction(self.solid.space)
        numbers = (self.dt, self.beta, self.gamma, self.alpha_m, self.alpha_f, solid.density, solid.damping)
        # constants, so that another step or density needs no other compiled form
        dt, b, g, alpha_m, alpha_f, rho, eta = (fem.Constant(solid.mesh.mesh, float(x)) for x in numbers)
        self._dt = dt
        a_new = (self.new - solid.u - dt * solid.v) / (b * dt**2) - (1 - 2 * b) / (2 * b) * solid.a
        v_new = solid.v + dt * ((1 - g) * solid.a + g * a_new)
        a = (1 - alpha_m) * a_new + alpha_m * solid.a
        v = (1 - alpha_f) * v_new + alpha_f * solid.v
        forces = solid.inner if solid.outer is None else solid.inner - solid.outer
        forces = ufl.algorithms.expand_derivatives(forces)
        u = (1 - alpha_f) * self.new + alpha_f * solid.u
        residual = ufl.replace(forces, {solid.u: u}) + ufl.inner(rho * a + eta * v, test) * solid.dX
        newton = Newton(self.new, residual, solid.prescribed.conditions)
        size = solid.material.shear_modulus * solid.size ** (solid.dim - 1)
        newton.set_tolerances(1e-9, 1e-12 * size, 25)
        return newton

    def _start(self) -> None:
        """Find the acceleration that belongs to the state at the start, and its energies."""
        solid, test = self.solid, ufl.TestFunction(self.solid.space)
        solid.factor.value = solid.ramp(solid.t)
        forces = solid.inner if solid.outer is None else solid.inner - solid.outer
        rho, eta = (fem.Constant(solid.mesh.mesh, float(x)) for x in (solid.density, solid.damping))
        residual = ufl.inner(rho * solid.a + eta * solid.v, test) * solid.dX + forces
        size = solid.material.shear_modulus * solid.size ** (solid.dim - 1)
        with Newton(solid.a, residual, solid.prescribed.conditions) as mass:
            mass.set_tolerances(1e-10, 1e-14 * size, 5)
            mass.solve()
        kinetic, stored = solid.kinetic(), solid.stored()
        self.energies = Energies(kinetic, stored, 0.0, 0.0, kinetic + stored)
        self._loads = self._outer().copy()
        self._square = compat.compile_form(ufl.inner(solid.v, solid.v) * solid.dX)
        self._rate = self._damping_rate()

    def _damping_rate(self) -> float:
        return self.solid.damping * self.solid.comm.allreduce(fem.assemble_scalar(self._square))

    def destroy(self) -> None:
        """Free what PETSc holds (collective); petsc4py leaves it to the end of the program on several ranks."""
        self._newton.destroy()

    def step(self) -> Energies:
        """Advance by one step, in halves, quarters ... where Newton's method fails; return the energies.

        Raises:
            ConvergenceError: Newton's method fails in the smallest part of a step, too.

        Note:
            Collective.
        """
        self._advance(self.dt, MOST_HALVINGS)
        return self.energies

    def _advance(self, dt: float, halvings: int) -> None:
        """Advance by ``dt``, or by its two halves."""
        solid = self.solid
        # 1. the new displacement, with the loads between the two times
        self._dt.value = dt
        solid.factor.value = solid.ramp(solid.t + (1 - self.alpha_f) * dt)
        self.new.x.array[:] = solid.u.x.array + dt * solid.v.x.array
        solid.hold(self.new.x.array)
        converged, iterations = self._newton.solve()
        if converged:
            self._accept(dt)
        elif halvings > 0:
            self._advance(dt / 2, halvings - 1)
            self._advance(dt / 2, halvings - 1)
        else:
            message = (
                f"no motion found at t = {solid.t + dt:.6g} s in {iterations} iterations; take a smaller dt"
            )
            raise ConvergenceError(f"generalised-alpha: {message}, now {self.dt:.3g} s")

    def _accept(self, dt: float) -> None:
        """Take the velocity, the acceleration and the energies that belong to the new displacement."""
        solid, b, g = self.solid, self.beta, self.gamma
        # 2. velocity and acceleration
        u, v, a = (function.x.array for function in (solid.u, solid.v, solid.a))
        moved = self.new.x.array - u
        a_new = (moved - dt * v) / (b * dt**2) - (1 - 2 * b) / (2 * b) * a
        v += dt * ((1 - g) * a + g * a_new)
        a[:] = a_new
        u[:] = self.new.x.array
        solid.t += dt
        # 3. energies, work and loss by the trapezoidal rule
        solid.factor.value = solid.ramp(solid.t)
        loads, rate = self._outer().copy(), self._damping_rate()
        given = solid.comm.allreduce(float((self._loads + loads) @ moved[: self._n]) / 2)
        lost, old = dt * (self._rate + rate) / 2, self.energies
        self._loads, self._rate = loads, rate
        self.energies = Energies(
            solid.kinetic(), solid.stored(), old.work + given, old.lost + lost, old.start
        )


def run(
    stepper: CentralDifferences | GeneralisedAlpha,
    t_end: float,
    note: Callable[[float, Energies], None] | None = None,
) -> Energies:
    """Advance to ``t_end``, to within half a step; call ``note(t, energies)`` after every step (collective)."""
    steps = max(0, round((t_end - stepper.solid.t) / stepper.dt))
    for _ in range(steps):
        energies = stepper.step()
        if note is not None:
            note(stepper.solid.t, energies)
    return stepper.energies
