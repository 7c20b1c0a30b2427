"""Fibre fields: unit vectors in the reference state from a constant, a rule, or data, and their check.

Every function returns a discontinuous DOLFINx function of ``dim`` components with unit values at its nodes; give it
a name with ``mesh.with_fibres(name=field)``, and materials find it there. Degree 0 holds one vector a cell; above
that the energies normalise it between the nodes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import basix
import ufl
from dolfinx import fem
from mpi4py import MPI

from valvefsi.errors import CaseError, raise_together
from valvefsi.runtime.mesh_files import read_mesh_file
from valvefsi.solid.materials.harmonic import harmonic
from valvefsi.solid.materials.kinematics import Kinematics

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from _typeshed import DataclassInstance
    from ufl.core.expr import Expr

    from valvefsi.solid.materials.laws import Material
    from valvefsi.solid.materials.parameters import Direction
    from valvefsi.types import Array, Mesh

UNIT_TOLERANCE = 1e-6
"""Largest difference of a fibre's length to 1 that the solid accepts."""

DATA_TOLERANCE = 1e-2
"""The same for data from files, which are then normalised."""


def from_function(mesh: Mesh, function: Callable[[Array], Array], *, degree: int = 0) -> fem.Function:
    """Make a fibre field of a function of the reference position.

    Args:
        mesh: A ``SolidMesh``.
        function: ``function(X)`` gives vectors ``(n, dim)`` of any length at positions ``(n, 3)`` [cm].
        degree: Degree of the elements; 0 takes the value at the middle of each cell.

    Raises:
        CaseError: A vector is zero or not finite; on all ranks.

    Note:
        Collective.
    """
    space = fem.functionspace(mesh.mesh, ("DG", degree, (mesh.dim,)))
    X = space.tabulate_dof_coordinates()[: space.dofmap.index_map.size_local]
    vectors = np.asarray(function(X), dtype=np.float64)[:, : mesh.dim]
    return _fill(mesh, space, vectors)


def constant(mesh: Mesh, direction: Sequence[float]) -> fem.Function:
    """Make a fibre field with one direction, ``(dim,)`` of any length (collective)."""
    vector = np.asarray(direction, dtype=np.float64)
    if vector.shape != (mesh.dim,):
        raise CaseError(f"expected {mesh.dim} components", key="direction", value=list(direction))
    return from_function(mesh, lambda X: np.broadcast_to(vector, (len(X), mesh.dim)))


def circumferential(
    mesh: Mesh,
    *,
    axis: Sequence[float] = (0.0, 0.0, 1.0),
    through: Sequence[float] = (0.0, 0.0, 0.0),
    angle: float = 0.0,
    degree: int = 0,
) -> fem.Function:
    """Make a fibre field around an axis, turned out of the circle by an angle.

        a = cos(angle) e_theta + sin(angle) e_axis,    e_theta = e_axis x (X - through) / |...|

    In two dimensions the axis is z and the fibre turns towards the radius instead, away from the axis.

    Args:
        mesh: A ``SolidMesh``.
        axis: Direction of the axis, ``(3,)``.
        through: A point on it, ``(dim,)`` or ``(3,)`` [cm].
        angle: 0 for circles, 45 and -45 for two crossing families [deg].
        degree: Degree of the elements.

    Raises:
        CaseError: A fibre lies on the axis, or the axis is zero.

    Note:
        Collective.
    """
    along = _unit((0.0, 0.0, 1.0) if mesh.dim == 2 else axis, "axis")
    point = np.zeros(3)
    point[: len(through)] = through
    turn = math.radians(angle)

    def direction(X: Array) -> Array:
        radius = X - point
        if mesh.dim == 2:
            radius[:, 2] = 0.0
        around = np.cross(along, radius)
        length = np.linalg.norm(around, axis=1, keepdims=True)
        with np.errstate(invalid="ignore", divide="ignore"):
            around = np.where(length > 1e-12, around / length, np.nan)
        return math.cos(turn) * around + math.sin(turn) * (
            np.cross(around, along) if mesh.dim == 2 else along
        )

    return from_function(mesh, direction, degree=degree)


def turned(mesh: Mesh, angle: float) -> fem.Function:
    """Make a fibre field in the tangent plane of a leaflet, turned from its circumferential to its radial direction.

        a = cos(angle) e_c + sin(angle) e_r

    Args:
        mesh: A ``SolidMesh`` with the fibre fields "circumferential" and "radial", as meshes of valves have them.
        angle: The angle [deg].

    Raises:
        CaseError: The mesh lacks one of the two fields, or they are not of one kind.

    Note:
        Collective.
    """
    missing = [name for name in ("circumferential", "radial") if name not in mesh.fibres]
    if missing:
        raise CaseError(
            f"an angle from circumferential needs the mesh's fibre field {' and '.join(missing)}: add it with "
            '[[solid.fibre]], or give a flat sheet\'s angle to the x axis, such as "45 deg"',
            key="fibre",
            value=f"{angle:g} deg from circumferential",
        )
    around, up = mesh.fibres["circumferential"], mesh.fibres["radial"]
    if around.x.array.shape != up.x.array.shape:
        raise CaseError("circumferential and radial fibre fields are of different degrees", key="fibre")
    count = around.function_space.dofmap.index_map.size_local * mesh.dim
    turn = math.radians(angle)
    values = math.cos(turn) * around.x.array[:count] + math.sin(turn) * up.x.array[:count]
    return _fill(mesh, around.function_space, values.reshape(-1, mesh.dim))


def blend(
    mesh: Mesh,
    angles: Mapping[str, float],
    *,
    axis: Sequence[float] = (0.0, 0.0, 1.0),
) -> fem.Function:
    """Make a fibre field that turns through the wall from the angle at one surface to that at the other.

    The depth phi solves Laplace's equation with 0 on the first surface and 1 on the second. With the wall's
    normal n = grad phi/|grad phi|, the circumferential e_c = e_axis x n/|...| and e_l = n x e_c,

        a = cos(alpha) e_c + sin(alpha) e_l,    alpha = (1 - phi) alpha_first + phi alpha_second.

    In two dimensions e_c lies along the layers and e_l across them.

    Args:
        mesh: A ``SolidMesh``.
        angles: Two facet tags and the angle at each [deg].
        axis: Direction of the axis, ``(3,)``.

    Returns:
        Field of degree 0.

    Raises:
        CaseError: There are not two surfaces, a tag is unknown or empty, or the axis is normal to the wall.

    Note:
        Collective. One linear solve by MUMPS.
    """
    if len(angles) != 2 or not all(math.isfinite(angle) for angle in angles.values()):
        raise CaseError("expected two facet tags with an angle each", key="angles", value=dict(angles))
    inner, outer = angles
    depth = harmonic(mesh, [((inner,), 0.0), ((outer,), 1.0)], "angles")
    phi, gradient = at_midpoints(mesh, depth)[:, 0], np.zeros((_own_cells(mesh), 3))
    gradient[:, : mesh.dim] = at_midpoints(mesh, ufl.grad(depth))
    along = _unit((0.0, 0.0, 1.0) if mesh.dim == 2 else axis, "axis")
    first, second = (math.radians(angle) for angle in angles.values())
    with np.errstate(invalid="ignore", divide="ignore"):
        normal = gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
        around = np.cross(along, normal)
        length = np.linalg.norm(around, axis=1, keepdims=True)
        around = np.where(length > 1e-8, around / length, np.nan)
    up = normal if mesh.dim == 2 else np.cross(normal, around)
    alpha = ((1 - phi) * first + phi * second)[:, None]
    return from_values(mesh, np.cos(alpha) * around + np.sin(alpha) * up)


def from_cells(mesh: Mesh, points: Array, vectors: Array) -> fem.Function:
    """Make a fibre field of data given cell by cell, in any order and on any partition.

    Args:
        mesh: A ``SolidMesh``.
        points: Middles of all cells, the mean of their corners, on every rank ``(num_cells, 3)`` [cm].
        vectors: Fibres there, unit within `DATA_TOLERANCE`, ``(num_cells, dim)`` or ``(num_cells, 3)``.

    Raises:
        CaseError: A cell has no datum near its middle, or a datum is not a unit vector.

    Note:
        Collective.
    """
    from scipy.spatial import cKDTree

    points, vectors = np.asarray(points, dtype=np.float64), np.asarray(vectors, dtype=np.float64)
    length = np.linalg.norm(vectors, axis=1)
    wrong = np.count_nonzero(~(np.abs(length - 1) <= DATA_TOLERANCE))
    if wrong or len(points) != len(vectors):
        message = f"{wrong} of {len(vectors)} fibres are not unit vectors"
        message = message if wrong else f"{len(points)} points and {len(vectors)} fibres"
        raise CaseError(message, file=mesh.source, key="fibre")
    tree = cKDTree(points) if len(points) else None
    size = np.ptp(points, axis=0).max() if len(points) else 0.0

    def nearest(X: Array) -> Array:
        if tree is None:
            return np.full((len(X), mesh.dim), np.nan)
        distance, place = tree.query(X)
        return np.where((distance <= 1e-6 * size)[:, None], vectors[place, : mesh.dim], np.nan)

    try:
        return from_function(mesh, nearest)
    except CaseError as error:
        raise CaseError(f"cells without data: {error.reason}", file=mesh.source, key="fibre") from None


def read_fibres(mesh: Mesh, path: str | Path, name: str) -> fem.Function:
    """Read a fibre field from the cell data or point data ``name`` of a file that meshio reads (.vtu, .msh ...).

    The file's cells must be those of the mesh, in any order. Point data are averaged over the corners of each cell,
    each turned to the side of the first, because a fibre has no sign.

    Raises:
        CaseError: The file is missing or cannot be read, has no such data, or does not fit the mesh.

    Note:
        Collective; rank 0 reads.
    """
    comm, data, error = mesh.mesh.comm, None, None
    if comm.rank == 0:
        try:
            data = _read_cells(Path(path), name, mesh.dim)
        except CaseError as problem:
            error = problem
    raise_together(comm, error)
    points, vectors = comm.bcast(data, root=0)
    return from_cells(mesh, points, vectors)


def read_vectors(mesh: Mesh, path: str | Path) -> dict[str, fem.Function]:
    """Read all cell data of unit vectors of a file that meshio reads as fibre fields by name; fibre is fibre_1, too.

    Raises:
        CaseError: The file cannot be read, has no unit vectors, or does not fit the mesh.

    Note:
        Collective; rank 0 reads.
    """
    comm, data, error = mesh.mesh.comm, None, None
    if comm.rank == 0:
        try:
            data = _unit_vectors(Path(path), mesh.dim)
        except CaseError as problem:
            error = problem
    raise_together(comm, error)
    points, vectors = comm.bcast(data, root=0)
    fields = {name: from_cells(mesh, points, values) for name, values in vectors.items()}
    return fields | ({"fibre": fields["fibre_1"]} if "fibre_1" in fields and "fibre" not in fields else {})


def _unit_vectors(path: Path, dim: int) -> tuple[Array, dict[str, Array]]:
    """Read middles of the cells of the highest dimension, and their unit vectors by name."""
    data = read_mesh_file(path)
    points, vectors = np.zeros((0, 3)), {}
    for name in data.cell_data:
        points, found = _cells_of(data, name, dim)
        if found.ndim != 2 or found.shape[1] not in (dim, 3):
            continue
        if np.abs(np.linalg.norm(found, axis=1) - 1).max(initial=0.0) <= DATA_TOLERANCE:
            vectors[name] = found
    if not vectors:
        listed = ", ".join(data.cell_data) or "none"
        raise CaseError(f"{path.name} has no cell data of unit vectors; its cell data are {listed}")
    return points, vectors


def check_fibres(mesh: Mesh, material: Material) -> None:
    """Refuse fibre fields that a material cannot use: missing, not unit, not at right angles where they must be.

    Raises:
        CaseError: With the name of the field; on all ranks.

    Note:
        Collective.
    """
    kinematics = Kinematics(ufl.Identity(mesh.dim), mesh.fibres)
    for given in directions(material):
        kinematics.vector(given)
        if isinstance(given, str):
            field = mesh.fibres[given]
            values = field.x.array.reshape(-1, mesh.dim) if field.x.array.size else np.zeros((0, mesh.dim))
            wrong = np.count_nonzero(~(np.abs(np.linalg.norm(values, axis=1) - 1) <= UNIT_TOLERANCE))
            wrong = mesh.mesh.comm.allreduce(wrong)
            if wrong:
                raise CaseError(
                    f"{wrong} fibres are not unit vectors", file=mesh.source, key="fibre", value=given
                )
    pair = getattr(material, "orthogonal", None)
    if pair is not None:
        product = ufl.inner(*(kinematics.vector(given) for given in pair))
        values = at_midpoints(mesh, product)
        worst = mesh.mesh.comm.allreduce(float(np.abs(values).max(initial=0.0)), op=MPI.MAX)
        if not worst <= 1e-3:
            message = f"expected two directions at right angles, the cosine between them reaches {worst:.3g}"
            raise CaseError(message, file=mesh.source, key="sheet", value=pair[1])


def directions(material: Material | DataclassInstance) -> Iterator[Direction]:
    """Give every direction that a material declares, those of its tables too."""
    for item in fields(material) if is_dataclass(material) else ():
        value, kind = getattr(material, item.name), item.metadata.get("kind")
        if kind == "direction":
            yield value
        elif kind == "table":
            for entry in value:
                yield from directions(entry)


def at_midpoints(mesh: Mesh, expression: Expr) -> Array:
    """Evaluate a UFL expression at the middle of this rank's cells, ``(num_cells, size)`` (collective)."""
    domain = mesh.mesh
    middle = basix.geometry(domain.basix_cell()).mean(axis=0, keepdims=True)
    cells = np.arange(_own_cells(mesh), dtype=np.int32)
    of_mesh = expression + fem.Constant(
        domain, np.zeros(expression.ufl_shape)
    )  # a vector of numbers has no mesh
    return compat.evaluate(compat.compile_expression(of_mesh, middle, domain.comm), domain, cells)


def _own_cells(mesh: Mesh) -> int:
    return int(mesh.mesh.topology.index_map(mesh.mesh.topology.dim).size_local)


def on_root(mesh: Mesh, name: str) -> tuple[Array, Array] | None:
    """Gather a fibre field for pictures: middles ``(n, 3)`` and vectors ``(n, 3)`` on rank 0 (collective)."""
    dim = mesh.dim
    a = Kinematics(ufl.Identity(dim), mesh.fibres).vector(name)
    places = at_midpoints(mesh, ufl.SpatialCoordinate(mesh.mesh))
    X, vectors = np.zeros((len(places), 3)), np.zeros((len(places), 3))
    X[:, :dim], vectors[:, :dim] = places, at_midpoints(mesh, a)
    gathered = mesh.mesh.comm.gather((X, vectors), root=0)
    if gathered is None:
        return None
    points, values = (np.concatenate(parts) for parts in zip(*gathered, strict=True))
    order = np.lexsort(np.round(points, 9).T[::-1])
    return points[order], values[order]


def from_values(mesh: Mesh, vectors: Array) -> fem.Function:
    """Make a field of degree 0 of vectors of this rank's own cells, ``(num_cells, 3)``, of any length (collective)."""
    space = fem.functionspace(mesh.mesh, ("DG", 0, (mesh.dim,)))
    ordered = np.full((space.dofmap.index_map.size_local, mesh.dim), np.nan)
    ordered[space.dofmap.list[: len(vectors), 0]] = vectors[:, : mesh.dim]
    return _fill(mesh, space, ordered)


def _fill(mesh: Mesh, space: fem.FunctionSpace, vectors: Array) -> fem.Function:
    """Make a function of the normalised vectors of this rank's own nodes; refuse zero and NaN."""
    length = np.linalg.norm(vectors, axis=1)
    bad = mesh.mesh.comm.allreduce(int(np.count_nonzero(~(np.isfinite(length) & (length > 0)))))
    if bad:
        raise CaseError(f"{bad} fibres are zero or not finite", file=mesh.source, key="fibre")
    field = fem.Function(space, name="fibre")
    field.x.array[: vectors.size] = (vectors / length[:, None]).ravel()
    field.x.scatter_forward()
    return field


def _unit(vector: Sequence[float], key: str) -> Array:
    """Return a vector of length 1; refuse one that has none."""
    given = np.asarray(vector, dtype=np.float64)
    length = np.linalg.norm(given)
    if given.shape != (3,) or not 0 < length < np.inf:
        raise CaseError("expected 3 components, not all zero", key=key, value=list(vector))
    return given / length


def _read_cells(path: Path, name: str, dim: int) -> tuple[Array, Array]:
    """Read middles and vectors of the cells of the highest dimension."""
    data = read_mesh_file(path)
    known = [*data.cell_data, *data.point_data]
    if name not in known:
        listed = ", ".join(known) or "none"
        raise CaseError(
            f"no such cell or point data; the file has {listed}", file=path, key="data", value=name
        )
    points, found = _cells_of(data, name, dim)
    if found.ndim != 2 or found.shape[1] not in (dim, 3):
        raise CaseError(f"expected {dim} components", file=path, key="data", value=name)
    return points, found


def _cells_of(data: Any, name: str, dim: int) -> tuple[Array, Array]:
    """Return middles and values of the cells of the highest dimension."""
    points, vectors = [], []
    for number, block in enumerate(data.cells):
        if block.dim != dim:
            continue
        corners = data.points[block.data]
        points.append(np.pad(corners.mean(axis=1), ((0, 0), (0, 3 - corners.shape[2]))))
        if name in data.cell_data:
            vectors.append(np.asarray(data.cell_data[name][number], dtype=np.float64))
        else:
            vectors.append(_average(np.asarray(data.point_data[name], dtype=np.float64)[block.data]))
    found = np.concatenate(vectors) if vectors else np.zeros((0, dim))
    return np.concatenate(points) if points else np.zeros((0, 3)), found


def _average(corners: Array) -> Array:
    """Average vectors ``(n, corners, dim)`` with the sign of the first corner's; unit unless they cancel."""
    sign = np.where(np.einsum("ckd,cd->ck", corners, corners[:, 0]) < 0, -1.0, 1.0)
    mean = np.einsum("ckd,ck->cd", corners, sign)
    length = np.linalg.norm(mean, axis=1, keepdims=True)
    return np.divide(mean, length, out=np.full_like(mean, np.nan), where=length > 0)
