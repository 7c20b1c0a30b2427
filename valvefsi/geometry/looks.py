"""What a mesh looks like before it is used: its outer facets by tag, its thickness, how good its cells are."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
from dolfinx import mesh as meshes

if TYPE_CHECKING:
    from valvefsi.geometry.mesh import SolidMesh
    from valvefsi.types import Array, Indices

AROUND = {"interval": [0, 1], "triangle": [0, 1, 2], "quadrilateral": [0, 1, 3, 2]}
"""Corners of a facet one after the other, of those in DOLFINx' order."""
NEIGHBOURS: dict[str, tuple[list[tuple[int, ...]], float]] = {
    "triangle": ([(1, 2), (2, 0), (0, 1)], 2 / math.sqrt(3)),
    "quadrilateral": ([(1, 2), (3, 0), (0, 3), (2, 1)], 1.0),
    "tetrahedron": ([(1, 2, 3), (2, 0, 3), (0, 1, 3), (1, 0, 2)], math.sqrt(2)),
    "hexahedron": (
        [(1, 2, 4), (3, 0, 5), (0, 3, 6), (2, 1, 7), (6, 5, 0), (4, 7, 1), (7, 4, 2), (5, 6, 3)],
        1.0,
    ),
}
"""Corners beside each corner of a cell, in DOLFINx' order, and what makes 1 of the best cell."""
GOOD, POOR = 0.3, 0.1
"""Scaled Jacobians above which a cell is good, and below which it is bad."""
RAYS, PAIRS = 4000, 1_000_000
"""Facets from which the thickness is looked for at most, and pairs of a ray and a triangle at once."""


@dataclass(frozen=True, kw_only=True)
class Quality:
    """How good the cells of a mesh are.

    Attributes:
        cells: Number of cells.
        nodes: Number of nodes.
        scaled: Least scaled Jacobian of the corners of each cell, 1 for the best cell, ``(cells,)``.
        edges: Length of each edge of each cell [cm].
    """

    cells: int
    nodes: int
    scaled: Array
    edges: Array

    def verdict(self) -> str:
        """Return what the shapes of the cells are good for."""
        least, poor = float(self.scaled.min()), int(np.count_nonzero(self.scaled < GOOD))
        if least >= GOOD:
            return "good"
        if least >= POOR:
            return f"usable; {poor} cells are poor, below {GOOD:g}"
        return f"bad: {int(np.count_nonzero(self.scaled < POOR))} cells below {POOR:g}; mesh it anew, --size helps"


def facets_by_tag(mesh: SolidMesh) -> dict[str, Array]:
    """Return the corners of this rank's outer facets by tag, ``(n, k, 3)`` [cm]; those without a tag under ""."""
    domain = mesh.mesh
    dim = domain.topology.dim - 1
    domain.topology.create_connectivity(dim, dim + 1)
    domain.topology.create_connectivity(dim + 1, dim)
    outer = np.asarray(meshes.exterior_facet_indices(domain.topology), dtype=np.int32)
    groups: dict[str, Indices] = {}
    for name, (of, number) in mesh.names.items():
        if of == dim and mesh.facet_tags is not None:
            groups[name] = np.intersect1d(mesh.facet_tags.find(number), outer)
    tagged = np.concatenate([*groups.values(), np.zeros(0, dtype=np.int32)])
    groups[""] = np.setdiff1d(outer, tagged)
    around = AROUND[_facet_kind(mesh)]
    made = {}
    for name, facets in groups.items():
        if len(facets):
            local = np.asarray(meshes.entities_to_geometry(domain, dim, facets.astype(np.int32)))
            made[name] = _outward(mesh, domain.geometry.x[local[:, around]], facets)
    return made


def _facet_kind(mesh: SolidMesh) -> str:
    kind = mesh.mesh.basix_cell().name
    return {"tetrahedron": "triangle", "hexahedron": "quadrilateral"}.get(kind, "interval")


def _outward(mesh: SolidMesh, polygons: Array, facets: Indices) -> Array:
    """Turn facets round whose normal points into their cell."""
    if polygons.shape[1] == 2:
        return polygons
    topology = mesh.mesh.topology
    cells = topology.connectivity(topology.dim - 1, topology.dim)
    own = np.array([cells.links(facet)[0] for facet in facets])
    inside = mesh.mesh.geometry.x[compat.geometry_nodes(mesh.mesh)[own]].mean(axis=1)
    normal = np.cross(polygons[:, 1] - polygons[:, 0], polygons[:, -1] - polygons[:, 0])
    wrong = np.einsum("ni,ni->n", normal, polygons.mean(axis=1) - inside) < 0
    return np.where(wrong[:, None, None], polygons[:, ::-1], polygons)


def quality_of(mesh: SolidMesh) -> Quality:
    """Return how good this rank's cells are."""
    kind = mesh.mesh.basix_cell().name
    beside, best = NEIGHBOURS[kind]
    nodes = compat.geometry_nodes(mesh.mesh)[:, : len(beside)]
    corners = mesh.mesh.geometry.x[nodes][..., : mesh.dim]
    first = np.stack([corners[:, other] - corners[:, 0] for other in beside[0]], axis=1)
    hand = np.sign(np.median(np.linalg.det(first)))  # a left-handed mesh is as good
    scaled = np.full(len(nodes), np.inf)
    lengths = []
    for k, others in enumerate(beside):
        arms = np.stack([corners[:, other] - corners[:, k] for other in others], axis=1)
        size = np.linalg.norm(arms, axis=2)
        lengths.append(size.ravel())
        scaled = np.minimum(scaled, hand * np.linalg.det(arms) / size.prod(axis=1))
    used = len(np.unique(nodes))
    return Quality(cells=len(nodes), nodes=used, scaled=best * scaled, edges=np.concatenate(lengths))


def thickness_through(polygons: Array) -> Array:
    """Return how far a body reaches behind the middle of each of its outer facets, along the normal, ``(n,)`` [cm].

    A facet with four corners is four triangles about its middle, so that the two sides of a twisted sheet agree. Where
    columns of nodes have one length t it is t times the length of the mean of a facet's unit columns: t cos(a/2) for
    a bend by an angle a from column to column.

    Args:
        polygons: Corners of all outer facets, outward, ``(n, 3 or 4, 3)`` [cm].

    Note:
        Of large meshes some facets are looked at, and the others have what the nearest of them has.
    """
    from scipy.spatial import cKDTree

    middles, ahead = polygons.mean(axis=1), np.roll(polygons, -1, axis=1)
    # About its middle: a diagonal of a facet that is not flat lies beside the surface, by up to half its twist.
    fan = np.stack([np.broadcast_to(middles[:, None], polygons.shape), polygons, ahead], axis=2)
    normal = np.cross(polygons - middles[:, None], ahead - middles[:, None]).sum(axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    triangles = polygons if polygons.shape[1] == 3 else fan.reshape(-1, 3, 3)
    some = np.arange(0, len(polygons), -(-len(polygons) // RAYS))
    found = np.empty(len(some))
    chunk = max(1, PAIRS // len(triangles))
    for start in range(0, len(some), chunk):
        part = some[start : start + chunk]
        found[start : start + chunk] = _reach(middles[part], -normal[part], triangles)
    return found[cKDTree(middles[some]).query(middles)[1]]


def _reach(starts: Array, ways: Array, triangles: Array) -> Array:
    """Return the distance of the first triangle that each ray meets behind its start (Moeller and Trumbore 1997)."""
    a, e, f = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    outward = np.cross(e, f)
    size = float(np.sqrt(np.linalg.norm(outward, axis=1).mean()))
    p = np.cross(ways[:, None], f[None])
    det = np.einsum("ti,rti->rt", e, p)
    with np.errstate(divide="ignore", invalid="ignore"):
        s = starts[:, None] - a[None]
        u = np.einsum("rti,rti->rt", s, p) / det
        q = np.cross(s, e[None])
        v = np.einsum("ri,rti->rt", ways, q) / det
        t = np.einsum("ti,rti->rt", f, q) / det
        slack = 1e-9
        meets = (u >= -slack) & (v >= -slack) & (u + v <= 1 + slack) & (t > 1e-6 * size)
        meets &= ways @ outward.T > 0  # where it leaves the body: not a neighbour of its own facet
    return np.where(meets, t, np.inf).min(axis=1)


def plane_cells(mesh: SolidMesh) -> list[Array]:
    """Return the corners of each of this rank's cells in the plane, one after the other around it, ``(k, 2)`` [cm]."""
    around = AROUND[mesh.mesh.basix_cell().name]
    return list(mesh.mesh.geometry.x[compat.geometry_nodes(mesh.mesh)[:, around], :2])
