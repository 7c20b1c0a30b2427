"""Transfer between points of a solid and the faces of the grid, over all ranks.

Points are sent to the rank that owns their cell; there the kernel reaches into ghost layers at most. Spreading
adds into ghosts and sums them home, interpolation reads filled ghosts, both with one set of weights: the two are
adjoint by construction. Beyond a side whose velocity is given both use its mirror image, see
`valvefsi.coupling.mirrors`: near it, part of the force is the side's to bear.
"""

from __future__ import annotations

import math

import numpy as np
from mpi4py import MPI

from valvefsi.coupling import kernels, mirrors, point_kernels
from valvefsi.errors import StabilityError
from valvefsi.grid import MacGrid
from valvefsi.types import Array, Faces, Indices


class Coupling:
    """The regularised delta function of one solid on one grid.

    Args:
        grid: The grid.
        kernel: Name of the kernel, see `valvefsi.coupling.kernels.KERNELS`.
        signs: How the fluid's velocity is reflected about sides, from `valvefsi.fluid.boundary.Boundary.signs`;
            moving points may come up to these, and to within the kernel's reach of all others.

    Raises:
        ValueError: The kernel is not known.
    """

    nodal = True
    """Whether the nodes themselves are the points."""
    gap = math.inf
    """Largest distance of neighbouring points that is let be [cm]: that of the nodes."""

    def __init__(self, grid: MacGrid, kernel: str, signs: mirrors.Signs | None = None) -> None:
        if kernel not in kernels.KERNELS:
            raise ValueError(f"unknown kernel {kernel!r}, a kernel is one of {', '.join(kernels.KERNELS)}")
        self.grid, self.name = grid, kernel
        self.kind = kernels.KERNELS[kernel]
        self.reach = 0.5 * max(self.kind[1:])
        dim = grid.dim
        # What the loops are compiled for: as many entries as the kernel has along an axis.
        normal, across = ((0,) * points for points in self.kind[1:])
        self.rows = (normal, across, across if dim == 3 else (0,))
        offset = tuple(g - s for g, s in zip(grid.ghosts, grid.start, strict=True))
        self.geometry = (grid.origin, 1.0 / grid.spacing, offset, dim)
        n1 = grid.process_grid[1]
        owner = [
            np.searchsorted(starts[1:], np.arange(n), side="right")
            for starts, n in zip(grid.starts[:2], grid.cells[:2], strict=True)
        ]
        self.owner = (owner[0] * n1, owner[1])
        free = ~(np.array(grid.periodic[:dim]) & np.array(grid.uniform[:dim]))
        margin = self.reach * grid.spacing[:dim]
        fine = np.array(grid.fine[:dim])
        self.low = np.where(free, fine[:, 0] + margin, -np.inf)
        self.high = np.where(free, fine[:, 1] - margin, np.inf)
        # A kernel may meet the faces on a side, but none beyond it and no centre beyond: both half a point farther in.
        at_side = np.isclose(fine, np.array([grid.lower[:dim], grid.upper[:dim]]).T, rtol=0.0, atol=1e-9)
        nearest = max(0.5 * self.kind[1] - 1.0, 0.5 * self.kind[2] - 0.5)
        nearer = (self.reach - nearest) * grid.spacing[:dim, None] * at_side
        self.low_rigid, self.high_rigid = self.low - nearer[:, 0], self.high + nearer[:, 1]
        # A moving point within the margin of a side that reflects needs its mirror image.
        self.signs = {side: sign for side, sign in (signs or {}).items() if at_side[side[0], int(side[1])]}
        self.inner_low, self.inner_high = self.low.copy(), self.high.copy()
        for axis, upper in self.signs:
            ends, side = (self.high, grid.upper) if upper else (self.low, grid.lower)
            ends[axis] = side[axis]

    def at(self, chi: Array) -> Transfer:
        """Prepare spreading and interpolation for points at chi.

        Args:
            chi: Positions of this rank's points, ``(num_points, 3)`` [cm].

        Raises:
            StabilityError: A point is not finite or outside the box, or lies within the kernel's reach of an open
                side or of cells that are larger than the smallest.

        Note:
            Collective.
        """
        ends = point_kernels.extent(chi[:, : self.grid.dim])
        place, problem = self._check(chi, ends, self.low, self.high)
        return Transfer(self, place, len(chi), problem, ends)

    def _check(self, chi: Array, ends: Array, low: Array, high: Array) -> tuple[Array | None, str | None]:
        """Return the places of points in the box, or what is wrong with them."""
        grid = self.grid
        place = chi[:, : grid.dim]
        slack = 1e-9 * grid.spacing[0]
        if not len(place) or ((ends[0] >= low - slack) & (ends[1] <= high + slack) & np.isfinite(ends)).all():
            return self._wrap(place), None
        inside = (place >= low - slack) & (place <= high + slack) & np.isfinite(place)
        worst = place[~inside.all(axis=1)][0]
        solid = ~np.array(grid.periodic[: grid.dim])
        outside = (worst < grid.lower[: grid.dim] - slack) | (worst > grid.upper[: grid.dim] + slack)
        if not np.isfinite(worst).all() or (outside & solid).any():
            what = "is lost, outside the box"
        else:
            what = (
                f"is within {self.reach:g} spacings of an open side or of graded cells (kernel {self.name})"
            )
        return None, f"a point of the solid at {np.array2string(worst, precision=4)} cm {what}"

    def sides_near(self, ends: Array) -> list[mirrors.Side]:
        """Return the sides that reflect and that the kernel of a point between these ends may reach beyond."""
        low, high = ends[0] < self.inner_low, ends[1] > self.inner_high
        return [(axis, upper) for axis, upper in self.signs if (high if upper else low)[axis]]

    def own(self, points: Array) -> Indices:
        """Return the numbers of the points, the same on all ranks, that lie in this rank's cells, ``(n,)``."""
        return np.flatnonzero(self.owners(self._wrap(points[:, : self.grid.dim])) == self.grid.comm.rank)

    def stay(self, chi: Array) -> Transfer:
        """Prepare spreading and interpolation for points that stay in this rank's cells, see `own`.

        Args:
            chi: Positions of this rank's points, ``(num_points, 3)`` [cm].

        Raises:
            StabilityError: As in `at`, but on the rank of the point, and up to half a spacing nearer to a side:
                forces on the faces of a side are the side's to bear.
        """
        ends = point_kernels.extent(chi[:, : self.grid.dim])
        place, problem = self._check(chi, ends, self.low_rigid, self.high_rigid)
        if problem is not None:
            raise StabilityError(problem)
        return Transfer(self, place, len(chi), None, None)

    def _wrap(self, place: Array) -> Array:
        grid = self.grid
        if not any(grid.periodic[: grid.dim]):
            return place
        place = place.copy()
        for axis in range(grid.dim):
            if grid.periodic[axis] and grid.uniform[axis]:
                lower, length = grid.lower[axis], grid.upper[axis] - grid.lower[axis]
                x = (place[:, axis] - lower) % length
                place[:, axis] = lower + np.where(x >= length, 0.0, x)
        return place

    def owners(self, place: Array) -> Indices:
        """Rank that owns the cell of each point inside the box, ``(num_points,)``."""
        grid = self.grid
        cell = [
            np.minimum((place[:, a] - grid.origin[a]) / grid.spacing[a], grid.cells[a] - 1).astype(np.intp)
            for a in range(2)
        ]
        return self.owner[0][cell[0]] + self.owner[1][cell[1]]


class Transfer:
    """Spreading and interpolation for one position of the points; made by `Coupling.at` and `Coupling.stay`."""

    def __init__(
        self, coupling: Coupling, place: Array | None, count: int, problem: str | None, ends: Array | None
    ) -> None:
        self.coupling, self.count = coupling, count
        comm = coupling.grid.comm
        self.route = None
        if comm.size > 1 and ends is not None:  # points that stay are where they belong
            self.route = Route(comm, coupling.owners(place) if place is not None else None)
        failed = self.route.failed if self.route else problem is not None
        if failed:
            raise StabilityError(_first_problem(comm, problem))
        assert place is not None  # or it would have failed
        self.x = np.ascontiguousarray(self.route.send(place) if self.route else place)
        self.sides: list[mirrors.Side] = []
        if ends is not None and coupling.signs:
            self.sides = coupling.sides_near(point_kernels.extent(self.x) if self.route else ends)

    def spread(self, F: Array, out: Faces | None = None) -> Faces:
        """Spread nodal forces to the MAC faces, f = S[chi] F.

            f_d(x) = sum_k F_d(k) delta_h(x - chi_k)          (Lee2020, S13)

        Args:
            F: Force of this rank's points, ``(num_points, 3)`` [dyn].
            out: Faces to add to; new ones by default.

        Returns:
            Force density on the owned faces, one local array per axis [dyn/cm^3].

        Note:
            Collective. Keeps the total force to round-off, but for what a side near by bears.
        """
        grid = self.coupling.grid
        out = grid.zero_faces() if out is None else out
        F = np.ascontiguousarray(F[:, : grid.dim])
        F = self.route.send(F) if self.route else F
        c, faces = self.coupling, tuple(out[: grid.dim])
        kernels.spread(faces, self.x, F, 1.0 / grid.cell_volume, c.kind, c.geometry, c.rows)
        if self.sides:
            mirrors.fold(out, grid, self.coupling.signs, self.sides)
        grid.add_ghosts(out)
        return out

    def interpolate(self, u: Faces) -> Array:
        """Interpolate a face velocity to the points, U = S*[chi] u.

            U_d(k) = sum_x u_d(x) delta_h(x - chi_k) h^3      (Lee2020, S14)

        Args:
            u: Velocity with filled ghosts, one local array per axis [cm/s].

        Returns:
            Velocity of this rank's points, ``(num_points, 3)`` [cm/s].

        Note:
            Collective.
        """
        grid = self.coupling.grid
        c, values = self.coupling, np.empty((len(self.x), grid.dim))
        kernels.interpolate(values, self.x, tuple(u[: grid.dim]), c.kind, c.geometry, c.rows)
        values = self.route.send_back(values) if self.route else values
        if grid.dim == 3:
            return values
        U = np.zeros((self.count, 3))
        U[:, :2] = values
        return U

    def smooth(self, F: Array) -> Array:
        """Return the force density that the points feel of their own forces, S*[chi] S[chi] F, ``(num_points, 3)``.

        Sides reflect nothing here, so that it is symmetric and not negative wherever the points are.

        Args:
            F: Force of this rank's points, ``(num_points, 3)`` [dyn].

        Returns:
            Force density [dyn/cm^3].

        Note:
            Collective.
        """
        grid, c = self.coupling.grid, self.coupling
        f = grid.zero_faces()
        F = np.ascontiguousarray(F[:, : grid.dim])
        F = self.route.send(F) if self.route else F
        kernels.spread(tuple(f[: grid.dim]), self.x, F, 1.0 / grid.cell_volume, c.kind, c.geometry, c.rows)
        grid.add_ghosts(f)
        grid.exchange(f)
        return self.interpolate(f)


class Route:
    """Where each point goes and how its results come back.

    Args:
        comm: Communicator of the grid.
        owners: Rank that each of this rank's points goes to; None where this rank has found a fault, which
            all ranks then see in `failed`.
    """

    def __init__(self, comm: MPI.Comm, owners: Indices | None) -> None:
        self.comm = comm
        counts = np.full(comm.size, -1, dtype=np.intc)
        if owners is not None:
            counts = np.bincount(owners, minlength=comm.size).astype(np.intc)
            self.order = np.argsort(owners, kind="stable")
        received = np.empty_like(counts)
        comm.Alltoall(counts, received)
        self.failed = bool(received.min() < 0)
        self.sent, self.received = counts, received

    def send(self, values: Array) -> Array:
        """Send one row per point to the owners, ``(num_points, k)`` to ``(num_received, k)``. Collective."""
        k = values.shape[1]
        out = np.empty((self.received.sum(), k))
        self.comm.Alltoallv((values[self.order], self.sent * k), (out, self.received * k))
        return out

    def send_back(self, values: Array) -> Array:
        """Return one row per received point to where it came from. Collective."""
        k = values.shape[1]
        buffer = np.empty((len(self.order), k))
        self.comm.Alltoallv((values, self.received * k), (buffer, self.sent * k))
        out = np.empty_like(buffer)
        out[self.order] = buffer
        return out


def _first_problem(comm: MPI.Comm, problem: str | None) -> str:
    return next(found for found in comm.allgather(problem) if found is not None)
