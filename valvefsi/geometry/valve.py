"""Solid meshes of three leaflets: structured hexahedra or tetrahedra with layers, tags, fibres and a quality table."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.errors import CaseError
from valvefsi.geometry.tagged_files import fill_model, write_model

if TYPE_CHECKING:
    from mpi4py import MPI
    from numpy.typing import NDArray

    from valvefsi.geometry.leaflets import ValveGeometry
    from valvefsi.geometry.mesh import SolidMesh
    from valvefsi.types import Array, Gmsh

    Cells = NDArray[np.int64]

STEP = 1e-5
"""Step of the centred differences that give the tangents; their error is about STEP^2."""

KUHN = ((0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6))
"""Six tetrahedra of a hexahedron; the same in all, so that they fit from cell to cell."""

FACES = {
    "inflow": (0, 3, 2, 1),
    "outflow": (4, 5, 6, 7),
    "attached": (0, 1, 5, 4),
    "free": (3, 7, 6, 2),
    "low": (0, 4, 7, 3),
    "high": (1, 2, 6, 5),
}
"""Corners of a hexahedron's faces, outward."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ValveMesh:
    """Three leaflets of solid cells.

    Attributes:
        points: Nodes, ``(num_nodes, 3)`` [cm].
        cells: Corners of the cells, 8 or 4 each, ``(num_cells, 8 or 4)``.
        leaflet: Number of each cell's leaflet, 1 to 3, ``(num_cells,)``.
        facets: Corners of the outer facets by tag: "inflow", "outflow", "attached", "free".
        fibres: Unit vectors at the cells' middles by name, "circumferential", "radial" and "fibre_1", ..., each
            ``(num_cells, 3)``.
        elements: Number around, from the attachment to the free edge, through the thickness.
    """

    points: Array
    cells: Cells
    leaflet: NDArray[np.int64]
    facets: dict[str, Cells]
    fibres: dict[str, Array]
    elements: tuple[int, int, int]


def mesh_valve(
    geometry: ValveGeometry, *, size: float, layers: int = 1, cell: str = "hexahedron"
) -> ValveMesh:
    """Mesh the three leaflets of a valve.

    The middle surface is thickened along its normal by half the thickness to both sides. The second and the third
    leaflet are the first one, turned by 120 degrees.

    Args:
        geometry: The valve.
        size: Largest length of an element along the leaflet [cm], such as mesh/h times h.
        layers: Number of elements through the thickness.
        cell: "hexahedron" or "tetrahedron", six of which make a hexahedron.

    Raises:
        CaseError: A value cannot be used, or the thickness does not fit the curvature (inverted cells).
    """
    if cell not in ("hexahedron", "tetrahedron"):
        raise CaseError('expected "hexahedron" or "tetrahedron"', key="cell", value=cell)
    if not 0 < size < math.inf or layers < 1:
        raise CaseError("expected a positive size and a layer", key="size, layers", value=[size, layers])
    around, up = _counts(geometry, size)
    points, hexahedra = _leaflet_nodes(geometry, (around, up, layers))
    facets = _outer_faces(hexahedra, (around, up, layers))
    fibres = _fibres(geometry, (around, up, layers))
    if cell == "tetrahedron":
        cells = hexahedra[:, KUHN].reshape(-1, 4)
        facets = {name: _split(faces) for name, faces in facets.items()}
        fibres = {name: np.repeat(vectors, len(KUHN), axis=0) for name, vectors in fibres.items()}
    else:
        cells = hexahedra
    turns, shift = [_turn(k) for k in range(3)], len(points) * np.arange(3)
    mesh = ValveMesh(
        points=np.concatenate([points @ R.T for R in turns]),
        cells=np.concatenate([cells + s for s in shift]),
        leaflet=np.repeat([1, 2, 3], len(cells)),
        facets={name: np.concatenate([faces + s for s in shift]) for name, faces in facets.items()},
        fibres={name: np.concatenate([a @ R.T for R in turns]) for name, a in fibres.items()},
        elements=(around, up, layers),
    )
    if not jacobians(mesh).min() > 0:
        raise CaseError("the thickness does not fit the shape: inverted cells", key="thickness")
    return mesh


def first_leaflet(mesh: ValveMesh) -> ValveMesh:
    """Return the first of a valve's three leaflets, that of the sector around x; the others are it, turned."""
    nodes, cells = len(mesh.points) // 3, len(mesh.cells) // 3
    return replace(
        mesh,
        points=mesh.points[:nodes],
        cells=mesh.cells[:cells],
        leaflet=mesh.leaflet[:cells],
        facets={name: faces[: len(faces) // 3] for name, faces in mesh.facets.items()},
        fibres={name: vectors[:cells] for name, vectors in mesh.fibres.items()},
    )


def corner_edges(mesh: ValveMesh) -> Array:
    """Return the three edges at each corner of each cell, right-handed, ``(num_cells, corners, 3, 3)`` [cm]."""
    corners = mesh.points[mesh.cells]
    following = _NEXT if mesh.cells.shape[1] == 8 else _NEXT_OF_FOUR
    return np.stack([corners[:, list(n)] - corners[:, k : k + 1] for k, n in enumerate(following)], axis=1)


def corner_frames(mesh: ValveMesh) -> Array:
    """Return `corner_edges` divided by their lengths."""
    edges = corner_edges(mesh)
    return edges / np.linalg.norm(edges, axis=-1, keepdims=True)


def jacobians(mesh: ValveMesh) -> Array:
    """Return the determinant of the edges at each corner of each cell, ``(num_cells, corners)`` [cm^3]."""
    return np.linalg.det(corner_edges(mesh))


def volumes(mesh: ValveMesh) -> Array:
    """Return the volume of each cell; of hexahedra by Gauss' rule, exact for them, ``(num_cells,)`` [cm^3]."""
    corners = mesh.points[mesh.cells]
    if mesh.cells.shape[1] == 4:
        return np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    total = np.zeros(len(corners))
    for at in np.ndindex(2, 2, 2):
        r = 0.5 + (np.array(at) - 0.5) / math.sqrt(3)
        share = np.where(_UNIT == 1, r, 1 - r)
        sign = np.where(_UNIT == 1, 1.0, -1.0)
        slopes = np.stack([sign[:, i] * np.delete(share, i, axis=1).prod(axis=1) for i in range(3)])
        total += np.linalg.det(np.einsum("dk,cki->cdi", slopes, corners)) / 8
    return total


def surface_volume(geometry: ValveGeometry, *, panels: int = 60) -> float:
    """Return the volume of one leaflet by Gauss quadrature of its formulas, with no mesh [cm^3].

        V = integral t dA + integral K t^3/12 dA,    K the Gaussian curvature

    exact where the thickness is uniform (Steiner); where it varies the second term is what is left out at most.
    """
    x, w = np.polynomial.legendre.leggauss(3)
    edges = np.linspace(0, 1, panels + 1)
    v = (edges[:-1, None] + np.diff(edges)[:, None] * (x + 1) / 2).ravel()
    weight = np.tile(w / 2 / panels, panels)
    U, V = (part.ravel() for part in np.meshgrid(2 * v - 1, v, indexing="ij"))
    W = np.outer(2 * weight, weight).ravel()
    c, m = _tangents(geometry, U, V)
    normal = np.cross(c, m)
    area = np.linalg.norm(normal, axis=1)
    n, step = normal / area[:, None], 1e-4
    n_u = (_normals(geometry, U + step, V) - _normals(geometry, U - step, V)) / (2 * step)
    n_v = (_normals(geometry, U, V + step) - _normals(geometry, U, V - step)) / (2 * step)
    curvature = np.einsum("ni,ni->n", np.cross(n_u, n_v), n)  # K dA
    t = geometry.thickness_at(U, V)
    return float(np.sum(W * (t * area + curvature * t**3 / 12)))


def write_valve(path: str | Path, mesh: ValveMesh) -> Path:
    """Write a gmsh file with tags leaflet_1 ... leaflet_3, inflow, outflow, attached, free, and fibres as cell data."""
    from valvefsi.geometry.mesh import _quiet_gmsh

    path = Path(path)
    if path.suffix != ".msh":
        raise CaseError("expected a name that ends in .msh", key="out", value=str(path))
    with _quiet_gmsh() as gmsh:
        _to_gmsh(gmsh, mesh)
        write_model(gmsh, path, sum(len(faces) for faces in mesh.facets.values()), mesh.fibres)
    return path


def distribute(mesh: ValveMesh, comm: MPI.Comm) -> SolidMesh:
    """Return a valve's mesh as DOLFINx has it, with the tags of `write_valve`. Collective; rank 0's is taken."""
    from valvefsi.geometry.mesh import mesh_from_gmsh

    return mesh_from_gmsh(lambda gmsh: _to_gmsh(gmsh, mesh), comm, source="valve")


def _to_gmsh(gmsh: Gmsh, mesh: ValveMesh) -> None:
    cells = {f"leaflet_{number}": mesh.cells[mesh.leaflet == number] for number in np.unique(mesh.leaflet)}
    fill_model(gmsh, mesh.points, mesh.facets, cells)


def _counts(geometry: ValveGeometry, size: float) -> tuple[int, int]:
    """Return numbers of elements around (even) and up that keep edges of the middle surface below ``size``."""
    line = np.linspace(0, 1, 401)
    around = max(_length(geometry.surface(2 * line - 1, np.full(401, v))) for v in (0.0, 0.5, 1.0))
    up = max(_length(geometry.surface(np.full(401, u), line)) for u in (0.0, 0.5, 1.0))
    return 2 * max(2, math.ceil(around / size / 2)), max(2, math.ceil(up / size))


def _length(x: Array) -> float:
    return float(np.linalg.norm(np.diff(x, axis=0), axis=1).sum())


def _tangents(geometry: ValveGeometry, u: Array, v: Array) -> tuple[Array, Array]:
    """Return dS/du and dS/dv by centred differences; S is defined a little beyond its edges too."""
    c = (geometry.surface(u + STEP, v) - geometry.surface(u - STEP, v)) / (2 * STEP)
    m = (geometry.surface(u, v + STEP) - geometry.surface(u, v - STEP)) / (2 * STEP)
    return c, m


def _normals(geometry: ValveGeometry, u: Array, v: Array) -> Array:
    """Return unit normals, toward the outflow side."""
    normal = np.cross(*_tangents(geometry, u, v))
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def _leaflet_nodes(geometry: ValveGeometry, counts: tuple[int, int, int]) -> tuple[Array, Cells]:
    """Return nodes and hexahedra of the first leaflet; mirrored halves, so that they agree to round-off."""
    around, up, layers = counts
    u, v, s = np.linspace(-1, 1, around + 1), np.linspace(0, 1, up + 1), np.linspace(-0.5, 0.5, layers + 1)
    U, V = (part.ravel() for part in np.meshgrid(u, v, indexing="ij"))
    middle, thick = geometry.surface(U, V), geometry.thickness_at(U, V)
    along = thick[:, None, None] * s[:, None] * _normals(geometry, U, V)[:, None, :]
    points = (middle[:, None, :] + along).reshape(-1, 3)
    index = np.arange(len(points)).reshape(around + 1, up + 1, layers + 1)
    corners = [index[i : around + i, j : up + j, k : layers + k].ravel() for i, j, k in _UNIT]
    return points, np.stack(corners, axis=1)


def _outer_faces(hexahedra: Cells, counts: tuple[int, int, int]) -> dict[str, Cells]:
    """Return the outer faces by tag; the two sides at the posts belong to the attachment."""
    box = hexahedra.reshape(*counts, 8)
    at = {
        "inflow": box[:, :, 0],
        "outflow": box[:, :, -1],
        "attached": box[:, 0],
        "free": box[:, -1],
        "low": box[0],
        "high": box[-1],
    }
    faces = {name: cells[..., list(FACES[name])].reshape(-1, 4) for name, cells in at.items()}
    attached = np.concatenate([faces.pop("attached"), faces.pop("low"), faces.pop("high")])
    return {**faces, "attached": attached}


def _split(faces: Cells) -> Cells:
    """Split quadrilaterals as `KUHN` does, along the diagonal through the corner 0 or 6 of the hexahedron."""
    return np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])


def _fibres(geometry: ValveGeometry, counts: tuple[int, int, int]) -> dict[str, Array]:
    """Return the fibres at the middles of the first leaflet's hexahedra, in the tangent plane."""
    around, up, layers = counts
    u, v = (np.arange(around) + 0.5) / around * 2 - 1, (np.arange(up) + 0.5) / up
    U, V = (part.ravel() for part in np.meshgrid(u, v, indexing="ij"))
    c, _ = _tangents(geometry, U, V)
    n = _normals(geometry, U, V)
    c /= np.linalg.norm(c, axis=1, keepdims=True)
    m = np.cross(n, c)
    found = {name: np.repeat(a, layers, axis=0) for name, a in (("circumferential", c), ("radial", m))}
    for number, angle in enumerate(geometry.fibre_angles, start=1):
        a = math.cos(math.radians(angle)) * c + math.sin(math.radians(angle)) * m
        found[f"fibre_{number}"] = np.repeat(a, layers, axis=0)
    return found


def _turn(k: int) -> Array:
    """Return the rotation by k times 120 degrees about z."""
    c, s = ((1.0, 0.0), (-0.5, math.sqrt(0.75)), (-0.5, -math.sqrt(0.75)))[k]
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


_UNIT = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])
_NEXT = ((1, 3, 4), (2, 0, 5), (3, 1, 6), (0, 2, 7), (7, 5, 0), (4, 6, 1), (5, 7, 2), (6, 4, 3))
_NEXT_OF_FOUR = ((1, 2, 3), (2, 0, 3), (0, 1, 3), (0, 2, 1))
