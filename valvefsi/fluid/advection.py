"""The advection term N = div(u u) on the faces of a staggered grid.

`centred`: second-order differences in conservative form (Harlow and Welch 1965); with a discretely solenoidal
transporting velocity they keep momentum and kinetic energy.

`xsppm7`: the same fluxes with the transported factor reconstructed upwind to the faces of the control volume by the
xsPPM7 scheme (Rider, Greenough and Kamm 2007; on the staggered grid after Griffith 2009): a seventh-order value where
that is monotone, elsewhere the median of it, the monotone value of the piecewise parabolic method and the
fifth-order WENO value, which keeps smooth extrema and lets layers overshoot hardly at all. With the Adams-Bashforth
steps it wants the sum of the Courant numbers of all axes below about 0.3; at 0.8 it blows up.
"""

from __future__ import annotations

import numba
import numpy as np

Array = np.ndarray
BLOCK = 4096
"""Entries in a block of the upwind fluxes (three scratch arrays of it fit the first two caches)."""

kernel = numba.njit(cache=True, fastmath={"contract", "nsz"}, error_model="numpy")


@kernel
def centred(out: Array, q: Array, u: tuple, d: int, inv_h: tuple, strides: tuple, bounds: tuple) -> None:
    """Advection of q, on the faces of component d, by u.

    Both factors are averaged to the edges (e != d) or centres (e = d) of the faces,

    out = sum_e (v+ q+ - v- q-) / h_e,
    v+ = (u_e[c+e] + u_e[c+e-d]) / 2,  q+ = (q[c] + q[c+e]) / 2,  and the same one e lower for the minus side
    """
    first, last = bounds
    n = last - first
    sd = strides[d]
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


@kernel
def median(a: float, b: float, c: float) -> float:
    """Return the middle one of three numbers."""
    return max(min(a, b), min(max(a, b), c))


@kernel
def weno5(a: float, b: float, c: float, d: float, e: float) -> float:
    """Return the fifth-order WENO value at the upper edge of cell c (Jiang and Shu 1996)."""
    s0 = 13.0 / 12.0 * (a - 2.0 * b + c) ** 2 + 0.25 * (a - 4.0 * b + 3.0 * c) ** 2
    s1 = 13.0 / 12.0 * (b - 2.0 * c + d) ** 2 + 0.25 * (b - d) ** 2
    s2 = 13.0 / 12.0 * (c - 2.0 * d + e) ** 2 + 0.25 * (3.0 * c - 4.0 * d + e) ** 2
    tiny = 1e-6 * (a * a + b * b + c * c + d * d + e * e) + 1e-60
    w0, w1, w2 = 0.1 / (s0 + tiny) ** 2, 0.6 / (s1 + tiny) ** 2, 0.3 / (s2 + tiny) ** 2
    p0 = (2.0 * a - 7.0 * b + 11.0 * c) / 6.0
    p1 = (-b + 5.0 * c + 2.0 * d) / 6.0
    p2 = (2.0 * c + 5.0 * d - e) / 6.0
    return (w0 * p0 + w1 * p1 + w2 * p2) / (w0 + w1 + w2)


@kernel
def edge(a: float, b: float, c: float, d: float, e: float, f: float, g: float) -> float:
    """Return the xsPPM7 value at the upper edge of cell d of seven cells a to g."""
    upper = (-3.0 * a + 25.0 * b - 101.0 * c + 319.0 * d + 214.0 * e - 38.0 * f + 4.0 * g) / 420.0
    lower = (-3.0 * g + 25.0 * f - 101.0 * e + 319.0 * d + 214.0 * c - 38.0 * b + 4.0 * a) / 420.0
    monotone = median(d, median(d, upper, e), 3.0 * d - 2.0 * median(d, lower, c))
    if monotone == upper:
        return upper
    return median(monotone, weno5(b, c, d, e, f), upper)


@kernel
def upwind_fluxes(flux: Array, margin: Array, speed: Array, q: Array, first: int, s: int) -> None:
    """Fluxes v q with the seventh-order edge value from the side that v comes from; it is monotone where margin >= 0.

    Faces lie between entries c - s and c; branches are selections, so that the loop is compiled to vectors.
    """
    n = len(flux)
    qa, qb, qc, qd = (
        q[first - 4 * s : first - 4 * s + n],
        q[first - 3 * s : first - 3 * s + n],
        q[first - 2 * s : first - 2 * s + n],
        q[first - s : first - s + n],
    )
    qe, qf, qg, qh = (
        q[first : first + n],
        q[first + s : first + s + n],
        q[first + 2 * s : first + 2 * s + n],
        q[first + 3 * s : first + 3 * s + n],
    )
    for c in range(n):
        up = speed[c] > 0.0
        c0, c1, c2 = (qa[c] if up else qh[c]), (qb[c] if up else qg[c]), (qc[c] if up else qf[c])
        c3, c4 = (qd[c] if up else qe[c]), (qe[c] if up else qd[c])
        c5, c6 = (qf[c] if up else qc[c]), (qg[c] if up else qb[c])
        upper = (-3.0 * c0 + 25.0 * c1 - 101.0 * c2 + 319.0 * c3 + 214.0 * c4 - 38.0 * c5 + 4.0 * c6) / 420.0
        lower = (-3.0 * c6 + 25.0 * c5 - 101.0 * c4 + 319.0 * c3 + 214.0 * c2 - 38.0 * c1 + 4.0 * c0) / 420.0
        # Not limited where upper and lower lie between the neighbours and the parabola through them is monotone.
        a, b = upper - c3, c3 - lower
        r0, r1, r2 = a * (c4 - upper), b * (lower - c2), a * (2.0 * b - a)
        least = r0 if r0 < r1 else r1
        margin[c] = r2 if r2 < least else least
        flux[c] = speed[c] * upper


@kernel
def limit(flux: Array, margin: Array, speed: Array, q: Array, first: int, s: int) -> None:
    """Replace the fluxes whose edge value is not monotone by those of the limited one."""
    for c in range(len(flux)):
        if margin[c] < 0.0:
            up = speed[c] > 0.0
            m, t = (first + c - s, s) if up else (first + c, -s)
            flux[c] = speed[c] * edge(
                q[m - 3 * t], q[m - 2 * t], q[m - t], q[m], q[m + t], q[m + 2 * t], q[m + 3 * t]
            )


@kernel
def xsppm7(out: Array, q: Array, u: tuple, d: int, inv_h: tuple, strides: tuple, bounds: tuple) -> None:
    """Advection of q, on the faces of component d, by u with upwind reconstruction, in blocks that stay in the cache.

    out = sum_e (F[c+e] - F[c]) / h_e,  F[c] = v q,  v = (u_e[c] + u_e[c-d]) / 2,
    q the edge value between faces c-e and c, from the side that v comes from
    """
    first, last = bounds
    sd = strides[d]
    out[first:last] = 0.0
    for e in range(len(strides)):
        s, v, k = strides[e], u[e], inv_h[e]
        block = max(BLOCK, 8 * s)
        speed, flux, margin = np.empty(block + s), np.empty(block + s), np.empty(block + s)
        for start in range(first, last, block):
            stop = min(start + block, last)
            n = stop - start + s
            v0, vm = v[start : start + n], v[start - sd : start - sd + n]
            for c in range(n):
                speed[c] = 0.5 * (v0[c] + vm[c])
            upwind_fluxes(flux[:n], margin[:n], speed, q, start, s)
            limit(flux[:n], margin, speed, q, start, s)
            o = out[start:stop]
            for c in range(stop - start):
                o[c] += k * (flux[c + s] - flux[c])


SCHEMES = {"centred": centred, "xsppm7": xsppm7}
"""Advection schemes by name."""
