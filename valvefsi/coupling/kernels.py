"""Regularised delta functions: one-dimensional kernels and the loops that spread and interpolate with them.

delta_h(x) = prod_d phi(x_d / h_d) / h_d. Names as in the literature: ``piecewise_linear`` (Lee2020, S15),
``bspline3`` (S16), ``bspline4`` to ``bspline6`` (cardinal B-splines of that many points), ``ib3`` (Roma, Peskin and
Berger 1999), ``ib4`` (Peskin 2002), ``ib5`` (Bao, Donev, Griffith, McQueen and Peskin 2017), ``ib6`` (Bao, Kaye and
Peskin 2016), and the composite B-splines ``composite_bspline32`` to ``composite_bspline65``: for component d the first
number of points along axis d, the second one along the others. As the derivative of a B-spline is the difference of
two of one point less, the velocity they interpolate from a solenoidal field on faces is solenoidal everywhere.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numba
import numpy as np

Array = np.ndarray
kernel = numba.njit(cache=True, fastmath={"contract", "nsz"}, error_model="numpy")
INDEX = np.uint64  # of a place that is not negative: no code for counting from the end


def vectors(compiled: Callable) -> Callable:
    """Let the compiler make vectors of sums that are written out, which numba leaves off: twice as fast here."""

    @functools.wraps(compiled)
    def call(*args: object) -> None:
        before, numba.config.SLP_VECTORIZE = numba.config.SLP_VECTORIZE, 1
        try:
            compiled(*args)
        finally:
            numba.config.SLP_VECTORIZE = before

    return call


BSPLINE, IB3, IB4, IB5, IB6 = range(5)

KERNELS = {
    "piecewise_linear": (BSPLINE, 2, 2),
    "bspline3": (BSPLINE, 3, 3),
    "bspline4": (BSPLINE, 4, 4),
    "bspline5": (BSPLINE, 5, 5),
    "bspline6": (BSPLINE, 6, 6),
    "ib3": (IB3, 3, 3),
    "ib4": (IB4, 4, 4),
    "ib5": (IB5, 5, 5),
    "ib6": (IB6, 6, 6),
    "composite_bspline32": (BSPLINE, 3, 2),
    "composite_bspline43": (BSPLINE, 4, 3),
    "composite_bspline54": (BSPLINE, 5, 4),
    "composite_bspline65": (BSPLINE, 6, 5),
}
"""Family of each kernel, its number of points along the axis of the component, and along the other axes."""

# Second moments that make ib5 and ib6 three times continuously differentiable.
K5 = (38.0 - math.sqrt(69.0)) / 60.0
K6 = 59.0 / 60.0 - math.sqrt(29.0) / 20.0


@kernel
def bspline(w: Array, points: int, t: float) -> None:
    """Cardinal B-spline values at the grid positions it reaches, by the recursion of Cox and de Boor.

    ``t`` in [0, 1) is the place within the knot span.
    """
    w[0] = 1.0
    for j in range(1, points):
        saved = 0.0
        for r in range(j):
            value = w[r] / j
            w[r] = saved + (r + 1.0 - t) * value
            saved = (j - r - 1.0 + t) * value
        w[j] = saved


@kernel
def ib3(w: Array, r: float) -> None:
    """Three points: sum 1, first moment 0, sum of squares 1/2; ``r`` in [-1/2, 1/2] from the middle point."""
    w[1] = (1.0 + math.sqrt(1.0 - 3.0 * r * r)) / 3.0
    w[0] = (5.0 - 3.0 * (1.0 + r) - math.sqrt(max(0.0, 1.0 - 3.0 * r * r))) / 6.0
    w[2] = (5.0 - 3.0 * (1.0 - r) - math.sqrt(max(0.0, 1.0 - 3.0 * r * r))) / 6.0


@kernel
def ib4(w: Array, r: float) -> None:
    """Four points: even and odd sums 1/2, first moment 0, sum of squares 3/8; ``r`` in [0, 1) from the second."""
    root = math.sqrt(1.0 + 4.0 * r - 4.0 * r * r)
    w[0] = (3.0 - 2.0 * r - root) / 8.0
    w[1] = (3.0 - 2.0 * r + root) / 8.0
    w[2] = (1.0 + 2.0 * r + root) / 8.0
    w[3] = (1.0 + 2.0 * r - root) / 8.0


@kernel
def ib5(w: Array, r: float) -> None:
    """Five points: sum 1, moments 0, K5, 0, sum of squares constant; ``r`` in [-1/2, 1/2] from the middle point.

    With a, b the sums and c, d the differences of the inner and outer pairs, the moments give all weights as affine
    functions of the middle one; the sum of squares, known from r = 1/2 where an outer weight vanishes, gives that one.
    """
    middle = 0.5625 - 0.25 * K5
    b, d = (K5 - 0.75 + middle) / 3.0, (0.375 * (4.0 * K5 - 1.0)) / 6.0
    a, c = 1.0 - middle - b, 0.5 - 2.0 * d
    squares = middle * middle + 0.5 * (a * a + c * c + b * b + d * d)
    a0, b0 = (4.0 - K5 - r * r) / 3.0, (K5 + r * r - 1.0) / 3.0  # values for a middle weight of zero
    c, d = (4.0 * r - r**3 - 3.0 * K5 * r) / 3.0, (r**3 + 3.0 * K5 * r - r) / 6.0
    # (1 + 16/18 + 1/18) m^2 + 2 beta m + gamma = 0
    beta = 0.5 * (-4.0 / 3.0 * a0 + b0 / 3.0)
    gamma = 0.5 * (a0 * a0 + b0 * b0 + c * c + d * d) - squares
    m = (-beta + math.sqrt(max(0.0, beta * beta - 35.0 / 18.0 * gamma))) * 18.0 / 35.0
    a, b = a0 - 4.0 / 3.0 * m, b0 + m / 3.0
    w[0], w[1], w[2], w[3], w[4] = 0.5 * (b - d), 0.5 * (a - c), m, 0.5 * (a + c), 0.5 * (b + d)


@kernel
def ib6(w: Array, r: float) -> None:
    """Six points: even and odd sums 1/2, moments 0, K6, 0, sum of squares constant; ``r`` in [0, 1) from the third.

    The linear conditions leave w + t (1, -3, 2, 2, -3, 1); the sum of squares, known from r = 0 where the last
    weight vanishes, gives t.
    """
    k, r2, r3 = K6, r * r, r * r * r
    p0 = 0.625 - 0.25 * k
    side = 0.5 * (0.5 - p0)
    squares = p0 * p0 + 0.125 + 2.0 * side * side
    w[5] = 0.0
    w[4] = -0.0625 + 0.125 * (k + r2) + (3.0 * k - 1.0) * r / 12.0 + r3 / 12.0
    w[3] = 0.25 + (4.0 - 3.0 * k) * r / 6.0 - r3 / 6.0
    w[2] = 0.625 - 0.25 * (k + r2)
    w[1] = 0.25 - (4.0 - 3.0 * k) * r / 6.0 + r3 / 6.0
    w[0] = -0.0625 + 0.125 * (k + r2) - (3.0 * k - 1.0) * r / 12.0 - r3 / 12.0
    beta = w[0] - 3.0 * w[1] + 2.0 * w[2] + 2.0 * w[3] - 3.0 * w[4]
    gamma = w[0] ** 2 + w[1] ** 2 + w[2] ** 2 + w[3] ** 2 + w[4] ** 2 - squares
    t = (-beta + math.sqrt(max(0.0, beta * beta - 28.0 * gamma))) / 28.0
    w[0] += t
    w[1] -= 3.0 * t
    w[2] += 2.0 * t
    w[3] += 2.0 * t
    w[4] -= 3.0 * t
    w[5] += t


@kernel
def place_at(points: int, s: float) -> tuple[int, float]:
    """Return the lowest grid position that the kernel reaches from ``s`` (in spacings), and s from the middle one."""
    middle = math.floor(s) if points % 2 == 0 else math.floor(s + 0.5)
    return int(middle) - (points - 1) // 2, s - middle


@kernel
def weights_at(w: Array, family: int, points: int, s: float) -> int:
    """Write the kernel's values at the grid positions around ``s`` (in spacings); return the lowest position."""
    lowest, r = place_at(points, s)
    if family == BSPLINE:
        bspline(w, points, r if points % 2 == 0 else r + 0.5)
    elif family == IB3:
        ib3(w, r)
    elif family == IB4:
        ib4(w, r)
    elif family == IB5:
        ib5(w, r)
    else:
        ib6(w, r)
    return lowest


@kernel
def extent(x: Array) -> Array:
    """Return the lowest and the highest coordinates of the points, ``(2, dim)``, NaN where one is NaN."""
    ends = np.empty((2, x.shape[1]))
    ends[0], ends[1] = math.inf, -math.inf
    for q in range(x.shape[0]):
        for axis in range(x.shape[1]):
            s = x[q, axis]
            ends[0, axis] = ends[0, axis] if ends[0, axis] <= s else s
            ends[1, axis] = ends[1, axis] if ends[1, axis] >= s else s
            if math.isnan(s):
                return np.full((2, x.shape[1]), math.nan)
    return ends


@kernel
def prepare(base: Array, w: Array, x: Array, kind: tuple, grid: tuple) -> None:
    """Weights of all points on faces (0) and centres (1) along each axis.

    base[q, axis, s] is the first local index, w[q, axis, s, :] the weights; an axis of one cell has weight one. The
    kernel most in use has a loop of its own, into which the compiler takes its formula.
    """
    family, normal, tangential = kind
    origin, inv_h, offset, dim = grid  # offset: local index of global entry 0
    for q in range(x.shape[0]):
        for axis in range(dim):
            s = (x[q, axis] - origin[axis]) * inv_h[axis]
            for side in range(2):
                if family == IB4:
                    lowest, r = place_at(4, s - 0.5 * side)
                    ib4(w[q, axis, side], r)
                else:
                    points = normal if side == 0 else tangential
                    lowest = weights_at(w[q, axis, side], family, points, s - 0.5 * side)
                base[q, axis, side] = lowest + offset[axis]
        if dim == 2:
            base[q, 2, 1] = 0
            w[q, 2, 1, 0] = 1.0


@vectors
@kernel
def spread(f: Array, base: Array, w: Array, F: Array, d: int, scale: float, kind: tuple, row: tuple) -> None:
    """Spread component d, f(x) += scale sum_q F_d(q) w0 w1 w2, the weights of axis d being those on faces.

    The length of ``row`` is the kernel's along the last axis. The compiler knows it, and only where nothing is read
    between the sums that are written out does it make vectors of them.
    """
    normal, tangential = kind[1], kind[2]
    n0, n1, n2 = normal if d == 0 else tangential, normal if d == 1 else tangential, len(row)
    s0, s1, s2 = int(d != 0), int(d != 1), int(d != 2)
    for q in range(F.shape[0]):
        i0, j0, k0 = base[q, 0, s0], base[q, 1, s1], base[q, 2, s2]
        g = scale * F[q, d]
        c0 = g * w[q, 2, s2, 0]
        c1 = g * w[q, 2, s2, 1] if n2 > 1 else 0.0
        c2 = g * w[q, 2, s2, 2] if n2 > 2 else 0.0
        c3 = g * w[q, 2, s2, 3] if n2 > 3 else 0.0
        c4 = g * w[q, 2, s2, 4] if n2 > 4 else 0.0
        c5 = g * w[q, 2, s2, 5] if n2 > 5 else 0.0
        for i in range(n0):
            for j in range(n1):
                b = w[q, 0, s0, i] * w[q, 1, s1, j]
                x, y = INDEX(i0 + i), INDEX(j0 + j)
                f[x, y, INDEX(k0)] += b * c0
                if n2 > 1:
                    f[x, y, INDEX(k0 + 1)] += b * c1
                if n2 > 2:
                    f[x, y, INDEX(k0 + 2)] += b * c2
                if n2 > 3:
                    f[x, y, INDEX(k0 + 3)] += b * c3
                if n2 > 4:
                    f[x, y, INDEX(k0 + 4)] += b * c4
                if n2 > 5:
                    f[x, y, INDEX(k0 + 5)] += b * c5


@vectors
@kernel
def interpolate(U: Array, base: Array, w: Array, u: Array, d: int, kind: tuple, row: tuple) -> None:
    """Interpolate component d, U_d(q) = sum_x u(x) w0 w1 w2: the transpose of `spread`."""
    normal, tangential = kind[1], kind[2]
    n0, n1 = normal if d == 0 else tangential, normal if d == 1 else tangential
    s0, s1, s2 = int(d != 0), int(d != 1), int(d != 2)
    for q in range(U.shape[0]):
        i0, j0, k0 = base[q, 0, s0], base[q, 1, s1], base[q, 2, s2]
        total = 0.0
        for i in range(n0):
            plane = 0.0
            for j in range(n1):
                line = 0.0
                for k in range(len(row)):
                    line += w[q, 2, s2, k] * u[INDEX(i0 + i), INDEX(j0 + j), INDEX(k0 + k)]
                plane += w[q, 1, s1, j] * line
            total += w[q, 0, s0, i] * plane
        U[q, d] = total
