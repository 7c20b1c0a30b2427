"""Loops over the rows of a mass matrix for conjugate gradients with Eisenstat's form of symmetric Gauss-Seidel.

With A = L + D + L^T and K = D + L the preconditioned operator is K^-1 A K^-T = K^-T + K^-1 (I - D K^-T): one sweep up
and one down the rows, which cost together what one product with A does (Eisenstat 1981). All three components are
done at once, so that a row is read once.

A row of the matrix holds its columns in ascending order: below the diagonal, the diagonal at ``diagonal[i]``, above it
up to ``stop[i]``; what follows belongs to nodes of other ranks.
"""

from __future__ import annotations

import numba
import numpy as np

Array = np.ndarray
kernel = numba.njit(cache=True, fastmath={"contract", "nsz"}, error_model="numpy")


@kernel
def sweep_up(t: Array, p: Array, r: Array, beta: Array, matrix: tuple) -> None:
    """New direction p = D r + beta p and t = K^-T p, from the last row to the first."""
    _, columns, values, diagonal, stop = matrix
    n = p.shape[0]
    for m in range(n):
        i = n - 1 - m
        first = diagonal[i]
        a = values[first]
        for d in range(3):
            p[i, d] = a * r[i, d] + beta[d] * p[i, d]
        x, y, z = p[i, 0], p[i, 1], p[i, 2]
        last = stop[i] - 1
        for k in range(last - first):
            e = np.uint32(last - k)
            j, v = columns[e], values[e]
            x -= v * t[j, 0]
            y -= v * t[j, 1]
            z -= v * t[j, 2]
        f = 1.0 / a
        t[i, 0], t[i, 1], t[i, 2] = f * x, f * y, f * z


@kernel
def sweep_down(w: Array, b: Array, t: Array, matrix: tuple) -> None:
    """Solve K w = b - D t, from the first row to the last."""
    start, columns, values, diagonal, _ = matrix
    for i in range(b.shape[0]):
        last = diagonal[i]
        a = values[last]
        x, y, z = b[i, 0] - a * t[i, 0], b[i, 1] - a * t[i, 1], b[i, 2] - a * t[i, 2]
        for e in range(start[i], last):
            j, v = columns[e], values[e]
            x -= v * w[j, 0]
            y -= v * w[j, 1]
            z -= v * w[j, 2]
        f = 1.0 / a
        w[i, 0], w[i, 1], w[i, 2] = f * x, f * y, f * z


@kernel
def curvature(out: Array, p: Array, t: Array, w: Array) -> None:
    """Take out_d = sum_i p_d(i) (t_d(i) + w_d(i)), p being the direction and t + w its image."""
    x, y, z = 0.0, 0.0, 0.0
    for i in range(p.shape[0]):
        x += p[i, 0] * (t[i, 0] + w[i, 0])
        y += p[i, 1] * (t[i, 1] + w[i, 1])
        z += p[i, 2] * (t[i, 2] + w[i, 2])
    out[0], out[1], out[2] = x, y, z


@kernel
def advance(out: Array, x: Array, r: Array, t: Array, w: Array, alpha: Array, matrix: tuple) -> None:
    """Step along t: x += alpha t, r -= alpha (t + w); then out_d = sum_i D(i) r_d(i)^2."""
    _, _, values, diagonal, _ = matrix
    out[:] = 0.0
    for i in range(r.shape[0]):
        a = values[diagonal[i]]
        for d in range(3):
            x[i, d] += alpha[d] * t[i, d]
            r[i, d] -= alpha[d] * (t[i, d] + w[i, d])
            out[d] += a * r[i, d] * r[i, d]


@kernel
def add_others(out: Array, t: Array, matrix: tuple, rows: int) -> None:
    """Add A t for what couples nodes of different ranks: columns past ``stop``, and rows from ``rows`` on."""
    start, columns, values, _, stop = matrix
    for i in range(out.shape[0]):
        first = stop[i] if i < rows else start[i]
        for e in range(first, start[i + 1]):
            j, v = columns[e], values[e]
            for d in range(3):
                out[i, d] += v * t[j, d]
