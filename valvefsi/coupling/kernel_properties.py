"""What follows from a kernel's weights."""

from __future__ import annotations

import numpy as np

from valvefsi.coupling.kernels import KERNELS, weights_at


def largest_square_sum(name: str) -> float:
    """Return the largest sum of squares of a kernel's weights over all shifts."""
    family, _, points = KERNELS[name]
    sums = []
    for s in np.linspace(0.0, 1.0, 101):
        w = np.zeros(points)
        weights_at(w, family, points, s)
        sums.append(float((w**2).sum()))
    return max(sums)
