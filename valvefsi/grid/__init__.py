"""The staggered grid and the grading of its axes.

The grid itself is loaded when it is asked for, so that cases are read, and their axes graded, without MPI.
"""

from typing import TYPE_CHECKING, Any

from valvefsi.types import Array, Faces

if TYPE_CHECKING:
    from valvefsi.grid.mac import DEPTH, GHOSTS, UNIFORM, MacGrid

__all__ = ["DEPTH", "GHOSTS", "UNIFORM", "Array", "Faces", "MacGrid"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from valvefsi.grid import mac

    return getattr(mac, name)
