"""Viscous shear stress of fields that a run has written, in the cells, and its percentiles by volume."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from valvefsi.types import Array, Mask


def cell_gradient(u: Array, centres: Sequence[Array]) -> Array:
    """Return du_i/dx_j of a velocity in cells, ``(nx, ny, nz, 3, 3)`` [1/s].

    Centred differences between the cells' centres, exact for quadratic functions, one-sided at the ends.

    Args:
        u: Velocity, ``(nx, ny, nz, 3)`` [cm/s].
        centres: Centres of the cells along each axis, an axis of one cell has no derivative [cm].
    """
    G = np.zeros((*u.shape, 3))
    for j, x in enumerate(centres):
        if len(x) > 1:
            G[..., j] = np.gradient(u, x, axis=j, edge_order=2 if len(x) > 2 else 1)
    return G


def shear_stress(G: Array, mu: float) -> Array:
    """Return the viscous shear stress, mu sqrt(2 S:S) with the strain rate S, that of simple shear at its rate.

    Args:
        G: Velocity gradient, ``(..., 3, 3)`` [1/s].
        mu: Viscosity [dyn s/cm^2].
    """
    S = 0.5 * (G + np.swapaxes(G, -1, -2))
    return mu * np.sqrt(2.0 * np.einsum("...ij,...ij->...", S, S))


def volume_percentiles(
    values: Array, edges: Sequence[Array], inside: Mask, parts: Sequence[float]
) -> list[float]:
    """Return the values that parts of the volume of some cells do not exceed; the maximum for the part 1.

    Args:
        values: A field in cells, ``(nx, ny, nz)``.
        edges: Edges of the cells along each axis [cm].
        inside: The cells that count, ``(nx, ny, nz)``.
        parts: Parts of their volume between 0 and 1.
    """
    x, y, z = (np.diff(e) for e in edges)
    volumes = (x[:, None, None] * y[:, None] * z)[inside]
    order = np.argsort(values[inside], kind="stable")
    total = np.cumsum(volumes[order])
    at = np.searchsorted(total, np.asarray(parts) * total[-1] * (1.0 - 1e-12))
    return [float(v) for v in values[inside][order][at]]
