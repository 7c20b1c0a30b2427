"""Elastic forces of linear tetrahedra of the modified HGO material, cell by cell: the yardstick of the assembled form.

The solid computes its forces by the weak form (`elasticity`), whatever the element and the material.
This loop does the same sum for the one law and element that leaflets mostly have, as one would write it by hand;
`bench speed` times one against the other and the tests compare their results.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from valvefsi.types import Array


# F = sum_k chi_k (x) g_k,   f_k -= V P g_k,   H = F^-T, L = J^(-2/3),
# P = 2 L W_1 (F - I1/3 H) + sum_f 2 L W_4f (F a_f (x) a_f - I4_f/3 H) + kappa_stab ln J H
@numba.njit(cache=True, fastmath={"contract", "nsz"}, error_model="numpy")
def hgo_tetrahedra(
    chi: Array,
    cells: Array,
    gradients: Array,
    volumes: Array,
    matrix: Array,
    families: Array,
    fibres: Array,
    out: Array,
) -> None:
    """Add the forces of all cells to ``out (num_nodes, 3)``.

    ``matrix`` is (c10, c01, kappa_stab), ``families (m, 3)`` k1, k2 and kappa, ``fibres (m, num_cells, 3)``,
    ``gradients (num_cells, 4, 3)`` those of the shape functions.
    """
    F, H, P = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    c10, c01, bulk = matrix[0], matrix[1], matrix[2]
    for c in range(cells.shape[0]):
        I1 = 0.0
        for i in range(3):
            for j in range(3):
                s = 0.0
                for k in range(4):
                    s += chi[cells[c, k], i] * gradients[c, k, j]
                F[i, j] = s
                I1 += s * s
        for i in range(3):
            a, b = (i + 1) % 3, (i + 2) % 3
            for j in range(3):
                d, e = (j + 1) % 3, (j + 2) % 3
                H[i, j] = F[a, d] * F[b, e] - F[a, e] * F[b, d]
        J = F[0, 0] * H[0, 0] + F[0, 1] * H[0, 1] + F[0, 2] * H[0, 2]
        log_J = math.log(J) if J > 0.0 else np.nan
        L = math.exp(-2.0 / 3.0 * log_J)
        excess = L * I1 - 3.0
        W1 = c10 * c01 * math.exp(c01 * excess)
        spherical = 0.0
        P[:] = 0.0
        for m in range(families.shape[0]):
            k1, k2, kappa = families[m, 0], families[m, 1], families[m, 2]
            a0, a1, a2 = fibres[m, c, 0], fibres[m, c, 1], fibres[m, c, 2]
            b0 = F[0, 0] * a0 + F[0, 1] * a1 + F[0, 2] * a2
            b1 = F[1, 0] * a0 + F[1, 1] * a1 + F[1, 2] * a2
            b2 = F[2, 0] * a0 + F[2, 1] * a1 + F[2, 2] * a2
            I4 = b0 * b0 + b1 * b1 + b2 * b2
            E = kappa * excess + (1.0 - 3.0 * kappa) * (max(L * I4, 1.0) - 1.0)
            slope = k1 * E * math.exp(k2 * E * E)
            W1 += kappa * slope
            if L * I4 > 1.0:
                W4 = 2.0 * L * (1.0 - 3.0 * kappa) * slope
                spherical += W4 * I4 / 3.0
                P[0, 0] += W4 * b0 * a0
                P[0, 1] += W4 * b0 * a1
                P[0, 2] += W4 * b0 * a2
                P[1, 0] += W4 * b1 * a0
                P[1, 1] += W4 * b1 * a1
                P[1, 2] += W4 * b1 * a2
                P[2, 0] += W4 * b2 * a0
                P[2, 1] += W4 * b2 * a1
                P[2, 2] += W4 * b2 * a2
        scale = 2.0 * L * W1
        spherical = (bulk * log_J - spherical - scale * I1 / 3.0) / J
        for i in range(3):
            for j in range(3):
                P[i, j] += scale * F[i, j] + spherical * H[i, j]
        for k in range(4):
            node = cells[c, k]
            for i in range(3):
                g = gradients[c, k]
                out[node, i] -= volumes[c] * (P[i, 0] * g[0] + P[i, 1] * g[1] + P[i, 2] * g[2])


def tetrahedra(points: Array) -> tuple[Array, Array]:
    """Return gradients of the shape functions ``(n, 4, 3)`` [1/cm] and volumes ``(n,)`` of ``points (n, 4, 3)``."""
    edges = points[:, 1:] - points[:, :1]
    inverse = np.linalg.inv(edges)
    gradients = np.empty((len(points), 4, 3))
    gradients[:, 1:] = inverse.transpose(0, 2, 1)
    gradients[:, 0] = -gradients[:, 1:].sum(axis=1)
    return gradients, np.abs(np.linalg.det(edges)) / 6
