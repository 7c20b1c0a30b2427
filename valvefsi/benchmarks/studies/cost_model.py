"""Cost of a fluid step on many cores: counts of work and messages times constants measured on this machine.

Only the busiest rank is counted: n0 n1 N cells of a cube of N cells along each axis on p0 p1 ranks, ghosts computed
along with them where a kernel does so. The constants are times of one core per entry (advection, all other passes over
memory) and per cell and level (transforms with elimination); no core waits for another but in messages, which cost
latency + bytes / bandwidth each, one after the other.

Flops and bytes are those that the formulas need, each array read once per kernel; they say what to expect of the
constants and do not enter the time. The network is assumed, not measured, beyond the ranks of the run.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np
from mpi4py import MPI

from valvefsi.grid import GHOSTS

SIZES = (256, 512, 1024)
CORES = (64, 256, 1024, 4096)
ADVECTION_FLOPS = {"centred": 9, "xsppm7": 44}
"""Per face of a control volume, none limited."""


@dataclass(frozen=True, kw_only=True)
class Network:
    """What a message costs: latency [s] and bandwidth of one core [byte/s]."""

    latency: float = 2e-6
    bandwidth: float = 1e9


@dataclass(frozen=True, kw_only=True)
class Machine:
    """Times of one core.

    Attributes:
        advection: Per entry [s].
        streams: All other passes over memory, per entry [s].
        transforms: Those of a solve, per cell and log2 N [s].
        packing: Copies of a transpose between ranks, per cell [s].
    """

    advection: float
    streams: float
    transforms: float
    packing: float


@dataclass(frozen=True, kw_only=True)
class Work:
    """What the busiest rank does in a step.

    Attributes:
        cells: Cells that it owns.
        entries: Entries of its planes of axis 0, ghosts of the other two included.
        levels: Cells times log2 N times the number of solves.
        packed: Cells times transposes.
        flops: Floating-point operations, with nothing limited.
        bytes: Bytes to and from memory.
        messages: Messages sent.
        sent: Bytes sent.
    """

    cells: int
    entries: int
    levels: float
    packed: int
    flops: float
    bytes: float
    messages: int
    sent: float


def process_grid(n: int, ranks: int) -> tuple[int, int]:
    """Return the ranks along axes 0 and 1, as the grid chooses them: slabs as long as they hold the ghosts.

    Raises:
        ValueError: No division leaves every rank as many cells as the ghosts are wide.
    """
    for p1 in range(1, ranks + 1):
        p0 = ranks // p1
        if p0 * p1 == ranks and n // p0 >= GHOSTS and n // p1 >= GHOSTS:
            return p0, p1
    raise ValueError(f"{ranks} ranks are too many for a grid of {n}^3 cells")


def work(n: int, ranks: int, *, solves: int = 4, advection: str = "xsppm7") -> Work:
    """Count the work of a step of n^3 cells on a number of ranks.

    Args:
        n: Cells along each axis.
        ranks: Number of ranks.
        solves: Direct solves per step, 4 with implicit viscosity and 1 with explicit.
        advection: Advection scheme.
    """
    p0, p1 = process_grid(n, ranks)
    n0, n1 = math.ceil(n / p0), math.ceil(n / p1)
    cells = n0 * n1 * n
    entries = n0 * (n1 + 2 * GHOSTS) * (n + 2 * GHOSTS)
    levels = solves * cells * math.log2(n)
    messages, sent = _messages((n0, n1, n), (p0, p1), solves)
    return Work(
        cells=cells,
        entries=entries,
        levels=levels,
        packed=2 * solves * cells * ((p0 > 1) + (p1 > 1)),
        # A real transform takes 2.5 n log2 n, there are four per solve, and ten operations per cell eliminate the lines
        # of the third axis; right-hand side, projection and update 100.
        flops=9 * ADVECTION_FLOPS[advection] * entries + 10.0 * levels + (100 + 10 * solves) * cells,
        # Arrays read once, written with a read before: 18 arrays in advection, 24 in the right-hand side, 25 in the
        # projection; each transform and the elimination read and write their array.
        bytes=8.0 * (67 * entries + 14 * solves * cells),
        messages=messages,
        sent=sent,
    )


def _messages(block: tuple[int, int, int], ranks: tuple[int, int], solves: int) -> tuple[int, float]:
    """Messages and bytes sent by a rank in a step: three exchanges of ghosts, two or four transposes per solve."""
    cells = math.prod(block)
    messages, sent = 0, 0.0
    for axis, p in enumerate(ranks):
        if p > 1:
            face = math.prod(m + 2 * GHOSTS for a, m in enumerate(block) if a != axis)
            layers = (
                3 * 1 + 2 * 1 + 3 * GHOSTS
            )  # u*, both pressures one deep, the velocity as deep as it goes
            messages += 2 * 3 + 2 * solves * (p - 1)
            sent += 8.0 * (2 * layers * face + 2 * solves * cells * (p - 1) / p)
    return messages, sent


def predict(count: Work, machine: Machine, network: Network) -> dict[str, float]:
    """Return the time of a step and its parts [s]."""
    parts = {
        "advection": machine.advection * count.entries,
        "transforms": machine.transforms * count.levels,
        "streams": machine.streams * count.entries,
        "packing": machine.packing * count.packed,
        "messages": network.latency * count.messages + count.sent / network.bandwidth,
    }
    return {"step": sum(parts.values()), **parts}


def calibrate(n: int, phases_ms: Mapping[str, float], *, solves: int) -> Machine:
    """Return the constants of one core from the phases of a step on one rank.

    Args:
        n: Cells along each axis.
        phases_ms: Time of each phase; what is neither advection nor a solve counts as streaming [ms].
        solves: Direct solves per step.
    """
    count = work(n, 1, solves=solves)
    transforms = sum(phases_ms.get(name, 0.0) for name in ("viscous solves", "pressure solve"))
    rest = sum(phases_ms.values()) - transforms - phases_ms["advection"]
    return Machine(
        advection=1e-3 * phases_ms["advection"] / count.entries,
        transforms=1e-3 * transforms / count.levels,
        streams=1e-3 * rest / count.entries,
        packing=packing_time(n),
    )


def packing_time(n: int, repeats: int = 5) -> float:
    """Return the time per cell of the copies of a transpose of n^3 cells between two ranks [s]."""
    x, half, samples = np.ones((n, n, n)), n // 2, []
    for _ in range(repeats + 1):
        started = time.perf_counter()
        sent = np.empty((n, n - half, n))
        sent[...] = x[:, half:]
        out = np.empty((n, n, n))
        out[:, :half] = x[:, :half]
        out[:, half:] = sent
        samples.append(time.perf_counter() - started)
    return float(np.median(samples[1:])) / n**3


def measure_network(comm: MPI.Comm, repeats: int = 20) -> Network | None:
    """Return latency and bandwidth of messages around the ring of all ranks, None on a single one. Collective."""
    if comm.size == 1:
        return None
    times = []
    for size in (1, 10**6):
        out, back = np.zeros(size), np.zeros(size)
        up, down = (comm.rank + 1) % comm.size, (comm.rank - 1) % comm.size
        samples = []
        for _ in range(repeats):
            comm.barrier()
            started = time.perf_counter()
            comm.Sendrecv(out, up, recvbuf=back, source=down)
            samples.append(time.perf_counter() - started)
        times.append(comm.allreduce(float(np.median(samples)), op=MPI.MAX))
    return Network(latency=times[0], bandwidth=8e6 / max(times[1] - times[0], 1e-9))


def triad_bandwidth(comm: MPI.Comm, size: int = 4 * 10**6, repeats: int = 7) -> float:
    """Return bytes per second of a = b + k c on every rank at once, that of the slowest [byte/s]. Collective.

    The product and the sum are separate passes of numpy and move three arrays each: what is written is read before.
    """
    b, c, a = np.ones(size), np.ones(size), np.zeros(size)
    samples = []
    for _ in range(repeats):
        comm.barrier()
        started = time.perf_counter()
        np.multiply(c, 3.0, out=a)
        np.add(a, b, out=a)
        samples.append(time.perf_counter() - started)
    return 8.0 * 6 * size / comm.allreduce(float(np.median(samples)), op=MPI.MAX)


def table(machine: Machine, network: Network, *, solves: int, advection: str) -> list[dict[str, float]]:
    """Return the prediction for every size and number of cores that the grid can be divided among."""
    lines = []
    for n in SIZES:
        for cores in CORES:
            try:
                count = work(n, cores, solves=solves, advection=advection)
            except ValueError:
                continue
            times = {f"{k}_s": v for k, v in predict(count, machine, network).items()}
            lines.append({"N": n, "cores": cores, **asdict(count), **times})
    return lines
