"""How far fitted parameters may be trusted: intervals, correlation, verdicts, resampling.

Everything here works on a `Fit` of any problem. Intervals are taken in the scaled parameters (the logarithm of
a positive one) and handed back in the parameter's own unit. All of it supposes independent residuals of one
size; where the model misses the data systematically they are neither, and the bootstrap over blocks and the
error on held-out blocks say more.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy import stats

from valvefsi.fitting.least_squares import CLOSE, Fit, Notify, solve
from valvefsi.fitting.problem import Parameter
from valvefsi.fitting.profiles import LEVEL, RESAMPLED, Profile
from valvefsi.types import Array, Indices

WEAK = 0.5
"""A parameter is weak when its interval reaches further than this part of its value (or of its range)."""
TRADES = 0.99
"""Two parameters trade against each other when they are correlated more than this."""
NEGLIGIBLE = 1e-7
"""A direction is not in the data when its singular value is below this part of the largest."""
ALIKE = 2.0
"""Residuals alike over more observations than this are systematic, not noise."""


@dataclass(frozen=True, kw_only=True)
class Linear:
    """Linearised uncertainty at the values found.

    Attributes:
        names: The free parameters.
        covariance: Covariance of the scaled parameters, ``(free, free)``; NaN where the data do not fix them.
        std: Standard deviation in the parameter's own unit, ``(free,)``.
        intervals: 95 % intervals in the parameter's own unit, ``(free, 2)``.
        correlation: Correlation matrix, ``(free, free)``.
        singular_values: Of the scaled Jacobian with columns of unit length, largest first, ``(inside,)``.
        lost: Directions that the data do not fix, rows of unit length in the scaled parameters, ``(lost, free)``.
        sigma: Standard deviation of the weighted residuals.
        freedom: Observations less free parameters.
    """

    names: tuple[str, ...]
    covariance: Array
    std: Array
    intervals: Array
    correlation: Array
    singular_values: Array
    lost: Array
    sigma: float
    freedom: int


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
    draws: Array
    intervals: Array
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
    size = np.linalg.norm(jacobian, axis=0)
    inside = np.array([bound is None for bound in fit.at_bound], dtype=bool)
    inside &= size > NEGLIGIBLE * size.max(initial=0.0)
    singular, rows = np.zeros(0), np.zeros((0, 0))
    if inside.any():
        _, singular, rows = np.linalg.svd(jacobian[:, inside] / size[inside], full_matrices=False)
    visible = singular > NEGLIGIBLE * singular.max(initial=0.0)
    covariance = np.full((count, count), np.nan)
    part = sigma**2 * (rows[visible].T / singular[visible] ** 2) @ rows[visible]
    part = part / np.outer(size[inside], size[inside])
    loose = np.abs(rows[~visible]).max(axis=0, initial=0.0) > 1e-3
    part[loose, :] = part[:, loose] = np.nan
    covariance[np.ix_(inside, inside)] = part
    lost = np.zeros((int((~visible).sum()), count))
    lost[:, inside] = rows[~visible]
    deviation = np.sqrt(np.diag(covariance))
    reach = stats.t.ppf((1 + level) / 2, freedom) * deviation if freedom else np.full(count, np.nan)
    with np.errstate(invalid="ignore"):
        correlation = covariance / np.outer(deviation, deviation)
    return Linear(
        names=tuple(p.name for p in problem.free_parameters),
        covariance=covariance,
        std=problem.slopes(fit.values) * deviation,
        intervals=_interval(fit, reach),
        correlation=correlation,
        singular_values=singular,
        lost=lost,
        sigma=sigma,
        freedom=freedom,
    )


def verdicts(
    fit: Fit, linear: Linear, walked: tuple[Profile, ...] = (), *, doubt: str = ""
) -> dict[str, str]:
    """Return a plain verdict for each free parameter.

    ``identified``; ``weak`` (its interval reaches further than half its value); ``at bound``; ``not identified``
    with the parameters it trades against; ``doubtful`` in place of identified where there is a ``doubt``.
    """
    by_name = {p.name: p for p in walked}
    verdicts = {}
    for k, (parameter, bound) in enumerate(zip(fit.problem.free_parameters, fit.at_bound, strict=True)):
        own = by_name.get(parameter.name)
        partners = _partners(linear, k)
        against = f": trades against {', '.join(partners)}" if partners else ""
        open_ends = own.open_ends if own else (False, False)
        fixed = np.isfinite(linear.std[k]) or (own is not None and not all(open_ends))
        loose = any(abs(direction[k]) > 1e-2 for direction in linear.lost) or not fixed
        value = fit.values[fit.problem.free[k]]
        reference = min(abs(value), parameter.width) if parameter.period is None else parameter.period / 2
        low, high = own.interval if own else linear.intervals[k]
        wide = not max(high - value, value - low) <= WEAK * max(reference, 1e-300)
        bound = bound or _folded_to(parameter, value)
        if bound is not None:
            verdicts[parameter.name] = f"at bound ({bound})"
        elif loose or (all(open_ends) and parameter.period is None):
            verdicts[parameter.name] = f"not identified{against}"
        elif wide or (any(open_ends) and parameter.period is None):
            verdicts[parameter.name] = f"weak{against}"
        else:
            verdicts[parameter.name] = f"doubtful: {doubt}" if doubt else "identified"
    return verdicts


def _folded_to(parameter: Parameter, value: float) -> str | None:
    """Return the end of a range at which an angle lies, where symmetry has cut the range below a period."""
    span = parameter.upper - parameter.lower
    if parameter.period is None or span >= parameter.period:
        return None
    close = CLOSE * span
    return (
        "lower" if value - parameter.lower <= close else "upper" if parameter.upper - value <= close else None
    )


def correlation_length(residual: Array, series: Indices | None = None) -> float:
    """Return over how many observations residuals are alike: 1 + 2 sum rho_k to the first rho_k <= 0.

    Args:
        residual: Residuals, those of a series one after the other, ``(m,)``.
        series: Number of the series of each, ``(m,)``; one series if not given.
    """
    z = residual - residual.mean()
    square = float(z @ z)
    parts = [z] if series is None else [z[series == number] for number in np.unique(series)]
    total = 1.0
    if square < 1e-20 * max(len(z), 1):
        return total
    for lag in range(1, max(map(len, parts))):
        rho = sum(float(part[:-lag] @ part[lag:]) for part in parts if len(part) > lag) / square
        if rho <= 0:
            break
        total += 2 * rho
    return total


def widened(fit: Fit, linear: Linear, length: float) -> dict[str, list[float]]:
    """Return covariance intervals for residuals that are alike over ``length`` observations."""
    reach = stats.t.ppf(0.975, max(linear.freedom / length, 1.0)) * np.sqrt(length) * linear.std
    values = [fit.named[name] for name in linear.names]
    return {name: [v - r, v + r] for name, v, r in zip(linear.names, values, reach, strict=True)}


def combined(
    fit: Fit, functions: Mapping[str, Callable[[Mapping[str, complex]], complex]]
) -> dict[str, tuple[float, float | None]]:
    """Return value and standard deviation of combinations of parameters, by the linearised covariance.

    A combination may be well known where its parameters are not: they then trade against one another. The deviation
    is None where the data do not fix the combination either; one that depends on nothing free is left out.
    """
    problem, values = fit.problem, fit.named
    _, singular, rows = np.linalg.svd(fit.jacobian, full_matrices=False)
    visible = singular > NEGLIGIBLE * singular.max(initial=0.0)
    sigma = np.sqrt(2 * fit.half_squares / max(len(problem.data) - len(problem.free), 1))
    entries: dict[str, tuple[float, float | None]] = {}
    for name, function in functions.items():
        by = [
            np.imag(function({**values, p.name: values[p.name] + 1e-30j})) / 1e-30
            for p in problem.free_parameters
        ]
        slopes = np.array(by) * problem.slopes(fit.values)
        along = rows @ slopes
        lost = np.linalg.norm(along[~visible]) > 1e-6 * np.linalg.norm(slopes)
        if np.any(slopes):
            deviation = None if lost else float(sigma * np.linalg.norm(along[visible] / singular[visible]))
            entries[name] = (float(np.real(function(values))), deviation)
    return entries


def bootstrap(
    fit: Fit, *, draws: int = 100, seed: int = 0, level: float = LEVEL, notify: Notify | None = None
) -> Bootstrap | None:
    """Refit to blocks drawn with replacement, from the values found; None with fewer than three blocks."""
    problem = fit.problem
    blocks, place = np.unique(problem.block_of, return_inverse=True)
    if len(blocks) < 3:
        return None
    rng = np.random.default_rng(seed)
    start, rows = problem.scaled(fit.values), []
    for number in range(draws):
        counts = np.bincount(rng.choice(len(blocks), len(blocks)), minlength=len(blocks))
        answer = solve(problem.weighted(np.sqrt(counts)[place]), start, limit=100, tolerance=RESAMPLED)
        rows.append(answer.values[list(problem.free)])
        if notify:
            notify("resampling", number + 1, draws)
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
    start, entries = problem.scaled(fit.values), []
    for block in blocks:
        out = problem.block_of == block
        answer = solve(problem.weighted((~out).astype(float)), start)
        error = (problem.model(answer.values) - problem.data)[out]
        size = np.linalg.norm(problem.data[out]) or 1.0
        entries.append(
            HeldOut(
                block=problem.block_names.get(int(block), str(block)),
                rmse=float(np.sqrt(np.mean(error**2))),
                relative_l2=float(np.linalg.norm(error) / size),
                fitted_relative_l2=float(np.linalg.norm(fit.residual[out]) / size),
            )
        )
    return tuple(entries)


def band(
    fit: Fit, linear: Linear, model_jacobian: Callable[[Array], Array] | None = None, level: float = LEVEL
) -> Array:
    """Return half the width of the confidence band of the curve, ``(m,)``.

        t sqrt(diag(J cov J^T))

    Args:
        fit: The fit.
        linear: Its linearised uncertainty.
        model_jacobian: Derivative of another curve by all parameters, ``(n,)`` to ``(m, n)``; of the fitted one if
            not given.
        level: Confidence level.
    """
    if model_jacobian is None:
        sensitivity = fit.problem.sensitivity(fit.values)
    else:
        sensitivity = np.asarray(model_jacobian(fit.values))[:, list(fit.problem.free)]
    if not linear.freedom:
        return np.full(len(sensitivity), np.nan)
    scaled = sensitivity * fit.problem.slopes(fit.values)
    variance = np.einsum("ij,jk,ik->i", scaled, np.nan_to_num(linear.covariance), scaled)
    return stats.t.ppf((1 + level) / 2, linear.freedom) * np.sqrt(np.maximum(variance, 0.0))


def information(fit: Fit) -> dict[str, float]:
    """Return AICc and BIC of a least-squares fit with Gaussian residuals; smaller is better."""
    m, n = len(fit.problem.data), len(fit.problem.free) + 1
    size = m * np.log(max(2 * fit.half_squares / m, 1e-300))
    correction = 2 * n * (n + 1) / (m - n - 1) if m > n + 1 else np.inf
    return {"aicc": float(size + 2 * n + correction), "bic": float(size + n * np.log(m))}


def _interval(fit: Fit, reach: Array) -> Array:
    """Return the intervals in the parameters' own units, inside their bounds, ``(free, 2)``."""
    problem = fit.problem
    ends = [
        [p.natural(x - r), p.natural(x + r)] if np.isfinite(r) else [np.nan, np.nan]
        for p, x, r in zip(problem.free_parameters, problem.scaled(fit.values), reach, strict=True)
    ]
    return np.array(ends).reshape(-1, 2)


def _partners(linear: Linear, k: int) -> list[str]:
    """Return the names of the parameters that parameter ``k`` trades against."""
    with np.errstate(invalid="ignore"):
        trades = np.abs(linear.correlation[k]) > TRADES
    for direction in linear.lost:
        if abs(direction[k]) > 1e-2:
            trades |= np.abs(direction) > 1e-2
    return [name for j, name in enumerate(linear.names) if j != k and trades[j]]
