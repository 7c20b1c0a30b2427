"""The staggered grid and the grading of its axes."""

from valvefsi.grid.mac import DEPTH, GHOSTS, UNIFORM, MacGrid
from valvefsi.types import Array, Faces

__all__ = ["DEPTH", "GHOSTS", "UNIFORM", "Array", "Faces", "MacGrid"]
