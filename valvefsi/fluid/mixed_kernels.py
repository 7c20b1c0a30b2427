"""Loops over the modes of a direct solver for sides that are open on a part."""

from __future__ import annotations

import numba

from valvefsi.types import Array, Faces

kernel = numba.njit(cache=True, nogil=True, error_model="numpy")


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
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            across = l0[i] + l1[j]
            if axis == 2:
                p, q = planes[0, i, j], second * planes[last, i, j]
                for k in range(x.shape[2]):
                    d = a - b * (across + l2[k])
                    value = weights[0, k] * p + weights[last, k] * q
                    x[i, j, k] += value / d if d != 0.0 else 0.0
                continue
            m, n = (i, j) if axis == 0 else (j, i)
            for k in range(x.shape[2]):
                d = a - b * (across + l2[k])
                value = weights[0, m] * planes[0, n, k] + second * weights[last, m] * planes[last, n, k]
                x[i, j, k] += value / d if d != 0.0 else 0.0
