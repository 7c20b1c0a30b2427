"""A dam behind a rigid wall: nothing can flow round what the wall shuts where its kernel lets a little through.

Every face of the grid that lies behind the wall between two planes has a spring and a damper of its own. No kernel is
between them and the fluid, so no combination of theirs cancels on the grid.

A wall of kernels needs the fluid behind it: beside a flow along the wall, that fluid moves a little against the flow,
so that the mean that the kernel sees vanishes. Held still there, it would push the wall's place into the flow, the
further the longer that lasts. So the dam is to stand where hardly anything flows along the wall.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.spatial import cKDTree

from valvefsi.bodies import rigid_kernels
from valvefsi.bodies.rigid import RigidSurface

if TYPE_CHECKING:
    from valvefsi.coupling.transfer import Coupling
    from valvefsi.geometry.aortic_section import PointSurface
    from valvefsi.grid import MacGrid
    from valvefsi.types import Array, Faces, Indices, Mask, Transfer

MARGIN = 0.5
"""How far behind the wall a face lies at least, in spacings: before it the wall alone decides where the fluid stops."""


class Filling(RigidSurface):
    """The faces behind a part of a wall; ``d`` is how far the fluid has been carried on the lower faces of each cell.

    Args:
        wall: Points of the wall and its normals away from the fluid, the same on all ranks.
        coupling: Any kernel on the grid; it says which rank owns which cell.
        between: z of the planes between which the dam stands [cm].
        name: Name in files.
        stiffness: kappa per volume [dyn/cm^4].
        damping: eta per volume [dyn s/cm^4].

    Note:
        Collective.
    """

    def __init__(
        self,
        wall: PointSurface,
        coupling: Coupling,
        *,
        between: tuple[float, float] = (-math.inf, math.inf),
        name: str,
        stiffness: float,
        damping: float,
    ) -> None:
        cells = _Cells(wall, coupling, between)
        super().__init__(cells.points, cells.volumes, cells, name=name, stiffness=stiffness, damping=damping)

    def memory(self) -> int:
        """Return the bytes that a step takes for it on this rank: places, numbers and volumes, and its vectors."""
        return 8 * (3 * self.num_points + 24 * len(self.X))


class _Cells:
    """The cells with a lower face behind a wall, in the place of a kernel's coupling."""

    def __init__(self, wall: PointSurface, coupling: Coupling, between: tuple[float, float]) -> None:
        grid = coupling.grid
        self.grid, self.coupling = grid, coupling
        centres, edges = [grid.centres(axis) for axis in range(3)], list(grid.cell_widths)
        level = (centres[2] > between[0]) & (centres[2] - 0.5 * edges[2] < between[1])
        centres[2], edges[2] = centres[2][level], edges[2][level]
        points = np.stack(np.meshgrid(*centres, indexing="ij"), axis=-1).reshape(-1, 3)
        widths = np.stack(np.meshgrid(*edges, indexing="ij"), axis=-1).reshape(-1, 3)
        behind = np.zeros(points.shape, dtype=bool)
        for d in range(3):
            faces = points - 0.5 * widths * (np.arange(3) == d)
            inside = np.flatnonzero((faces[:, 2] >= between[0]) & (faces[:, 2] <= between[1]))
            behind[inside, d] = _behind(wall, faces[inside], float(grid.spacing[0]))
        some = behind.any(axis=1)
        self.points, self.volumes, self.behind = points[some], np.prod(widths[some], axis=1), behind[some]

    def own(self, points: Array) -> Indices:
        """Return the numbers of the cells of this rank."""
        return self.coupling.own(points)

    def stay(self, X: Array) -> Transfer:
        """Return spreading and interpolation for this rank's cells."""
        return _FaceTransfer(self.grid, X, self.behind[self.own(self.points)])


class _FaceTransfer:
    """Spreading to the faces and reading from them, without a kernel."""

    def __init__(self, grid: MacGrid, X: Array, behind: Array) -> None:
        self.grid = grid
        cell = np.empty((len(X), 3), dtype=np.int64)
        for axis in range(3):
            local = grid.centres(axis)[grid.start[axis] : grid.start[axis] + grid.size[axis]]
            cell[:, axis] = np.searchsorted(local, X[:, axis] - 1e-9) + grid.ghosts[axis]
        flat = np.ravel_multi_index((cell[:, 0], cell[:, 1], cell[:, 2]), grid.shape)
        self.cells = flat.astype(np.uint32)  # of no sign: the loops need not look for places from the end
        volumes = np.stack([grid.volumes(d).ravel()[flat] for d in range(3)], axis=1)
        self.volumes = np.where(behind, volumes, 0.0)

    def spread(self, F: Array, out: Faces | None = None) -> Faces:
        """Return the force density on the faces [dyn/cm^3] of forces by cell, ``(n, 3)`` [dyn]."""
        out = self.grid.zero_faces() if out is None else out
        rigid_kernels.add_to_faces(tuple(c.reshape(-1) for c in out), F, self.cells, self.volumes)
        return out

    def interpolate(self, u: Faces) -> Array:
        """Return the velocity on the lower faces of each cell that lie behind the wall, else 0, ``(n, 3)`` [cm/s]."""
        U = np.empty((len(self.cells), 3))
        rigid_kernels.read_faces(U, tuple(c.reshape(-1) for c in u), self.cells, self.volumes)
        return U

    def smooth(self, F: Array) -> Array:
        """Return the force density that the cells feel of their own forces, ``(n, 3)`` [dyn/cm^3]."""
        return self.interpolate(self.spread(F))


def _behind(wall: PointSurface, X: Array, h: float) -> Mask:
    """Return which points lie behind a wall around the z axis by at least `MARGIN` of h, ``(n,)``."""
    r, nearest, farthest = np.hypot(X[:, 0], X[:, 1]), *_radii(wall, X[:, 2], h)
    behind = r > farthest + 2.0 * h
    near = np.flatnonzero(~behind & (r > nearest - h))  # of points near the axis no wall point is the nearest
    at = cKDTree(wall.points).query(X[near])[1]
    depth = ((X[near] - wall.points[at]) * wall.normals[at]).sum(axis=1)
    behind[near] = depth > MARGIN * h
    return behind


def _radii(wall: PointSurface, z: Array, h: float) -> tuple[Array, Array]:
    """Return the least and the largest distance of the wall from the axis within 2 h of z, each ``(n,)`` [cm]."""
    first = float(wall.points[:, 2].min())
    place = np.floor((wall.points[:, 2] - first) / h).astype(int)
    r, count = np.hypot(wall.points[:, 0], wall.points[:, 1]), int(place.max()) + 1
    least, largest = np.full(count, np.inf), np.zeros(count)
    np.minimum.at(least, place, r)
    np.maximum.at(largest, place, r)
    slab = np.clip(np.floor((z - first) / h).astype(int), 0, count - 1)
    return minimum_filter1d(least, 3, mode="nearest")[slab], maximum_filter1d(largest, 3, mode="nearest")[
        slab
    ]
