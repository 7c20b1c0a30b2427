"""Regularised delta functions: one-dimensional kernels and the loops that spread and interpolate with them.

delta_h(x) = prod_d phi(x_d / h_d) / h_d. Names as in the literature: ``piecewise_linear`` (Lee2020, S15),
``bspline3`` (S16), ``bspline4`` to ``bspline6`` (cardinal B-splines of that many points), ``ib3`` (Roma, Peskin and
Berger 1999), ``ib4`` (Peskin 2002), ``ib5`` (Bao, Donev, Griffith, McQueen and Peskin 2017), ``ib6`` (Bao, Kaye and
Peskin 2016), and the composite B-splines ``composite_bspline32`` to ``composite_bspline65``: for component d the first
number of points along axis d, the second one along the others. As the derivative of a B-spline is the difference of
two of one point less, the velocity they interpolate from a solenoidal field on faces is solenoidal everywhere.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from valvefsi.runtime.compiled import vectors
from valvefsi.types import Array, Faces, Indices

Kind = tuple[int, int, int]
"""Family of a kernel, and its points along a component's own axis and across it."""

Geometry = tuple[Array, Array, Indices, int]
"""Origin [cm], 1 / h [1/cm], local index of global entry 0, dimensions."""

Rows = tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]
"""As many numbers as the kernel has points along three axes."""

Part = tuple[int, int, int]
"""First point, number of points, component; or the shape of a local array."""

kernel = numba.njit(cache=True, fastmath={"contract", "nsz"}, error_model="numpy")
INDEX = np.uint64  # of a place that is not negative: no code for counting from the end


BSPLINE, IB3, IB4, IB5, IB6 = range(5)

BLOCK = 64
"""Points whose weights are computed at once."""
MOST = 6
"""Points of the widest kernel along an axis."""
# Where things are in the workspace of a block: places, lowest index, fraction, partial sums, weights by axis and side
# and point of the kernel, weights of the last axis by side and point of the solid, ones.
LOWEST, FRACTION, SAVED, WEIGHTS = BLOCK, 2 * BLOCK, 3 * BLOCK, 4 * BLOCK
LINES = WEIGHTS + 6 * MOST * BLOCK
ONES = LINES + 2 * BLOCK * MOST
SIZE = ONES + BLOCK

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
def bsplines(workspace: Array, at: int, points: int) -> None:
    """`bspline` for a block of points: the fractions are in workspace, the values go there from ``at`` on."""
    for b in range(BLOCK):
        workspace[at + INDEX(b)] = 1.0
    for j in range(1, points):
        for b in range(BLOCK):
            workspace[INDEX(SAVED + b)] = 0.0
        for r in range(j):
            here, up, down, share = at + INDEX(r * BLOCK), r + 1.0, j - r - 1.0, 1.0 / j
            for b in range(BLOCK):
                t = workspace[INDEX(FRACTION + b)]
                value = share * workspace[here + INDEX(b)]
                workspace[here + INDEX(b)] = workspace[INDEX(SAVED + b)] + (up - t) * value
                workspace[INDEX(SAVED + b)] = (down + t) * value
        here = at + INDEX(j * BLOCK)
        for b in range(BLOCK):
            workspace[here + INDEX(b)] = workspace[INDEX(SAVED + b)]


@kernel
def ib4s(workspace: Array, at: int) -> None:
    """`ib4` for a block of points, as `bsplines`."""
    for b in range(BLOCK):
        r = workspace[INDEX(FRACTION + b)]
        root = math.sqrt(0.015625 + 0.0625 * (r - r * r))
        low = 0.375 - 0.25 * r
        high = 0.5 - low
        workspace[at + INDEX(b)] = low - root
        workspace[at + INDEX(BLOCK + b)] = low + root
        workspace[at + INDEX(2 * BLOCK + b)] = high + root
        workspace[at + INDEX(3 * BLOCK + b)] = high - root


@kernel
def others(workspace: Array, at: int, family: int, points: int) -> None:
    """Values of the kernels of the other families for a block of points, as `bsplines`."""
    w = np.empty(MOST)
    for b in range(BLOCK):
        r = workspace[INDEX(FRACTION + b)]
        if family == IB3:
            ib3(w, r - 0.5)
        elif family == IB5:
            ib5(w, r - 0.5)
        else:
            ib6(w, r)
        for k in range(points):
            workspace[at + INDEX(k * BLOCK + b)] = w[k]


@kernel
def weigh(
    base: Indices, workspace: Array, x: Array, first: int, count: int, kind: Kind, grid: Geometry
) -> None:
    """First local index and weights of a block of points on faces (0) and centres (1) along each axis.

    They are kept axis by axis, each number of all points in a row; those of the last axis also point by point. One
    array holds them all, so that the compiler knows what lies apart.
    """
    family, normal, tangential = kind
    origin, inv_h, offset, dim = grid  # offset: local index of global entry 0
    for axis in range(dim):
        start, scale = origin[axis], inv_h[axis]
        for b in range(count):
            workspace[INDEX(b)] = (x[first + b, axis] - start) * scale
        for side in range(2):
            points = normal if side == 0 else tangential
            at = INDEX(WEIGHTS + (2 * axis + side) * MOST * BLOCK)
            shift = 0.5 * (points % 2) - 0.5 * side
            for b in range(BLOCK):
                s = workspace[INDEX(b)] + shift
                low = np.floor(s)
                workspace[INDEX(LOWEST + b)] = low
                workspace[INDEX(FRACTION + b)] = s - low
            lowest = offset[axis] - (points - 1) // 2
            for b in range(BLOCK):
                base[INDEX((2 * axis + side) * BLOCK + b)] = np.int64(workspace[INDEX(LOWEST + b)]) + lowest
            if family == BSPLINE:
                bsplines(workspace, at, points)
            elif family == IB4:
                ib4s(workspace, at)
            else:
                others(workspace, at, family, points)
    for side in range(2):
        points = normal if side == 0 else tangential
        at = INDEX(WEIGHTS + (2 * (dim - 1) + side) * MOST * BLOCK)
        for b in range(count):
            line = INDEX(LINES + (side * BLOCK + b) * MOST)
            for k in range(points):
                workspace[line + INDEX(k)] = workspace[at + INDEX(k * BLOCK + b)]


@kernel
def table() -> tuple[Indices, Array]:
    """Return workspace for indices and weights of a block of points; what stands for a missing axis is filled in."""
    base, workspace = np.zeros(7 * BLOCK, dtype=np.int64), np.zeros(SIZE)
    workspace[ONES : ONES + BLOCK] = 1.0
    return base, workspace


@kernel
def stencils(cells: Indices, weights: Array, x: Array, kind: Kind, grid: Geometry) -> None:
    """`weigh` for all points: ``cells`` are ``(n, 2 dim)``, ``weights`` ``(n, 2 dim, MOST)``."""
    base, workspace = table()
    for first in range(0, x.shape[0], BLOCK):
        count = min(BLOCK, x.shape[0] - first)
        weigh(base, workspace, x, first, count, kind, grid)
        for b in range(count):
            for side in range(2 * grid[3]):
                cells[first + b, side] = base[INDEX(side * BLOCK + b)]
                for k in range(MOST):
                    weights[first + b, side, k] = workspace[INDEX(WEIGHTS + (side * MOST + k) * BLOCK + b)]


@kernel
def places(d: int, dim: int) -> tuple[int, int, int, int, int, int]:
    """Where a block's indices and weights for component d are: outer, middle and last axis."""
    outer, middle, last = int(d != 0), 2 + int(d != 1), 4 + int(d != 2)
    if dim == 2:
        outer, middle, last = 6, int(d != 0), 2 + int(d != 1)
    w0 = WEIGHTS + outer * MOST * BLOCK if dim == 3 else ONES
    w1 = WEIGHTS + middle * MOST * BLOCK
    line = LINES + (last % 2) * BLOCK * MOST
    return outer * BLOCK, middle * BLOCK, last * BLOCK, w0, w1, line


@kernel
def spread_block(
    f: Array, base: Indices, workspace: Array, F: Array, part: Part, scale: float, shape: Part, rows: Rows
) -> None:
    """Spread component d of a block of points, f(x) += scale sum_q F_d(q) w0 w1 w2.

    The lengths of ``rows`` are the kernel's along the three axes. The compiler knows them, and makes vectors of sums
    that are written out where nothing else is read or written between.
    """
    first, count, d = part
    flat, strides = f.reshape(f.size), (INDEX(shape[0]), INDEX(shape[1]))
    i0, i1, i2, w0, w1, line = places(d, shape[2])
    n0, n1, n2 = len(rows[0]), len(rows[1]), len(rows[2])
    for b in range(count):
        at = INDEX(base[INDEX(i0 + b)] * shape[0] + base[INDEX(i1 + b)] * shape[1] + base[INDEX(i2 + b)])
        g, k = scale * F[first + b, d], INDEX(line + b * MOST)
        c0, c1 = g * workspace[k], g * workspace[k + INDEX(1)]
        c2 = g * workspace[k + INDEX(2)] if n2 > 2 else 0.0
        c3 = g * workspace[k + INDEX(3)] if n2 > 3 else 0.0
        c4 = g * workspace[k + INDEX(4)] if n2 > 4 else 0.0
        c5 = g * workspace[k + INDEX(5)] if n2 > 5 else 0.0
        for i in range(n0):
            z = workspace[INDEX(w0 + i * BLOCK + b)]
            e0, e1, e2, e3, e4, e5 = z * c0, z * c1, z * c2, z * c3, z * c4, z * c5
            q = at
            for j in range(n1):
                y = workspace[INDEX(w1 + j * BLOCK + b)]
                f0, f1 = flat[q] + y * e0, flat[q + INDEX(1)] + y * e1
                f2 = flat[q + INDEX(2)] + y * e2 if n2 > 2 else 0.0
                f3 = flat[q + INDEX(3)] + y * e3 if n2 > 3 else 0.0
                f4 = flat[q + INDEX(4)] + y * e4 if n2 > 4 else 0.0
                f5 = flat[q + INDEX(5)] + y * e5 if n2 > 5 else 0.0
                flat[q], flat[q + INDEX(1)] = f0, f1
                if n2 > 2:
                    flat[q + INDEX(2)] = f2
                if n2 > 3:
                    flat[q + INDEX(3)] = f3
                if n2 > 4:
                    flat[q + INDEX(4)] = f4
                if n2 > 5:
                    flat[q + INDEX(5)] = f5
                q += strides[1]
            at += strides[0]


@kernel
def interpolate_block(
    U: Array, base: Indices, workspace: Array, u: Array, part: Part, shape: Part, rows: Rows
) -> None:
    """Interpolate component d at a block of points, U_d(q) = sum_x u(x) w0 w1 w2: the transpose of `spread_block`."""
    first, count, d = part
    flat, strides = u.reshape(u.size), (INDEX(shape[0]), INDEX(shape[1]))
    i0, i1, i2, w0, w1, line = places(d, shape[2])
    n0, n1, n2 = len(rows[0]), len(rows[1]), len(rows[2])
    sums = np.empty((BLOCK, 4))
    for b in range(count):
        at = INDEX(base[INDEX(i0 + b)] * shape[0] + base[INDEX(i1 + b)] * shape[1] + base[INDEX(i2 + b)])
        a0, a1, a2, a3, a4, a5 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(n0):
            p0, p1, p2, p3, p4, p5 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            q = at
            for j in range(n1):
                y = workspace[INDEX(w1 + j * BLOCK + b)]
                p0 += y * flat[q]
                p1 += y * flat[q + INDEX(1)]
                p2 += y * flat[q + INDEX(2)] if n2 > 2 else 0.0
                p3 += y * flat[q + INDEX(3)] if n2 > 3 else 0.0
                p4 += y * flat[q + INDEX(4)] if n2 > 4 else 0.0
                p5 += y * flat[q + INDEX(5)] if n2 > 5 else 0.0
                q += strides[1]
            at += strides[0]
            z = workspace[INDEX(w0 + i * BLOCK + b)]
            a0 += z * p0
            a1 += z * p1
            a2 += z * p2
            a3 += z * p3
            a4 += z * p4
            a5 += z * p5
        k = INDEX(line + b * MOST)
        a0 *= workspace[k]
        a1 *= workspace[k + INDEX(1)]
        a2 *= workspace[k + INDEX(2)]
        a3 *= workspace[k + INDEX(3)]
        if n2 > 4:
            a0 += a4 * workspace[k + INDEX(4)]
        if n2 > 5:
            a1 += a5 * workspace[k + INDEX(5)]
        sums[b, 0], sums[b, 1], sums[b, 2], sums[b, 3] = a0, a1, a2, a3
    for b in range(count):
        U[first + b, d] = (sums[b, 0] + sums[b, 1]) + (sums[b, 2] + sums[b, 3])


@kernel
def strides_of(f: Array, dim: int) -> tuple[int, int, int]:
    """Return the distances of neighbours along the outer and the middle axis, and the number of dimensions."""
    if dim == 2:
        return 0, f.shape[1] * f.shape[2], dim
    return f.shape[1] * f.shape[2], f.shape[2], dim


@vectors
@kernel
def spread(f: Faces, x: Array, F: Array, scale: float, kind: Kind, grid: Geometry, rows: Rows) -> None:
    """Spread forces F ``(num_points, dim)`` from points at x, f_d(x) += scale sum_q F_d(q) w0 w1 w2.

    The weights of axis d are those on faces. ``rows`` are as many numbers as the kernel has points along and across
    the component's axis, the outer axis of two dimensions having one.
    """
    normal, across, outer = rows
    base, workspace = table()
    for first in range(0, F.shape[0], BLOCK):
        count = min(BLOCK, F.shape[0] - first)
        weigh(base, workspace, x, first, count, kind, grid)
        for d in range(len(f)):
            part, g = (first, count, d), f[d]
            if d == 0 and len(f) == 3:
                spread_block(g, base, workspace, F, part, scale, strides_of(g, 3), (normal, across, across))
            elif d == len(f) - 1:
                spread_block(
                    g, base, workspace, F, part, scale, strides_of(g, len(f)), (outer, across, normal)
                )
            else:
                spread_block(
                    g, base, workspace, F, part, scale, strides_of(g, len(f)), (outer, normal, across)
                )


@vectors
@kernel
def interpolate(U: Array, x: Array, u: Faces, kind: Kind, grid: Geometry, rows: Rows) -> None:
    """Interpolate a velocity on faces to points at x, U_d(q) = sum_x u_d(x) w0 w1 w2: the transpose of `spread`."""
    normal, across, outer = rows
    base, workspace = table()
    for first in range(0, U.shape[0], BLOCK):
        count = min(BLOCK, U.shape[0] - first)
        weigh(base, workspace, x, first, count, kind, grid)
        for d in range(len(u)):
            part, v = (first, count, d), u[d]
            if d == 0 and len(u) == 3:
                interpolate_block(U, base, workspace, v, part, strides_of(v, 3), (normal, across, across))
            elif d == len(u) - 1:
                interpolate_block(U, base, workspace, v, part, strides_of(v, len(u)), (outer, across, normal))
            else:
                interpolate_block(U, base, workspace, v, part, strides_of(v, len(u)), (outer, normal, across))
