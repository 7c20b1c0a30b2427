"""The mesh of a solid with its named tags, made from a gmsh model or read from a .msh file."""

from __future__ import annotations

import contextlib
import difflib
import shutil
import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import basix

from valvefsi.errors import CaseError, raise_together
from valvefsi.runtime.mesh_files import check_beginning

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from dolfinx import fem
    from dolfinx.mesh import Mesh, MeshTags
    from mpi4py import MPI

    from valvefsi.types import Gmsh


@dataclass(frozen=True, kw_only=True)
class SolidMesh:
    """A distributed mesh, its cell and facet tags and their names.

    Args:
        mesh: DOLFINx mesh of one cell type, coordinates in cm, two or three dimensions.
        cell_tags: Tags of the cells, None where there are none.
        facet_tags: Tags of the facets, None where there are none.
        names: ``{name: (dimension, tag)}`` of the physical groups.
        source: Where it comes from, for messages.
        fibres: Unit vector fields of the reference state by name, DOLFINx functions of ``dim`` components;
            see `with_fibres`.

    Note:
        Collective. Raises CaseError on every rank where a cell is inverted or flat.
    """

    mesh: Mesh
    cell_tags: MeshTags | None
    facet_tags: MeshTags | None
    names: dict[str, tuple[int, int]] = field(default_factory=dict)
    source: str = "mesh"
    fibres: dict[str, fem.Function] = field(default_factory=dict)

    def __post_init__(self) -> None:
        comm = self.mesh.comm
        bad = comm.allreduce(_count_bad_cells(self.mesh))
        if bad:
            raise CaseError(f"the mesh has {bad} inverted or flat cells", file=self.source)

    @property
    def dim(self) -> int:
        """Number of dimensions, 2 or 3."""
        return self.mesh.geometry.dim

    def with_fibres(self, **fibres: fem.Function) -> SolidMesh:
        """Return this mesh with more fibre fields, checked where a material uses them."""
        return replace(self, fibres={**self.fibres, **fibres})

    def tag(self, name: str) -> tuple[int, int]:
        """Return dimension and number of the tag called ``name``.

        Raises:
            CaseError: There is no such tag; the message lists those there are.
        """
        if name in self.names:
            return self.names[name]
        known = ", ".join(f'"{known}"' for known in self.names) or "none"
        near = difflib.get_close_matches(name, self.names, n=1)
        hint = f' (did you mean "{near[0]}"?)' if near else ""
        raise CaseError(f"no such tag{hint}; the mesh has {known}", file=self.source, key="on", value=name)


def read_mesh(path: str | Path, comm: MPI.Comm) -> SolidMesh:
    """Read a gmsh file; flat in z means two dimensions.

    Args:
        path: A ``.msh`` file with at least one physical group for the cells; coordinates in cm.
        comm: Communicator the mesh is distributed on.

    Returns:
        The mesh with its tags; groups without a name are called ``cells_1``, ``facets_2``, ...

    Raises:
        CaseError: The file is missing, is not a gmsh file, or holds no tagged cells of one kind.

    Note:
        Collective; rank 0 reads.
    """
    path = Path(path)

    def build(gmsh: Gmsh) -> None:
        check_beginning(path, ("gmsh",))
        # Gmsh runs what it takes for a script, and NAME.opt beside a file; a copy under our name has neither.
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder) / "mesh.msh"
            shutil.copyfile(path, copy)
            try:
                check_beginning(copy)
                gmsh.open(str(copy))
            except Exception as error:  # gmsh raises nothing narrower
                reason = str(error).replace(str(copy), path.name)
                raise CaseError(f"gmsh cannot read this file: {reason}", file=path) from None

    return mesh_from_gmsh(build, comm, source=str(path))


def mesh_from_gmsh(build: Callable[[Gmsh], None], comm: MPI.Comm, *, source: str) -> SolidMesh:
    """Make a mesh with ``build(gmsh)``, which rank 0 alone calls with a fresh, quiet gmsh.

    Args:
        build: Fills gmsh's current model: entities, physical groups, mesh.
        comm: Communicator the mesh is distributed on.
        source: Name of the mesh for messages.

    Raises:
        CaseError: The model cannot be used, or ``build`` raised it; on all ranks.

    Note:
        Collective. Gmsh is finalised unless the caller had initialised it before.
    """
    with contextlib.ExitStack() as stack:
        model, about, error = None, None, None
        if comm.rank == 0:
            try:
                gmsh = stack.enter_context(_quiet_gmsh())
                build(gmsh)
                model, about = gmsh.model, _inspect(gmsh.model, source)
            except Exception as problem:  # whatever it is, the other ranks must not wait
                error = problem
        raise_together(comm, error)
        gdim, names = comm.bcast(about, root=0)
        mesh, cell_tags, facet_tags = compat.model_to_mesh(model, comm, gdim)
    return SolidMesh(mesh=mesh, cell_tags=cell_tags, facet_tags=facet_tags, names=names, source=source)


@contextlib.contextmanager
def _quiet_gmsh() -> Iterator[Gmsh]:
    """Give gmsh with an empty model, silent, leaving Ctrl-C to Python; put back what was there before."""
    import gmsh

    mine = not gmsh.isInitialized()
    if mine:
        gmsh.initialize([], readConfigFiles=False, interruptible=False)
    terminal = gmsh.option.getNumber("General.Terminal")
    gmsh.option.setNumber("General.Terminal", 0)
    before = gmsh.model.list()
    gmsh.model.add("valvefsi")
    try:
        yield gmsh
    finally:
        if mine:
            gmsh.finalize()
        else:
            for name in [name for name in gmsh.model.list() if name not in before]:
                gmsh.model.setCurrent(name)
                gmsh.model.remove()
            gmsh.option.setNumber("General.Terminal", terminal)


def _inspect(model: Gmsh, source: str) -> tuple[int, dict[str, tuple[int, int]]]:
    """Return dimension and names of the physical groups of a gmsh model; renumber its nodes without gaps."""
    _, points, _ = model.mesh.getNodes()
    groups = model.getPhysicalGroups()
    tdim = max((dim for dim, _ in groups), default=-1)
    if len(points) == 0 or tdim < 2:
        raise CaseError("expected a mesh with a physical group for its cells", file=source)
    z = np.asarray(points).reshape(-1, 3)[:, 2]
    gdim = 3 if tdim == 3 else 2
    if gdim == 2 and np.ptp(z) > 0:
        raise CaseError("a mesh of triangles or quadrilaterals must be flat, z constant", file=source)
    if len(model.mesh.getElements(tdim)[0]) != 1:
        raise CaseError("expected cells of one kind", file=source)
    tagged = sum(_count_elements(model, tdim, tag) for dim, tag in groups if dim == tdim)
    (numbers,) = model.mesh.getElements(tdim)[1]
    total = len(numbers)
    if len(np.unique(numbers)) != total:
        raise CaseError("two cells have the same number", file=source)
    if tagged != total:
        raise CaseError(f"{total} cells, {tagged} tags: every cell needs one physical group", file=source)
    model.mesh.renumberNodes()
    return gdim, _names(model, tdim, source)


def _names(model: Gmsh, tdim: int, source: str) -> dict[str, tuple[int, int]]:
    """Return ``{name: (dimension, tag)}`` of the groups of cells and facets; name those without a name."""
    names: dict[str, tuple[int, int]] = {}
    for dim, tag in model.getPhysicalGroups():
        if dim < tdim - 1:
            model.removePhysicalGroups([(dim, tag)])
            continue
        name = model.getPhysicalName(dim, tag) or f"{'cells' if dim == tdim else 'facets'}_{tag}"
        if name in names:
            raise CaseError(f'two physical groups are called "{name}"', file=source)
        model.setPhysicalName(dim, tag, name)
        names[name] = (dim, tag)
    return names


def _count_elements(model: Gmsh, dim: int, tag: int) -> int:
    """Return the number of elements in a physical group."""
    entities = model.getEntitiesForPhysicalGroup(dim, tag)
    return sum(len(tags) for entity in entities for tags in model.mesh.getElements(dim, entity)[1])


def _count_bad_cells(mesh: Mesh) -> int:
    """Count this rank's cells whose Jacobian determinant at the corners is zero or changes sign."""
    element = mesh.ufl_domain().ufl_coordinate_element().basix_element
    corners = basix.geometry(element.cell_type)
    gradients = element.tabulate(1, corners)[1:, :, :, 0]
    points = mesh.geometry.x[compat.geometry_nodes(mesh)][:, :, : mesh.geometry.dim]
    determinants = np.linalg.det(np.einsum("dpn,cni->cpid", gradients, points))
    size = np.ptp(points, axis=1).prod(axis=1) if len(points) else np.zeros(0)
    smallest = np.where(determinants[:, :1] < 0, -determinants, determinants).min(axis=1, initial=np.inf)
    return int(np.count_nonzero(~(smallest > 1e-12 * size)))
