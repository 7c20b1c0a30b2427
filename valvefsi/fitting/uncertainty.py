"""How far fitted parameters may be trusted: intervals, correlation, verdicts, resampling.

Everything here works on a `Fit` of any problem. Intervals are taken in the scaled parameters (the logarithm of
a positive one) and handed back in the parameter's own unit. All of it supposes independent residuals of one
size; where the model misses the data systematically they are neither, and the bootstrap over blocks and the
error on held-out blocks say more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from valvefsi.fitting.least_squares import Fit, Problem, solve

LEVEL = 0.95
WEAK = 0.5
"""A parameter is weak when its interval reaches further than this part of its value (or of its range)."""
TRADES = 0.99
"""Two parameters trade against each other when they are correlated more than this."""
LOST = 1e-7
"""A direction is not in the data when its singular value is below this part of the largest."""


@dataclass(frozen=True, kw_only=True)
class Linear:
    """Linearised uncertainty at the values found.

    Attributes:
        names: The free parameters.
        covariance: Covariance of the scaled parameters, ``(free, free)``; NaN where the data do not fix them.
        std: Standard deviation in the parameter's own unit, ``(free,)``.
        intervals: 95 % intervals in the parameter's own unit, ``(free, 2)``.
        correlation: Correlation matrix, ``(free, free)``.
        singular_values: Of the scaled Jacobian with columns of unit length, largest first.
        lost: Directions that the data do not fix, rows of unit length in the scaled parameters.
        sigma: Standard deviation of the weighted residuals.
        freedom: Observations less free parameters.
    """

    names: tuple[str, ...]
    covariance: NDArray
    std: NDArray
    intervals: NDArray
    correlation: NDArray
    singular_values: NDArray
    lost: NDArray
    sigma: float
    freedom: int


@dataclass(frozen=True, kw_only=True)
class Profile:
    """Least cost over all other parameters as one of them is moved.

    Attributes:
        name: The parameter.
        values: Where it was held, increasing.
        costs: Least cost there.
        threshold: Cost at which the interval ends.
        interval: Ends of the interval; a bound where the threshold was not met before it.
        open_ends: Whether the lower and the upper end are bounds of the parameter.
    """

    name: str
    values: NDArray
    costs: NDArray
    threshold: float
    interval: tuple[float, float]
    open_ends: tuple[bool, bool]


@dataclass(frozen=True, kw_only=True)
class HeldOut:
    """Prediction of a block by a fit to the others.

    Attributes:
        block: Name of the block.
        rmse: Root mean square error of the prediction, in the unit of the data.
        relative_l2: Error over data, in the L2 norm.
        fitted_relative_l2: The same of the fit to all blocks.
    """

    block: str
    rmse: float
    relative_l2: float
    fitted_relative_l2: float


@dataclass(frozen=True, kw_only=True)
class Bootstrap:
    """Refits to blocks drawn with replacement.

    Attributes:
        names: The free parameters.
        draws: Values, ``(draws, free)``.
        intervals: 2.5 and 97.5 percentiles, ``(free, 2)``.
        blocks: Number of blocks.
    """

    names: tuple[str, ...]
    draws: NDArray
    intervals: NDArray
    blocks: int


def linearised(fit: Fit, level: float = LEVEL) -> Linear:
    """Return the covariance-based uncertainty of a fit.

        cov = sigma^2 (A^T A)^-1,  sigma^2 = sum r^2 / (m - n),  A the scaled Jacobian

    Parameters that ended at a bound are held there: they get no deviation, and add none to the others'.
    """
    problem, jacobian = fit.problem, fit.jacobian
    count = jacobian.shape[1]
    freedom = max(len(problem.data) - count, 0)
    sigma = float(np.sqrt(2 * fit.half_squares / freedom)) if freedom else np.nan
    inside = np.array([bound is None for bound in fit.at_bound], dtype=bool)
    size = np.linalg.norm(jacobian, axis=0)
    inside &= size > LOST * size.max(initial=0.0)
    unit = jacobian[:, inside] / size[inside]
    _, singular, rows = (
        np.linalg.svd(unit, full_matrices=False) if inside.any() else (0, np.zeros(0), np.zeros((0, 0)))
    )
    found = singular > LOST * singular.max(initial=0.0)
    covariance = np.full((count, count), np.nan)
    part = sigma**2 * (rows[found].T / singular[found] ** 2) @ rows[found]
    part = part / np.outer(size[inside], size[inside])
    loose = np.abs(rows[~found]).max(axis=0, initial=0.0) > 1e-3
    part[loose, :] = part[:, loose] = np.nan
    covariance[np.ix_(inside, inside)] = part
    lost = np.zeros((int((~found).sum()), count))
    lost[:, inside] = rows[~found]
    deviation = np.sqrt(np.diag(covariance))
    reach = stats.t.ppf((1 + level) / 2, freedom) * deviation if freedom else np.full(count, np.nan)
    with np.errstate(invalid="ignore"):
        correlation = covariance / np.outer(deviation, deviation)
    return Linear(
        names=tuple(p.name for p in problem.free_parameters),
        covariance=covariance,
        std=_slopes(fit) * deviation,
        intervals=_interval(fit, reach),
        correlation=correlation,
        singular_values=singular,
        lost=lost,
        sigma=sigma,
        freedom=freedom,
    )


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
    step = _first_step(fit, at, freedom)
    threshold = fit.cost * (1 + stats.f.ppf(level, 1, freedom) / freedom)
    centre = float(problem.scaled(fit.values)[at])
    points, ends, opened = [(centre, fit.cost)], [], []
    for side, bound in zip((-1, 1), problem.bounds[:, at], strict=True):
        walked, end, reached = _walk(fit, at, side * step, (bound, threshold, most))
        points += walked
        ends.append(end)
        opened.append(not reached)
    points.sort()
    parameter = problem.free_parameters[at]
    return Profile(
        name=name,
        values=np.array([parameter.natural(x) for x, _ in points]),
        costs=np.array([cost for _, cost in points]),
        threshold=float(threshold),
        interval=(parameter.natural(ends[0]), parameter.natural(ends[1])),
        open_ends=(opened[0], opened[1]),
    )


def profiles(fit: Fit, level: float = LEVEL) -> tuple[Profile, ...]:
    """Return the profile of every free parameter."""
    return tuple(profile(fit, p.name, level=level) for p in fit.problem.free_parameters)


def verdicts(fit: Fit, linear: Linear, found: tuple[Profile, ...] = ()) -> dict[str, str]:
    """Return a plain verdict for each free parameter.

    ``identified``; ``weak`` (its interval reaches further than half its value); ``at bound``; ``not identified``
    with the parameters it trades against.
    """
    by_name = {p.name: p for p in found}
    said = {}
    for k, (parameter, bound) in enumerate(zip(fit.problem.free_parameters, fit.at_bound, strict=True)):
        against = _partners(linear, k)
        open_ends = by_name[parameter.name].open_ends if parameter.name in by_name else (False, False)
        lost = any(abs(direction[k]) > 1e-2 for direction in linear.lost)
        known = np.isfinite(linear.std[k]) or (parameter.name in by_name and not all(open_ends))
        value = fit.values[fit.problem.free[k]]
        reference = min(abs(value), parameter.width) if parameter.period is None else parameter.period / 2
        low, high = by_name[parameter.name].interval if parameter.name in by_name else linear.intervals[k]
        wide = not max(high - value, value - low) <= WEAK * max(reference, 1e-300)
        if bound is not None:
            said[parameter.name] = f"at bound ({bound})"
        elif lost or not known or (all(open_ends) and parameter.period is None):
            said[parameter.name] = "not identified" + (
                f": trades against {', '.join(against)}" if against else ""
            )
        elif wide or (any(open_ends) and parameter.period is None):
            said[parameter.name] = "weak" + (f": trades against {', '.join(against)}" if against else "")
        else:
            said[parameter.name] = "identified"
    return said


def bootstrap(fit: Fit, *, draws: int = 100, seed: int = 0, level: float = LEVEL) -> Bootstrap | None:
    """Refit to blocks drawn with replacement, from the values found; None with fewer than three blocks."""
    problem = fit.problem
    blocks = np.unique(problem.block_of)
    if len(blocks) < 3:
        return None
    rng = np.random.default_rng(seed)
    start = problem.scaled(fit.values)
    rows = []
    for _ in range(draws):
        chosen = rng.choice(blocks, len(blocks))
        weights = np.sqrt([np.sum(chosen == block) for block in blocks])[
            np.searchsorted(blocks, problem.block_of)
        ]
        done = solve(problem.weighted(weights), start, loss=fit.loss, loss_scale=fit.loss_scale, limit=100)
        rows.append(done.values[list(problem.free)])
    values = np.array(rows)
    tail = 50 * (1 - level)
    return Bootstrap(
        names=tuple(p.name for p in problem.free_parameters),
        draws=values,
        intervals=np.percentile(values, [tail, 100 - tail], axis=0).T,
        blocks=len(blocks),
    )


def leave_one_out(fit: Fit) -> tuple[HeldOut, ...]:
    """Predict each block with a fit to the others, started from the values found."""
    problem = fit.problem
    blocks = np.unique(problem.block_of)
    if len(blocks) < 2:
        return ()
    start = problem.scaled(fit.values)
    found = []
    for block in blocks:
        out = problem.block_of == block
        done = solve(problem.weighted((~out).astype(float)), start, loss=fit.loss, loss_scale=fit.loss_scale)
        error = (problem.model(done.values) - problem.data)[out]
        size = np.linalg.norm(problem.data[out]) or 1.0
        found.append(
            HeldOut(
                block=problem.block_names.get(int(block), str(block)),
                rmse=float(np.sqrt(np.mean(error**2))),
                relative_l2=float(np.linalg.norm(error) / size),
                fitted_relative_l2=float(np.linalg.norm(fit.residual[out]) / size),
            )
        )
    return tuple(found)


def band(
    fit: Fit, linear: Linear, model_jacobian: Callable[[NDArray], NDArray] | None = None, level: float = LEVEL
) -> NDArray:
    """Return half the width of the confidence band of the curve.

        t sqrt(diag(J cov J^T))

    Args:
        fit: The fit.
        linear: Its linearised uncertainty.
        model_jacobian: Derivative of another curve by all parameters; of the fitted one if not given.
        level: Confidence level.
    """
    free = list(fit.problem.free)
    if model_jacobian is None:
        sensitivity = fit.problem.sensitivity(fit.values)
    else:
        sensitivity = np.asarray(model_jacobian(fit.values))[:, free]
    if not linear.freedom:
        return np.full(len(sensitivity), np.nan)
    scaled = sensitivity * _slopes(fit)
    variance = np.einsum("ij,jk,ik->i", scaled, np.nan_to_num(linear.covariance), scaled)
    return stats.t.ppf((1 + level) / 2, linear.freedom) * np.sqrt(np.maximum(variance, 0.0))


def information(fit: Fit) -> dict[str, float]:
    """Return AICc and BIC of a least-squares fit with Gaussian residuals; smaller is better."""
    m, n = len(fit.problem.data), len(fit.problem.free) + 1
    size = m * np.log(max(2 * fit.half_squares / m, 1e-300))
    correction = 2 * n * (n + 1) / (m - n - 1) if m > n + 1 else np.inf
    return {"aicc": float(size + 2 * n + correction), "bic": float(size + n * np.log(m))}


def _slopes(fit: Fit) -> NDArray:
    """Return d value / d scaled for each free parameter."""
    problem = fit.problem
    return np.array(
        [p.slope(fit.values[i]) for i, p in zip(problem.free, problem.free_parameters, strict=True)]
    )


def _interval(fit: Fit, reach: NDArray) -> NDArray:
    """Return the intervals in the parameters' own units, inside their bounds."""
    problem = fit.problem
    x = problem.scaled(fit.values)
    ends = [
        [p.natural(a - r), p.natural(a + r)] if np.isfinite(r) else [np.nan, np.nan]
        for p, a, r in zip(problem.free_parameters, x, reach, strict=True)
    ]
    return np.array(ends).reshape(-1, 2)


def _partners(linear: Linear, k: int) -> list[str]:
    """Return the names of the parameters that parameter ``k`` trades against."""
    names = [
        name
        for j, name in enumerate(linear.names)
        if j != k and np.isfinite(linear.correlation[k, j]) and abs(linear.correlation[k, j]) > TRADES
    ]
    for direction in linear.lost:
        if abs(direction[k]) > 1e-2:
            names += [n for j, n in enumerate(linear.names) if j != k and abs(direction[j]) > 1e-2]
    return list(dict.fromkeys(names))


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


def _walk(
    fit: Fit, at: int, step: float, limits: tuple[float, float, int]
) -> tuple[list[tuple[float, float]], float, bool]:
    """Move one parameter away until the least cost passes the threshold.

    Returns:
        The points ``(scaled value, cost)``, the end of the interval, and whether the threshold was passed.
    """
    bound, threshold, most = limits
    x, values = float(fit.problem.scaled(fit.values)[at]), fit.values
    last = (x, fit.cost)
    points: list[tuple[float, float]] = []
    for _ in range(most):
        at_end = (x + step - bound) * np.sign(step) >= 0
        x = bound if at_end else x + step
        cost, values = _least(fit, at, x, values)
        points.append((x, cost))
        if cost > threshold:
            tried = _crossing(fit, at, (last, (x, cost)), (threshold, values))
            return points + tried, tried[-1][0], True
        if at_end:
            break
        if cost - last[1] < 0.15 * (threshold - fit.cost):
            step *= 1.8
        last = (x, cost)
    return points, bound, False


def _crossing(
    fit: Fit, at: int, ends: tuple[tuple[float, float], tuple[float, float]], limits: tuple[float, NDArray]
) -> list[tuple[float, float]]:
    """Return the points tried on the way to the threshold: secant and bisection in turn on the root of its growth."""
    threshold, values = limits
    (a, low), (b, high) = ends
    aim = np.sqrt(max(threshold - fit.cost, 0.0))
    tried: list[tuple[float, float]] = []
    for turn in range(40):
        f, g = (np.sqrt(max(cost - fit.cost, 0.0)) - aim for cost in (low, high))
        x = a - f * (b - a) / (g - f) if turn % 2 == 0 and g > f and np.isfinite(g) else (a + b) / 2
        cost, values = _least(fit, at, x, values)
        tried.append((x, cost))
        if abs(np.sqrt(max(cost - fit.cost, 0.0)) - aim) < 1e-3 * aim:
            break
        (a, low), (b, high) = ((x, cost), (b, high)) if cost <= threshold else ((a, low), (x, cost))
    return tried


def _least(fit: Fit, at: int, x: float, values: NDArray) -> tuple[float, NDArray]:
    """Return the least cost with one scaled parameter held, and the values there."""
    problem = fit.problem
    parameter = problem.free_parameters[at]
    held = _hold(problem, at, parameter.natural(x))
    if not held.free:
        values = held.values(np.empty(0))
        return float(np.sum(held.residual(np.empty(0)) ** 2) / 2), values
    done = solve(held, held.scaled(values), loss=fit.loss, loss_scale=fit.loss_scale, limit=60)
    return done.cost, done.values


def _hold(problem: Problem, at: int, value: float) -> Problem:
    """Return the problem with its free parameter number ``at`` held."""
    index = problem.free[at]
    parameters = list(problem.parameters)
    parameters[index] = replace(parameters[index], value=value)
    return replace(problem, parameters=tuple(parameters))
