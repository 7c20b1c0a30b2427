"""How far in front of its points a surface of held points stops the fluid, for any direction of the surface.

Points with a smooth force density hold the fluid, in the mean over the surface, through a kernel of width h. In Stokes
flow along t in front of a plane with normal n, on a grid of spacing 1, a density that is spread twice by component d's
kernel (once as a force, once as the velocity that is interpolated) has along the normal the transform prod_a
phi_da(k n_a)^2, and the grid's Laplacian is -4 sum_a sin(k n_a / 2)^2 there. Far in front the flow is that of a sharp
wall a distance

    y_0 = 1/pi int_0^inf (1 - F(k)) / k^2 dk,    F = sum_d t_d^2 prod_a phi_da(k n_a)^2 k^2 / (4 sum_a sin(k n_a / 2)^2)

in front of the points, in the mean over the places of the plane between those of the grid. A B-spline of m points has
phi = (sin(k / 2) / (k / 2))^m. It is h / 6 for ``piecewise_linear`` along the grid, 0.201 h at 45 degrees and 0.185 h
in the mean over a circle; `valvefsi.coupling.wall_offset` has several planes behind one another.
"""

from __future__ import annotations

import numpy as np

from valvefsi.coupling.kernels import BSPLINE, KERNELS
from valvefsi.types import Array

WAVES = 0.08 * (np.arange(500) + 0.5)
"""Wave numbers times h of the midpoint rule; what lies above them is taken with F = 0."""
BLOCK = 50
"""Normals at a time: what belongs to them stays in the cache."""


def surface_offset(kernel: str, normals: Array, along: tuple[float, float, float]) -> Array:
    """Return how far in front of its points a surface stops a flow along it, in spacings, ``(n,)``.

    Args:
        kernel: Name of the kernel, a B-spline or a composite one.
        normals: Unit normals of the surface, ``(n, 3)``.
        along: Direction of the flow; what of it is normal to the surface does not count.

    Raises:
        ValueError: The kernel is none of B-splines.
    """
    if KERNELS[kernel][0] != BSPLINE:
        raise ValueError(f"the offset is that of B-splines, {kernel} is none")
    direction = np.asarray(along, dtype=float)
    flow = direction - (normals @ direction)[:, None] * normals
    length = np.linalg.norm(flow, axis=1)
    flow = np.where(length[:, None] > 1e-6, flow / np.maximum(length, 1e-6)[:, None], np.sqrt(1.0 / 3.0))
    # Many points of a plane face, or of a column of a tube, have one normal.
    _, first, same = np.unique(normals, axis=0, return_index=True, return_inverse=True)
    normals, flow = normals[first], flow[first]
    parts = [
        _offset(kernel, normals[k : k + BLOCK], flow[k : k + BLOCK]) for k in range(0, len(normals), BLOCK)
    ]
    return np.concatenate(parts)[same.ravel()] if parts else np.zeros(0)


def _offset(kernel: str, normals: Array, flow: Array) -> Array:
    """As `surface_offset`, for unit vectors along the flow."""
    _, own, others = KERNELS[kernel]
    half = np.maximum(0.5 * WAVES * np.abs(normals)[:, :, None], 1e-20)
    square = np.sin(half) ** 2
    spread = square / half**2
    laplacian = 4.0 * square.sum(axis=1)
    product = _power(spread.prod(axis=1), others)
    F = sum(flow[:, d, None] ** 2 * _power(spread[:, d], own - others) for d in range(3)) * product
    F *= WAVES**2 / np.maximum(laplacian, 1e-12)
    return (((1.0 - F) / WAVES**2).sum(axis=1) * (WAVES[1] - WAVES[0]) + 1.0 / (WAVES[-1] + WAVES[0])) / np.pi


def _power(base: Array, exponent: int) -> Array:
    """Return a whole power by products, a tenth of the time of a general one."""
    result = np.ones_like(base)
    for _ in range(exponent):
        result = result * base
    return result
