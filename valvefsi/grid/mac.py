"""The staggered (MAC) grid: extents, spacing, ownership, ghost layers, positions.

Pressure sits in cell centres, velocity component d on the faces normal to axis d; face ``i`` of an axis is the lower
face of cell ``i``. Two dimensions are a grid one periodic cell of 1 cm thick, so that a force per depth and a
force have the same number. Every field is a C-contiguous local array with ghost layers; on the last rank of an
axis that is not periodic, the boundary face ``n`` of the component normal to it lies in the first upper ghost layer.

Ranks form a grid over axes 0 and 1; axis 2 is never divided.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from mpi4py import MPI

from valvefsi.types import Array, Faces, Slices

GHOSTS = 4
"""Ghost layers: the upwind reconstruction reaches four, the widest kernel (six points) three."""

UNIFORM = 1e-9
"""Relative difference of widths that counts as none."""

DEPTH = 1.0
"""Thickness of a two-dimensional grid [cm]."""


def _free(comm: MPI.Comm, _: int, along: dict[int, tuple[MPI.Comm, MPI.Comm]]) -> None:
    for pair in along.values():
        for part in pair:
            part.Free()


@functools.cache
def _along_axes_key() -> int:
    """Return the key, made at the first use: an import begins nothing of MPI."""
    return MPI.Comm.Create_keyval(delete_fn=_free)


def _along_axes(comm: MPI.Comm, n1: int) -> tuple[MPI.Comm, MPI.Comm]:
    """Return the communicators along each divided axis: all ranks that share the other coordinate.

    They stay with the communicator that they divide, for every grid on it: an MPI library has only some two thousand,
    and to free one is collective, which the end of an object in Python is not.
    """
    along: Any = comm.Get_attr(_along_axes_key())
    if along is None:
        along = {}
        comm.Set_attr(_along_axes_key(), along)
    if n1 not in along:
        along[n1] = comm.Split(comm.rank % n1), comm.Split(comm.rank // n1)
    pair: tuple[MPI.Comm, MPI.Comm] = along[n1]
    return pair


def divided(cells: Sequence[int], ranks: int) -> tuple[int, int] | None:
    """Return the ranks along axes 0 and 1 of a grid, None where every division leaves slabs thinner than the ghosts.

    Slabs along axis 0 (one transpose fewer), pencils where those would be too thin.
    """
    for n1 in range(1, ranks + 1 if len(cells) == 3 else 2):
        n0 = ranks // n1
        if n0 * n1 == ranks and cells[0] // n0 >= GHOSTS and cells[1] // n1 >= GHOSTS:
            return n0, n1
    return None


class MacGrid:
    """A staggered grid over a box, divided among the ranks of a communicator; uniform, or graded by `graded`.

    Args:
        lower: Lower corner of the box, ``(2,)`` or ``(3,)`` [cm].
        upper: Upper corner of the box, same length [cm].
        cells: Number of cells along each axis, same length.
        periodic: Whether each axis is periodic, same length.
        comm: Communicator; the world by default.
        process_grid: Ranks along axes 0 and 1; chosen when not given.

    Attributes:
        spacing: Grid spacing, the smallest on a graded axis [cm].
        cell_widths: Widths of all cells along each axis [cm].
        widths: Widths of the local cells along each axis, ghosts included [cm].
        gaps: Distance of the centres on both sides of each local face, ghosts included [cm].
        uniform: Whether each axis has one spacing.
        fine: Along each axis the bounds of the region where cells have the smallest width, ``(2,)`` [cm].
        origin: Where cell 0 would begin if all cells had the width of those in ``fine``, ``(3,)`` [cm].

    Raises:
        ValueError: Lengths differ, an extent or a cell count is not positive, or a rank would own fewer cells than
            the ghost layers are wide.
    """

    def __init__(
        self,
        lower: Sequence[float],
        upper: Sequence[float],
        cells: Sequence[int],
        periodic: Sequence[bool],
        comm: MPI.Comm = MPI.COMM_WORLD,
        process_grid: tuple[int, int] | None = None,
    ) -> None:
        self.dim = len(cells)
        if self.dim not in (2, 3) or not len(lower) == len(upper) == len(periodic) == self.dim:
            raise ValueError(f"lower, upper, cells and periodic need 2 or 3 entries each, got {cells}")
        flat = self.dim == 2
        self.cells = (*map(int, cells), 1)[:3]
        self.lower = np.array([*lower, 0.0][:3], dtype=float)
        self.upper = np.array([*upper, DEPTH][:3], dtype=float)
        self.periodic = (*map(bool, periodic), True)[:3]
        if min(self.cells) < 1 or not np.all(self.upper > self.lower):
            raise ValueError(f"a box needs upper > lower and cells > 0, got {lower}, {upper}, {cells}")
        self.spacing = (self.upper - self.lower) / self.cells
        self.ghosts = (GHOSTS, GHOSTS, 0 if flat else GHOSTS)
        self.comm = comm
        self.process_grid = process_grid or divided(self.cells[: self.dim], comm.size) or (comm.size, 1)
        self._divide()
        self._set_widths([np.full(n, h) for n, h in zip(self.cells, self.spacing, strict=True)])

    @classmethod
    def graded(
        cls,
        edges: Sequence[Sequence[float] | Array],
        periodic: Sequence[bool],
        comm: MPI.Comm = MPI.COMM_WORLD,
        process_grid: tuple[int, int] | None = None,
    ) -> MacGrid:
        """Return a grid from the positions of the cells' edges, see `valvefsi.grid.grading`.

        Args:
            edges: Increasing positions along each axis, 2 or 3 of ``(cells + 1,)`` [cm].
            periodic: Whether each axis is periodic, same length.
            comm: Communicator; the world by default.
            process_grid: Ranks along axes 0 and 1; chosen when not given.

        Raises:
            ValueError: As for the class, or positions do not increase.
        """
        ends = [np.asarray(e, dtype=float) for e in edges]
        if any(e.ndim != 1 or len(e) < 2 or not np.all(np.diff(e) > 0.0) for e in ends):
            raise ValueError("the edges of cells must increase along every axis")
        grid = cls(
            [e[0] for e in ends],
            [e[-1] for e in ends],
            [len(e) - 1 for e in ends],
            periodic,
            comm,
            process_grid,
        )
        widths = [np.diff(e) for e in ends] + [grid.cell_widths[2]][: 3 - grid.dim]
        grid._set_widths(
            [
                w if np.ptp(w) > UNIFORM * w.max() else uniform
                for w, uniform in zip(widths, grid.cell_widths, strict=True)
            ]
        )
        return grid

    def _set_widths(self, widths: Sequence[Array]) -> None:
        """Set what follows from the widths of all cells along each axis."""
        self.cell_widths = tuple(widths)
        self.uniform = tuple(bool(np.ptp(w) == 0.0) for w in widths)
        self.spacing = np.array([w.min() for w in widths])
        self.widths, self.gaps, self._edges = [], [], []
        self.fine, self.origin = [], np.zeros(3)
        for axis, w in enumerate(widths):
            g, first = self.ghosts[axis], self.start[axis]
            wide = np.pad(w, g + 1, mode="wrap" if self.periodic[axis] else "symmetric")
            local = slice(first + 1, first + 1 + self.shape[axis])
            self.widths.append(wide[local])
            self.gaps.append(0.5 * (wide[first : first + self.shape[axis]] + wide[local]))
            edges = self.lower[axis] + np.concatenate([[0.0], np.cumsum(w)])
            outer = np.cumsum(wide) - np.cumsum(wide)[g] + self.lower[axis]
            self._edges.append(outer[first : first + self.shape[axis] + 1])
            small = np.flatnonzero(w <= w.min() * (1.0 + UNIFORM))
            run = small[: np.argmax(np.diff(small, append=small[-1] + 2) > 1) + 1]  # the first without a gap
            self.fine.append((edges[run[0]], edges[run[-1] + 1]))
            self.origin[axis] = self.lower[axis] if self.uniform[axis] else edges[run[0]] - run[0] * w.min()

    def _divide(self) -> None:
        n0, n1 = self.process_grid
        if n0 * n1 != self.comm.size:
            raise ValueError(f"a process grid of {n0} x {n1} does not make {self.comm.size} ranks")
        if any(n // p < min(GHOSTS, n) for n, p in zip(self.cells, (n0, n1), strict=False)):
            raise ValueError(
                f"{self.comm.size} ranks are too many for a grid of {self.cells[: self.dim]} cells"
            )
        self.position = divmod(self.comm.rank, n1)
        self.starts = tuple(
            np.array([n * r // p for r in range(p + 1)]) for n, p in zip(self.cells, (n0, n1, 1), strict=True)
        )
        place = (*self.position, 0)
        self.start = tuple(int(s[r]) for s, r in zip(self.starts, place, strict=True))
        self.size = tuple(int(s[r + 1] - s[r]) for s, r in zip(self.starts, place, strict=True))
        self.is_first = tuple(r == 0 for r in place)
        self.is_last = tuple(r == p - 1 for r, p in zip(place, (n0, n1, 1), strict=True))
        self.shape = tuple(n + 2 * g for n, g in zip(self.size, self.ghosts, strict=True))
        x, y, z = (slice(g, g + n) for n, g in zip(self.size, self.ghosts, strict=True))
        self.owned = (x, y, z)
        self.axis_comms = (self.comm, MPI.COMM_SELF) if n1 == 1 else _along_axes(self.comm, n1)

    def owned_faces(self, d: int) -> Slices:
        """Slices of the owned faces of component d, boundary face ``n`` included on its last rank."""
        extra = int(self.is_last[d] and not self.periodic[d])
        x, y, z = (slice(s.start, s.stop + (extra if axis == d else 0)) for axis, s in enumerate(self.owned))
        return x, y, z

    def unknown_faces(self, d: int) -> Slices:
        """Slices of the owned faces of component d that are not on a side: the unknowns of the momentum equation."""
        skip = int(self.is_first[d] and not self.periodic[d])
        x, y, z = (slice(s.start + (skip if axis == d else 0), s.stop) for axis, s in enumerate(self.owned))
        return x, y, z

    def face_shape(self, d: int) -> tuple[int, int, int]:
        """Global number of faces of component d along each axis."""
        x, y, z = (n + int(axis == d and not self.periodic[d]) for axis, n in enumerate(self.cells))
        return x, y, z

    def zeros(self) -> Array:
        """Return a local cell or face array of zeros, ghosts included."""
        return np.zeros(self.shape)

    def zero_faces(self) -> Faces:
        """Return one local array of zeros per velocity component."""
        return tuple(self.zeros() for _ in range(self.dim))

    def coordinates(self, axis: int, *, on_faces: bool) -> Array:
        """Positions along an axis of all local entries, ghosts included [cm]."""
        if not self.uniform[axis]:
            edges = self._edges[axis]
            return edges[:-1].copy() if on_faces else 0.5 * (edges[:-1] + edges[1:])
        index = np.arange(self.shape[axis]) - self.ghosts[axis] + self.start[axis]
        return self.lower[axis] + (index + (0.0 if on_faces else 0.5)) * self.spacing[axis]

    def centres(self, axis: int) -> Array:
        """Positions of the centres of all cells along an axis, of all ranks [cm]."""
        if self.uniform[axis]:
            return self.lower[axis] + (np.arange(self.cells[axis]) + 0.5) * self.spacing[axis]
        edges = self.lower[axis] + np.concatenate([[0.0], np.cumsum(self.cell_widths[axis])])
        return 0.5 * (edges[:-1] + edges[1:])

    def points(self, d: int | None = None) -> Faces:
        """Open-mesh coordinates of the local cell centres (None) or of the faces of component d, ghosts included."""
        axes = [self.coordinates(axis, on_faces=axis == d) for axis in range(3)]
        return tuple(np.meshgrid(*axes, indexing="ij", sparse=True))

    @property
    def cell_volume(self) -> float:
        """Volume of the smallest cell, that of every cell of a uniform grid [cm^3]."""
        return float(np.prod(self.spacing))

    def volumes(self, d: int | None = None) -> Array:
        """Volumes of the local cells (None) or of the control volumes of component d, ghosts included [cm^3].

        A face on a side that is not periodic has half the volume of one inside.
        """
        sizes = [self.gaps[a] if a == d else self.widths[a] for a in range(3)]
        if d is not None and not self.periodic[d]:
            sizes[d] = sizes[d].copy()
            g, n = self.ghosts[d], self.size[d]
            sizes[d][[i for i, at_end in ((g, self.is_first[d]), (g + n, self.is_last[d])) if at_end]] *= 0.5
        return sizes[0][:, None, None] * sizes[1][:, None] * sizes[2]

    # Ghost layers -----------------------------------------------------------------------------------------------

    def exchange(self, arrays: Sequence[Array], width: int = GHOSTS) -> None:
        """Fill ghost layers from the ranks (or the periodic images) that own them; sides are left alone.

        Args:
            arrays: Local arrays with ghosts.
            width: Number of layers to fill, at most `GHOSTS`.

        Note:
            Collective. Corners are filled too.
        """
        for axis in (2, 1, 0):
            if self.ghosts[axis]:
                self._move_layers(arrays, axis, min(width, self.ghosts[axis]), add=False)

    def add_ghosts(self, arrays: Sequence[Array], width: int = GHOSTS) -> None:
        """Add ghost layers onto the entries they are images of, then clear them: the adjoint of `exchange`.

        Note:
            Collective. Layers beyond a side that is not periodic are left alone.
        """
        for axis in (0, 1, 2):
            if self.ghosts[axis]:
                self._move_layers(arrays, axis, min(width, self.ghosts[axis]), add=True)

    def _move_layers(self, arrays: Sequence[Array], axis: int, width: int, *, add: bool) -> None:
        g, n = self.ghosts[axis], self.size[axis]
        below, above = (g - width, g), (g + n, g + n + width)
        first, last = (g, g + width), (g + n - width, g + n)
        # (what leaves, where it goes to on the neighbour) toward the upper and the lower neighbour
        upward, downward = ((above, first), (below, last)) if add else ((last, below), (first, above))
        ranks = self.process_grid[axis] if axis < 2 else 1
        if ranks == 1:
            if self.periodic[axis]:
                for array in arrays:
                    for source, target in (upward, downward):
                        _put(_layer(array, axis, target), _layer(array, axis, source), add)
                    _clear(array, axis, (below, above), add)
            return
        comm, here = self.axis_comms[axis], self.position[axis]
        up, down = here + 1, here - 1
        if self.periodic[axis]:
            up, down = up % ranks, down % ranks
        else:
            up, down = (up if up < ranks else MPI.PROC_NULL), (down if down >= 0 else MPI.PROC_NULL)
        for (source, target), to, origin in ((upward, up, down), (downward, down, up)):
            sent = np.stack([_layer(array, axis, source) for array in arrays])
            received = np.empty_like(sent)
            comm.Sendrecv(sent, to, recvbuf=received, source=origin)
            for array, block in zip(arrays, received, strict=True):
                if origin != MPI.PROC_NULL:
                    _put(_layer(array, axis, target), block, add)
                if to != MPI.PROC_NULL:
                    _clear(array, axis, (source,), add)


def _layer(array: Array, axis: int, bounds: tuple[int, int]) -> Array:
    return array[(slice(None),) * axis + (slice(*bounds),)]


def _put(target: Array, values: Array, add: bool) -> None:
    if add:
        target += values
    else:
        target[...] = values


def _clear(array: Array, axis: int, layers: Sequence[tuple[int, int]], add: bool) -> None:
    if add:
        for bounds in layers:
            _layer(array, axis, bounds)[...] = 0.0
