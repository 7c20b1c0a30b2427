"""Texts of case files that several tests start from, and how they are written for all ranks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mpi4py import MPI

from valvefsi.case import Case, load_case


def stream(length: float, cells: tuple[int, int]) -> str:
    """Return grid and fluid of a stream that slips between y = 0 and 1; its two ends are to follow."""
    return f"""
[grid]
lower = [0, 0]
upper = [{length}, 1]
cells = {list(cells)}
[fluid]
viscosity = 0.05
[fluid.sides]
y_lower = {{type = "free_slip"}}
y_upper = {{type = "free_slip"}}
"""


def written(folder: Path, text: str, overrides: Sequence[str] = (), **tables: str) -> Case:
    """Write a case and its tables, ``name="rows"`` to ``name.csv``, on the first rank; read it on all."""
    MPI.COMM_WORLD.barrier()
    if MPI.COMM_WORLD.rank == 0:
        for name, rows in tables.items():
            (folder / f"{name}.csv").write_text(rows)
        (folder / "case.toml").write_text(text)
    MPI.COMM_WORLD.barrier()
    return load_case(folder / "case.toml", overrides)
