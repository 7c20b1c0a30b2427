"""Elimination along the lines of one axis: a tridiagonal system for every pair of modes of the other two.

With the other two axes transformed, a - b (D0 + l1 + l2) is tridiagonal along axis 0. A line costs one division and
a few products an entry, whatever its length and spacing, where a transform there and back costs more: at 128^3 cells a
Poisson solve takes 0.7 of the time with it, at 573 x 223 graded cells 0.35.
"""

from __future__ import annotations

import numpy as np

from valvefsi.fluid.axes import Axis
from valvefsi.fluid.stencils import kernel
from valvefsi.runtime import threads
from valvefsi.types import Array, Faces

WIDTH = 64
"""Lines that are worked on together, side by side in memory."""


@kernel
def eliminate(x: Array, bands: Faces, shift: Array, first: int, last: int) -> None:
    """Solve (shift_k V + K) x_k = V x_k for the lines ``first`` to ``last``, columns of x, in place.

    V is diagonal and K symmetric and tridiagonal; ``bands`` are V, the diagonal of K and what stands beside it with its
    sign changed. shift V + K is definite, so that no pivoting is needed.
    """
    volume, diagonal, beside = bands
    n = x.shape[0]
    c, y = np.empty((n, WIDTH)), np.empty((n, WIDTH))
    for start in range(first, last, WIDTH):
        m = min(WIDTH, last - start)
        s = shift[start : start + m]
        for i in range(n):
            v, d, e, f = volume[i], diagonal[i], beside[i], beside[i + 1]
            row, ci, yi = x[i, start : start + m], c[i], y[i]
            if i == 0:
                for k in range(m):
                    p = 1.0 / (d + v * s[k])
                    ci[k] = f * p
                    yi[k] = v * row[k] * p
            else:
                cm, ym = c[i - 1], y[i - 1]
                for k in range(m):
                    p = 1.0 / (d + v * s[k] - e * cm[k])
                    ci[k] = f * p
                    yi[k] = (v * row[k] + e * ym[k]) * p
        top = x[n - 1, start : start + m]
        for k in range(m):
            top[k] = y[n - 1, k]
        for i in range(n - 2, -1, -1):
            row, above, ci, yi = x[i, start : start + m], x[i + 1, start : start + m], c[i], y[i]
            for k in range(m):
                row[k] = yi[k] + ci[k] * above[k]


class LineSolver:
    """Solve (shift - b D) x = r along axis 0 of arrays, with D the second difference of an axis that is not periodic.

    Args:
        axis: The axis.

    Raises:
        ValueError: A periodic axis.
    """

    def __init__(self, axis: Axis) -> None:
        if axis.kind == "periodic":
            raise ValueError("a periodic axis has no tridiagonal second difference")
        self.volumes = np.ascontiguousarray(axis.volumes, dtype=float)
        self.diagonal, self.beside = axis.bands()
        self.loose = axis.kind.endswith("NN")

    def solve(self, x: Array, shift: Array, b: float) -> Array:
        """Solve for every line; of a singular one neither r's mean counts nor has x one.

        Args:
            x: Right-hand sides, ``(n0, n1, n2)``; may be overwritten.
            shift: Multiple of the identity of every line, ``(n1, n2)``.
            b: Multiple of the second difference, of such a sign that shift - b D is definite or singular.

        Returns:
            The solutions, same shape.
        """
        lines, flat = np.ascontiguousarray(x).reshape(len(x), -1), shift.ravel()
        singular = np.flatnonzero(flat == 0.0) if self.loose else ()
        kept = [lines[:, k].copy() for k in singular]
        if kept:  # anything definite in their place: no division by zero, whose flag a later sum might report
            flat = np.where(flat == 0.0, b, flat)
        bands = (self.volumes, -b * self.diagonal, b * self.beside)
        threads.divide(
            lambda first, last: eliminate(lines, bands, flat, first, last),
            0,
            lines.shape[1],
            step=WIDTH,
            least=threads.LEAST // len(x),
        )
        for k, r in zip(singular, kept, strict=True):
            lines[:, k] = self._singular(r) / -b
        return lines.reshape(x.shape)

    def _singular(self, r: Array) -> Array:
        """Return x without a mean with D x = r less its mean: fluxes are summed up, then differences."""
        V = self.volumes
        r = r - (V * r).sum() / V.sum()
        flux = np.cumsum(V * r)[:-1]
        x = np.concatenate([[0.0], np.cumsum(flux / self.beside[1:-1])])
        return x - (V * x).sum() / V.sum()
