"""How far in front of its points a surface of held points stops the fluid, for any direction of the surface.

Points with a smooth force density hold the fluid, in the mean over the surface, through a kernel of width h. In a
shear flow u = s y t in front of a plane with normal n the fluid then seems to be at rest a distance

    y_0 = 1/2 sum_d t_d^2 E |n . (a - b)|

in front of the points, with a and b two independent positions of the grid, drawn with the weights of component d's
kernel around one point, and the mean taken over all places of the point between the grid's: second differences of
|y| / 2 are point forces. Along each axis a - b is then an integer, drawn with the values of the B-spline of twice the
kernel's points. One sixth of h for ``piecewise_linear`` along the grid, 0.196 h at 45 degrees;
`valvefsi.benchmarks.wall_offset` has several planes behind one another.
"""

from __future__ import annotations

import numpy as np

from valvefsi.coupling.kernels import KERNELS, weights_at
from valvefsi.types import Array

PLACES = 40
"""Places between two positions of the grid that are averaged over."""


def surface_offset(kernel: str, normals: Array, along: tuple[float, float, float]) -> Array:
    """Return how far in front of its points a surface stops a flow along it, in spacings, ``(n,)``.

    Args:
        kernel: Name of the kernel.
        normals: Unit normals of the surface, ``(n, 3)``.
        along: Direction of the flow; what of it is normal to the surface does not count.
    """
    family, own, others = KERNELS[kernel]
    direction = np.asarray(along, dtype=float)
    flow = direction - (normals @ direction)[:, None] * normals
    length = np.linalg.norm(flow, axis=1)
    flow = np.where(length[:, None] > 1e-6, flow / np.maximum(length, 1e-6)[:, None], np.sqrt(1.0 / 3.0))
    chances = {points: _differences(family, points) for points in {own, others}}
    offset = np.zeros(len(normals))
    for d in range(3):
        each = [chances[own if axis == d else others] for axis in range(3)]
        apart = [np.arange(len(c)) - len(c) // 2 for c in each]
        for i, P in zip(apart[0], each[0], strict=True):
            for j, Q in zip(apart[1], each[1], strict=True):
                far = np.abs(
                    (normals[:, 0] * i + normals[:, 1] * j)[:, None] + np.outer(normals[:, 2], apart[2])
                )
                offset += 0.5 * flow[:, d] ** 2 * P * Q * (far @ each[2])
    return offset


def _differences(family: int, points: int) -> Array:
    """Chances of the differences -points .. points of two positions drawn with the weights of a kernel."""
    chances, w = np.zeros(2 * points + 1), np.zeros(points)
    for s in np.arange(PLACES) / PLACES:
        weights_at(w, family, points, s)
        chances[1:-1] += np.correlate(w, w, "full") / PLACES
    return chances
