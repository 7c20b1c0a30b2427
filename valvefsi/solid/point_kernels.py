"""Loops over the elements of a solid and the points in them: values from nodes to points and back."""

from __future__ import annotations

import math

import numba
import numpy as np

Array = np.ndarray
kernel = numba.njit(cache=True, fastmath={"contract", "nsz"}, error_model="numpy")


@kernel
def at_points(out: Array, values: Array, nodes: Array, phi: Array, weights: Array) -> None:
    """Values at the points of each element, out(c, q) = w(c, q) sum_k phi(q, k) values(node(c, k)).

    ``out`` is ``(num_cells, num_points, 3)``; weights without columns count as 1.
    """
    weighted = weights.shape[1] > 0
    local = np.empty((nodes.shape[1], 3))
    for c in range(nodes.shape[0]):
        for k in range(nodes.shape[1]):
            for d in range(3):
                local[k, d] = values[np.uint32(nodes[c, k]), d]
        for q in range(phi.shape[0]):
            x, y, z = 0.0, 0.0, 0.0
            for k in range(phi.shape[1]):
                x += phi[q, k] * local[k, 0]
                y += phi[q, k] * local[k, 1]
                z += phi[q, k] * local[k, 2]
            w = weights[c, q] if weighted else 1.0
            out[c, q, 0], out[c, q, 1], out[c, q, 2] = w * x, w * y, w * z


@kernel
def add_to_nodes(sums: Array, values: Array, nodes: Array, phi: Array, weights: Array) -> None:
    """The transpose of `at_points`, sums(node(c, k)) += sum_q phi(q, k) w(c, q) values(c, q)."""
    local = np.empty((nodes.shape[1], 3))
    for c in range(nodes.shape[0]):
        local[:] = 0.0
        for q in range(phi.shape[0]):
            w = weights[c, q]
            x, y, z = w * values[c, q, 0], w * values[c, q, 1], w * values[c, q, 2]
            for k in range(phi.shape[1]):
                local[k, 0] += phi[q, k] * x
                local[k, 1] += phi[q, k] * y
                local[k, 2] += phi[q, k] * z
        for k in range(nodes.shape[1]):
            for d in range(3):
                sums[np.uint32(nodes[c, k]), d] += local[k, d]


@kernel
def longest_edges(out: Array, x: Array, nodes: Array, edges: Array) -> None:
    """Length of the longest edge of each element between its corners, NaN where a corner is not finite."""
    for c in range(nodes.shape[0]):
        square = 0.0
        for e in range(edges.shape[0]):
            a, b = np.uint32(nodes[c, edges[e, 0]]), np.uint32(nodes[c, edges[e, 1]])
            one = (x[a, 0] - x[b, 0]) ** 2 + (x[a, 1] - x[b, 1]) ** 2 + (x[a, 2] - x[b, 2]) ** 2
            square = one if not one <= square else square
        out[c] = math.sqrt(square)
