"""The directions of a leaflet's own, circumferential and radial, from what its facets are.

With n the normal of the sheet from its inflow to its outflow side, from the gradient of a harmonic depth, and psi the
harmonic field that is 0 on the attached edge and 1 on the free edge,

    e_r = (grad psi - (n . grad psi) n) / |...|,    e_c = e_r x n,

so that e_r leads from the attached to the free edge and e_c runs along both, counter-clockwise about the flow. At the
posts, where the two edges meet, both turn with the edges.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from valvefsi.runtime import dolfinx_compat  # noqa: F401  (before ufl)

# isort: split
import ufl

from valvefsi.solid.materials.fibres import at_midpoints, from_values
from valvefsi.solid.materials.harmonic import harmonic

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from dolfinx import fem

    from valvefsi.types import Mesh

DIRECTIONS = ("circumferential", "radial")
"""Names of the two fields."""


def leaflet_directions(mesh: Mesh, tags: Mapping[str, Sequence[str]]) -> dict[str, fem.Function]:
    """Make the fibre fields circumferential and radial of leaflets.

    Args:
        mesh: A ``SolidMesh`` in three dimensions.
        tags: Tags of facets by what they are: "inflow", "outflow", "attached", "free".

    Returns:
        Fields of degree 0 by name.

    Raises:
        CaseError: No facet has a tag, or a direction vanishes in a cell.

    Note:
        Collective. Two linear solves by MUMPS.
    """
    depth = harmonic(mesh, [(tags["inflow"], 0.0), (tags["outflow"], 1.0)], "outflow")
    height = harmonic(mesh, [(tags["attached"], 0.0), (tags["free"], 1.0)], "free")
    n, up = (at_midpoints(mesh, ufl.grad(field)) for field in (depth, height))
    with np.errstate(invalid="ignore", divide="ignore"):
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        up -= np.einsum("ni,ni->n", n, up)[:, None] * n
        up /= np.linalg.norm(up, axis=1, keepdims=True)
    return {name: from_values(mesh, v) for name, v in zip(DIRECTIONS, (np.cross(up, n), up), strict=True)}
