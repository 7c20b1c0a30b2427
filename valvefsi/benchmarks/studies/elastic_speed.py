"""Speed of the elastic forces: the assembled weak form against a hand-written loop of the same law, in one run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from mpi4py import MPI

from valvefsi.benchmarks.results import row
from valvefsi.geometry.shapes import box
from valvefsi.runtime.clock import seconds
from valvefsi.solid.elements.force_loop import HgoLoop
from valvefsi.solid.materials.fibre_reinforced import HGO, FibreFamily
from valvefsi.solid.materials.fibres import circumferential
from valvefsi.solid.structure import Structure

MATERIAL = HGO(c10=1.0e3, c01=5.0, families=(FibreFamily(k1=1.0e4, k2=5.0, kappa=0.1, fibre="around"),))
LIMIT = 2.0
"""Times the loop that the weak form may take."""


def measure(
    comm: MPI.Comm = MPI.COMM_WORLD, *, elements: Sequence[int] = (14, 14, 14), repeats: int = 40
) -> dict[str, Any]:
    """Time the forces of linear tetrahedra of HGO material, one family of fibres, on one core (collective).

    The two take turns, so that a busy machine disturbs both; the fastest call of each counts.

    Args:
        comm: Communicator; rank 0 measures while the others wait.
        elements: Boxes along each edge of a cube, six tetrahedra each.
        repeats: Calls of each.

    Returns:
        ``cells``, ``form_ns`` and ``loop_ns`` per cell, ``ratio``, ``difference`` of the forces relative to the
        largest, and ``row`` for the table of a benchmark; the same on all ranks.
    """
    return comm.bcast(_measure(elements, repeats) if comm.rank == 0 else None)


def _measure(elements: Sequence[int], repeats: int) -> dict[str, Any]:
    mesh = box(MPI.COMM_SELF, elements=elements, cell="tetrahedron")
    mesh = mesh.with_fibres(around=circumferential(mesh, through=(2.0, 2.0, 0.0)))
    solid = Structure(mesh, MATERIAL)
    loop = HgoLoop(solid)
    chi = solid.X + 0.02 * np.sin(5 * solid.X[:, [1, 2, 0]])
    assembled = solid.elasticity.force(chi).copy()
    difference = float(np.abs(loop.force(chi) - assembled).max() / np.abs(assembled).max())
    turns = [lambda: solid.elasticity.force(chi), lambda: loop.force(chi)]
    form, by_hand = np.min([[seconds(call) for call in turns] for _ in range(repeats)], axis=0)
    cells = len(loop.cells)
    ratio = form / by_hand
    return {
        "cells": cells,
        "form_ns": 1e9 * form / cells,
        "loop_ns": 1e9 * by_hand / cells,
        "ratio": ratio,
        "difference": difference,
        "row": row("elastic force, weak form / hand-written loop", ratio, LIMIT, "a goal, not a bound"),
    }
