"""How far outside its points a surface of forced points stands in the flow: the offset of a kernel.

Points that hold the fluid through a regularised delta function stop it at a plane a part of h outside their own. In
Stokes flow along points on planes at y_a (the outermost at 0), with shear 1 outside and rest far inside, the velocity
at the grid's positions y_i is

    u_i = y_i / 2 + c + sum_a g_a sum_j w_aj |y_i - y_j| / 2,        w_aj = phi((y_a - y_j) / h),

as the second difference of |i - j| / 2 is one at i = j and nothing elsewhere. That u interpolated to every plane is
zero and that the forces g_a add up to the shear determines g and c; far outside the flow is zero at

    y_0 = sum_a g_a y_a / 2 - c.

One plane: y_0 = sum_ij w_i w_j |i - j| / 2, which is 7/30 h for ``bspline3``, the mean over all places of the plane
between the grid's. (At 45 degrees to the grid it is 0.259 h, in the mean over all angles 0.247 h.) Several planes
close together stand out farther: their forces alternate in sign.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from valvefsi.coupling.kernels import KERNELS, weights_at

PLACES = 40
"""Places of the plane between two positions of the grid that are averaged over."""


def wall_offset(kernel: str, depths: Sequence[float] = (0.0,)) -> float:
    """Return how far outside the outermost points the fluid is at rest, in spacings, for a wall along the grid.

    Args:
        kernel: Name of the kernel; a composite one acts by its number of points across the wall.
        depths: How far inside the surface the planes of points lie, the outermost at 0, in spacings.
    """
    family, _, points = KERNELS[kernel]
    inside = np.asarray(depths, dtype=float)
    return float(np.mean([_offset(family, points, s - inside) for s in np.arange(PLACES) / PLACES]))


def _offset(family: int, points: int, y: np.ndarray) -> float:
    """As `wall_offset`, for planes at y (in spacings, the first the surface) between the positions of the grid."""
    n = len(y)
    at, w = np.empty((n, points)), np.empty((n, points))
    for k in range(n):
        at[k] = weights_at(w[k], family, points, float(y[k])) + np.arange(points)
    apart = np.abs(at[:, None, :, None] - at[None, :, None, :])
    matrix = np.ones((n + 1, n + 1))
    matrix[:n, :n] = 0.5 * np.einsum("ai,bj,abij->ab", w, w, apart)
    matrix[n, n] = 0.0
    solution = np.linalg.solve(matrix, np.concatenate([-0.5 * y, [1.0]]))
    return 0.5 * float(solution[:n] @ y) - solution[n] - y[0]
