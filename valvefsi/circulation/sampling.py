"""The times of a record: intervals that are alike, or not far from one another, share matrix exponentials."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from valvefsi.types import Array, Indices

SAME_STEP = 1e-12
"""Steps that differ by less, relative to the median step, share one matrix exponential."""
ROUND_OFF = 1e-17
"""Bound on the error of the interpolation between intervals, relative to the exponentials."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Steps:
    """Sizes at which the matrices of a record's intervals are computed, and how each interval's follow from them.

    Attributes:
        dt: The sizes, ``(k,)`` [s].
        which: Number of the size of each interval, ``(n - 1,)``; used where there are no ``weights``.
        weights: Weight of each size in each interval, ``(n - 1, k)``; None where ``which`` says it all.
    """

    dt: Array
    which: Indices
    weights: Array | None = None

    def spread(self, matrices: Array) -> Array:
        """Return each interval's matrix (one, where all are alike) from those of the sizes, ``(k, i, j)``."""
        if self.weights is not None:
            return np.tensordot(self.weights, matrices, 1)
        return matrices if len(matrices) == 1 else matrices[self.which]

    def apply(self, matrices: Array, vectors: Array) -> Array:
        """Return the product of each interval's matrix and vector.

        Args:
            matrices: Of the sizes, ``(k, i, j)``.
            vectors: Of the intervals, ``(n - 1, j)``.

        Returns:
            ``(n - 1, i)``.
        """
        if len(matrices) == 1:
            return vectors @ matrices[0].T
        if self.weights is None:
            return np.einsum("nij,nj->ni", matrices[self.which], vectors)
        return sum(w[:, None] * (vectors @ M.T) for w, M in zip(self.weights.T, matrices, strict=True))


@dataclass(frozen=True, kw_only=True, eq=False)
class Sampling:
    """The times of a record, its intervals sorted by size.

    Attributes:
        t: Increasing times, ``(n,)`` [s].
        sizes: Sizes of the intervals, each once, ``(k,)`` [s].
        which: Number of the size of each interval, ``(n - 1,)``.
    """

    t: Array
    sizes: Array
    which: Indices
    _steps: dict[int, Steps] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, t: Array | Sampling) -> Sampling:
        """Sort the intervals of times, ``(n,)`` [s]; a sampling is returned as it is.

        Raises:
            ValueError: The times do not increase, or there is only one.
        """
        if isinstance(t, Sampling):
            return t
        t = np.asarray(t, dtype=float)
        step = np.diff(t)
        if len(step) == 0 or not step.min() > 0:
            raise ValueError("expected two increasing times or more")
        unit = SAME_STEP * np.median(step)
        _, first, which = np.unique(np.round(step / unit), return_index=True, return_inverse=True)
        return cls(t=t, sizes=step[first], which=which)

    def steps(self, rate: float) -> Steps:
        """Return the sizes at which a circuit's matrices are computed.

        Its exponentials are entire functions of the size: between k Chebyshev nodes over a span s the interpolation
        errs by no more than 2 (rate s / 4)^k / k!, which is kept below `ROUND_OFF`. Where that needs more nodes than
        there are sizes, every size has its own exponential.

        Args:
            rate: Bound on the circuit's rates, the norm of its matrix A [1/s].
        """
        reach = rate * float(np.ptp(self.sizes)) / 4
        count = next(
            (k for k in range(2, min(len(self.sizes), 60)) if 2 * reach**k <= ROUND_OFF * math.factorial(k)),
            0,
        )
        if count not in self._steps:
            self._steps[count] = (
                self._interpolated(count + 2) if count else Steps(dt=self.sizes, which=self.which)
            )
        return self._steps[count]

    def _interpolated(self, count: int) -> Steps:
        """Return Chebyshev nodes and barycentric weights."""
        angle = np.pi * (2 * np.arange(count) + 1) / (2 * count)
        middle, half = (self.sizes.max() + self.sizes.min()) / 2, np.ptp(self.sizes) / 2
        nodes = middle + half * np.cos(angle)
        away = self.sizes[:, None] - nodes
        on_node = away == 0
        parts = (-1.0) ** np.arange(count) * np.sin(angle) / np.where(on_node, 1.0, away)
        weights = np.where(on_node.any(axis=1)[:, None], on_node, parts)
        weights = weights / weights.sum(axis=1, keepdims=True)
        return Steps(dt=nodes, which=self.which, weights=weights[self.which])
