"""Direct solver of tensor-product operators: fast diagonalisation (Lynch, Rice and Thomas 1964).

The operator a - b (D0 + D1 + D2), a sum of one-dimensional second differences, is diagonal in the product of
their eigenvectors: transform along each axis, divide, transform back. On a uniform axis the eigenvectors are those
of a discrete cosine, sine or Hartley transform. Short axes (`MATRIX_LIMIT`) use the matrix product with them, long
ones the fast transform.

In parallel every rank holds whole lines of axis 2, and two transposes give it whole lines of axis 1 and axis 0.
"""

from __future__ import annotations

import itertools

import numpy as np
import scipy.fft
from mpi4py import MPI

from valvefsi.fluid.stencils import divide
from valvefsi.grid import MacGrid

Array = np.ndarray

MATRIX_LIMIT = {"neumann": 64, "dirichlet": 64, "faces": 96, "periodic": 160}
"""Longest axis that is transformed by a matrix product: where it stops to be the faster one on one core (cubes of 48
to 128 cells, median over the three axes; the Hartley transform pays for its copies)."""


class Axis:
    """Second difference along one axis, with its eigenvalues and orthonormal transform.

    Args:
        kind: ``periodic``; ``neumann`` (cells, zero derivative at the sides); ``dirichlet`` (cells, value given at the
            sides half a cell away); ``faces`` (interior faces, value given on the boundary faces).
        cells: Number of cells along the axis.
        spacing: Grid spacing [cm].
    """

    def __init__(self, kind: str, cells: int, spacing: float) -> None:
        self.kind = kind
        self.size = cells - 1 if kind == "faces" else cells
        mode = np.arange(self.size) + (1 if kind in ("dirichlet", "faces") else 0)
        angle = np.pi * mode / cells * (1.0 if kind == "periodic" else 0.5)
        self.eigenvalues = -4.0 / spacing**2 * np.sin(angle) ** 2
        self.matrix = None
        if self.size <= MATRIX_LIMIT[kind]:
            self.matrix = np.ascontiguousarray(self._fast(np.eye(self.size), 0, inverse=False))

    def _fast(self, x: Array, axis: int, *, inverse: bool) -> Array:
        if self.kind == "periodic":
            return _hartley(x, axis)
        if self.kind == "neumann":
            transform, type_ = (scipy.fft.idct if inverse else scipy.fft.dct), 2
        else:
            transform, type_ = (
                (scipy.fft.idst if inverse else scipy.fft.dst),
                (1 if self.kind == "faces" else 2),
            )
        return transform(x, type=type_, axis=axis, norm="ortho", overwrite_x=True)

    def transform(self, x: Array, axis: int, *, inverse: bool = False) -> Array:
        """Transform a three-dimensional array along one of its axes (or back).

        Args:
            x: Array whose length along ``axis`` is `size`; may be overwritten.
            axis: Axis of the array.
            inverse: Whether to transform back.
        """
        if self.size == 1:
            return x
        if self.matrix is None:
            return self._fast(x, axis, inverse=inverse)
        matrix = self.matrix.T if inverse else self.matrix
        if axis == 0:
            return (matrix @ x.reshape(self.size, -1)).reshape(x.shape)
        if axis == 2:
            return (x.reshape(-1, self.size) @ matrix.T).reshape(x.shape)
        if x.shape[2] == 1:
            return (x[:, :, 0] @ matrix.T)[:, :, None]
        return np.matmul(matrix, x)


def _hartley(x: Array, axis: int) -> Array:
    """Orthonormal discrete Hartley transform, its own inverse: eigenvectors of every symmetric circulant matrix."""
    n = x.shape[axis]
    spectrum = np.moveaxis(scipy.fft.rfft(x, axis=axis, norm="ortho"), axis, 0)
    half, upper = spectrum.shape[0], (n + 1) // 2
    out = np.empty((n, *spectrum.shape[1:]))
    out[:half] = spectrum.real - spectrum.imag
    out[half:] = (spectrum.real + spectrum.imag)[1:upper][::-1]
    return np.ascontiguousarray(np.moveaxis(out, 0, axis))


class TensorSolver:
    """Solve (a - b (D0 + D1 + D2)) x = r for one cell or face field of a grid.

    Args:
        grid: The grid.
        kinds: Kind of each of the three axes, see `Axis`.
    """

    def __init__(self, grid: MacGrid, kinds: tuple[str, str, str]) -> None:
        self.axes = [Axis(k, n, h) for k, n, h in zip(kinds, grid.cells, grid.spacing, strict=True)]
        sizes = [axis.size for axis in self.axes]
        n0, n1 = grid.process_grid
        # Bounds of what each rank owns: of the unknowns along axes 0 and 1, and of the split of axes 1 and 2.
        home = [s - (kinds[axis] == "faces") for axis, s in enumerate(grid.starts)]
        home = [np.maximum(s, 0) for s in home]
        self.transposes = []
        if n1 > 1:
            self.transposes.append(Transpose(grid.axis_comms[1], 1, home[1], 2, _split(sizes[2], n1)))
        else:
            self.transposes.append(None)
        self.transposes.append(
            Transpose(grid.axis_comms[0], 0, home[0], 1, _split(sizes[1], n0)) if n0 > 1 else None
        )
        i0, i1 = grid.position
        own1 = slice(*_split(sizes[1], n0)[i0 : i0 + 2]) if n0 > 1 else slice(None)
        own2 = slice(*_split(sizes[2], n1)[i1 : i1 + 2]) if n1 > 1 else slice(None)
        lam = [axis.eigenvalues for axis in self.axes]
        # The constant mode of a singular operator must be exactly zero for `divide` to recognise it.
        self.eigenvalues = (lam[0], np.ascontiguousarray(lam[1][own1]), np.ascontiguousarray(lam[2][own2]))

    def solve(self, r: Array, a: float, b: float) -> Array:
        """Return x with (a - b (D0 + D1 + D2)) x = r; the mean of x is zero where the operator is singular.

        Args:
            r: Right-hand side on this rank's unknowns, contiguous, ``(n0, n1, n2)``; is overwritten.
            a: Multiple of the identity.
            b: Multiple of the second differences.

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
        x = self.axes[0].transform(x, 0)
        divide(x, self.eigenvalues, a, b)
        x = self.axes[0].transform(x, 0, inverse=True)
        x = second.backward(x) if second else x
        x = self.axes[1].transform(x, 1, inverse=True)
        x = first.backward(x) if first else x
        return self.axes[2].transform(x, 2, inverse=True)


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

    def _exchange(self, x: Array, split: int, pieces: list, join: int, places: list) -> Array:
        rank = self.comm.rank
        shape = list(x.shape)
        shape[split] = pieces[rank].stop - pieces[rank].start
        shape[join] = places[-1].stop
        out = np.empty(shape)
        rest = shape[3 - split - join]
        sent = [np.ascontiguousarray(x[_at(split, piece)]).ravel() for piece in pieces]
        counts = [rest * shape[split] * (place.stop - place.start) for place in places]
        received = np.empty(sum(counts))
        self.comm.Alltoallv((np.concatenate(sent), [s.size for s in sent]), (received, counts))
        offset = 0
        for place, count in zip(places, counts, strict=True):
            target = out[_at(join, place)]
            target[...] = received[offset : offset + count].reshape(target.shape)
            offset += count
        return out


def _at(axis: int, piece: slice) -> tuple[slice, ...]:
    return (slice(None),) * axis + (piece,)
