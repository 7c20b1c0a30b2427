"""Second differences along one axis of a staggered grid, with their eigenvalues and transforms.

On cells or on faces, with the value (D) or a zero derivative (N) given at either end, or periodic:

    cells: (D q)_i = [(q_{i+1} - q_i) / g_{i+1} - (q_i - q_{i-1}) / g_i] / w_i
    faces: (D q)_i = [(q_{i+1} - q_i) / w_i - (q_i - q_{i-1}) / w_{i-1}] / g_i

w are the widths of the cells and g the distances of their centres; beyond an end values are reflected about it.
Faces on an end with a given value are no unknowns, those on an end with zero derivative are. With M the diagonal
matrix of control volumes (half of one at such an end), M^(1/2) D M^(-1/2) is symmetric and has an orthonormal basis Q
of eigenvectors: a discrete cosine, sine or Fourier transform on a uniform axis. The transform along the axis is
Q^T M^(1/2), the one back M^(-1/2) Q, up to a factor per mode that cancels. The Fourier transform packs cosines and
sines into one real array: at 128 points 0.2 to 0.45 of the time of a matrix product, depending on the axis, and 0.12 to
0.32 of that of a Hartley transform made from a complex one.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.fft
import scipy.fftpack

from valvefsi.runtime import threads
from valvefsi.types import Array

KINDS = (
    "periodic",
    *(f"{where} {ends}" for where in ("cells", "faces") for ends in ("NN", "DD", "ND", "DN")),
)
"""Kinds of an axis: where the unknowns sit, and what is given at the lower and the upper end."""

FAST = {
    "cells NN": ("dct", 2),
    "cells DD": ("dst", 2),
    "cells ND": ("dct", 4),
    "cells DN": ("dst", 4),
    "faces NN": ("dct", 1),
    "faces DD": ("dst", 1),
    "faces ND": ("dct", 3),
    "faces DN": ("dst", 3),
}
"""Transform of each kind on a uniform axis."""

MATRIX_LIMIT = {kind: 32 if kind == "periodic" else 96 if kind == "faces DD" else 64 for kind in KINDS}
"""Longest uniform axis that is transformed by a matrix product: where it stops to be the faster one on one core (cubes
of 48 to 128 cells, median over the three axes)."""


class Axis:
    """Second difference along one axis, with its eigenvalues and transform.

    Args:
        kind: One of `KINDS`.
        widths: Widths of all cells along the axis, ``(n,)`` [cm].

    Attributes:
        size: Number of unknowns.
        skip: Number of faces at the lower end that are no unknowns, 0 or 1.
        eigenvalues: ``(size,)``, not positive [1/cm^2].

    Raises:
        ValueError: An unknown kind.
    """

    def __init__(self, kind: str, widths: Array) -> None:
        if kind not in KINDS:
            raise ValueError(f"unknown kind of axis {kind!r}, one of {', '.join(KINDS)}")
        widths = np.asarray(widths, dtype=float)
        self.kind, self.widths = kind, widths
        n = len(widths)
        on_faces = kind.startswith("faces")
        self.skip = int(on_faces and kind[6] == "D")
        self.size = n + 1 - self.skip - int(kind[-1] == "D") if on_faces else n
        self.uniform = bool(np.ptp(widths) <= 1e-12 * widths.max())
        self.volumes = self._volumes()
        self.matrix: Array | None = None
        self.inverse_matrix: Array | None = None
        if not self.uniform:
            self.eigenvalues, vectors = self._eigenvectors()
            root = np.sqrt(self.volumes)
            self.matrix = np.ascontiguousarray(vectors.T * root)
            self.inverse_matrix = np.ascontiguousarray(vectors / root[:, None])
            return
        self.eigenvalues = self._uniform_eigenvalues(widths[0])
        if self.size <= MATRIX_LIMIT[kind]:
            unit = np.eye(self.size)
            self.matrix = np.ascontiguousarray(self._fast(unit.copy(), 0, inverse=False))
            self.inverse_matrix = np.ascontiguousarray(self._fast(unit, 0, inverse=True))

    def _volumes(self) -> Array:
        """Control volumes of the unknowns."""
        w = self.widths
        if self.kind == "periodic" or self.kind.startswith("cells"):
            return w
        gaps = np.concatenate([[0.5 * w[0]], 0.5 * (w[:-1] + w[1:]), [0.5 * w[-1]]])
        return gaps[self.skip : self.skip + self.size]

    def second_difference(self) -> Array:
        """Return D as a dense matrix, ``(size, size)`` [1/cm^2]."""
        return self._symmetric_part() / self.volumes[:, None]

    def bands(self) -> tuple[Array, Array]:
        """Return the diagonal of M D, ``(size,)``, and what is beside it, zero beyond the ends, ``(size + 1,)`` [1/cm].

        M D is tridiagonal unless the axis is periodic.
        """
        K = self._symmetric_part()
        return np.diag(K).copy(), np.pad(np.diag(K, 1), 1)

    def _symmetric_part(self) -> Array:
        """Return M D, a graph Laplacian: one coupling per pair of neighbours, and one per end with a given value."""
        w, n = self.widths, len(self.widths)
        K = np.zeros((n + 2, n + 2))  # cells 0 .. n-1 or faces 0 .. n, and one place more for what is given
        if self.kind.startswith("faces"):
            pairs = [(i, i + 1, 1.0 / w[i]) for i in range(n)]
        else:
            pairs = [(i, i + 1, 2.0 / (w[i] + w[i + 1])) for i in range(n - 1)]
            if self.kind == "periodic":
                pairs.append((n - 1, 0, 2.0 / (w[0] + w[-1])))
            else:
                ends = ((self.kind[-2], 0), (self.kind[-1], n - 1))
                pairs += [(i, n, 2.0 / w[i]) for end, i in ends if end == "D"]
        for i, j, k in pairs:
            if i != j:
                K[i, i] -= k
                K[j, j] -= k
                K[i, j] += k
                K[j, i] += k
        return K[self.skip : self.skip + self.size, self.skip : self.skip + self.size]

    def _eigenvectors(self) -> tuple[Array, Array]:
        root = np.sqrt(self.volumes)
        values, vectors = np.linalg.eigh(self._symmetric_part() / np.outer(root, root))
        if self.kind in ("periodic", "cells NN", "faces NN"):
            values[-1] = 0.0  # the constant; what divides by the sum of such values must see an exact zero
        return values, vectors

    def _uniform_eigenvalues(self, h: float) -> Array:
        first = {"NN": 0.0, "DD": 1.0}.get(self.kind[-2:], 0.5)
        number = np.arange(self.size)
        if self.kind == "periodic":  # wave numbers 0, 1, 1, 2, 2, ...
            angle = np.pi * ((number + 1) // 2) / len(self.widths)
        else:
            angle = np.pi * (number + first) / len(self.widths) * 0.5
        return -4.0 / h**2 * np.sin(angle) ** 2

    def _fast(self, x: Array, axis: int, *, inverse: bool) -> Array:
        if self.kind == "periodic":
            return _in_parts(lambda part: fourier(part, axis, inverse=inverse), x, axis)
        name, type_ = FAST[self.kind]
        if self.kind.startswith("faces") and not inverse:
            self._scale_ends(x, axis, np.sqrt(0.5))
        transform = getattr(scipy.fft, f"i{name}" if inverse else name)
        options = {"type": type_, "axis": axis, "norm": "ortho", "overwrite_x": True}
        x = _in_parts(lambda part: transform(part, **options), x, axis)
        if self.kind.startswith("faces") and inverse:
            self._scale_ends(x, axis, np.sqrt(2.0))
        return x

    def _scale_ends(self, x: Array, axis: int, factor: float) -> None:
        """Multiply the faces on ends with zero derivative, whose control volume is a half."""
        for end, place in ((self.kind[-2], 0), (self.kind[-1], -1)):
            if end == "N":
                x[(slice(None),) * axis + (place,)] *= factor

    def transform(self, x: Array, axis: int, *, inverse: bool = False) -> Array:
        """Transform a three-dimensional array along one of its axes (or back).

        Args:
            x: Array whose length along ``axis`` is `size`; may be overwritten.
            axis: Axis of the array.
            inverse: Whether to transform back.
        """
        if self.size == 1 and self.uniform:
            return x
        matrix = self.inverse_matrix if inverse else self.matrix
        if matrix is None:
            return self._fast(x, axis, inverse=inverse)
        if axis == 0:
            return (matrix @ x.reshape(self.size, -1)).reshape(x.shape)
        if axis == 2:
            return (x.reshape(-1, self.size) @ matrix.T).reshape(x.shape)
        if x.shape[2] == 1:
            return (x[:, :, 0] @ matrix.T)[:, :, None]
        return np.matmul(matrix, x)

    def row(self, place: int, *, inverse: bool = False) -> Array:
        """Return what one unknown adds to every mode, or (inverse) every mode to that unknown, ``(size,)``."""
        unit = np.zeros((self.size, 1, 1))
        if not inverse:
            unit[place] = 1.0
            return self.transform(unit, 0).ravel()
        return self.dense(inverse=True)[place]

    def dense(self, *, inverse: bool = False) -> Array:
        """Return the transform (or the one back) as a matrix, ``(size, size)``."""
        given = self.inverse_matrix if inverse else self.matrix
        if given is not None:
            return given
        return self._fast(np.eye(self.size), 0, inverse=inverse)


def _in_parts(transform: Callable[[Array], Array], x: Array, axis: int) -> Array:
    """Transform along an axis, by as many threads as pay; x may be overwritten."""
    if threads.share(x.size) == 1 or x.ndim < 2:
        return transform(x)

    def loop(first: int, last: int) -> None:
        part = x[:, first:last] if axis == 0 else x[first:last]
        done = transform(part)
        if not np.may_share_memory(done, part):
            part[...] = done

    threads.divide(loop, 0, x.shape[1 if axis == 0 else 0], least=1)
    return x


def fourier(x: Array, axis: int, *, inverse: bool) -> Array:
    """Real Fourier transform in packed order: the mean, then the cosine and the sine of every wave number.

    They are eigenvectors of every symmetric circulant matrix. The transform is not normalised, only the one back is.
    """
    transform = scipy.fftpack.irfft if inverse else scipy.fftpack.rfft
    return transform(x, axis=axis, overwrite_x=True)
