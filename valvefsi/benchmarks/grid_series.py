"""Runs of one benchmark on finer and finer grids."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from mpi4py import MPI

from valvefsi.benchmarks.results import environment, write_result

Run = Mapping[str, object]


def refined(cells: int, refine: int, ratio: float) -> list[int]:
    """Return the cells of a grid and of ``refine`` finer ones, each ``ratio`` times as fine as the one before."""
    return [round(cells * ratio**k) for k in range(refine + 1)]


def run_series(
    grids: Sequence[int],
    one: Callable[[int], Run],
    told: Callable[[Sequence[Run]], Mapping[str, object]],
    *,
    out: Path,
    comm: MPI.Comm,
) -> dict[str, object]:
    """Run every grid and write ``result.json`` after each, so that a finer one that is stopped loses nothing.

    Args:
        grids: Cells of each grid.
        one: Runs a grid of so many cells; has at least ``cells``, ``quantities`` and ``wall_s``.
        told: What the runs so far say beside their numbers and times.
        out: Folder of ``result.json``.
        comm: Communicator.

    Returns:
        The contents of ``result.json``.

    Note:
        Collective.
    """
    runs: list[Run] = []
    result: dict[str, object] = {}
    for cells in grids:
        runs.append(one(cells))
        result = {
            **told(runs),
            "quantities": {run["cells"]: run["quantities"] for run in runs},
            "runs": runs,
            "timing": {"wall_s": sum(run["wall_s"] for run in runs)},
            "environment": environment(comm),
        }
        write_result(out, result, comm)
    return result
