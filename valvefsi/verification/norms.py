"""Norms of differences: of records over time (Lee2020, S24 and S25), and of errors at points."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ORDERS = (1.0, 2.0, math.inf)


class Reducer(Protocol):
    """A communicator, as far as norms over all ranks need one."""

    def allreduce(self, sendobj: Any, op: Any = ...) -> Any:
        """Combine a value of every rank, by default their sum."""
        ...

    def allgather(self, sendobj: Any) -> list[Any]:
        """Return the value of every rank."""
        ...


def time_norm(t: Array, values: Array, q: float = 2.0) -> float:
    """Return the norm of a record in L^q(0, T), by the trapezoidal rule.

    Args:
        t: Times, ``(n,)`` [s].
        values: The record, ``(n,)``.
        q: 1, 2 or infinity.
    """
    if q not in ORDERS:
        raise ValueError(f"q is 1, 2 or infinity, found {q}")
    if math.isinf(q):
        return float(np.abs(values).max())
    return float(np.trapezoid(np.abs(values) ** q, t) ** (1.0 / q))


def normalised_difference(t: Array, values: Array, reference: Array, q: float = 2.0) -> float:
    """Return the normalised difference of two records (S24, S25).

        ||M - M_ref||_{L^q(0, T)} / ||M_ref||_{L^q(0, T)}

    Args:
        t: Times of both, ``(n,)`` [s].
        values: The coarser run's record M, ``(n,)``.
        reference: The finer run's or the experiment's record M_ref, ``(n,)``.
        q: 1, 2 or infinity.
    """
    return time_norm(t, np.asarray(values) - np.asarray(reference), q) / time_norm(t, reference, q)


@dataclass(frozen=True, kw_only=True)
class ErrorNorms:
    """Norms of errors at points that stand for equal volumes.

    Attributes:
        L1: Mean magnitude.
        L2: Root of the mean square.
        largest: Largest magnitude.
    """

    L1: float
    L2: float
    largest: float


def error_norms(errors: Array, comm: Reducer | None = None) -> ErrorNorms:
    """Return the norms of errors at this rank's points, over all ranks (collective with a communicator).

    Args:
        errors: Errors, ``(n,)``.
        comm: Communicator; None for the points of this process alone.
    """
    sizes = np.abs(np.ravel(errors))
    sums = np.array([sizes.size, sizes.sum(), (sizes**2).sum()])
    largest = float(sizes.max(initial=0.0))
    if comm is not None:
        sums, largest = comm.allreduce(sums), max(comm.allgather(largest))
    return ErrorNorms(L1=float(sums[1] / sums[0]), L2=math.sqrt(sums[2] / sums[0]), largest=largest)
