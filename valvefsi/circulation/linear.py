"""Linear lumped circuits, stepped exactly for inputs that are linear between samples.

Every circuit of the flow loop (Lee2020, S4-S10) is a descriptor system

    M dz/dt = A z + B u,    y = C z + D u,    M = diag(compliances, inertances),

and `reduce` takes the algebraic unknowns (zero entries of M: a rigid chamber) out. What is left, `LinearSystem`,
is stepped by the matrix exponential: no time step error, no stability limit, any sampling.

The matrices may be complex: a complex step through everything here gives derivatives to round-off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm, get_lapack_funcs

from valvefsi.circulation.sampling import Sampling, Steps
from valvefsi.types import Array

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

STEP = 1e-30
"""Complex step of derivatives; small enough that nothing of second order is left."""
SINGULAR = 1e-10
"""Smallest singular value of I - exp(A T) below which there is no periodic state."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CircuitState:
    """Everything a circuit remembers between two steps: exactly what a checkpoint needs.

    Attributes:
        t: Time [s].
        x: States of the circuit, ``(num_states,)`` [dyn/cm^2, or cm^3/s for an inertance].
        u: Inputs at ``t``, ``(num_inputs,)``.
    """

    t: float
    x: Array
    u: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearSystem:
    """A linear circuit dx/dt = A x + B u, y = C x + D u with one output.

    Attributes:
        A: ``(num_states, num_states)`` [1/s].
        B: ``(num_states, num_inputs)``.
        C: ``(num_states,)``.
        D: ``(num_inputs,)``.
        states: Names of the states.
        inputs: Names of the inputs.
        output: Name of the output.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    output: str
    _last: dict[str, Any] = field(default_factory=dict, repr=False)

    def propagators(self, dt: ArrayLike) -> tuple[Array, Array, Array]:
        """Return E, G0, G1 of the exact update x_new = E x + G0 u + G1 u_new, for each step size.

            exp(dt [A B 0; 0 0 1/dt; 0 0 0]) = [E, Gamma_1, Gamma_2; ...],   G0 = Gamma_1 - Gamma_2,  G1 = Gamma_2

        Args:
            dt: Step sizes, ``(n,)`` [s].

        Returns:
            ``(n, num_states, num_states)``, twice ``(n, num_states, num_inputs)``.
        """
        dt = np.atleast_1d(np.asarray(dt, dtype=float))
        m, k = self.B.shape
        if m == 0:
            return np.zeros((len(dt), 0, 0)), np.zeros((len(dt), 0, k)), np.zeros((len(dt), 0, k))
        largest = np.abs(self.B).max(axis=0)
        scale = np.where(
            largest > 0, largest, 1.0
        )  # B holds 1/C: left as it is, it would rule the exponential
        block = np.zeros((len(dt), m + 2 * k, m + 2 * k), dtype=np.result_type(self.A, self.B))
        block[:, :m, :m] = self.A * dt[:, None, None]
        block[:, :m, m : m + k] = self.B / scale * dt[:, None, None]
        block[:, m : m + k, m + k :] = np.eye(k)
        power = expm(block)
        ramp = power[:, :m, m + k :] * scale
        return power[:, :m, :m], power[:, :m, m : m + k] * scale - ramp, ramp

    def start(self, x: ArrayLike, u: ArrayLike, t: float = 0.0) -> CircuitState:
        """Return the state at ``t`` with states ``x`` and inputs ``u``."""
        x, u = np.array(x, dtype=float), np.array(u, dtype=float)
        if x.shape != (len(self.states),) or u.shape != (len(self.inputs),):
            raise ValueError(
                f"expected states {self.states} and inputs {self.inputs}, got {x.shape} and {u.shape}"
            )
        return CircuitState(t=float(t), x=x, u=u)

    def advance(self, s: CircuitState, u_new: ArrayLike, dt: float) -> CircuitState:
        """Step exactly over ``dt``, the inputs going linearly from ``s.u`` to ``u_new``.

        Args:
            s: State at the start of the step; it is not changed.
            u_new: Inputs at its end, ``(num_inputs,)``.
            dt: Step [s].

        Returns:
            The state at its end.
        """
        if self._last.get("dt") != dt:
            E, G0, G1 = self.propagators(dt)
            self._last.update(dt=dt, matrices=(E[0], G0[0], G1[0]))
        E, G0, G1 = self._last["matrices"]
        u_new = np.array(u_new, dtype=float)
        return CircuitState(t=s.t + dt, x=E @ s.x + G0 @ s.u + G1 @ u_new, u=u_new)

    def observe(self, s: CircuitState) -> float:
        """Return the output y = C x + D u at a state."""
        return float(self.C @ s.x + self.D @ s.u)

    def simulate(self, t: Array | Sampling, u: Array, x: ArrayLike) -> Array:
        """Return the states at all samples.

        Args:
            t: Increasing times, ``(n,)`` [s], or their `Sampling`.
            u: Inputs there, linear in between, ``(n, num_inputs)``.
            x: States at ``t[0]``, ``(num_states,)``.

        Returns:
            ``(n, num_states)``.
        """
        return _recur(*self._driven(Sampling.of(t), u), np.asarray(x))

    def outputs(self, x: Array, u: Array) -> Array:
        """Return y = C x + D u at all samples, ``(n,)``."""
        return x @ self.C + u @ self.D

    def periodic_state(self, t: Array | Sampling, u: Array) -> Array:
        """Solve for the states at ``t[0]`` to which the record ``t``, ``u`` returns them: the periodic steady state.

            x(T) = exp(A T) x(0) + forced(T) = x(0)

        Args:
            t: Times over one period, both ends included, ``(n,)`` [s].
            u: Inputs there, the last equal to the first, ``(n, num_inputs)``.

        Returns:
            ``(num_states,)``.

        Raises:
            ValueError: The circuit has no way out for a mean inflow, so that nothing is periodic.
        """
        m = len(self.states)
        if m == 0:
            return np.zeros(0)
        sampling = Sampling.of(t)
        forced = _recur(*self._driven(sampling, u), np.zeros(m))[-1]
        gap = np.eye(m) - expm(self.A * (sampling.t[-1] - sampling.t[0]))
        if np.linalg.svd(gap.real, compute_uv=False)[-1] < SINGULAR:
            raise ValueError("the circuit has no periodic steady state: a compliance cannot empty")
        return np.linalg.solve(gap, forced)

    def sensitivities(
        self,
        t: Array | Sampling,
        u: Array,
        x: Array,
        perturbations: Sequence[LinearSystem],
        start: Array | None,
    ) -> Array:
        """Return the derivative of the output by parameters and initial states.

            s_{n+1} = E s_n + E' x_n + G0' u_n + G1' u_{n+1},   y' = C' x + C s + D' u

        Args:
            t: Times, ``(n,)`` [s].
            u: Inputs there, ``(n, num_inputs)``.
            x: States at all samples, from `simulate`, ``(n, num_states)``.
            perturbations: The system with each of the parameters perturbed by `STEP` along the imaginary axis.
            start: Derivative of the initial states by the parameters and by whatever else ``x[0]`` depends on,
                ``(num_states, k)`` with k the number of ``perturbations`` or more; None where ``x`` is periodic.

        Returns:
            ``(n, k)``.
        """
        sampling, m = Sampling.of(t), len(self.states)
        columns = len(perturbations) if start is None else start.shape[1]
        steps = self._steps(sampling)
        E = steps.spread(self.propagators(steps.dt)[0])
        forcing = np.zeros((len(sampling.t) - 1, m, columns))
        slope = np.zeros((len(sampling.t), columns))
        if perturbations and m:
            slopes = [
                np.concatenate(other.propagators(steps.dt), axis=2).imag / STEP for other in perturbations
            ]
            along = np.concatenate([x[:-1], u[:-1], u[1:]], axis=1)
            pushed = steps.apply(np.concatenate(slopes, axis=1), along)
            forcing[:, :, : len(perturbations)] = pushed.reshape(
                len(pushed), len(perturbations), m
            ).transpose(0, 2, 1)
        for i, other in enumerate(perturbations):
            slope[:, i] = x @ (other.C.imag / STEP) + u @ (other.D.imag / STEP)
        if m == 0:
            return slope
        if start is None:
            forced = _recur(E, forcing, np.zeros((m, columns)))[-1]
            start = np.linalg.solve(np.eye(m) - expm(self.A * (sampling.t[-1] - sampling.t[0])), forced)
        return slope + np.einsum("nmk,m->nk", _recur(E, forcing, start), self.C)

    def steady_state(self, u: ArrayLike) -> Array:
        """Return the states that constant inputs lead to, -A^-1 B u."""
        return np.linalg.solve(self.A, -self.B @ np.asarray(u)) if self.states else np.zeros(0)

    def _steps(self, sampling: Sampling) -> Steps:
        """Return the sizes at which the matrices of a record's intervals are computed."""
        return sampling.steps(float(np.abs(self.A.real).sum(axis=1).max(initial=0.0)))

    def _driven(self, sampling: Sampling, u: Array) -> tuple[Array, Array]:
        """Return E of each interval (one, where all are alike), and what its inputs ``(n, num_inputs)`` add."""
        steps, u = self._steps(sampling), np.asarray(u)
        E, G0, G1 = self.propagators(steps.dt)
        inputs = np.concatenate([u[:-1], u[1:]], axis=1)
        return steps.spread(E), steps.apply(np.concatenate([G0, G1], axis=2), inputs)


class Circuit(Protocol):
    """A circuit: frozen parameters, and the linear system they make."""

    def system(self) -> LinearSystem:
        """Return the system that `LinearSystem.simulate` and `LinearSystem.advance` step exactly."""
        ...


def reduce(
    storage: ArrayLike,
    A: ArrayLike,
    B: ArrayLike,
    C: ArrayLike,
    D: ArrayLike,
    names: tuple[tuple[str, ...], ...],
) -> LinearSystem:
    """Take the unknowns without storage out of M dz/dt = A z + B u, y = C z + D u.

        0 = A_21 x + A_22 w + B_2 u   gives   w = -A_22^-1 (A_21 x + B_2 u)

    Args:
        storage: Diagonal of M: compliances and inertances, zero where rigid, ``(num_unknowns,)``.
        A: ``(num_unknowns, num_unknowns)``.
        B: ``(num_unknowns, num_inputs)``.
        C: ``(num_unknowns,)``.
        D: ``(num_inputs,)``.
        names: Names of the unknowns, of the inputs, and of the one output.

    Returns:
        The system of the unknowns that have storage.
    """
    M, A_, B_, C_, D_ = (np.asarray(part) for part in (storage, A, B, C, D))
    keep, drop = np.flatnonzero(M != 0), np.flatnonzero(M == 0)
    unknowns, inputs, (output,) = names
    if len(drop):
        weights = -np.linalg.solve(
            A_[np.ix_(drop, drop)], np.concatenate([A_[np.ix_(drop, keep)], B_[drop]], axis=1)
        )
        by_x, by_u = weights[:, : len(keep)], weights[:, len(keep) :]
        through = A_[np.ix_(keep, drop)]
        B_ = B_[keep] + through @ by_u
        A_ = A_[np.ix_(keep, keep)] + through @ by_x
        C_, D_ = C_[keep] + C_[drop] @ by_x, D_ + C_[drop] @ by_u
    rate = 1.0 / M[keep][:, None]
    states = tuple(unknowns[i] for i in keep)
    return LinearSystem(A=rate * A_, B=rate * B_, C=C_, D=D_, states=states, inputs=inputs, output=output)


def check_values(
    owner: DataclassInstance, positive: tuple[str, ...], not_negative: tuple[str, ...] = ()
) -> None:
    """Refuse parameters of a circuit that mean nothing.

    Raises:
        ValueError: One of ``positive`` is not above zero, or one of ``not_negative`` below it, or not finite.
    """
    for name in (*positive, *not_negative):
        value = float(np.real(getattr(owner, name)))
        if not np.isfinite(value) or value < 0 or (name in positive and value == 0):
            least = "above zero" if name in positive else "zero or above"
            raise ValueError(f"{name} = {value!r}: expected a finite number {least}")


def _recur(E: Array, forcing: Array, x: Array) -> Array:
    """Return all x_n of x_{n+1} = E_n x_n + forcing_n (or E_0 x_n): one triangular banded solve.

    Args:
        E: ``(n, m, m)`` or ``(1, m, m)``.
        forcing: ``(n, m)``, or ``(n, m, k)`` for k problems at once.
        x: ``(m,)`` or ``(m, k)``.
    """
    n, m = forcing.shape[:2]
    kind = np.result_type(E, forcing, x, float)
    x = np.asarray(x, dtype=kind)
    if m == 0:
        return np.zeros((n + 1, *forcing.shape[1:]), dtype=kind)
    rhs = forcing.astype(kind)
    rhs[0] += E[0] @ x
    band = np.zeros((2 * m, n * m), dtype=kind)
    band[0] = 1.0
    for row in range(m):
        for column in range(m):
            entries = E if len(E) == 1 else E[1:]
            band[m + row - column, column : (n - 1) * m : m] = -entries[:, row, column]
    (tbtrs,) = get_lapack_funcs(("tbtrs",), (band, rhs))
    later, _ = tbtrs(band, rhs.reshape(n * m, -1), uplo="L", diag="U")
    return np.concatenate([x[None], later.reshape(forcing.shape)])
