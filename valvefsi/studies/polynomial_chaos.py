"""Polynomial chaos of few runs: a polynomial of orthogonal variates by least squares, with its own error.

    y(u) = sum_a c_a Psi_a(u),   |a| <= p,   E[Psi_a Psi_b] = delta_ab

Variance and Sobol indices are sums of squares of the coefficients. Errors are of left-out runs: the leave-one-out error
of the surrogate, and the jackknife's intervals of the indices; both follow from the one fit (Blatman and Sudret 2010).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.polynomial import hermite_e, legendre
from scipy.special import ndtri

from valvefsi.types import Array

SPARE = 1.5
"""Runs for each term of the polynomial, at least."""
REACH = 1.959963984540054
"""Standard deviations to the end of a 95 % interval."""
Term = tuple[int, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class Chaos:
    """A polynomial chaos of one output.

    Attributes:
        germs: Kind of each variate, ``normal`` or ``uniform``.
        terms: Degrees of each term in each variate; the first is the constant.
        coefficients: Coefficients, ``(num_terms,)``, in the output's unit.
        left_out: The same without each of the runs, ``(num_runs, num_terms)``.
        error: Root mean square error at left-out runs, in the output's unit.
        relative_error: Mean square error at left-out runs over the variance of the runs, corrected for their number.
        degree: Total degree.
    """

    germs: tuple[str, ...]
    terms: tuple[Term, ...]
    coefficients: Array
    left_out: Array
    error: float
    relative_error: float
    degree: int

    def __call__(self, u: Array) -> Array:
        """Return the output at points of the unit cube, ``(n, num_variates)``."""
        return basis(u, self.germs, self.terms) @ self.coefficients

    @property
    def mean(self) -> float:
        """Mean of the output."""
        return float(self.coefficients[0])

    @property
    def variance(self) -> float:
        """Variance of the output."""
        return float(np.sum(self.coefficients[1:] ** 2))

    def indices(self, of_variates: Sequence[str], kind: Literal["first", "total"]) -> tuple[Array, Array]:
        """Return Sobol indices of groups of variates, and the ends of their 95 % intervals by the jackknife.

        Args:
            of_variates: Name of the group of each variate.
            kind: Which.

        Returns:
            ``(num_groups,)`` and ``(num_groups, 2)``.
        """
        groups = list(dict.fromkeys(of_variates))
        touched = [{of_variates[k] for k, power in enumerate(term) if power} for term in self.terms]
        wanted = np.array(
            [
                [group in names and (kind == "total" or len(names) == 1) for names in touched]
                for group in groups
            ]
        )

        def parts(c: Array) -> Array:
            squares = c[..., 1:] ** 2
            return squares @ wanted[:, 1:].T / squares.sum(axis=-1, keepdims=True)

        found, without = parts(self.coefficients), parts(self.left_out)
        n = len(without)
        deviation = np.sqrt((n - 1) / n * np.sum((without - without.mean(axis=0)) ** 2, axis=0))
        return found, np.stack([found - REACH * deviation, found + REACH * deviation], axis=1)


def fit_chaos(u: Array, y: Array, germs: Sequence[str], largest: int) -> Chaos:
    """Return the chaos of the total degree with the smallest leave-one-out error.

    Args:
        u: Points of the unit cube, ``(num_runs, num_variates)``.
        y: The output there, ``(num_runs,)``; it varies.
        germs: Kind of each variate, ``normal`` or ``uniform``.
        largest: Largest degree that is tried.

    Raises:
        ValueError: There are too few runs for a polynomial of degree one, or no polynomial follows a variate.
    """
    if "none" in germs:
        raise ValueError(
            "no polynomial follows rows of a table of samples: take covariance, or the design sobol"
        )
    tried = [
        _fitted(u, y, germs, degree)
        for degree in range(1, largest + 1)
        if len(y) >= SPARE * math.comb(len(germs) + degree, degree)
    ]
    if not tried:
        need = math.ceil(SPARE * (len(germs) + 1))
        raise ValueError(f"{len(y)} runs are too few for {len(germs)} variates: {need} or more are needed")
    return min(tried, key=lambda chaos: chaos.relative_error)


def _fitted(u: Array, y: Array, germs: Sequence[str], degree: int) -> Chaos:
    """Return the chaos of one degree, and what leaving each run out does to it.

    e_i = r_i / (1 - h_i),   c_(-i) = c - (A^T A)^-1 a_i e_i,   h_i = a_i^T (A^T A)^-1 a_i
    """
    terms = terms_of(len(germs), degree)
    A = basis(u, germs, terms)
    inverse = np.linalg.pinv(A)
    c = inverse @ y
    residual, leverage = y - A @ c, np.einsum("ij,ji->i", A, inverse)
    missed = residual / np.maximum(1.0 - leverage, 1e-12)
    n, count = A.shape
    spread = float(np.var(y))
    few = (
        n / (n - count) * (1.0 + float(np.trace(np.linalg.pinv(A.T @ A / n))) / n) if n > count else math.inf
    )
    of_residuals = float(np.mean(missed**2))
    return Chaos(
        germs=tuple(germs),
        terms=terms,
        coefficients=c,
        left_out=c - inverse.T * missed[:, None],
        error=math.sqrt(of_residuals),
        relative_error=of_residuals / spread * few,
        degree=degree,
    )


def terms_of(num_variates: int, degree: int) -> tuple[Term, ...]:
    """Return all terms up to a total degree, the constant first."""
    found: list[Term] = []
    for total in range(degree + 1):
        for chosen in itertools.combinations_with_replacement(range(num_variates), total):
            found.append(tuple(chosen.count(k) for k in range(num_variates)))
    return tuple(found)


def basis(u: Array, germs: Sequence[str], terms: Sequence[Term]) -> Array:
    """Return the orthonormal polynomials of each term at points of the unit cube, ``(n, num_terms)``.

    uniform: sqrt(2 k + 1) P_k(2 u - 1);   normal: He_k(z) / sqrt(k!), z the standard normal quantile of u
    """
    most = max(map(max, terms))
    one = [_polynomials(u[:, k], germ, most) for k, germ in enumerate(germs)]
    columns = [np.prod([one[k][:, power] for k, power in enumerate(term)], axis=0) for term in terms]
    return np.stack(columns, axis=1)


def _polynomials(u: Array, germ: str, most: int) -> Array:
    if germ == "uniform":
        scales = np.sqrt(2.0 * np.arange(most + 1) + 1.0)
        return np.asarray(legendre.legvander(2.0 * u - 1.0, most) * scales, dtype=float)
    z = ndtri(np.clip(u, 1e-12, 1.0 - 1e-12))
    sizes: Array = np.sqrt([float(math.factorial(k)) for k in range(most + 1)])
    return np.asarray(hermite_e.hermevander(z, most) / sizes, dtype=float)


def latin_hypercube(num_variates: int, size: int, seed: int) -> Array:
    """Return points of the unit cube, one in each of ``size`` layers along every axis, ``(size, num_variates)``."""
    rng = np.random.default_rng(seed)
    layers = np.stack([rng.permutation(size) for _ in range(num_variates)], axis=1)
    return (layers + rng.random((size, num_variates))) / size
