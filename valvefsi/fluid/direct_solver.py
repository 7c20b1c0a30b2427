"""Direct solver of tensor-product operators: fast diagonalisation (Lynch, Rice and Thomas 1964).

The operator a - b (D0 + D1 + D2), a sum of one-dimensional second differences, is diagonal in the product of
their eigenvectors: transform along each axis, divide, transform back. See `valvefsi.fluid.axes` for the transforms.
Where axis 0 is not periodic it is not transformed: its lines are eliminated, see `valvefsi.fluid.line_solver`, unless
the modes are asked for.

In parallel every rank holds whole lines of axis 2, and two transposes give it whole lines of axis 1 and axis 0.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
from mpi4py import MPI

from valvefsi.fluid.axes import Axis
from valvefsi.fluid.line_solver import LineSolver
from valvefsi.fluid.stencils import divide
from valvefsi.grid import MacGrid
from valvefsi.types import Array


class TensorSolver:
    """Solve (a - b (D0 + D1 + D2)) x = r for one cell or face field of a grid.

    Args:
        grid: The grid.
        kinds: Kind of each of the three axes, see `valvefsi.fluid.axes.KINDS`.

    Attributes:
        axes: The three axes.
        modes: Slices of the modes that this rank holds between the transforms.
        eigenvalues: Eigenvalues of this rank's modes along each axis [1/cm^2].
    """

    def __init__(self, grid: MacGrid, kinds: tuple[str, str, str]) -> None:
        self.comm = grid.comm
        self.axes = [Axis(kind, widths) for kind, widths in zip(kinds, grid.cell_widths, strict=True)]
        sizes = [axis.size for axis in self.axes]
        n0, n1 = grid.process_grid
        # Bounds of what each rank owns: of the unknowns along axes 0 and 1, and of the split of axes 1 and 2.
        home = [np.maximum(s - axis.skip, 0) for s, axis in zip(grid.starts, self.axes, strict=True)]
        for bounds, size in zip(home, sizes, strict=True):
            bounds[-1] = size
        self.transposes = (
            Transpose(grid.axis_comms[1], 1, home[1], 2, _split(sizes[2], n1)) if n1 > 1 else None,
            Transpose(grid.axis_comms[0], 0, home[0], 1, _split(sizes[1], n0)) if n0 > 1 else None,
        )
        i0, i1 = grid.position
        own1 = slice(*_split(sizes[1], n0)[i0 : i0 + 2]) if n0 > 1 else slice(0, sizes[1])
        own2 = slice(*_split(sizes[2], n1)[i1 : i1 + 2]) if n1 > 1 else slice(0, sizes[2])
        self.modes = (slice(0, sizes[0]), own1, own2)
        # The constant mode of a singular operator must be exactly zero for `divide` to recognise it.
        self.eigenvalues = tuple(
            np.ascontiguousarray(axis.eigenvalues[own])
            for axis, own in zip(self.axes, self.modes, strict=True)
        )
        self.lines = LineSolver(self.axes[0]) if kinds[0] != "periodic" else None

    @property
    def singular(self) -> bool:
        """Whether constants are in the null space of D0 + D1 + D2."""
        return all(axis.eigenvalues.max(initial=-np.inf) == 0.0 for axis in self.axes)

    def solve(self, r: Array, a: float, b: float, correct: Callable[[Array], None] | None = None) -> Array:
        """Return x with (a - b (D0 + D1 + D2)) x = r; its constant part is zero where the operator is singular.

        Args:
            r: Right-hand side on this rank's unknowns, contiguous, ``(n0, n1, n2)``; is overwritten.
            a: Multiple of the identity.
            b: Multiple of the second differences.
            correct: Called with the modes of x, which it may change, before they are transformed back.

        Returns:
            Solution on this rank's unknowns, same shape.

        Note:
            Collective.
        """
        first, second = self.transposes
        x = self.axes[2].transform(r, 2)
        x = first.forward(x) if first else x
        x = self.axes[1].transform(x, 1)
        x = second.forward(x) if second else x
        if self.lines is not None and correct is None:
            _, l1, l2 = self.eigenvalues
            x = self.lines.solve(x, a - b * (l1[:, None] + l2), b)
        else:
            x = self._along_modes(x, a, b, correct)
        x = second.backward(x) if second else x
        x = self.axes[1].transform(x, 1, inverse=True)
        x = first.backward(x) if first else x
        return self.axes[2].transform(x, 2, inverse=True)

    def _along_modes(self, x: Array, a: float, b: float, correct: Callable[[Array], None] | None) -> Array:
        """Transform along axis 0, divide, correct and transform back."""
        x = self.axes[0].transform(x, 0)
        divide(x, self.eigenvalues, a, b)
        if correct is not None:
            correct(x)
        return self.axes[0].transform(x, 0, inverse=True)


def _split(size: int, parts: int) -> Array:
    return np.array([size * r // parts for r in range(parts + 1)])


class Transpose:
    """Redistribute an array: lines of one axis are gathered whole while another axis is divided.

    Args:
        comm: Ranks that take part.
        gathered: Axis that is divided at first and whole afterwards.
        bounds: Its division, ``(ranks + 1,)``.
        divided: Axis that is whole at first and divided afterwards.
        new_bounds: Its division, ``(ranks + 1,)``.
    """

    def __init__(self, comm: MPI.Comm, gathered: int, bounds: Array, divided: int, new_bounds: Array) -> None:
        self.comm, self.gathered, self.divided = comm, gathered, divided
        self.gathered_slices = [slice(a, b) for a, b in itertools.pairwise(bounds)]
        self.divided_slices = [slice(a, b) for a, b in itertools.pairwise(new_bounds)]

    def forward(self, x: Array) -> Array:
        """Gather the one axis and divide the other. Collective."""
        return self._exchange(x, self.divided, self.divided_slices, self.gathered, self.gathered_slices)

    def backward(self, x: Array) -> Array:
        """Undo `forward`. Collective."""
        return self._exchange(x, self.gathered, self.gathered_slices, self.divided, self.divided_slices)

    def _exchange(self, x: Array, split: int, pieces: list[slice], join: int, places: list[slice]) -> Array:
        """Each piece is packed once and unpacked once; what stays on this rank is copied straight to its place."""
        rank = self.comm.rank
        shape = list(x.shape)
        shape[split] = pieces[rank].stop - pieces[rank].start
        shape[join] = places[-1].stop
        out = np.empty(shape)
        rest = shape[3 - split - join]
        thick = x.shape[join]
        sizes = [rest * thick * (piece.stop - piece.start) for piece in pieces]
        counts = [rest * shape[split] * (place.stop - place.start) for place in places]
        sizes[rank] = counts[rank] = 0
        sent, received = np.empty(sum(sizes)), np.empty(sum(counts))
        offset = 0
        for piece, size in zip(pieces, sizes, strict=True):
            if size:
                part = x[_at(split, piece)]
                sent[offset : offset + size].reshape(part.shape)[...] = part
                offset += size
        self.comm.Alltoallv((sent, sizes), (received, counts))
        out[_at(join, places[rank])] = x[_at(split, pieces[rank])]
        offset = 0
        for place, count in zip(places, counts, strict=True):
            if count:
                target = out[_at(join, place)]
                target[...] = received[offset : offset + count].reshape(target.shape)
                offset += count
        return out


def _at(axis: int, piece: slice) -> tuple[slice, ...]:
    return (slice(None),) * axis + (piece,)
