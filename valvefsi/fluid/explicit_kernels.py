"""Kernels of the step with explicit viscosity, in the form of `valvefsi.fluid.stencils`."""

from __future__ import annotations

import numba

from valvefsi.types import Array, Faces

BLOCK = 4096
"""Entries that are worked on in several passes before the next ones, as in `valvefsi.fluid.stencils`."""

kernel = numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz"}, error_model="numpy")


@kernel
def subtract_laplacian(
    out: Array, q: Array, nu: tuple[float, ...], bounds: tuple[int, int, tuple[int, ...]]
) -> None:
    """Viscous part of the explicit terms: out -= sum_e nu_e (q[c+e] - 2 q[c] + q[c-e]), nu_e = nu / h_e^2."""
    first, last, strides = bounds
    for start in range(first, last, BLOCK):
        stop = min(start + BLOCK, last)
        o, q0 = out[start:stop], q[start:stop]
        for e in range(len(strides)):
            qp, qm = q[start + strides[e] : stop + strides[e]], q[start - strides[e] : stop - strides[e]]
            k = nu[e]
            for c in range(stop - start):
                o[c] -= k * ((qp[c] - q0[c]) - (q0[c] - qm[c]))


@kernel
def advance(
    out: Array, q: Array, p: Array, terms: Faces, weights: tuple[float, ...], bounds: tuple[int, int, int]
) -> None:
    """Velocity before the projection: out = q + k (f - (p[c] - p[c-d]) / h_d) - a N - b N_old."""
    N, N_old, f = terms
    k, a, b, inv_h = weights
    first, last, sd = bounds
    o, q0, f_ = out[first:last], q[first:last], f[first:last]
    N_, M_, p0, pm = N[first:last], N_old[first:last], p[first:last], p[first - sd : last - sd]
    for c in range(last - first):
        o[c] = q0[c] + k * (f_[c] - (p0[c] - pm[c]) * inv_h) - a * N_[c] - b * M_[c]
