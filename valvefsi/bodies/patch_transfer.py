"""Spreading and interpolation of patches whose points stay where they are: straight to their amplitudes.

The springs of a patch c hold one vector, its amplitude m_c, of the velocities U_j that its points interpolate, and the
forces of its points follow from one vector G_c, as w_j R_j^T G_c (see `valvefsi.bodies.patches`). With phi_dj the
weights of a kernel for component d, V the volume of a cell and s_j the part that a point has in the area w_c of its
patch,

    m_ci = sum_d sum_x a_cdi(x) u_d(x),    a_cdi(x) = sum_j s_j (R_j)_id phi_dj(x),
    f_d(x) = w_c / V sum_c sum_i a_cdi(x) G_ci.

Neither the weights nor the faces change, so the a are summed up once: the points of a patch reach the same faces many
times over, a patch each of its faces once. Points by themselves keep a transfer of their own.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.bodies import rigid_kernels
from valvefsi.coupling import kernels

if TYPE_CHECKING:
    from valvefsi.bodies.patches import LocalPatches
    from valvefsi.coupling.transfer import Coupling, Transfer
    from valvefsi.types import Array, Faces, Indices

ENTRY = 4 + 3 * 8
"""Bytes of a face that a patch reaches: its number and three weights."""


@dataclass(frozen=True, kw_only=True)
class Reach:
    """The faces of one component that patches reach.

    Attributes:
        faces: Their numbers in the local array, patch by patch, ``(k,)``.
        starts: Where each patch begins, and the end, ``(m + 1,)``.
        weights: a, ``(k, 3)``.
    """

    faces: Indices
    starts: Indices
    weights: Array


class PatchTransfer:
    """Spreading of forces that patches hold, and interpolation of what they hold of a velocity.

    Args:
        coupling: Their kernel on the grid.
        X: Points of this rank, which stay in its cells, ``(n, 3)`` [cm].
        patches: Their patches.

    Raises:
        StabilityError: A point lies too near to a side, on the rank of the point.
    """

    def __init__(self, coupling: Coupling, X: Array, patches: LocalPatches) -> None:
        self.coupling, self.patches = coupling, patches
        self.points: Transfer = coupling.stay(X)
        self.alone = np.flatnonzero(patches.labels < 0)
        self.single: Transfer = coupling.stay(X[self.alone])

    @cached_property
    def reach(self) -> list[Reach]:
        """The faces that the patches reach, by component; a surface that moves never asks."""
        coupling, x = self.coupling, self.points.x
        cells = np.empty((len(x), 2 * x.shape[1]), dtype=np.int64)
        weights = np.empty((*cells.shape, kernels.MOST))
        kernels.stencils(cells, weights, x, coupling.kind, coupling.geometry)
        together = np.flatnonzero(self.patches.labels >= 0)
        return [self._reach(d, together, cells[together], weights[together]) for d in range(x.shape[1])]

    def _reach(self, d: int, those: Indices, cells: Indices, weights: Array) -> Reach:
        """Return the faces of component d that points reach, whose stencils are given."""
        _, normal, across = self.coupling.kind
        shape, size = self.coupling.grid.shape, int(np.prod(self.coupling.grid.shape))
        axes = range(cells.shape[1] // 2)
        sides = [2 * axis + int(axis != d) for axis in axes]
        faces, phi = [], []
        for at in itertools.product(*(range(normal if axis == d else across) for axis in axes)):
            places = [cells[:, side] + k for side, k in zip(sides, at, strict=True)]
            places += [np.zeros_like(places[0])] * (3 - len(places))
            faces.append(np.ravel_multi_index(places, shape))
            phi.append(np.prod([weights[:, side, k] for side, k in zip(sides, at, strict=True)], axis=0))
        patches = self.patches
        keys = (size * patches.labels[those] + np.stack(faces)).ravel()
        order = np.argsort(keys, kind="stable")
        keys = keys[order]
        first = np.flatnonzero(np.diff(keys, prepend=-1))
        parts = (patches.shares[those] * patches.turns[those, :, d].T)[:, None] * np.stack(phi)
        sums = [np.add.reduceat(part.ravel()[order], first) for part in parts]
        number, face = np.divmod(keys[first], size)
        starts = np.searchsorted(number, np.arange(patches.size + 1))
        return Reach(
            faces=face.astype(np.uint32), starts=starts.astype(np.uint32), weights=np.stack(sums, axis=1)
        )

    @cached_property
    def leads(self) -> tuple[Indices, Indices, Array]:
        """Patches of this rank, a point of each, and what turns the force of that into w_c / V G_c, ``(k, 3, 3)``."""
        patches = self.patches
        order = np.argsort(patches.shares, kind="stable")
        lead = np.full(patches.size + 1, -1, dtype=np.int64)  # the last one is of points by themselves
        lead[patches.labels[order]] = order
        those = np.flatnonzero(lead[:-1] >= 0)
        at = lead[those]
        scale = self.coupling.grid.cell_volume * patches.shares[at]
        return those, at, patches.turns[at] / scale[:, None, None]

    def spread(self, F: Array, out: Faces | None = None) -> Faces:
        """Spread forces of points to the faces, see `valvefsi.coupling.transfer.Transfer.spread`.

        Args:
            F: Forces of this rank's points, those of a patch w_j R_j^T G_c, ``(n, 3)`` [dyn].
            out: Faces to add to; new ones by default.

        Note:
            Collective.
        """
        out = self.coupling.grid.zero_faces() if out is None else out
        G = np.zeros((self.patches.size, 3))
        rigid_kernels.turn(G, F, *self.leads)
        for f, reach in zip(out, self.reach, strict=False):
            rigid_kernels.add_amplitudes(f.reshape(-1), G, reach.faces, reach.starts, reach.weights)
        return self.single.spread(np.take(F, self.alone, axis=0), out=out)

    def interpolate(self, u: Faces) -> Array:
        """Return what is held of a velocity at the points of this rank, ``(n, 3)`` [cm/s]. Collective.

        Args:
            u: Velocity with filled ghosts [cm/s].
        """
        m, U = np.zeros((self.patches.size, 3)), np.empty((len(self.patches.labels), 3))
        U[self.alone] = self.single.interpolate(u)
        for v, reach in zip(u, self.reach, strict=False):
            rigid_kernels.read_amplitudes(m, v.reshape(-1), reach.faces, reach.starts, reach.weights)
        return self.patches.turned_back(m, U)

    def smooth(self, F: Array) -> Array:
        """Return what is held of the force density that points feel of their own forces, ``(n, 3)``. Collective."""
        f = self.spread(F)
        self.coupling.grid.exchange(f)
        return self.interpolate(f)

    def memory(self) -> int:
        """Return the bytes of what is kept on this rank for the patches."""
        return sum(ENTRY * len(reach.faces) for reach in self.reach)
