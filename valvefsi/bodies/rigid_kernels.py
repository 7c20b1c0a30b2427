"""Loops over the points of rigid surfaces, and over the faces behind them."""

from __future__ import annotations

import numba

from valvefsi.types import Array, Faces, Indices

kernel = numba.njit(cache=True, error_model="numpy")


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
def patch_means(out: Array, v: Array, means: Array, turns: Array, labels: Indices) -> None:
    """Means turned back to the points of their patches, out_k = R_k^T mean_c; points by themselves keep v_k."""
    for k in range(len(labels)):
        c, R = labels[k], turns[k]
        for i in range(3):
            if c >= 0:
                out[k, i] = R[0, i] * means[c, 0] + R[1, i] * means[c, 1] + R[2, i] * means[c, 2]
            else:
                out[k, i] = v[k, i]
