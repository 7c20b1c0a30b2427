"""Nodal elastic forces of a thin body of solid-shell elements, in the place of `valvefsi.solid.elements.elasticity`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from valvefsi.runtime import dolfinx_compat  # noqa: F401  (before ufl)

# isort: split
import ufl
from dolfinx import fem, la
from mpi4py import MPI

from valvefsi.errors import CaseError
from valvefsi.solid.elements.shell_cells import MODES, ShellCells
from valvefsi.solid.elements.shell_kernels import add_monomials, monomials
from valvefsi.solid.elements.shell_layers import BITS, slants, thickness_axes, through_last
from valvefsi.solid.materials import Volumetric, kappa_stab, stabilisation
from valvefsi.solid.materials.fibres import at_midpoints
from valvefsi.solid.materials.kinematics import Kinematics

if TYPE_CHECKING:
    from collections.abc import Sequence

    from valvefsi.solid.materials import Material
    from valvefsi.types import Array, Mesh

POINTS = 3
"""Gauss points through the thickness of an element."""


def split(
    material: Material, nu_stab: float | None, kappa: float | None, form: str
) -> tuple[Volumetric, Volumetric]:
    """Return the volumetric energies of the columns, up to the modulus of nu = 0, and of the elements, the rest.

    The columns need just enough to keep their thickness from alternating. More stiffens layers that bend: the nodes'
    thickness is continuous and the stretch of the layers is not (two layers of ten elements: 4 to 6 % with nu = 0.4,
    1 % with 0). A compressible material needs none: its own modulus holds its thickness, nu_stab means nothing to it.
    """
    if hasattr(material, "normal_modulus"):
        if kappa is not None:
            message = (
                "this material has a volumetric part of its own, which solid-shell elements take as it is"
            )
            raise CaseError(message, key="kappa", value=kappa)
        return Volumetric(kappa=0.0, form=form), Volumetric(kappa=0.0, form=form)
    whole = stabilisation(material, nu_stab, form, kappa).kappa
    if not whole > 0:
        message = (
            "solid-shell elements need a volumetric energy that holds their thickness; give nu_stab or kappa"
        )
        raise CaseError(message, key="kappa", value=kappa)
    held = min(whole, kappa_stab(material.shear_modulus, 0.0)) if material.shear_modulus > 0 else whole
    return Volumetric(kappa=held, form=form), Volumetric(kappa=whole - held, form=form)


class ShellElasticity:
    """Elastic nodal forces, energy and volume ratio of a body of solid-shell elements at a given position.

        F_k = -dE/dchi_k,    E of `ShellCells`

    Args:
        mesh: A ``SolidMesh`` of hexahedra.
        space: Vector Lagrange space of the position, degree 1.
        material: Energy W of an incompressible body, or a compressible one, see `ShellCells`.
        columns: Volumetric energy of each column through the thickness of an element.
        mean: Volumetric energy of each element as a whole.
        points: Gauss points through the thickness of an element.
        faces: Tags of the facets on both sides of the body; None to look for its thickness, see `thickness_axes`.

    Attributes:
        corners: Corner of the mesh's cell that each corner of the element is, ``(num_cells, 8)``.
        slant: Largest angle between an element's thickness and its normal, on all ranks [deg].

    Note:
        Collective.
    """

    def __init__(
        self,
        mesh: Mesh,
        space: fem.FunctionSpace,
        material: Material,
        columns: Volumetric,
        mean: Volumetric,
        points: int = POINTS,
        faces: tuple[Sequence[str], Sequence[str]] | None = None,
    ) -> None:
        if space.ufl_element().degree != 1:
            raise CaseError("solid-shell elements are of degree 1", key="degree")
        self.space, self.mesh, self.dim = space, space.mesh, 3
        self.position = fem.Function(space, name="chi")
        axes = thickness_axes(mesh, faces)
        self._num_cells = self.mesh.topology.index_map(3).size_local
        self.corners = through_last(np.tile(np.arange(8, dtype=np.int32), (self._num_cells, 1)), axes)
        nodes = through_last(space.dofmap.list[: self._num_cells], axes)
        idle = np.asarray(BITS[None], dtype=np.float64)  # an idle rank has a cell, too
        X: Array = space.tabulate_dof_coordinates()[nodes] if len(nodes) else idle
        here = float(slants(X).max())
        self.slant: float = self.mesh.comm.allreduce(here, op=MPI.MAX)
        kinematics = Kinematics(ufl.Identity(3), mesh.fibres)
        fibres = {name: at_midpoints(mesh, kinematics.vector(name)) for name in sorted(mesh.fibres)}
        fibres = {name: a if len(a) else np.eye(3)[:1] for name, a in fibres.items()}
        self.cells = ShellCells(X, material, columns=columns, mean=mean, points=points, fibres=fibres)
        self.nodes = np.ascontiguousarray(nodes[self.cells.order] if len(nodes) else nodes)
        self._residual = la.vector(space.dofmap.index_map, space.dofmap.index_map_bs)
        self._num_owned = space.dofmap.index_map.size_local
        self._parallel = self.mesh.comm.size > 1

    def set_position(self, chi: Array) -> None:
        """Take ``chi`` ``(n, 3)`` [cm] of the owned nodes as the current position (collective)."""
        array = self.position.x.array
        array[: self._num_owned * 3].reshape(-1, 3)[:] = chi
        if self._parallel:
            self.position.x.scatter_forward()
        self.set_local(array)

    def set_local(self, chi: Array) -> None:
        """Take the position of owned and ghost nodes, flat, as the cells' one."""
        monomials(self.cells.m.x.array.reshape(-1, MODES, 3), chi.reshape(-1, 3), self.nodes)

    def force(self, chi: Array) -> Array:
        """Return the elastic nodal forces at ``chi``.

        Args:
            chi: Position of the owned nodes, ``(n, 3)`` [cm].

        Returns:
            F_k of the owned nodes, ``(n, 3)`` [dyn]; a view that the next call overwrites.

        Note:
            Collective. An inverted element makes the forces of its nodes NaN.
        """
        self.set_position(chi)
        array = self._residual.array
        array[:] = 0.0
        add_monomials(array.reshape(-1, 3), self.cells.forces(), self.nodes)
        if self._parallel:
            self._residual.scatter_reverse(la.InsertMode.add)
        return array[: self._num_owned * 3].reshape(-1, 3)

    def energy(self, chi: Array) -> float:
        """Return the elastic energy at ``chi`` ``(n, 3)`` [erg] (collective)."""
        self.set_position(chi)
        return self.mesh.comm.allreduce(self.cells.energy() if self._num_cells else 0.0)

    def jacobian(self, chi: Array) -> Array:
        """Return J of the columns of owned elements, ``(num_cells, 4)`` (collective)."""
        self.set_position(chi)
        return self.cells.in_order(self.cells.column_ratios())[: self._num_cells]

    def volume(self, chi: Array) -> float:
        """Return the volume, the exact integral of J dX [cm^3] (collective)."""
        self.set_position(chi)
        return self.mesh.comm.allreduce(self.cells.volume() if self._num_cells else 0.0)
