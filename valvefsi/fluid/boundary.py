"""What the sides of the box do to the fluid: ghost values and boundary faces.

A side is periodic or a wall with a prescribed velocity (at rest by default), constant or a function of position and
time. The velocity normal to a side is set on its faces; everything beyond by reflection about the side's value,
u_ghost = 2 u_side - u, which keeps second order.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from valvefsi.grid import Array, Faces, MacGrid

SIDES = ("x_lower", "x_upper", "y_lower", "y_upper", "z_lower", "z_upper")

Velocity = Callable[[Array, Array, Array, float], Sequence[Array | float]]


@dataclass(frozen=True, kw_only=True)
class Wall:
    """A side with prescribed velocity.

    Attributes:
        velocity: Constant, one entry per dimension [cm/s], or a function of x, y, z [cm] and t [s] that returns
            one array (or number) per dimension.
    """

    velocity: tuple[float, ...] | Velocity = (0.0, 0.0, 0.0)


class Boundary:
    """Sets boundary faces and ghost values of velocity fields.

    Args:
        grid: The grid.
        walls: Wall of each side that is not periodic, keyed ``x_lower`` ... ``z_upper``; at rest when left out.

    Raises:
        ValueError: A wall is named on a periodic side, or a side is not known.
    """

    def __init__(self, grid: MacGrid, walls: Mapping[str, Wall] | None = None) -> None:
        self.grid = grid
        walls = dict(walls or {})
        self.walls = []
        for number, name in enumerate(SIDES[: 2 * grid.dim]):
            axis, upper = divmod(number, 2)
            wall = walls.pop(name, None)
            if grid.periodic[axis]:
                if wall is not None:
                    raise ValueError(f"side {name} is periodic, it cannot be a wall")
                continue
            self.walls.append((axis, bool(upper), wall or Wall()))
        if walls:
            raise ValueError(f"unknown side {next(iter(walls))!r}, a side is one of {', '.join(SIDES)}")
        self.changes_in_time = any(callable(wall.velocity) for _, _, wall in self.walls)

    def fill(self, u: Faces, *times: float) -> None:
        """Set the boundary faces and the ghost layers beyond each wall, in place.

        Args:
            u: Velocity on the faces whose ghost layers from other ranks are filled.
            times: Times of the wall velocities; their mean is used where several are given [s].
        """
        for axis, upper, wall in self.walls:
            if self.grid.is_last[axis] if upper else self.grid.is_first[axis]:
                for d, component in enumerate(u):
                    value = sum(self._value(wall, axis, upper, d, t) for t in times) / len(times)
                    self._set(component, axis, upper, axis == d, value)

    def set_faces(self, u: Faces, t: float) -> None:
        """Set the boundary faces alone, which a rank nearby may hold as ghosts: before the ghosts are exchanged."""
        for axis, upper, wall in self.walls:
            if self.grid.is_last[axis] if upper else self.grid.is_first[axis]:
                side = self.grid.ghosts[axis] + (self.grid.size[axis] if upper else 0)
                u[axis][_plane(axis, side)] = self._value(wall, axis, upper, axis, t)

    def _value(self, wall: Wall, axis: int, upper: bool, d: int, t: float) -> Array | float:
        if not callable(wall.velocity):
            return wall.velocity[d]
        points = list(self.grid.points(d))
        points[axis] = np.full((1, 1, 1), (self.grid.upper if upper else self.grid.lower)[axis])
        value = np.asarray(wall.velocity(*points, t)[d], dtype=float)
        return value if value.ndim == 0 else np.take(value, 0, axis)

    def _set(self, q: Array, axis: int, upper: bool, normal: bool, value: Array | float) -> None:
        g, n = self.grid.ghosts[axis], self.grid.size[axis]
        side, beyond = (g + n, 1) if upper else (g, -1)
        if normal:
            q[_plane(axis, side)] = value
        # First place beyond the side and its mirror image: a face away from the side, or half a cell.
        outside, inside = (
            (side + beyond, side - beyond) if normal else (side, side - 1)[:: 1 if upper else -1]
        )
        while 0 <= outside < q.shape[axis]:
            q[_plane(axis, outside)] = 2.0 * value - q[_plane(axis, inside)]
            outside, inside = outside + beyond, inside - beyond


def _plane(axis: int, index: int) -> tuple:
    return (slice(None),) * axis + (index,)
