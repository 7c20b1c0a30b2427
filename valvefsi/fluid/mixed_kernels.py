"""Loops over the modes of a direct solver for sides that are open on a part."""

from __future__ import annotations

import numba

from valvefsi.types import Array, Faces

kernel = numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz"}, error_model="numpy")


@kernel
def add_response(
    x: Array, weights: Array, planes: Array, eigenvalues: Faces, axis: int, operator: tuple[float, float]
) -> None:
    """Add the response to sources on one or two sides, x += sum_s w_s p_s / (a - b (l0 + l1 + l2)).

    The weights w_s vary along the axis normal to the sides and p_s across it; a divisor of zero adds nothing.
    """
    a, b = operator
    l0, l1, l2 = eigenvalues
    last, second = len(planes) - 1, float(len(planes) - 1)  # one side alone counts once
    first, other = weights[0], weights[last]
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            row, across = x[i, j], a - b * (l0[i] + l1[j])
            if axis == 2:
                p, q = planes[0, i, j], second * planes[last, i, j]
                for k in range(len(row)):
                    d = across - b * l2[k]
                    row[k] += (first[k] * p + other[k] * q) / d if d != 0.0 else 0.0
                continue
            m, n = (i, j) if axis == 0 else (j, i)
            f, g, p0, p1 = first[m], second * other[m], planes[0, n], planes[last, n]
            for k in range(len(row)):
                d = across - b * l2[k]
                row[k] += (f * p0[k] + g * p1[k]) / d if d != 0.0 else 0.0
