"""The hand-written loop of `force_kernels` set up for a solid, beside the solid's own weak form."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import ufl

from valvefsi.errors import CaseError
from valvefsi.solid.elements.force_kernels import hgo_tetrahedra, tetrahedra
from valvefsi.solid.materials.fibre_reinforced import HGO
from valvefsi.solid.materials.fibres import at_midpoints
from valvefsi.solid.materials.kinematics import Kinematics

if TYPE_CHECKING:
    from valvefsi.solid.structure import Structure
    from valvefsi.types import Array


class HgoLoop:
    """Elastic forces of a solid of linear tetrahedra and HGO material, by the loop; one rank.

    Args:
        solid: The solid; its fibres constant in each cell, its volumetric energy "log".

    Raises:
        CaseError: It is another element, material or volumetric energy, or runs on more than one rank.
    """

    def __init__(self, solid: Structure) -> None:
        linear = solid.mesh.mesh.basix_cell().name == "tetrahedron" and solid.discretisation.degree == 1
        material = solid.material
        fits = linear and solid.volumetric.form == "log" and solid.comm.size == 1
        if (
            not fits
            or not isinstance(material, HGO)
            or material.width
            or any(f.lam_max for f in material.families)
        ):
            message = 'the loop is for linear tetrahedra of "hgo" without width and lam_max, with "log", on one rank'
            raise CaseError(message, key="solid", value=solid.name)
        self.cells = np.ascontiguousarray(solid.space.dofmap.list)
        points = solid.mesh.mesh.geometry.x[compat.geometry_nodes(solid.mesh.mesh)]
        self.gradients, self.volumes = tetrahedra(solid.X[self.cells])
        if not np.allclose(self.volumes, tetrahedra(points)[1]):
            raise CaseError("the loop is for straight cells", key="solid", value=solid.name)
        self.matrix = np.array([material.c10, material.c01, solid.kappa])
        self.families = np.array([(f.k1, f.k2, f.kappa) for f in material.families]).reshape(-1, 3)
        kinematics = Kinematics(ufl.Identity(3), solid.mesh.fibres)
        fields = [at_midpoints(solid.mesh, kinematics.vector(f.fibre)) for f in material.families]
        self.fibres = np.array(fields).reshape(-1, len(self.cells), 3)
        self._out = np.zeros((len(solid.X), 3))

    def force(self, chi: Array) -> Array:
        """Return the elastic nodal forces at ``chi (n, 3)`` [dyn]; the next call overwrites them."""
        self._out[:] = 0.0
        hgo_tetrahedra(
            chi,
            self.cells,
            self.gradients,
            self.volumes,
            self.matrix,
            self.families,
            self.fibres,
            self._out,
        )
        return self._out
