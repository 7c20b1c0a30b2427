"""Loops over points that need no regularised delta function."""

from __future__ import annotations

import math

import numba
import numpy as np

from valvefsi.types import Array

kernel = numba.njit(cache=True, error_model="numpy")


@kernel
def extent(x: Array) -> Array:
    """Return the lowest and the highest coordinates of the points, ``(2, dim)``; NaN where one of the axis is NaN."""
    ends = np.empty((2, x.shape[1]))
    for axis in range(x.shape[1]):
        low, high, lost = math.inf, -math.inf, 0
        for q in range(x.shape[0]):
            s = x[q, axis]
            low = s if s < low else low
            high = s if s > high else high
            lost += int(s != s)
        ends[0, axis], ends[1, axis] = (math.nan, math.nan) if lost else (low, high)
    return ends
