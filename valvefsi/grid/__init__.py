"""The staggered grid and the grading of its axes."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from valvefsi.grid.mac import DEPTH, GHOSTS, UNIFORM, Array, Faces, MacGrid

__all__ = ["DEPTH", "GHOSTS", "UNIFORM", "Array", "Faces", "MacGrid"]


def __getattr__(name: str) -> Any:
    """Import the grid, and MPI with it, only when it is asked for: case files and fits do without."""
    if name in __all__:
        return getattr(importlib.import_module("valvefsi.grid.mac"), name)
    raise AttributeError(name)
