"""Profile likelihoods: the least cost over all other parameters as one of them is moved."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from valvefsi.fitting.least_squares import Fit, Notify, solve
from valvefsi.types import Array

LEVEL = 0.95
RESAMPLED = 1e-8
"""Tolerance of refits, far below the differences in cost that intervals are read from."""
INSIDE = 9
"""Number of points from one end of an interval to the other, so that a curve through them is supported."""
SMALL = 0.02
"""Part of an interval below which two points count as one."""
BEYOND = 0.1
"""Part of an interval by which a profile goes on beyond an end at the threshold."""


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
    reached = [max(point.cost for point in side) > threshold for side in sides]
    ends = [
        side[-1].x if met else bound for side, met, bound in zip(sides, reached, (low, high), strict=True)
    ]
    points = [walk.begin, *sides[0], *sides[1]]
    points += walk.beyond(points, (float(ends[0]), float(ends[1])), (float(low), float(high)))
    points = walk.refined(points, float(ends[0]), float(ends[1]))
    parameter = problem.free_parameters[at]
    return Profile(
        name=name,
        values=np.array([parameter.natural(point.x) for point in points]),
        costs=np.array([point.cost for point in points]),
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


@dataclass(frozen=True)
class _Point:
    """A scaled value of the parameter, the least cost there, and the values of all parameters."""

    x: float
    cost: float
    values: Array


@dataclass(frozen=True, kw_only=True)
class _Walk:
    """Moves one free parameter, number ``at``, away from its value."""

    fit: Fit
    at: int
    threshold: float

    @property
    def begin(self) -> _Point:
        return _Point(
            float(self.fit.problem.scaled(self.fit.values)[self.at]), self.fit.cost, self.fit.values
        )

    def towards(self, bound: float, step: float, most: int) -> list[_Point]:
        """Return the points tried until the least cost passes the threshold, the last one on it, or to the bound."""
        points = [self.begin]
        for _ in range(most):
            before = points[-1]
            at_end = (before.x + step - bound) * np.sign(step) >= 0
            point = self._least(bound if at_end else before.x + step, before.values)
            points.append(point)
            if point.cost > self.threshold:
                return points[1:] + self._crossing(before, point)
            if at_end:
                break
            if point.cost - before.cost < 0.15 * (self.threshold - self.fit.cost):
                step *= 1.8
        return points[1:]

    def beyond(
        self, points: Sequence[_Point], ends: tuple[float, float], bounds: tuple[float, float]
    ) -> list[_Point]:
        """Return a point beyond each end of the interval that has none, nor a bound, some way on."""
        found, way = [], BEYOND * (ends[1] - ends[0])
        for end, bound, sign in zip(ends, bounds, (-1, 1), strict=True):
            x = sign * min(sign * end + way, sign * bound)
            if sign * (x - end) > 0 and not any(sign * (point.x - x) >= 0 for point in points):
                near = min(points, key=lambda point: abs(point.x - x))
                found.append(self._least(x, near.values))
        return found

    def refined(self, points: Sequence[_Point], low: float, high: float) -> list[_Point]:
        """Return points in order, with more between the ends of the interval where they or their costs are far apart.

        Distances are those of the root of the cost's growth over the interval, which is nearly a straight line; near a
        bound at which the cost is least it is steep, and takes more of the points.
        """
        found, aim = sorted(points, key=lambda point: point.x), self._growth(self.threshold)
        if not (high > low and aim > 0):
            return found
        least = SMALL * (high - low)
        for _ in range(INSIDE):
            pairs = [(a, b) for a, b in itertools.pairwise(found) if low <= a.x < b.x <= high]
            if not pairs or sum(b.x - a.x > least for a, b in pairs) >= INSIDE - 1:
                break
            rises = [abs(self._growth(b.cost) - self._growth(a.cost)) / aim for a, b in pairs]
            apart = [(b.x - a.x) / (high - low) + min(r, 1.0) for (a, b), r in zip(pairs, rises, strict=True)]
            a, b = pairs[int(np.argmax(apart))]
            near = a if a.cost <= b.cost else b
            found = sorted([*found, self._least((a.x + b.x) / 2, near.values)], key=lambda point: point.x)
        return found

    def _crossing(self, inner: _Point, outer: _Point) -> list[_Point]:
        """Return the points tried on the way to the threshold: secant and bisection in turn on the growth's root."""
        aim = self._growth(self.threshold)
        trials: list[_Point] = []
        values = outer.values
        for turn in range(40):
            f, g = self._growth(inner.cost) - aim, self._growth(outer.cost) - aim
            secant = turn % 2 == 0 and g > f and np.isfinite(g)
            x = inner.x - f * (outer.x - inner.x) / (g - f) if secant else (inner.x + outer.x) / 2
            trial = self._least(x, values)
            values = trial.values
            trials.append(trial)
            if abs(self._growth(trial.cost) - aim) < 1e-3 * aim:
                break
            inner, outer = (trial, outer) if trial.cost <= self.threshold else (inner, trial)
        return trials

    def _growth(self, cost: float) -> float:
        return float(np.sqrt(max(cost - self.fit.cost, 0.0)))

    def _least(self, x: float, values: Array) -> _Point:
        """Return the least cost with the parameter held at the scaled value."""
        parameter = self.fit.problem.free_parameters[self.at]
        problem = self.fit.problem.with_constant(parameter.name, parameter.natural(x))
        if not problem.free:
            values = problem.values(np.empty(0))
            return _Point(x, float(np.sum(problem.residual(np.empty(0)) ** 2) / 2), values)
        answer = solve(problem, problem.scaled(values), limit=60, tolerance=RESAMPLED)
        return _Point(x, answer.cost, answer.values)
