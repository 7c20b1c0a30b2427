"""Loops over the elements of a solid and the points in them: values from nodes to points and back."""

from __future__ import annotations

import math

import numba
import numpy as np

from valvefsi.runtime.compiled import vectors
from valvefsi.types import Array

kernel = numba.njit(cache=True, fastmath={"contract", "nsz"}, error_model="numpy")


@vectors
@kernel
def at_points(out: Array, values: Array, nodes: Array, phi: Array, weights: Array) -> None:
    """Values at the points of each element, out(c, q) = w(c, q) sum_k phi(q, k) values(node(c, k)).

    ``out`` is ``(num_cells, num_points, 3)``; weights without columns count as 1. A fourth column makes a row a
    vector of the processor.
    """
    weighted = weights.shape[1] > 0
    local, sums = np.zeros((nodes.shape[1], 4)), np.empty((phi.shape[0], 4))
    for c in range(nodes.shape[0]):
        for k in range(nodes.shape[1]):
            for d in range(3):
                local[k, d] = values[np.uint32(nodes[c, k]), d]
        for q in range(phi.shape[0]):
            x, y, z, t = 0.0, 0.0, 0.0, 0.0
            for k in range(phi.shape[1]):
                x += phi[q, k] * local[k, 0]
                y += phi[q, k] * local[k, 1]
                z += phi[q, k] * local[k, 2]
                t += phi[q, k] * local[k, 3]
            w = weights[c, q] if weighted else 1.0
            sums[q, 0], sums[q, 1], sums[q, 2], sums[q, 3] = w * x, w * y, w * z, w * t
        for q in range(phi.shape[0]):
            for d in range(3):
                out[c, q, d] = sums[q, d]


@vectors
@kernel
def add_to_nodes(sums: Array, values: Array, nodes: Array, phi: Array, weights: Array) -> None:
    """The transpose of `at_points`, sums(node(c, k)) += sum_q phi(q, k) w(c, q) values(c, q)."""
    part, local = np.zeros((phi.shape[0], 4)), np.empty((nodes.shape[1], 4))
    for c in range(nodes.shape[0]):
        for q in range(phi.shape[0]):
            for d in range(3):
                part[q, d] = weights[c, q] * values[c, q, d]
        for k in range(phi.shape[1]):
            x, y, z, t = 0.0, 0.0, 0.0, 0.0
            for q in range(phi.shape[0]):
                x += phi[q, k] * part[q, 0]
                y += phi[q, k] * part[q, 1]
                z += phi[q, k] * part[q, 2]
                t += phi[q, k] * part[q, 3]
            local[k, 0], local[k, 1], local[k, 2], local[k, 3] = x, y, z, t
        for k in range(nodes.shape[1]):
            for d in range(3):
                sums[np.uint32(nodes[c, k]), d] += local[k, d]


@kernel
def square_lengths(out: Array, x: Array, edges: Array) -> None:
    """Squared length of each edge between two nodes, infinite where one is not finite."""
    for e in range(len(out)):
        a, b = np.uint32(edges[e, 0]), np.uint32(edges[e, 1])
        square = (x[a, 0] - x[b, 0]) ** 2 + (x[a, 1] - x[b, 1]) ** 2 + (x[a, 2] - x[b, 2]) ** 2
        out[e] = square if square < math.inf else math.inf


@kernel
def count_points(counts: Array, squares: Array, edges: Array, limits: Array) -> None:
    """How many entries of ``limits`` the longest edge of each element along each direction exceeds.

    ``edges`` is ``(num_cells, num_directions, k)`` into the squared lengths, and so are the limits squares.
    """
    for c in range(edges.shape[0]):
        for d in range(edges.shape[1]):
            square = 0.0
            for k in range(edges.shape[2]):
                one = squares[np.uint32(edges[c, d, k])]
                square = one if one > square else square
            n = 0
            while n < len(limits) and square > limits[n]:
                n += 1
            counts[c, d] = n
