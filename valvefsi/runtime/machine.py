"""How fast this machine is: messages between ranks, copies, memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI

from valvefsi.runtime.clock import seconds


@dataclass(frozen=True, kw_only=True)
class Network:
    """What a message costs: latency [s] and bandwidth of one core [byte/s]."""

    latency: float = 2e-6
    bandwidth: float = 1e9


def packing_time(n: int, repeats: int = 5) -> float:
    """Return the time per cell of the copies of a transpose of n^3 cells between two ranks [s]."""
    x, half = np.ones((n, n, n)), n // 2

    def copies() -> None:
        sent = np.empty((n, n - half, n))
        sent[...] = x[:, half:]
        out = np.empty((n, n, n))
        out[:, :half] = x[:, :half]
        out[:, half:] = sent

    return _median_time(copies, MPI.COMM_SELF, repeats) / n**3


def measure_network(comm: MPI.Comm, repeats: int = 20) -> Network | None:
    """Return latency and bandwidth of messages around the ring of all ranks, None on a single one. Collective."""
    if comm.size == 1:
        return None
    up, down = (comm.rank + 1) % comm.size, (comm.rank - 1) % comm.size

    def message(size: int) -> float:
        out, back = np.zeros(size), np.zeros(size)
        return _median_time(lambda: comm.Sendrecv(out, up, recvbuf=back, source=down), comm, repeats)

    short, long = message(1), message(10**6)
    return Network(latency=short, bandwidth=8e6 / max(long - short, 1e-9))


def triad_bandwidth(comm: MPI.Comm, size: int = 4 * 10**6, repeats: int = 7) -> float:
    """Return bytes per second of a = b + k c on every rank at once, that of the slowest [byte/s]. Collective.

    The product and the sum are separate passes of numpy and move three arrays each: what is written is read before.
    """
    b, c, a = np.ones(size), np.ones(size), np.zeros(size)
    return 8.0 * 6 * size / _median_time(lambda: np.add(np.multiply(c, 3.0, out=a), b, out=a), comm, repeats)


def _median_time(call: Callable[[], Any], comm: MPI.Comm, repeats: int) -> float:
    """Return the median time of a call that all ranks begin together, after one that counts not, of the slowest [s]."""
    times = []
    for _ in range(repeats + 1):
        comm.barrier()
        times.append(seconds(call))
    return comm.allreduce(float(np.median(times[1:])), op=MPI.MAX)
