"""Stencils on graded grids: loops over local entries with one number per entry along each axis.

Arrays are local with ghosts; ``box`` holds the first and the last-but-one-more index along each axis, and ``c - e``
is the neighbour below along axis e.
"""

from __future__ import annotations

import numba
import numpy as np

from valvefsi.types import Array, Faces, Indices

Weights = tuple[float, float, float]
"""Time over density and those of the advection terms, k, a, b."""

kernel = numba.njit(cache=True, fastmath={"contract", "nsz"}, error_model="numpy")
INDEX = np.uint64
"""Of a place that is not negative: no code for counting from the end, which keeps loops from becoming vectors."""


@kernel
def laplacian(out: Array, q: Array, rates: Faces, factor: float, box: Indices) -> None:
    """Second differences, out += factor sum_e [up_e (q[c+e] - q[c]) - down_e (q[c] - q[c-e])]."""
    up0, down0, up1, down1, up2, down2 = rates
    flat = q.shape[2] == 1
    for i in range(box[0, 0], box[0, 1]):
        for j in range(box[1, 0], box[1, 1]):
            for k in range(box[2, 0], box[2, 1]):
                x, y, z = INDEX(i), INDEX(j), INDEX(k)
                here = q[x, y, z]
                value = up0[x] * (q[INDEX(i + 1), y, z] - here) - down0[x] * (here - q[INDEX(i - 1), y, z])
                value += up1[y] * (q[x, INDEX(j + 1), z] - here) - down1[y] * (here - q[x, INDEX(j - 1), z])
                if not flat:
                    value += up2[z] * (q[x, y, INDEX(k + 1)] - here) - down2[z] * (
                        here - q[x, y, INDEX(k - 1)]
                    )
                out[x, y, z] += factor * value


@kernel
def difference(p: Array, i: int, j: int, k: int, d: int) -> float:
    """Difference of an entry and the one below it along axis d."""
    x, y, z = INDEX(i), INDEX(j), INDEX(k)
    if d == 0:
        return p[x, y, z] - p[INDEX(i - 1), y, z]
    if d == 1:
        return p[x, y, z] - p[x, INDEX(j - 1), z]
    return p[x, y, z] - p[x, y, INDEX(k - 1)]


@kernel
def advance(
    out: Array, q: Array, p: Array, terms: Faces, weights: Weights, d: int, inverse_gap: Array, box: Indices
) -> None:
    """Velocity before the projection: out = q + k (f - (p[c] - p[c-d]) / g_d) - a N - b N_old."""
    N, N_old, f = terms
    share, a, b = weights
    for i in range(box[0, 0], box[0, 1]):
        for j in range(box[1, 0], box[1, 1]):
            for k in range(box[2, 0], box[2, 1]):
                x, y, z = INDEX(i), INDEX(j), INDEX(k)
                g = inverse_gap[x if d == 0 else (y if d == 1 else z)]
                push = f[x, y, z] - difference(p, i, j, k, d) * g
                out[x, y, z] = q[x, y, z] + share * push - a * N[x, y, z] - b * N_old[x, y, z]


@kernel
def right_hand_side(
    out: Array, p: Array, terms: Faces, weights: tuple[float, float, int], inverse_gap: Array, box: Indices
) -> None:
    """Pressure gradient, advection and force of component d: out = f - (p[c] - p[c-d]) / g_d - a N - b N_old."""
    N, N_old, f = terms
    a, b, d = weights
    for i in range(box[0, 0], box[0, 1]):
        for j in range(box[1, 0], box[1, 1]):
            for k in range(box[2, 0], box[2, 1]):
                x, y, z = INDEX(i), INDEX(j), INDEX(k)
                gradient = difference(p, i, j, k, d) * inverse_gap[x if d == 0 else (y if d == 1 else z)]
                out[x, y, z] = f[x, y, z] - gradient - a * N[x, y, z] - b * N_old[x, y, z]


@kernel
def divergence(out: Array, u: Faces, inverse: Faces, box: Indices) -> None:
    """Divergence in cells, out = sum_d (u_d[c+d] - u_d[c]) / w_d."""
    w0, w1, w2 = inverse
    for i in range(box[0, 0], box[0, 1]):
        for j in range(box[1, 0], box[1, 1]):
            for k in range(box[2, 0], box[2, 1]):
                x, y, z = INDEX(i), INDEX(j), INDEX(k)
                value = w0[x] * (u[0][INDEX(i + 1), y, z] - u[0][x, y, z])
                value += w1[y] * (u[1][x, INDEX(j + 1), z] - u[1][x, y, z])
                if len(u) == 3:
                    value += w2[z] * (u[2][x, y, INDEX(k + 1)] - u[2][x, y, z])
                out[x, y, z] = value


@kernel
def subtract_gradient(out: Array, phi: Array, factors: Array, d: int, box: Indices) -> None:
    """Projection of one component, out -= factor_d (phi[c] - phi[c-d]), one factor per entry along axis d."""
    for i in range(box[0, 0], box[0, 1]):
        for j in range(box[1, 0], box[1, 1]):
            for k in range(box[2, 0], box[2, 1]):
                x, y, z = INDEX(i), INDEX(j), INDEX(k)
                factor = factors[x if d == 0 else (y if d == 1 else z)]
                out[x, y, z] -= factor * difference(phi, i, j, k, d)


@kernel
def transports(out: Array, u: Array, first: Array, second: Array, third: Array) -> None:
    """Flow through the faces of a component, out = u w_a w_b; the factor along its own axis is 1."""
    for i in range(u.shape[0]):
        for j in range(u.shape[1]):
            k1 = first[i] * second[j]
            for k in range(u.shape[2]):
                out[i, j, k] = k1 * third[k] * u[i, j, k]


@kernel
def divide_by_volume(out: Array, first: Array, second: Array, third: Array, box: Indices) -> None:
    """Divide by control volumes, out /= first second third."""
    for i in range(box[0, 0], box[0, 1]):
        for j in range(box[1, 0], box[1, 1]):
            k1 = 1.0 / (first[i] * second[j])
            for k in range(box[2, 0], box[2, 1]):
                out[i, j, k] *= k1 / third[k]
