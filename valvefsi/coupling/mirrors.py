"""Kernels near sides whose velocity is given: what they reach beyond the side is the mirror image of what is inside.

The fluid continues its velocity beyond such a side by reflection, u_ghost = 2 u_side - u where the value is given and
u_ghost = u where nothing holds the fluid back. Interpolation reads these ghosts. Spreading is the transpose for a side
at rest: the force on a ghost face goes home to its image with the sign of the reflection, -1 or +1, and the force on a
face of the side itself is the side's to bear. So sum F . U = sum f . u h^d for every u that vanishes on its sides.

The side takes part in the balance of forces: less than the whole force of a point near it reaches the fluid, none of
what is normal to it for a point on the side, and torque alike; the side bears the rest, as it does for a point force
near a wall.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from valvefsi.grid import MacGrid
from valvefsi.types import Array, Faces

Side = tuple[int, bool]
"""Axis of a side, and whether it is the upper one."""

Signs = Mapping[Side, tuple[float, ...]]
"""Sign of the reflection of each velocity component about each side that has one; other sides count as open."""


def fold(f: Faces, grid: MacGrid, signs: Signs, sides: Collection[Side]) -> None:
    """Add what was spread beyond sides to its mirror images, and clear it, in place.

    Args:
        f: Force density on the faces, before ghost layers are summed over the ranks [dyn/cm^3].
        grid: The grid.
        signs: Signs of the reflections.
        sides: Those near which this rank has points; it touches them.
    """
    for axis, upper in sorted(sides, reverse=True):  # the transpose of filling them in order
        for d, component in enumerate(f):
            _fold(component, grid, (axis, upper), on_faces=d == axis, sign=signs[axis, upper][d])


def _fold(q: Array, grid: MacGrid, side: Side, *, on_faces: bool, sign: float) -> None:
    axis, upper = side
    ghosts = grid.ghosts[axis]
    face = ghosts + (grid.size[axis] if upper else 0)
    beyond = 1 if upper else -1
    # First place beyond the side and its image, as in the fluid's boundary.
    if on_faces:
        outside, inside = face + beyond, face - beyond
    else:
        outside, inside = (face, face - 1) if upper else (face - 1, face)
    while 0 <= outside < q.shape[axis]:
        ghost, image = (_plane(q, axis, i) for i in (outside, inside))
        image += sign * ghost
        ghost[...] = 0.0
        outside, inside = outside + beyond, inside - beyond


def _plane(q: Array, axis: int, index: int) -> Array:
    plane: Array = q[(slice(None),) * axis + (index,)]
    return plane
