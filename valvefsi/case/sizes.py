"""What a case needs at least, before any of it is allocated."""

from __future__ import annotations

import math

from mpi4py import MPI

from valvefsi.case.models import Case
from valvefsi.errors import CaseError
from valvefsi.runtime.memory import machine_memory

CELL_BYTES, ELEMENT_BYTES = 16 * 8, 1000
"""Memory of the fluid per cell, and a low guess of that of a solid per element."""


def check_size(case: Case, comm: MPI.Comm) -> None:
    """Refuse a grid or a mesh that cannot fit into the memory of the machines that the ranks run on.

    Raises:
        CaseError: It cannot.

    Note:
        Collective.
    """
    machine = comm.Split_type(MPI.COMM_TYPE_SHARED)
    memory = comm.allreduce(machine_memory() / machine.size)
    machine.Free()
    counts = [len(edges) - 1 for edges in case.grid.edges]
    key = "grid.h" if case.grid.h is not None else "grid.x" if case.grid.x else "grid.cells"
    wanted = [(math.prod(counts), CELL_BYTES, "cells", key, " x ".join(map(str, counts)))]
    for solid in case.solid:
        if solid.mesh.shape is not None:
            place = f"solid.{solid.name}.mesh.elements"
            listed = " x ".join(map(str, solid.mesh.elements))
            wanted.append((math.prod(solid.mesh.elements), ELEMENT_BYTES, "elements", place, listed))
    for count, each, what, key, listed in wanted:
        if count * each > memory:
            raise CaseError(
                f"{count:.3g} {what} need {count * each / 1e9:.3g} GB of memory or more, there is {memory / 1e9:.3g}",
                file=case.file,
                key=key,
                value=listed,
            )
