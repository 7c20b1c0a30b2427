"""Loops over solid-shell elements: nodal positions to monomials of the reference cell, and forces back."""

from __future__ import annotations

import numba
import numpy as np

Array = np.ndarray
kernel = numba.njit(cache=True, error_model="numpy")


# x(xi, eta, zeta) = sum_k N_k x_k,  N_k = 1/8 (1 +- xi)(1 +- eta)(1 +- zeta),  node k = i + 2 j + 4 l
# m = (x_100, x_010, x_001, x_110, x_101, x_011, x_111), the coefficients of xi, eta, zeta, xi eta, ...
@kernel
def monomials(out: Array, x: Array, nodes: Array) -> None:
    """Coefficients of the position, ``out (num_cells, 7, 3)``, of ``x (num_nodes, 3)`` at ``nodes (num_cells, 8)``."""
    for c in range(nodes.shape[0]):
        for d in range(3):
            x0, x1 = x[nodes[c, 0], d], x[nodes[c, 1], d]
            x2, x3 = x[nodes[c, 2], d], x[nodes[c, 3], d]
            x4, x5 = x[nodes[c, 4], d], x[nodes[c, 5], d]
            x6, x7 = x[nodes[c, 6], d], x[nodes[c, 7], d]
            a0, a1, a2, a3 = x0 + x1, x2 + x3, x4 + x5, x6 + x7
            b0, b1, b2, b3 = x1 - x0, x3 - x2, x5 - x4, x7 - x6
            out[c, 0, d] = 0.125 * ((b0 + b1) + (b2 + b3))
            out[c, 1, d] = 0.125 * ((a1 - a0) + (a3 - a2))
            out[c, 2, d] = 0.125 * ((a2 + a3) - (a0 + a1))
            out[c, 3, d] = 0.125 * ((b1 - b0) + (b3 - b2))
            out[c, 4, d] = 0.125 * ((b2 + b3) - (b0 + b1))
            out[c, 5, d] = 0.125 * ((a3 - a2) - (a1 - a0))
            out[c, 6, d] = 0.125 * ((b3 - b2) - (b1 - b0))


@kernel
def add_monomials(out: Array, r: Array, nodes: Array) -> None:
    """The transpose of `monomials`: adds to ``out (num_nodes, 3)`` what ``r (num_cells, 7, 3)`` is to its nodes."""
    for c in range(nodes.shape[0]):
        for d in range(3):
            r1, r2, r3 = 0.125 * r[c, 0, d], 0.125 * r[c, 1, d], 0.125 * r[c, 2, d]
            r12, r13, r23 = 0.125 * r[c, 3, d], 0.125 * r[c, 4, d], 0.125 * r[c, 5, d]
            r123 = 0.125 * r[c, 6, d]
            for m in range(2):
                s = 2.0 * m - 1.0
                a, b = r1 + s * r13, r12 + s * r123
                e = r2 + s * r23
                low, high, here = a - b, a + b, s * r3
                out[nodes[c, 4 * m], d] += here - low - e
                out[nodes[c, 4 * m + 1], d] += here + low - e
                out[nodes[c, 4 * m + 2], d] += here - high + e
                out[nodes[c, 4 * m + 3], d] += here + high + e
