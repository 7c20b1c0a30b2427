"""Rigid surfaces: points on a surface that stay where they are (Lee2020, section C: the aortic test section).

Springs and dampers hold each point, F = w (-kappa d - eta U), with d the way the fluid has carried it. As d is a small
part of a grid spacing, the kernel stays where the point is at rest: its weights are made once, and every rank keeps the
points of its own cells.

Where points lie closer than their kernel tells apart, springs whose forces cancel in it are never held back and grow
for as long as a run lasts: points may slip back through the fluid to their place, d' = u - slip d.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


class RigidSurface:
    """The points of a rigid surface that lie in this rank's cells.

    Args:
        points: The points of the whole surface, the same on all ranks, ``(num_nodes, 3)`` [cm].
        areas: Area of each, ``(num_nodes,)`` [cm^2].
        mine: Numbers of those in this rank's cells, ``(n,)``.
        name: Name in files.
        stiffness: kappa per area [dyn/cm^3].
        damping: eta per area [dyn s/cm^3].
        slip: Rate at which a point slips back through the fluid to its place [1/s]; a traction f drives fluid through
            the surface with slip f / kappa.
        faces: Corners of quadrilaterals between the points, for pictures, ``(m, 4)``.

    Attributes:
        X: Points, ``(n, 3)`` [cm].
        ids: Their numbers in the whole surface, ``(n,)``.
        num_nodes: Number of points on all ranks.
    """

    def __init__(
        self,
        points: Array,
        areas: Array,
        mine: NDArray[np.intp],
        *,
        name: str,
        stiffness: float,
        damping: float,
        slip: float = 0.0,
        faces: NDArray[np.int64] | None = None,
    ) -> None:
        if not stiffness > 0.0 or not damping >= 0.0 or not slip >= 0.0:
            message = "expected stiffness > 0, damping >= 0 and slip >= 0"
            raise ValueError(f"{message}, got {stiffness}, {damping}, {slip}")
        self.name = name
        self.stiffness, self.damping, self.slip = float(stiffness), float(damping), float(slip)
        self.ids = np.asarray(mine, dtype=np.int64)
        self.num_nodes = len(points)
        self.points, self.faces = points, faces
        self.X: Array = np.ascontiguousarray(points[mine])
        self._weights = areas[mine][:, None]

    def force(self, d: Array, U: Array) -> Array:
        """Return the force on the fluid of points carried by d and moving with U, ``(n, 3)`` [dyn]."""
        return self._weights * (-self.stiffness * d - self.damping * U)
