"""Loops over the rows of a mass matrix: its incomplete Cholesky factor, and conjugate gradients with it.

Vectors have four columns, of which three are in use: a row is then one vector of the processor. All components are
done at once, so that an entry of the matrix is read once.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from valvefsi.runtime.compiled import vectors
from valvefsi.types import Array, Indices

Rows = tuple[NDArray[np.uint32], NDArray[np.uint32], NDArray[np.floating]]
"""Starts of rows, columns in ascending order, values."""

Halves = tuple[NDArray[np.uint32], NDArray[np.uint32], NDArray[np.floating], NDArray[np.floating]]
"""The same and the diagonal, or its inverse."""

kernel = numba.njit(cache=True, fastmath={"contract", "nsz"}, error_model="numpy")


@kernel
def factorise(out: tuple[Indices, Indices, Array, Array], matrix: Rows, drop: float) -> int:
    """Incomplete factor of a symmetric matrix A = L L^T row by row: l_ij = (a_ij - sum_k l_ik l_jk) / l_jj.

    What is smaller than ``drop`` sqrt(a_ii) is left out; what is larger stays, wherever it is. ``out`` takes starts of
    rows, columns in ascending order and values of L below the diagonal, and the diagonal. Returns how many entries
    there are, -1 where they do not fit. A pivot that is not positive, which comes of a large ``drop`` only, becomes
    that of A.
    """
    rows, columns, values, diagonal = out
    start, across, entries = matrix
    n, workspace, count = len(diagonal), len(values), 0
    row, listed = np.zeros(n), np.zeros(n, dtype=np.bool_)
    follow = np.empty(n, dtype=np.int64)  # the places of the row in ascending order, a chain that ends at i
    newest = np.full(n, -1, dtype=np.int64)  # the entries of each column, the newest first
    older, of_row = np.empty(workspace, dtype=np.int64), np.empty(workspace, dtype=np.int64)
    rows[0] = 0
    for i in range(n):
        first, last, pivot = np.int64(i), np.int64(-1), 0.0
        for e in range(start[i], start[i + 1]):
            j = np.int64(across[e])
            if j == i:
                pivot = entries[e]
            if j < i:  # columns ascend
                row[j], listed[j] = entries[e], True
                if last < 0:
                    first = j
                else:
                    follow[last] = j
                last = j
        if last >= 0:
            follow[last] = i
        whole, least, j = pivot, drop * math.sqrt(pivot), first
        while j < i:
            value = row[j] / diagonal[j]
            row[j], listed[j] = 0.0, False
            if abs(value) >= least:
                if count == workspace:
                    return -1
                pivot -= value * value
                e, before = newest[j], j
                while e >= 0:
                    k = of_row[e]
                    if not listed[k]:
                        if k < before:
                            before = j
                        while follow[before] < k:
                            before = follow[before]
                        follow[k], follow[before], listed[k] = follow[before], k, True
                    row[k] -= value * values[e]
                    e = older[e]
                columns[count], values[count], of_row[count] = j, value, i
                count += 1
            j = follow[j]
        for e in range(rows[i], count):
            j = columns[e]
            older[e], newest[j] = newest[j], e
        diagonal[i] = math.sqrt(pivot if pivot > 0.0 else whole)
        rows[i + 1] = count
    return count


@vectors
@kernel
def product(out: Array, q: Array, p: Array, upper: Halves) -> None:
    """Add A p to q; out_d = sum_i p_d(i) (A p)_d(i).

    A = D + V + V^T: ``upper`` has the entries V above the diagonal, which are read once for both sides of it.
    """
    start, columns, values, diagonal = upper
    e0, e1, e2, e3 = 0.0, 0.0, 0.0, 0.0
    for i in range(p.shape[0]):
        x, y, z, t = p[i, 0], p[i, 1], p[i, 2], p[i, 3]
        a, b, c, d = 0.0, 0.0, 0.0, 0.0
        for e in range(start[i], start[i + 1]):
            j, v = columns[e], values[e]
            a += v * p[j, 0]
            b += v * p[j, 1]
            c += v * p[j, 2]
            d += v * p[j, 3]
            q[j, 0] += v * x
            q[j, 1] += v * y
            q[j, 2] += v * z
            q[j, 3] += v * t
        m = diagonal[i]
        x, y, z, t = m * x, m * y, m * z, m * t
        e0 += p[i, 0] * (x + 2.0 * a)
        e1 += p[i, 1] * (y + 2.0 * b)
        e2 += p[i, 2] * (z + 2.0 * c)
        e3 += p[i, 3] * (t + 2.0 * d)
        q[i, 0] += x + a
        q[i, 1] += y + b
        q[i, 2] += z + c
        q[i, 3] += t + d
    out[0], out[1], out[2], out[3] = e0, e1, e2, e3


@vectors
@kernel
def advance(
    out: Array, x: Array, r: Array, y: Array, p: Array, q: Array, alpha: Array, lower: Halves
) -> None:
    """Step along p, whose image is q: x += alpha p, r -= alpha q; then L y = r, out_d = sum_i y_d(i)^2, and q = 0."""
    start, columns, values, inverse = lower
    a0, a1, a2, a3 = alpha[0], alpha[1], alpha[2], alpha[3]
    e0, e1, e2, e3 = 0.0, 0.0, 0.0, 0.0
    for i in range(y.shape[0]):
        a, b, c, d = x[i, 0], x[i, 1], x[i, 2], x[i, 3]
        a += a0 * p[i, 0]
        b += a1 * p[i, 1]
        c += a2 * p[i, 2]
        d += a3 * p[i, 3]
        x[i, 0], x[i, 1], x[i, 2], x[i, 3] = a, b, c, d
        a, b, c, d = r[i, 0], r[i, 1], r[i, 2], r[i, 3]
        a -= a0 * q[i, 0]
        b -= a1 * q[i, 1]
        c -= a2 * q[i, 2]
        d -= a3 * q[i, 3]
        r[i, 0], r[i, 1], r[i, 2], r[i, 3] = a, b, c, d
        q[i, 0], q[i, 1], q[i, 2], q[i, 3] = 0.0, 0.0, 0.0, 0.0
        for e in range(start[i], start[i + 1]):
            j, v = columns[e], values[e]
            a -= v * y[j, 0]
            b -= v * y[j, 1]
            c -= v * y[j, 2]
            d -= v * y[j, 3]
        f = inverse[i]
        a, b, c, d = f * a, f * b, f * c, f * d
        e0 += a * a
        e1 += b * b
        e2 += c * c
        e3 += d * d
        y[i, 0], y[i, 1], y[i, 2], y[i, 3] = a, b, c, d
    out[0], out[1], out[2], out[3] = e0, e1, e2, e3


@vectors
@kernel
def solve_down(out: Array, y: Array, right: Array, q: Array, lower: Halves) -> None:
    """Solve L y = right - q from the first row to the last; out_d = sum_i y_d(i)^2, and q = 0."""
    start, columns, values, inverse = lower
    e0, e1, e2, e3 = 0.0, 0.0, 0.0, 0.0
    for i in range(y.shape[0]):
        a, b, c, d = right[i, 0], right[i, 1], right[i, 2], right[i, 3]
        a -= q[i, 0]
        b -= q[i, 1]
        c -= q[i, 2]
        d -= q[i, 3]
        q[i, 0], q[i, 1], q[i, 2], q[i, 3] = 0.0, 0.0, 0.0, 0.0
        for e in range(start[i], start[i + 1]):
            j, v = columns[e], values[e]
            a -= v * y[j, 0]
            b -= v * y[j, 1]
            c -= v * y[j, 2]
            d -= v * y[j, 3]
        f = inverse[i]
        a, b, c, d = f * a, f * b, f * c, f * d
        e0 += a * a
        e1 += b * b
        e2 += c * c
        e3 += d * d
        y[i, 0], y[i, 1], y[i, 2], y[i, 3] = a, b, c, d
    out[0], out[1], out[2], out[3] = e0, e1, e2, e3


@vectors
@kernel
def solve_up(p: Array, z: Array, y: Array, beta: Array, upper: Halves) -> None:
    """Solve L^T z = y from the last row to the first, and take p = z + beta p."""
    start, columns, values, inverse = upper
    b0, b1, b2, b3 = beta[0], beta[1], beta[2], beta[3]
    n = z.shape[0]
    for m in range(n):
        i = n - 1 - m
        a, b, c, d = y[i, 0], y[i, 1], y[i, 2], y[i, 3]
        last = start[i + 1] - 1
        for k in range(start[i + 1] - start[i]):  # the neighbour that is found last comes last
            e = np.uint32(last - k)
            j, v = columns[e], values[e]
            a -= v * z[j, 0]
            b -= v * z[j, 1]
            c -= v * z[j, 2]
            d -= v * z[j, 3]
        f = inverse[i]
        a, b, c, d = f * a, f * b, f * c, f * d
        z[i, 0], z[i, 1], z[i, 2], z[i, 3] = a, b, c, d
        a += b0 * p[i, 0]
        b += b1 * p[i, 1]
        c += b2 * p[i, 2]
        d += b3 * p[i, 3]
        p[i, 0], p[i, 1], p[i, 2], p[i, 3] = a, b, c, d
