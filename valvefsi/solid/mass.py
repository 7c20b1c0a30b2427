"""The mass matrix of a solid's nodes and its solution: the L2 projections of elemental coupling.

The consistent matrix is solved by conjugate gradients with symmetric Gauss-Seidel in Eisenstat's form: 23 iterations
where Jacobi takes 82 (trilinear hexahedra), each as cheap as a product with the matrix. The loops take the three
components at once, which PETSc's solvers do not: about a tenth of the time of a solution column by column.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse
from mpi4py import MPI

from valvefsi.errors import CaseError, ConvergenceError
from valvefsi.solid import mass_kernels

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

TOLERANCE = 1e-14
"""Relative residual of a solution, in the norm of the preconditioner."""
MOST = 500
"""Largest number of iterations; the condition does not depend on the size of the mesh."""


class LumpedMass:
    """The row sums of the mass matrix.

    Args:
        blocks: Nodes ``(num_cells, k)`` and matrices ``(num_cells, k, k)`` of elements [cm^dim].
        halo: Exchange of rows between ranks.

    Raises:
        CaseError: A node has no positive share.

    Note:
        Collective.
    """

    def __init__(self, blocks: tuple[NDArray[np.int32], Array], halo: object) -> None:
        sums = np.zeros((halo.num_local, 3))
        nodes, block = blocks
        np.add.at(sums[:, 0], nodes, block.sum(axis=2))
        self.diagonal = halo.owned(sums)[:, :1].copy()
        lowest = halo.comm.allreduce(float(self.diagonal.min(initial=np.inf)), op=MPI.MIN)
        if not lowest > 0.0:
            message = (
                "these elements have nodes without a positive share of the mass; take the consistent one"
            )
            raise CaseError(message, key="mass", value="lumped")

    def solve(self, b: Array) -> Array:
        """Return b / m, ``(n, 3)``."""
        return b / self.diagonal


class ConsistentMass:
    """The consistent mass matrix, int phi_j phi_k dX.

    Each rank keeps what its own elements add; products are summed over the ranks. The preconditioner is that of the
    part that couples a rank's nodes with one another.

    Args:
        blocks: Nodes ``(num_cells, k)`` and matrices ``(num_cells, k, k)`` of elements [cm^dim].
        halo: Exchange of rows between ranks.

    Note:
        Collective.
    """

    def __init__(self, blocks: tuple[NDArray[np.int32], Array], halo: object) -> None:
        self.halo, self.comm = halo, halo.comm
        owned, local = halo.num_owned, halo.num_local
        nodes, block = blocks
        rows = np.repeat(nodes, nodes.shape[1], axis=1).ravel()
        columns = np.tile(nodes, nodes.shape[1]).ravel()
        # A ghost may have no element here, but its row has a diagonal.
        every = np.arange(local, dtype=np.int32)
        entries = np.concatenate([np.zeros(local), block.ravel()])
        place = tuple(np.concatenate([every, part]) for part in (rows, columns))
        matrix = scipy.sparse.csr_matrix((entries, place), shape=(local, local))
        matrix.sum_duplicates()
        start, columns = matrix.indptr, matrix.indices
        row = np.repeat(every, np.diff(start))
        diagonal = start[:-1] + np.bincount(row[columns < row], minlength=local)
        stop = start[:-1] + np.bincount(row[columns < owned], minlength=local)
        # The whole diagonal is its owner's: what other ranks add to it is not among their rows.
        shares = np.zeros((local, 3))
        shares[:, 0] = matrix.data[diagonal]
        matrix.data[diagonal[owned:]] = 0.0
        matrix.data[diagonal[:owned]] = halo.owned(shares)[:owned, 0]
        unsigned = [part.astype(np.uint32) for part in (start, columns)]
        self.matrix = (*unsigned, matrix.data, diagonal.astype(np.int64), stop.astype(np.int64))

    def solve(self, b: Array) -> Array:
        """Return M^-1 b, ``(n, 3)``; NaN where b is not finite (collective).

        Raises:
            ConvergenceError: The residual has not fallen by `TOLERANCE`.
        """
        x, p, t, w = np.zeros_like(b), np.zeros_like(b), np.zeros((self.halo.num_local, 3)), np.empty_like(b)
        r, sums = np.empty_like(b), np.empty(3)
        mass_kernels.sweep_down(r, b, x, self.matrix)
        mass_kernels.advance(sums, x, r, p, p, np.zeros(3), self.matrix)
        size = self._total(sums)
        enough, beta = TOLERANCE**2 * size, np.zeros(3)
        if not np.isfinite(size).all():
            return np.full_like(b, np.nan)
        for _ in range(MOST):
            if (size <= enough).all():
                return x
            self._product(w, t, p, r, beta)
            mass_kernels.curvature(sums, p, t, w)
            alpha = _ratio(size, self._total(sums))
            mass_kernels.advance(sums, x, r, t, w, alpha, self.matrix)
            before, size = size, self._total(sums)
            beta = _ratio(size, before)
        raise ConvergenceError(f"the mass matrix of a solid is not solved after {MOST} iterations")

    def _product(self, w: Array, t: Array, p: Array, r: Array, beta: Array) -> None:
        """New direction p, t = K^-T p on owned and ghost nodes, w = K^-1 (p - D t + the other ranks' part)."""
        mass_kernels.sweep_up(t, p, r, beta, self.matrix)
        b = p
        if self.comm.size > 1:
            t[:] = self.halo.local(t[: len(p)])
            others = np.zeros_like(t)
            mass_kernels.add_others(others, t, self.matrix, len(p))
            b = p + self.halo.owned(others)
        mass_kernels.sweep_down(w, b, t, self.matrix)

    def _total(self, sums: Array) -> Array:
        if self.comm.size == 1:
            return sums.copy()
        total = np.empty_like(sums)
        self.comm.Allreduce(sums, total)
        return total


def _ratio(a: Array, b: Array) -> Array:
    """Return a / b, 0 where b is 0: a component that is zero everywhere stays so."""
    return np.divide(a, b, out=np.zeros_like(a), where=b > 0.0)
