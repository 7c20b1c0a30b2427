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
from collections.abc import Mapping
from dataclasses import asdict, dataclass

from valvefsi.grid import GHOSTS
from valvefsi.grid.mac import divided
from valvefsi.runtime.machine import Network, packing_time

SIZES = (256, 512, 1024)
CORES = (64, 256, 1024, 4096)
ADVECTION_FLOPS = {"centred": 9, "xsppm7": 44}
"""Per face of a control volume, none limited."""


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


def work(n: int, ranks: int, *, solves: int = 4, advection: str = "xsppm7") -> Work:
    """Count the work of a step of n^3 cells on a number of ranks.

    Args:
        n: Cells along each axis.
        ranks: Number of ranks.
        solves: Direct solves per step, 4 with implicit viscosity and 1 with explicit.
        advection: Advection scheme.

    Raises:
        ValueError: No division leaves every rank as many cells as the ghosts are wide.
    """
    if (ranks_along := divided((n, n, n), ranks)) is None:
        raise ValueError(f"{ranks} ranks are too many for a grid of {n}^3 cells")
    p0, p1 = ranks_along
    n0, n1 = math.ceil(n / p0), math.ceil(n / p1)
    cells = n0 * n1 * n
    entries = n0 * (n1 + 2 * GHOSTS) * (n + 2 * GHOSTS)
    levels = solves * cells * math.log2(n)
    messages, sent = 0, 0.0  # three exchanges of ghosts, two or four transposes per solve
    for p, face in ((p0, (n1 + 2 * GHOSTS) * (n + 2 * GHOSTS)), (p1, (n0 + 2 * GHOSTS) * (n + 2 * GHOSTS))):
        if p > 1:
            # u*, both pressures one deep, the velocity as deep as it goes
            layers = 3 * 1 + 2 * 1 + 3 * GHOSTS
            messages += 2 * 3 + 2 * solves * (p - 1)
            sent += 8.0 * (2 * layers * face + 2 * solves * cells * (p - 1) / p)
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
