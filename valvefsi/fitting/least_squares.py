"""Bounded least squares from many starts: named parameters, scaled inside, one frozen result."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import optimize
from scipy.stats import qmc

from valvefsi.errors import CaseError, ConvergenceError
from valvefsi.fitting.problem import Parameter, Problem
from valvefsi.types import Array

__all__ = ["Fit", "Notify", "Parameter", "Problem", "Start", "draw_starts", "fit", "solve"]

Notify = Callable[[str, int, int], None]
"""Called with what has been done, how many times, and how many times it will be."""
SAME = 1e-6
"""Two costs are the same when they differ by no more than this part of the smaller one."""
NOTHING = 1e-18
"""A cost below this part of half the data's sum of squares is an exact fit."""
LEAST_PART = 0.05
"""Least part of the data that a positive linear parameter starts with."""
NUDGE = 0.01
"""Part of the distance of two axes at which it is seen whether an axis is a least."""
CLOSE = 1e-6
"""A parameter is at its bound when it is nearer than this part of the span of its bounds."""


@dataclass(frozen=True, kw_only=True)
class Start:
    """Where one start led.

    Attributes:
        initial: Values of all parameters at the start, ``(n,)``.
        values: Values at the end, ``(n,)``.
        cost: Half the sum of squares at the end (of the loss, where it is not linear).
        converged: The solver met its tolerance.
        evaluations: Evaluations of the model.
    """

    initial: Array
    values: Array
    cost: float
    converged: bool
    evaluations: int


@dataclass(frozen=True, kw_only=True)
class Fit:
    """The best of all starts.

    Attributes:
        problem: What was fitted.
        values: Values of all parameters, those held included, ``(n,)``.
        cost: Half the sum of squares of the weighted residuals (of the loss, where it is not linear).
        starts: Every start, best first.
        seed: Seed of the starts.
        seconds: Time it took [s].
    """

    problem: Problem
    values: Array
    cost: float
    starts: tuple[Start, ...]
    seed: int = 0
    seconds: float = 0.0

    @property
    def named(self) -> dict[str, float]:
        """Values by name."""
        return {p.name: float(v) for p, v in zip(self.problem.parameters, self.values, strict=True)}

    @cached_property
    def curve(self) -> Array:
        """The model at the values found, ``(m,)``."""
        return self.problem.model(self.values)

    @property
    def residual(self) -> Array:
        """Model minus data, without weights, ``(m,)``."""
        return self.curve - self.problem.data

    @property
    def half_squares(self) -> float:
        """Half the sum of squares of the weighted residuals, whatever the loss."""
        return float(np.sum((self.problem.w * self.residual) ** 2) / 2)

    @cached_property
    def jacobian(self) -> Array:
        """Weighted, scaled Jacobian, ``(m, free)``."""
        return self.problem.scaled_sensitivity(self.values)

    @property
    def converged(self) -> int:
        """Number of starts that converged."""
        return sum(start.converged for start in self.starts)

    @property
    def reached(self) -> int:
        """Number of starts that ended at the same cost as the best, itself included."""
        limit = self.cost * (1 + SAME) + _nothing(self.problem)
        return sum(start.cost <= limit for start in self.starts)

    @cached_property
    def at_bound(self) -> tuple[str | None, ...]:
        """For each free parameter ``lower`` or ``upper`` where it ended there, else None."""
        low, high = self.problem.bounds
        x, span = self.problem.scaled(self.values), high - low
        close = CLOSE * span
        return tuple(
            None if p.period is not None else "lower" if a else "upper" if b else None
            for p, a, b in zip(self.problem.free_parameters, x - low <= close, high - x <= close, strict=True)
        )


def fit(
    problem: Problem,
    *,
    starts: int = 32,
    seed: int = 0,
    first: Mapping[str, float] | None = None,
    notify: Notify | None = None,
) -> Fit:
    """Fit from many starts, drawn from a scrambled Sobol sequence, and return the best.

    Args:
        problem: What is fitted.
        starts: Number of starts.
        seed: Seed of the sequence.
        first: Values of parameters in a first start of one's own, the others from the middle of their range.
        notify: Called after each start.

    Raises:
        CaseError: There are fewer observations than parameters.
        ConvergenceError: No start led to a finite cost.
    """
    if len(problem.data) < len(problem.free):
        message = f"{len(problem.data)} observations cannot fix {len(problem.free)} parameters"
        raise CaseError(message, key="data")
    began = time.perf_counter()
    if not problem.free:
        return _fit_without_freedom(problem)
    fits = []
    for x in draw_starts(problem, starts, seed, first):
        fits.append(solve(problem, linear_start(problem, x)))
        if notify:
            notify("starts", len(fits), starts)
    finite = sorted((s for s in fits if np.isfinite(s.cost)), key=lambda s: (not s.converged, s.cost))
    if not finite:
        raise ConvergenceError("no start gave a finite model: narrow the bounds")
    best = min(finite, key=lambda s: s.cost)
    return Fit(
        problem=problem,
        values=_snapped(problem, best.values),
        cost=best.cost,
        starts=tuple(finite),
        seed=seed,
        seconds=time.perf_counter() - began,
    )


def draw_starts(
    problem: Problem, count: int, seed: int, first: Mapping[str, float] | None = None
) -> list[Array]:
    """Return scaled starts inside the range of each parameter, each ``(free,)``."""
    parameters = problem.free_parameters
    low = np.array([p.scaled(p.range[0]) for p in parameters])
    high = np.array([p.scaled(p.range[1]) for p in parameters])
    power = max(int(np.ceil(np.log2(max(count, 1)))), 0)
    cube = qmc.Sobol(len(parameters), scramble=True, seed=seed).random_base2(power)[:count]
    samples = list(low + cube * (high - low))
    if first is not None:
        middle = (low + high) / 2
        own = [
            p.scaled(first[p.name]) if p.name in first else m for p, m in zip(parameters, middle, strict=True)
        ]
        samples = [np.clip(own, *problem.bounds), *samples[: max(count - 1, 0)]]
    return samples


def linear_start(problem: Problem, x: Array) -> Array:
    """Return a start, ``(free,)``, whose linear parameters are the best for the others, inside their bounds.

    A positive one carries a part of the curve at least: from nothing the solver would not find it again.
    """
    which = [k for k, p in enumerate(problem.free_parameters) if p.linear]
    if not which:
        return x
    values = problem.values(x)
    columns = problem.w[:, None] * problem.sensitivity(values)[:, which]
    now = np.array([values[problem.free[k]] for k in which])
    with np.errstate(over="ignore", invalid="ignore"):
        target = columns @ now - problem.residual(x)
    if not (np.isfinite(columns).all() and np.isfinite(target).all() and np.any(columns, axis=0).all()):
        return x
    size = np.linalg.norm(columns, axis=0)
    least = LEAST_PART * np.linalg.norm(problem.w * problem.data) / size
    low, high = (
        np.array([getattr(problem.free_parameters[k], end) for k in which]) for end in ("lower", "upper")
    )
    if not np.all(low * size < high * size):  # out of the range of the numbers
        return x
    best = optimize.lsq_linear(columns / size, target, (low * size, high * size)).x / size
    x = x.copy()
    for k, value, floor in zip(which, best, least, strict=True):
        p = problem.free_parameters[k]
        x[k] = p.scaled(float(np.clip(max(value, floor) if p.log else value, *p.bounds)))
    return x


def solve(problem: Problem, x: Array, *, limit: int = 400, tolerance: float = 1e-12) -> Start:
    """Solve from one scaled start.

    Args:
        problem: What is fitted.
        x: Scaled start, ``(free,)``.
        limit: Most evaluations of the model.
        tolerance: Relative change of cost and parameters at which it ends.
    """
    start = _solved(problem, x, limit, tolerance)
    if start.converged or not np.isfinite(start.cost):
        return start
    return _solved_on_axes(problem, start, limit, tolerance)


def _solved_on_axes(problem: Problem, start: Start, limit: int, tolerance: float) -> Start:
    """Return the end of a start that crept, with what the model is even in held where it is, if that is the least.

    There the model has no first derivative and the solver, which knows no second, takes steps that are far too long.
    """
    held = beside = problem
    for i, p in zip(problem.free, problem.free_parameters, strict=True):
        axis = p.even * round(start.values[i] / p.even) if p.even else np.inf
        if p.even and p.lower <= axis <= p.upper:
            held = held.with_constant(p.name, axis)
            near = axis + NUDGE * p.even * (1 if axis < p.upper else -1)
            beside = beside.with_constant(p.name, near)
    if held is problem or not held.free:
        return start
    again, near_by = (_solved(one, one.scaled(start.values), limit, tolerance) for one in (held, beside))
    if again.cost > min(start.cost, near_by.cost):
        return start
    return replace(again, initial=start.initial, evaluations=start.evaluations + again.evaluations)


def _solved(problem: Problem, x: Array, limit: int, tolerance: float) -> Start:
    """Return where a solver leads from one scaled start."""
    low, high = problem.bounds
    inside = 1e-9 * (high - low)
    x = np.clip(x, low + inside, high - inside)
    initial = problem.values(x)
    if not (
        np.isfinite(problem.residual(x)).all() and np.isfinite(problem.scaled_sensitivity(initial)).all()
    ):
        return Start(initial=initial, values=initial, cost=np.inf, converged=False, evaluations=1)
    try:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            answer = optimize.least_squares(
                problem.residual,
                x,
                jac=lambda x: problem.scaled_sensitivity(problem.values(x)),
                bounds=(low, high),
                x_scale="jac",
                loss=problem.loss,
                f_scale=problem.loss_scale,
                ftol=tolerance,
                xtol=tolerance,
                gtol=1e-12,
                max_nfev=limit,
            )
    except (ValueError, np.linalg.LinAlgError):  # the model left the numbers that can be squared
        return Start(initial=initial, values=initial, cost=np.inf, converged=False, evaluations=limit)
    return Start(
        initial=initial,
        values=problem.values(answer.x),
        cost=float(answer.cost),
        converged=bool(answer.success),
        evaluations=int(answer.nfev),
    )


def _snapped(problem: Problem, values: Array) -> Array:
    """Return values with those that all but touch a bound put on it, where the curve does not change."""
    beside = values.copy()
    for i, p in zip(problem.free, problem.free_parameters, strict=True):
        x, ends = p.scaled(values[i]), [p.scaled(end) for end in p.bounds]
        for end, bound in zip(ends, p.bounds, strict=True):
            if abs(x - end) <= CLOSE * (ends[1] - ends[0]):
                beside[i] = bound
    with np.errstate(over="ignore", invalid="ignore"):
        change = np.abs(problem.w * (problem.model(beside) - problem.model(values))).max()
    return beside if change <= 1e-6 * np.abs(problem.w * problem.data).max() else values


def _fit_without_freedom(problem: Problem) -> Fit:
    """Return the fit of a problem in which nothing is free."""
    values = problem.values(np.empty(0))
    cost = float(np.sum(problem.residual(np.empty(0)) ** 2) / 2)
    start = Start(initial=values, values=values, cost=cost, converged=True, evaluations=1)
    return Fit(problem=problem, values=values, cost=cost, starts=(start,))


def _nothing(problem: Problem) -> float:
    """Return the cost below which a fit is exact."""
    return NOTHING * float(np.sum((problem.w * problem.data) ** 2) / 2)
