"""The mass matrix of a solid's nodes and its solution: the L2 projections of elemental coupling.

The consistent matrix is solved with an incomplete Cholesky factor that leaves out small entries: by corrections where
they converge fast, else by conjugate gradients. The factor of a tensor product of tridiagonal matrices is the product
of their factors, bidiagonal ones, and has eight entries in a row; that of a mapped mesh of hexahedra is near it. With
twelve, two corrections do what takes 22 iterations with symmetric Gauss-Seidel and 80 with Jacobi. The loops take the
three components at once, which PETSc's solvers do not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np
import scipy.sparse
from mpi4py import MPI

from valvefsi.errors import CaseError, ConvergenceError
from valvefsi.solid.elements import mass_kernels

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from valvefsi.types import Array

TOLERANCE = 1e-13
"""Relative error in the L2 norm of the body, as the residual in the norm of the preconditioner estimates it."""
DROP = 1e-5
"""Entries of the factor below it are left out, the diagonal of the matrix being one; three times as much and again
where the factor would have more entries than the matrix: tetrahedra fill it in."""
SLOW = 0.01
"""Ratio of the errors before and after a correction beyond which conjugate gradients take over."""
MOST = 500
"""Largest number of iterations; the condition does not depend on the size of the mesh."""


class Halo(Protocol):
    """Exchange of rows, one per node, between ranks."""

    comm: MPI.Comm
    """Communicator."""
    num_owned: int
    """Nodes that this rank owns."""
    num_local: int
    """The same and its ghosts."""

    def local(self, values: Array) -> Array:
        """Return the rows of all local nodes, ``(num_local, 3)``, of those owned, ``(num_owned, 3)``. Collective."""
        ...

    def owned(self, values: Array) -> Array:
        """Return the rows of owned nodes, ``(num_owned, 3)``, with what all ranks have for them. Collective."""
        ...


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

    def __init__(self, blocks: tuple[NDArray[np.int32], Array], halo: Halo) -> None:
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

    def __init__(self, blocks: tuple[NDArray[np.int32], Array], halo: Halo) -> None:
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
        # The whole diagonal is its owner's: what other ranks add to it is not among their rows.
        shares = np.zeros((local, 3))
        shares[:, 0] = matrix.diagonal()
        diagonal = np.zeros(local)
        diagonal[:owned] = halo.owned(shares)[:owned, 0]
        matrix.setdiag(diagonal)
        self.matrix = (*_rows(scipy.sparse.triu(matrix, 1).tocsr()), diagonal)
        self.lower, self.upper = _factors(matrix[:owned, :owned])

    def solve(self, b: Array) -> Array:
        """Return M^-1 b, ``(n, 3)``; NaN where b is not finite (collective).

        Each correction by the factor makes the error smaller by the same ratio. Where that is small, as on one rank
        with hexahedra, corrections go on until the next error would be within `TOLERANCE`; else conjugate gradients.

        Raises:
            ConvergenceError: The residual has not fallen by `TOLERANCE`.
        """
        right, x, y, z, q = (np.zeros((len(b), 4)) for _ in range(5))
        sums, one = np.empty(4), np.ones(4)
        right[:, :3] = b
        mass_kernels.solve_down(sums, y, right, q, self.lower)
        size = self._total(sums)
        enough = TOLERANCE**2 * size
        if not np.isfinite(size).all():
            return np.full_like(b, np.nan)
        while True:
            mass_kernels.solve_up(x, z, y, one, self.upper)
            self._product(sums, q, x)
            mass_kernels.solve_down(sums, y, right, q, self.lower)
            before, size = size, self._total(sums)
            if not (size <= np.maximum(SLOW**2 * before, enough)).all():
                return self._conjugate(x, right, enough)
            if (size * _ratio(size, before) <= enough).all():
                mass_kernels.solve_up(x, z, y, one, self.upper)
                return x[:, :3].copy()

    def _conjugate(self, x: Array, right: Array, enough: Array) -> Array:
        """Return the solution by conjugate gradients from x on, ``(n, 3)`` (collective)."""
        y, z, p, q = (np.zeros_like(x) for _ in range(4))
        sums, alpha, beta = np.empty(4), np.ones(4), np.zeros(4)
        self._product(sums, q, x)
        mass_kernels.advance(sums, x, right, y, p, q, alpha, self.lower)
        size = self._total(sums)
        for _ in range(MOST):
            if (size <= enough).all():
                return x[:, :3].copy()
            mass_kernels.solve_up(p, z, y, beta, self.upper)
            self._product(sums, q, p)
            alpha = _ratio(size, self._total(sums))
            mass_kernels.advance(sums, x, right, y, p, q, alpha, self.lower)
            before, size = size, self._total(sums)
            beta = _ratio(size, before)
        raise ConvergenceError(f"the mass matrix of a solid is not solved after {MOST} iterations")

    def _product(self, sums: Array, q: Array, p: Array) -> None:
        """Write M p of the owned nodes into q, ``(n, 4)``, and this rank's part of p . M p into sums (collective)."""
        if self.comm.size == 1:
            mass_kernels.product(sums, q, p, self.matrix)
            return
        whole, image = np.zeros((2, self.halo.num_local, 4))
        whole[:, :3] = self.halo.local(p[:, :3])
        mass_kernels.product(sums, image, whole, self.matrix)
        q[:, :3] = self.halo.owned(image[:, :3])

    def _total(self, sums: Array) -> Array:
        if self.comm.size == 1:
            return sums.copy()
        total = np.empty_like(sums)
        self.comm.Allreduce(sums, total)
        return total


def _ratio(a: Array, b: Array) -> Array:
    """Return a / b, 0 where b is 0: a component that is zero everywhere stays so."""
    return np.divide(a, b, out=np.zeros_like(a), where=b > 0.0)


def _rows(matrix: scipy.sparse.csr_matrix) -> tuple[NDArray[np.uint32], NDArray[np.uint32], Array]:
    """Return starts of rows, columns in ascending order and values, without sign: no code for counting from the end."""
    matrix.sort_indices()
    return matrix.indptr.astype(np.uint32), matrix.indices.astype(np.uint32), matrix.data


def _factors(matrix: scipy.sparse.csr_matrix) -> tuple[mass_kernels.Halves, mass_kernels.Halves]:
    """Return the incomplete factor L of a matrix and its transpose: rows without the diagonal, and its inverse."""
    n, workspace, count, drop = matrix.shape[0], matrix.nnz, -1, DROP
    out = (
        np.empty(n + 1, dtype=np.int64),
        np.empty(workspace, dtype=np.int64),
        np.empty(workspace),
        np.empty(n),
    )
    while count < 0:
        count = mass_kernels.factorise(out, _rows(matrix), drop)
        drop *= 3.0
    starts, columns, values, diagonal = out
    # Single precision is more than enough for what leaves out more than its round-off, and it is less to read.
    entries = values[:count].astype(np.float32)
    L = scipy.sparse.csr_matrix((entries, columns[:count], starts), shape=(n, n))
    inverse = 1.0 / diagonal
    return (*_rows(L), inverse), (*_rows(L.T.tocsr()), inverse)
