"""Points of a surface that are held in patches: what springs of points much closer than a kernel can hold.

Points half a spacing apart are more than the velocities that their kernels see. Springs on each point then reach
combinations whose forces all but cancel in the kernel: slowly, the slower the better they cancel, they bring every
velocity near the surface to rest, and the surface thickens by a part of the spacing for as long as a run lasts.

In patches of some spacings the springs hold the mean only. With R_i the smallest turn that takes the normal at point i
to that of its patch c, and w_i its area,

    (P v)_i = R_i^T sum_j w_j R_j v_j / sum_j w_j            over the points j of the patch:

a projection, symmetric in the product of the areas, under which uniform pressure stays what it is on a curved surface.
The points remain as close as they must be for the surface to be tight; what does not agree with P v moves freely and is
felt by nothing. This needs a kernel that turns a uniform pressure on a surface into the gradient of one: a composite
B-spline; with others the fluid flows in rings through the patches.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI

from valvefsi.bodies import rigid_kernels
from valvefsi.bodies.patch_transfer import PatchTransfer
from valvefsi.bodies.rigid import RigidSurface

if TYPE_CHECKING:
    from valvefsi.coupling.transfer import Coupling
    from valvefsi.geometry.aortic_section import PointSurface
    from valvefsi.types import Array, Faces, Indices

LEAST = 0.5
"""Least cosine of the angle between a normal and that of its patch."""


class PatchedSurface(RigidSurface):
    """A rigid surface whose springs and dampers hold the means over patches; ``d`` is P of how far points are carried.

    Args:
        surface: Points, areas and normals of the whole surface, the same on all ranks.
        labels: Patch of each point, negative for one by itself, ``(num_points,)``.
        coupling: Its kernel on the grid, a composite B-spline where pressures act on the surface.
        name: Name in files.
        stiffness: kappa per area [dyn/cm^3].
        damping: eta per area [dyn s/cm^3].
        slip: Rate at which points slip back, see `RigidSurface`, 0 in patches [1/s].

    Raises:
        StabilityError: A point lies too near to a side, on the rank of the point.
        ValueError: Springs that cannot hold, or points in patches that slip one by one.
    """

    def __init__(
        self,
        surface: PointSurface,
        labels: Indices,
        coupling: Coupling,
        *,
        name: str,
        stiffness: float,
        damping: float,
        slip: float | Array = 0.0,
    ) -> None:
        super().__init__(
            surface.points,
            surface.areas,
            coupling,
            name=name,
            stiffness=stiffness,
            damping=damping,
            slip=slip,
            faces=surface.faces,
        )
        patches = Patches(labels, surface.normals, surface.areas)
        if np.ndim(slip) and np.any(np.asarray(slip)[patches.labels >= 0]):
            raise ValueError("expected points in patches not to slip one by one, some do")
        self.patches = patches.on(self.ids, coupling.grid.comm)
        self.transfer = self._straight = PatchTransfer(coupling, self.X, self.patches)

    def held(self, v: Array) -> Array:
        """Return the means over patches of a vector at the points, ``(n, 3)`` (collective)."""
        return self.patches.mean(v)

    def felt(self, u: Faces) -> Array:
        """Return the means over patches of the velocity at the points, ``(n, 3)`` [cm/s]. Collective."""
        return self.transfer.interpolate(u)

    def memory(self) -> int:
        """Return the bytes that a step takes for what its patches reach, on this rank."""
        return self._straight.memory()


class Patches:
    """The patches of a surface, the same on all ranks.

    Args:
        labels: Patch of each point, negative for one by itself, ``(num_points,)``.
        normals: Unit normal at each point, ``(num_points, 3)``.
        areas: Area of each point, ``(num_points,)`` [cm^2].

    Note:
        A patch around an edge, whose normals differ by more than 60 degrees from their mean, falls apart into points.
    """

    def __init__(self, labels: Indices, normals: Array, areas: Array) -> None:
        labels = _numbered(labels)
        means = _means(labels, normals, areas)
        cosine = (normals * means[labels]).sum(axis=1)
        edges = np.unique(labels[(labels >= 0) & (cosine < LEAST)])
        self.labels: Indices = _numbered(np.where(np.isin(labels, edges), -1, labels))
        together, self.areas = self.labels >= 0, areas
        self.total = np.bincount(self.labels[together], areas[together]).astype(float)
        self.turns = np.broadcast_to(np.eye(3), (len(labels), 3, 3)).copy()
        means = _means(self.labels, normals, areas)
        self.turns[together] = _turns(normals[together], means[self.labels[together]])

    def on(self, ids: Indices, comm: MPI.Comm) -> LocalPatches:
        """Return what a rank needs that holds the points with these numbers."""
        return LocalPatches(self, ids, comm)


class LocalPatches:
    """The projection P for the points of this rank."""

    def __init__(self, patches: Patches, ids: Indices, comm: MPI.Comm) -> None:
        self.comm = comm
        self.size = len(patches.total)
        self.labels, self.turns = patches.labels[ids], patches.turns[ids]
        together = self.labels >= 0
        self.shares = np.zeros(len(ids))
        self.shares[together] = patches.areas[ids][together] / patches.total[self.labels[together]]

    def mean(self, v: Array) -> Array:
        """Return P v, ``(n, 3)``; points by themselves keep theirs (collective)."""
        sums = np.zeros((self.size, 3))
        rigid_kernels.patch_sums(sums, v, self.turns, self.labels, self.shares)
        return self.turned_back(sums, v.copy())

    def turned_back(self, sums: Array, out: Array) -> Array:
        """Write to points what their patches hold; those by themselves are left alone (collective).

        Args:
            sums: This rank's parts of the amplitudes of the patches, ``(m, 3)``; those of all ranks afterwards.
            out: Vectors at the points, ``(n, 3)``, which are returned.
        """
        if self.comm.size > 1:
            self.comm.Allreduce(MPI.IN_PLACE, sums)
        rigid_kernels.patch_means(out, sums, self.turns, self.labels)
        return out


def _numbered(labels: Indices) -> Indices:
    """Return labels 0, 1, ... of patches with at least two points; -1 for all other points."""
    _, at, count = np.unique(labels, return_inverse=True, return_counts=True)
    together = (labels >= 0) & (count[at] > 1)
    numbers = np.full(len(labels), -1, dtype=np.int64)
    numbers[together] = np.unique(labels[together], return_inverse=True)[1]
    return numbers


def _means(labels: Indices, normals: Array, areas: Array) -> Array:
    """Return the mean unit normal of each patch, with a last row for the points by themselves, ``(m + 1, 3)``."""
    together = labels >= 0
    at, w = labels[together], areas[together]
    mean = np.stack([np.bincount(at, w * n).astype(float) for n in normals[together].T], axis=1)
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-300)
    return np.concatenate([mean, [[0.0, 0.0, 0.0]]])


def _turns(normals: Array, to: Array) -> Array:
    """Return the smallest rotations that take unit vectors to others, ``(n, 3, 3)``."""
    cosine = (normals * to).sum(axis=1)
    x, y, z = np.cross(normals, to).T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    return np.eye(3) + cross + cross @ cross / (1.0 + cosine)[:, None, None]
