"""Global node numbers that do not depend on the number of ranks."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from valvefsi.errors import CaseError, raise_together

if TYPE_CHECKING:
    from mpi4py import MPI
    from numpy.typing import NDArray

    from valvefsi.types import Array


def number_nodes(X: Array, comm: MPI.Comm) -> NDArray[np.int64]:
    """Number nodes by their reference positions in lexicographic order of (x, y, z).

    Coordinates are first replaced by their place among the distinct values of an axis, where values nearer
    than 1e-10 of the body's size count as one: round-off, which depends on the partition, cannot change the
    order.

    Args:
        X: Reference positions of this rank's nodes, each on one rank only, ``(n, 3)`` [cm].
        comm: Communicator.

    Returns:
        Numbers 0 ... N-1 of this rank's nodes, ``(n,)``.

    Raises:
        CaseError: Two nodes are at the same place.

    Note:
        Collective; rank 0 sorts.
    """
    gathered = comm.gather(X, root=0)
    parts, error = None, None
    if gathered is not None:
        points = np.concatenate(gathered)
        tolerance = 1e-10 * np.ptp(points, axis=0).max(initial=0.0)
        grades = np.stack([_grades(column, tolerance) for column in points.T], axis=1)
        order = np.lexsort(grades.T[::-1])
        coincident = np.count_nonzero(np.all(np.diff(grades[order], axis=0) == 0, axis=1))
        if coincident:
            error = CaseError(
                f"{coincident} pairs of nodes are at the same place: unmerged nodes in the mesh?"
            )
        numbers = np.empty(len(points), dtype=np.int64)
        numbers[order] = np.arange(len(points))
        parts = np.split(numbers, np.cumsum([len(part) for part in gathered])[:-1])
    raise_together(comm, error)
    return comm.scatter(parts, root=0)


def _grades(values: Array, tolerance: float) -> NDArray[np.int64]:
    """Return each value's place among the distinct ones, those within ``tolerance`` counting as one."""
    order = np.argsort(values, kind="stable")
    steps = np.diff(values[order], prepend=values[order[:1]]) > tolerance
    grades = np.empty(len(values), dtype=np.int64)
    grades[order] = np.cumsum(steps)
    return grades
