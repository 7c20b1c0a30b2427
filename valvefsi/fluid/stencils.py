"""Stencils of the staggered grid as flat loops over cells, compiled by numba.

A field is the flat view of a local array with ghosts, and a neighbour along axis e is ``stride[e]`` entries away, so
that one formula serves every axis and both dimensions, and the loop over all entries from ``first`` to
``last`` is contiguous. Ghost entries between are computed too and hold no meaning afterwards. Every kernel writes
``out`` only.

`momentum` goes over blocks, about a fifth faster at 128^3 cells; for the divergence that did not pay.
"""

from __future__ import annotations

import numba

from valvefsi.types import Array, Faces, Indices

BLOCK = 4096
"""Entries that are worked on in several passes before the next ones: what is written stays in the first cache."""

MAGNITUDE = (1 << 63) - 1
"""All bits of a float64 but its sign."""

Weights = tuple[float, float, float, tuple[float, ...]]
"""a, b, 1 / h_d, and mu / h_e^2 of every axis."""

Bounds = tuple[int, int, int, tuple[int, ...]]
"""First entry, one more than the last, stride along axis d, and those of every axis."""

kernel = numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz"}, error_model="numpy")


@kernel
def momentum(out: Array, q: Array, p: Array, terms: Faces, weights: Weights, bounds: Bounds) -> None:
    """Right-hand side of the momentum equation of one component, on its faces.

    out = f - (p[c] - p[c-d]) / h_d - a N - b N_old + mu sum_e (q[c+e] - 2 q[c] + q[c-e]) / h_e^2
    """
    N, N_old, f = terms
    a, b, inv_h, nu = weights  # nu[e] = mu / h_e^2
    first, last, sd, strides = bounds
    for start in range(first, last, BLOCK):
        stop = min(start + BLOCK, last)
        n = stop - start
        o, f_, N_, M_ = out[start:stop], f[start:stop], N[start:stop], N_old[start:stop]
        p0, pm, q0 = p[start:stop], p[start - sd : stop - sd], q[start:stop]
        for c in range(n):
            o[c] = f_[c] - (p0[c] - pm[c]) * inv_h - a * N_[c] - b * M_[c]
        for e in range(len(strides)):
            qp, qm = q[start + strides[e] : stop + strides[e]], q[start - strides[e] : stop - strides[e]]
            k = nu[e]
            for c in range(n):
                o[c] += k * ((qp[c] - q0[c]) - (q0[c] - qm[c]))


@kernel
def divergence(
    out: Array, u: Faces, inv_h: tuple[float, ...], strides: tuple[int, ...], bounds: tuple[int, int]
) -> None:
    """Divergence in cells: out = sum_d (u_d[c+d] - u_d[c]) / h_d."""
    first, last = bounds
    n = last - first
    o = out[first:last]
    for d in range(len(strides)):
        up, u0 = u[d][first + strides[d] : last + strides[d]], u[d][first:last]
        k = inv_h[d]
        if d == 0:
            for c in range(n):
                o[c] = k * (up[c] - u0[c])
        else:
            for c in range(n):
                o[c] += k * (up[c] - u0[c])


@kernel
def subtract_gradient(out: Array, phi: Array, factor: float, bounds: tuple[int, int, int]) -> None:
    """Projection of one component: out -= factor (phi[c] - phi[c-d])."""
    first, last, sd = bounds
    o, a, b = out[first:last], phi[first:last], phi[first - sd : last - sd]
    for c in range(last - first):
        o[c] -= factor * (a[c] - b[c])


@kernel
def add_pressure(out: Array, phi: Array, p: Array, x: Array, div: Array, mu: float) -> None:
    """New pressure out = p + x - mu/2 div and the correction phi = x; x holds inner entries alone, and so do views."""
    half = 0.5 * mu
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            for k in range(x.shape[2]):
                value = x[i, j, k]
                phi[i, j, k] = value
                out[i, j, k] = p[i, j, k] + value - half * div[i, j, k]


@kernel
def largest_bits(q: Indices) -> int:
    """Largest bits of the numbers without their sign: those of the largest magnitude, below NaN and infinity."""
    most = 0
    for i in range(q.shape[0]):
        for j in range(q.shape[1]):
            for k in range(q.shape[2]):
                bits = q[i, j, k] & MAGNITUDE
                most = bits if bits > most else most
    return most


@kernel
def divide(x: Array, eigenvalues: Faces, a: float, b: float) -> None:
    """Divide by the eigenvalues of a tensor-product operator: x /= a - b (l0 + l1 + l2); a zero there gives zero."""
    l0, l1, l2 = eigenvalues
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            shift = a - b * (l0[i] + l1[j])
            for k in range(x.shape[2]):
                d = shift - b * l2[k]
                x[i, j, k] = x[i, j, k] / d if d != 0.0 else 0.0
