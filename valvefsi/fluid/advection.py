"""The advection term N = div(u u) on the faces of a staggered grid.

Centred second-order differences in conservative form (Harlow and Welch 1965): with a discretely solenoidal
transporting velocity they keep momentum and kinetic energy.
"""

from __future__ import annotations

import numba
import numpy as np

Array = np.ndarray
kernel = numba.njit(cache=True, fastmath={"contract", "nsz"}, boundscheck=False)


@kernel
def centred(out: Array, u: tuple, d: int, inv_h: tuple, strides: tuple, bounds: tuple) -> None:
    """Advection of component d, averaging both factors to the edges (e != d) or centres (e = d) of its faces.

    out = sum_e (v+ q+ - v- q-) / h_e,
    v+ = (u_e[c+e] + u_e[c+e-d]) / 2,  q+ = (u_d[c] + u_d[c+e]) / 2,  and the same one e lower for the minus side
    """
    first, last = bounds
    n = last - first
    sd = strides[d]
    q = u[d]
    o, q0 = out[first:last], q[first:last]
    for e in range(len(strides)):
        se = strides[e]
        v = u[e]
        v00, v0m = v[first:last], v[first - sd : last - sd]
        vp0, vpm = v[first + se : last + se], v[first + se - sd : last + se - sd]
        qp, qm = q[first + se : last + se], q[first - se : last - se]
        k = 0.25 * inv_h[e]
        if e == 0:
            for c in range(n):
                o[c] = k * ((vp0[c] + vpm[c]) * (q0[c] + qp[c]) - (v00[c] + v0m[c]) * (qm[c] + q0[c]))
        else:
            for c in range(n):
                o[c] += k * ((vp0[c] + vpm[c]) * (q0[c] + qp[c]) - (v00[c] + v0m[c]) * (qm[c] + q0[c]))
