"""Profile likelihoods: the least cost over all other parameters as one of them is moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from valvefsi.fitting.least_squares import Fit, Notify, solve
from valvefsi.types import Array

LEVEL = 0.95
RESAMPLED = 1e-8
"""Tolerance of refits, far below the differences in cost that intervals are read from."""


@dataclass(frozen=True, kw_only=True)
class Profile:
    """Least cost over all other parameters as one of them is moved.

    Attributes:
        name: The parameter.
        values: Where it was held, increasing, ``(points,)``.
        costs: Least cost there, ``(points,)``.
        threshold: Cost at which the interval ends.
        interval: Ends of the interval; a bound where the threshold was not met before it.
        open_ends: Whether the lower and the upper end are bounds of the parameter.
    """

    name: str
    values: Array
    costs: Array
    threshold: float
    interval: tuple[float, float]
    open_ends: tuple[bool, bool]


def profile(fit: Fit, name: str, *, level: float = LEVEL, most: int = 40) -> Profile:
    """Return the profile of one free parameter and the interval where it stays below the threshold.

        cost(theta) <= cost (1 + F_{1, m-n}(level) / (m - n))

    Args:
        fit: The fit.
        name: A free parameter.
        level: Confidence level.
        most: Most steps to either side.
    """
    problem = fit.problem
    at = [p.name for p in problem.free_parameters].index(name)
    freedom = max(len(problem.data) - len(problem.free), 1)
    threshold = float(fit.cost * (1 + stats.f.ppf(level, 1, freedom) / freedom))
    walk = _Walk(fit=fit, at=at, threshold=threshold)
    step, (low, high) = _first_step(fit, at, freedom), problem.bounds[:, at]
    sides = [walk.towards(float(low), -step, most), walk.towards(float(high), step, most)]
    points = sorted([(walk.centre, fit.cost), *sides[0], *sides[1]])
    reached = [max(cost for _, cost in side) > threshold for side in sides]
    ends = [
        side[-1][0] if met else bound for side, met, bound in zip(sides, reached, (low, high), strict=True)
    ]
    parameter = problem.free_parameters[at]
    return Profile(
        name=name,
        values=np.array([parameter.natural(x) for x, _ in points]),
        costs=np.array([cost for _, cost in points]),
        threshold=threshold,
        interval=(parameter.natural(ends[0]), parameter.natural(ends[1])),
        open_ends=(not reached[0], not reached[1]),
    )


def profiles(fit: Fit, level: float = LEVEL, notify: Notify | None = None) -> tuple[Profile, ...]:
    """Return the profile of every free parameter; ``notify`` is called after each."""
    walked: list[Profile] = []
    for p in fit.problem.free_parameters:
        walked.append(profile(fit, p.name, level=level))
        if notify:
            notify("profiles", len(walked), len(fit.problem.free))
    return tuple(walked)


def _first_step(fit: Fit, at: int, freedom: int) -> float:
    """Return a first step of a profile: what the Jacobian says the deviation is, within reason."""
    parameter = fit.problem.free_parameters[at]
    span = parameter.scaled(parameter.range[1]) - parameter.scaled(parameter.range[0])
    sigma = np.sqrt(2 * fit.half_squares / freedom)
    _, singular, rows = np.linalg.svd(fit.jacobian, full_matrices=False)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        deviation = sigma * np.sqrt(np.sum((rows[:, at] / singular) ** 2))
    if not np.isfinite(deviation) or deviation == 0:
        return span / 20
    return float(np.clip(0.7 * deviation, 1e-7 * span, span / 20))


@dataclass(frozen=True, kw_only=True)
class _Walk:
    """Moves one free parameter, number ``at``, away from its value; points are ``(scaled value, least cost)``."""

    fit: Fit
    at: int
    threshold: float

    @property
    def centre(self) -> float:
        return float(self.fit.problem.scaled(self.fit.values)[self.at])

    def towards(self, bound: float, step: float, most: int) -> list[tuple[float, float]]:
        """Return the points tried until the least cost passes the threshold, the last one on it, or to the bound."""
        x, values, points = self.centre, self.fit.values, [(self.centre, self.fit.cost)]
        for _ in range(most):
            at_end = (x + step - bound) * np.sign(step) >= 0
            x = bound if at_end else x + step
            cost, values = self._least(x, values)
            before, points = points[-1], [*points, (x, cost)]
            if cost > self.threshold:
                return points[1:] + self._crossing(before, points[-1], values)
            if at_end:
                break
            if cost - before[1] < 0.15 * (self.threshold - self.fit.cost):
                step *= 1.8
        return points[1:]

    def _crossing(
        self, inner: tuple[float, float], outer: tuple[float, float], values: Array
    ) -> list[tuple[float, float]]:
        """Return the points tried on the way to the threshold: secant and bisection in turn on the growth's root."""
        aim = self._growth(self.threshold)
        trials: list[tuple[float, float]] = []
        for turn in range(40):
            f, g = self._growth(inner[1]) - aim, self._growth(outer[1]) - aim
            secant = turn % 2 == 0 and g > f and np.isfinite(g)
            x = inner[0] - f * (outer[0] - inner[0]) / (g - f) if secant else (inner[0] + outer[0]) / 2
            cost, values = self._least(x, values)
            trials.append((x, cost))
            if abs(self._growth(cost) - aim) < 1e-3 * aim:
                break
            inner, outer = (trials[-1], outer) if cost <= self.threshold else (inner, trials[-1])
        return trials

    def _growth(self, cost: float) -> float:
        return float(np.sqrt(max(cost - self.fit.cost, 0.0)))

    def _least(self, x: float, values: Array) -> tuple[float, Array]:
        """Return the least cost with the parameter held at the scaled value, and the values there."""
        parameter = self.fit.problem.free_parameters[self.at]
        problem = self.fit.problem.with_constant(parameter.name, parameter.natural(x))
        if not problem.free:
            values = problem.values(np.empty(0))
            return float(np.sum(problem.residual(np.empty(0)) ** 2) / 2), values
        answer = solve(problem, problem.scaled(values), limit=60, tolerance=RESAMPLED)
        return answer.cost, answer.values
