"""Stencils on graded grids: loops over local entries with one number per entry along each axis.

Arrays are local with ghosts; ``box`` holds the first and the last-but-one-more index along each axis, and ``c - e``
is the neighbour below along axis e.
"""

from __future__ import annotations

import numba

from valvefsi.types import Array, Faces, Indices

kernel = numba.njit(cache=True, fastmath={"contract", "nsz"}, error_model="numpy")


@kernel
def laplacian(out: Array, q: Array, rates: Faces, factor: float, box: Indices) -> None:
    """Second differences, out += factor sum_e [up_e (q[c+e] - q[c]) - down_e (q[c] - q[c-e])]."""
    up0, down0, up1, down1, up2, down2 = rates
    flat = q.shape[2] == 1
    for i in range(box[0, 0], box[0, 1]):
        for j in range(box[1, 0], box[1, 1]):
            for k in range(box[2, 0], box[2, 1]):
                here = q[i, j, k]
                value = up0[i] * (q[i + 1, j, k] - here) - down0[i] * (here - q[i - 1, j, k])
                value += up1[j] * (q[i, j + 1, k] - here) - down1[j] * (here - q[i, j - 1, k])
                if not flat:
                    value += up2[k] * (q[i, j, k + 1] - here) - down2[k] * (here - q[i, j, k - 1])
                out[i, j, k] += factor * value


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
                if d == 0:
                    gradient = (p[i, j, k] - p[i - 1, j, k]) * inverse_gap[i]
                elif d == 1:
                    gradient = (p[i, j, k] - p[i, j - 1, k]) * inverse_gap[j]
                else:
                    gradient = (p[i, j, k] - p[i, j, k - 1]) * inverse_gap[k]
                out[i, j, k] = f[i, j, k] - gradient - a * N[i, j, k] - b * N_old[i, j, k]


@kernel
def divergence(out: Array, u: Faces, inverse: Faces, box: Indices) -> None:
    """Divergence in cells, out = sum_d (u_d[c+d] - u_d[c]) / w_d."""
    w0, w1, w2 = inverse
    for i in range(box[0, 0], box[0, 1]):
        for j in range(box[1, 0], box[1, 1]):
            for k in range(box[2, 0], box[2, 1]):
                value = w0[i] * (u[0][i + 1, j, k] - u[0][i, j, k]) + w1[j] * (
                    u[1][i, j + 1, k] - u[1][i, j, k]
                )
                if len(u) == 3:
                    value += w2[k] * (u[2][i, j, k + 1] - u[2][i, j, k])
                out[i, j, k] = value


@kernel
def subtract_gradient(out: Array, phi: Array, factors: Array, d: int, box: Indices) -> None:
    """Projection of one component, out -= factor_d (phi[c] - phi[c-d]), one factor per entry along axis d."""
    for i in range(box[0, 0], box[0, 1]):
        for j in range(box[1, 0], box[1, 1]):
            for k in range(box[2, 0], box[2, 1]):
                if d == 0:
                    out[i, j, k] -= factors[i] * (phi[i, j, k] - phi[i - 1, j, k])
                elif d == 1:
                    out[i, j, k] -= factors[j] * (phi[i, j, k] - phi[i, j - 1, k])
                else:
                    out[i, j, k] -= factors[k] * (phi[i, j, k] - phi[i, j, k - 1])


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
