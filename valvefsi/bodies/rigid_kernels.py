"""Loops over the points of rigid surfaces, and over the faces behind them."""

from __future__ import annotations

import numba

from valvefsi.types import Array, Faces, Indices

kernel = numba.njit(cache=True, error_model="numpy")


@kernel
def carry(d: Array, U: Array, d_old: Array, U_old: Array, U_half: Array, dt: float) -> None:
    """Carry points by the velocity at the middle of a step, d = d_old + dt U_half and U = 2 U_half - U_old."""
    for k in range(len(d)):
        for i in range(3):
            d[k, i] = d_old[k, i] + dt * U_half[k, i]
            U[k, i] = 2.0 * U_half[k, i] - U_old[k, i]


@kernel
def spring_forces(
    out: Array, d: Array, U: Array, weights: Array, ahead: float, law: tuple[float, float]
) -> None:
    """Springs and dampers of points carried by d + ahead U, out_k = -w_k (kappa (d_k + ahead U_k) + eta U_k)."""
    kappa, eta = law
    for k in range(len(out)):
        for i in range(3):
            out[k, i] = -weights[k] * (kappa * d[k, i] + (kappa * ahead + eta) * U[k, i])


@kernel
def add_to_faces(f: Faces, F: Array, cells: Indices, volumes: Array) -> None:
    """Spread forces to the lower faces of cells, f_d[c] += F_d / V_d; faces of no volume V are left alone."""
    for k in range(len(cells)):
        for d in range(3):
            if volumes[k, d] > 0.0:
                f[d][cells[k]] += F[k, d] / volumes[k, d]


@kernel
def read_faces(U: Array, u: Faces, cells: Indices, volumes: Array) -> None:
    """Read the lower faces of cells, U_d = u_d[c], 0 on faces of no volume."""
    for k in range(len(cells)):
        for d in range(3):
            U[k, d] = u[d][cells[k]] if volumes[k, d] > 0.0 else 0.0


@kernel
def patch_sums(out: Array, v: Array, turns: Array, labels: Indices, shares: Array) -> None:
    """Sums over patches of turned vectors, out_c += sum_k s_k R_k v_k over the points k of patch c."""
    for k in range(len(labels)):
        c, s = labels[k], shares[k]
        if c >= 0:
            for i in range(3):
                R = turns[k, i]
                out[c, i] += s * (R[0] * v[k, 0] + R[1] * v[k, 1] + R[2] * v[k, 2])


@kernel
def patch_means(out: Array, means: Array, turns: Array, labels: Indices) -> None:
    """Means turned back to the points of their patches, out_k = R_k^T mean_c; points by themselves are left alone."""
    for k in range(len(labels)):
        c, R = labels[k], turns[k]
        if c >= 0:
            for i in range(3):
                out[k, i] = R[0, i] * means[c, 0] + R[1, i] * means[c, 1] + R[2, i] * means[c, 2]


@kernel
def turn(out: Array, v: Array, rows: Indices, at: Indices, turns: Array) -> None:
    """Turn some vectors, out_r = R_k v_a for the k-th row r and place a."""
    for k in range(len(rows)):
        for i in range(3):
            R = turns[k, i]
            out[rows[k], i] = R[0] * v[at[k], 0] + R[1] * v[at[k], 1] + R[2] * v[at[k], 2]


@kernel
def read_amplitudes(out: Array, u: Array, faces: Indices, starts: Indices, weights: Array) -> None:
    """Amplitudes of patches from a component of the velocity, out_c += sum_x a_c(x) u(x) over the faces x of patch c.

    Faces are taken two at a time, each with sums of its own: one would wait for the other.
    """
    for c in range(len(out)):
        a0, a1, a2, b0, b1, b2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        first, last = starts[c], starts[c + 1]
        even = first + 2 * ((last - first) // 2)
        for k in range(first, even, 2):
            u0, u1 = u[faces[k]], u[faces[k + 1]]
            a0 += weights[k, 0] * u0
            a1 += weights[k, 1] * u0
            a2 += weights[k, 2] * u0
            b0 += weights[k + 1, 0] * u1
            b1 += weights[k + 1, 1] * u1
            b2 += weights[k + 1, 2] * u1
        for k in range(even, last):
            a0 += weights[k, 0] * u[faces[k]]
            a1 += weights[k, 1] * u[faces[k]]
            a2 += weights[k, 2] * u[faces[k]]
        out[c, 0] += a0 + b0
        out[c, 1] += a1 + b1
        out[c, 2] += a2 + b2


@kernel
def add_amplitudes(f: Array, G: Array, faces: Indices, starts: Indices, weights: Array) -> None:
    """Spread vectors of patches to a component of a density, f(x) += sum_c a_c(x) . G_c: the transpose."""
    for c in range(len(G)):
        g0, g1, g2 = G[c, 0], G[c, 1], G[c, 2]
        for k in range(starts[c], starts[c + 1]):
            f[faces[k]] += weights[k, 0] * g0 + weights[k, 1] * g1 + weights[k, 2] * g2
