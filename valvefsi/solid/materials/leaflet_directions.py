"""The directions of a leaflet's own, circumferential and radial, from what its facets are.

With n the normal of the sheet from its inflow to its outflow side, from the gradient of a harmonic depth, and Phi the
harmonic field that is the azimuth on the attached edge and has no flux through the free edge and the two sides,

    e_c = (grad Phi - (n . grad Phi) n) / |...|,    e_r = n x e_c.

e_c leads from one end of the attached edge to the other, e_r towards the free edge. On a part of a cylinder that is
attached along its lower edge and its sides e_c is the circle's tangent.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from valvefsi.runtime import dolfinx_compat  # noqa: F401  (before ufl)

# isort: split
import ufl

from valvefsi.errors import CaseError
from valvefsi.solid.materials.fibres import at_midpoints, from_values
from valvefsi.solid.materials.harmonic import harmonic

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from dolfinx import fem

    from valvefsi.types import Array, Mesh

DIRECTIONS = ("circumferential", "radial")
"""Names of the two fields."""
WIDEST = np.radians(300.0)
"""Largest azimuth that one leaflet's attached edge may go around."""


def leaflet_directions(
    mesh: Mesh, tags: Mapping[str, Sequence[str]], attached: Sequence[Array]
) -> dict[str, fem.Function]:
    """Make the fibre fields circumferential and radial of leaflets about the z axis.

    Args:
        mesh: A ``SolidMesh``.
        tags: Tags of facets by what they are: "inflow", "outflow", "attached".
        attached: Points of the attached edge of each leaflet, on all ranks, ``(num_points, 3)`` each [cm].

    Returns:
        Fields of degree 0 by name.

    Raises:
        CaseError: An edge goes around the axis, or a direction vanishes in a cell.

    Note:
        Collective. Two linear solves by MUMPS.
    """
    depth = harmonic(mesh, [(tags["inflow"], 0.0), (tags["outflow"], 1.0)], "inflow")
    turn = harmonic(mesh, [(tags["attached"], _Azimuth(attached))], "attached")
    n, around = (at_midpoints(mesh, ufl.grad(field)) for field in (depth, turn))
    with np.errstate(invalid="ignore", divide="ignore"):
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        around -= np.einsum("ni,ni->n", n, around)[:, None] * n
        around /= np.linalg.norm(around, axis=1, keepdims=True)
    fields = (around, np.cross(n, around))
    return {name: from_values(mesh, values) for name, values in zip(DIRECTIONS, fields, strict=True)}


class _Azimuth:
    """Azimuth about the z axis from the middle of the nearest edge.

    Args:
        edges: Points of each edge, ``(num_points, 3)`` [cm].

    Raises:
        CaseError: An edge goes (nearly) around the axis.
    """

    def __init__(self, edges: Sequence[Array]) -> None:
        from scipy.spatial import cKDTree

        turns = [np.unwrap(np.arctan2(x[:, 1], x[:, 0])) for x in edges]
        widest = max(float(np.ptp(turn)) for turn in turns)
        if widest > WIDEST:
            raise CaseError(
                f"an attached edge goes {np.degrees(widest):.0f} deg around the axis: no direction leads from one of "
                'its ends to the other; give the leaflets\' own as cell data, directions = "data"',
                key="attached",
            )
        self._middles = np.array([0.5 * (turn.min() + turn.max()) for turn in turns])
        self._tree = cKDTree(np.concatenate(edges))
        self._edge = np.repeat(np.arange(len(edges)), [len(x) for x in edges])

    def __call__(self, X: Array) -> Array:
        """Return the azimuth at positions ``(n, 3)`` [rad]."""
        if not len(X):
            return np.zeros(0)
        middle = self._middles[self._edge[self._tree.query(X)[1]]]
        turn = np.arctan2(X[:, 1], X[:, 0]) - middle
        return np.asarray((turn + np.pi) % (2.0 * np.pi) - np.pi)
