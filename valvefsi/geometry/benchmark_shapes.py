"""Shapes of the static benchmarks: Cook's membrane, thick shells, a truncated ellipsoid; structured, by gmsh."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.errors import CaseError
from valvefsi.geometry.mesh import SolidMesh, mesh_from_gmsh

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from mpi4py import MPI

    from valvefsi.types import Array, Gmsh

COOK = ((0.0, 0.0), (4.8, 4.4), (4.8, 6.0), (0.0, 4.4))
"""Corners of Cook's membrane [cm]."""


def cook_membrane(
    comm: MPI.Comm, *, elements: int = 8, cell: str = "quadrilateral", scale: float = 1.0
) -> SolidMesh:
    """Mesh Cook's membrane; tags "body", "bottom", "right", "top", "left".

    Args:
        comm: Communicator the mesh is distributed on.
        elements: Number of elements along each edge.
        cell: "quadrilateral" or "triangle".
        scale: Factor of all lengths.

    Note:
        Collective.
    """
    _check(cell, ("quadrilateral", "triangle"), elements=elements)

    def build(gmsh: Gmsh) -> None:
        geo = gmsh.model.geo
        points = [geo.addPoint(x * scale, y * scale, 0) for x, y in COOK]
        lines = [geo.addLine(a, b) for a, b in itertools.pairwise([*points, points[0]])]
        surface = geo.addPlaneSurface([geo.addCurveLoop(lines)])
        for line in lines:
            geo.mesh.setTransfiniteCurve(line, elements + 1)
        geo.mesh.setTransfiniteSurface(surface, "AlternateRight", points)
        if cell == "quadrilateral":
            geo.mesh.setRecombine(2, surface)
        geo.synchronize()
        _name(gmsh, 1, dict(zip(("bottom", "right", "top", "left"), ([line] for line in lines), strict=True)))
        _name(gmsh, 2, {"body": [surface]})
        gmsh.model.mesh.generate(2)

    return mesh_from_gmsh(build, comm, source="cook_membrane")


def thick_cylinder(
    comm: MPI.Comm,
    *,
    radii: tuple[float, float] = (1.0, 1.5),
    elements: int = 2,
    cell: str = "quadrilateral",
) -> SolidMesh:
    """Mesh a quarter of a thick ring; tags "body", "inner", "outer", "x_axis", "y_axis" (where y = 0, x = 0).

    Args:
        comm: Communicator the mesh is distributed on.
        radii: Inner and outer radius [cm].
        elements: Number of elements through the wall, three times as many along the quarter.
        cell: "quadrilateral" or "triangle"; their edges are parabolas.

    Note:
        Collective.
    """
    _check(cell, ("quadrilateral", "triangle"), elements=elements)
    _check_radii(radii)

    def to_ring(X: Array) -> Array:
        r, phi = radii[0] + (radii[1] - radii[0]) * X[:, 0], math.pi / 2 * X[:, 1]
        return np.stack([r * np.cos(phi), r * np.sin(phi), 0 * r], axis=1)

    def build(gmsh: Gmsh) -> None:
        geo = gmsh.model.geo
        points = [geo.addPoint(x, y, 0) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
        lines = [geo.addLine(a, b) for a, b in itertools.pairwise([*points, points[0]])]
        surface = geo.addPlaneSurface([geo.addCurveLoop(lines)])
        for line, count in zip(lines, (elements, 3 * elements) * 2, strict=True):
            geo.mesh.setTransfiniteCurve(line, count + 1)
        geo.mesh.setTransfiniteSurface(surface, "AlternateRight", points)
        if cell == "quadrilateral":
            geo.mesh.setRecombine(2, surface)
        geo.synchronize()
        names = ("x_axis", "outer", "y_axis", "inner")
        _name(gmsh, 1, dict(zip(names, ([line] for line in lines), strict=True)))
        _name(gmsh, 2, {"body": [surface]})
        gmsh.model.mesh.generate(2)
        _move_nodes(gmsh, to_ring)

    return mesh_from_gmsh(build, comm, source="thick_cylinder")


def thick_sphere(
    comm: MPI.Comm,
    *,
    radii: tuple[float, float] = (1.0, 1.5),
    elements: int = 2,
    cell: str = "hexahedron",
) -> SolidMesh:
    """Mesh an eighth of a thick sphere; tags "body", "inner", "outer", "x_plane", "y_plane", "z_plane".

    Args:
        comm: Communicator the mesh is distributed on.
        radii: Inner and outer radius [cm].
        elements: Number of elements through the wall, and along half of each edge of the eighth.
        cell: "hexahedron" or "tetrahedron"; their faces are curved.

    Note:
        Collective.
    """
    _check(cell, ("hexahedron", "tetrahedron"), elements=elements)
    _check_radii(radii)

    def to_sphere(X: Array) -> Array:
        share = np.stack([1 - X[:, 0] - X[:, 1], X[:, 0], X[:, 1]], axis=1)
        r = radii[0] + (radii[1] - radii[0]) * X[:, 2]
        return r[:, None] * share / np.linalg.norm(share, axis=1)[:, None]

    def build(gmsh: Gmsh) -> None:
        third, half = 1 / 3, 0.5
        corners = {
            "a": (0, 0),
            "b": (1, 0),
            "c": (0, 1),
            "ab": (half, 0),
            "bc": (half, half),
            "ca": (0, half),
        }
        corners["m"] = (third, third)
        patches = [("a", "ab", "m", "ca"), ("ab", "b", "bc", "m"), ("m", "bc", "c", "ca")]
        _extruded(gmsh, (corners, patches), elements, elements, recombine=cell == "hexahedron")
        planes = {f"{axis}_plane": _no_share(k) for k, axis in enumerate("xyz")}
        _tag_sides(gmsh, {"inner": _level(0.0), "outer": _level(1.0), **planes})
        gmsh.model.mesh.generate(3)
        _move_nodes(gmsh, to_sphere)

    return mesh_from_gmsh(build, comm, source="thick_sphere")


def truncated_ellipsoid(
    comm: MPI.Comm,
    *,
    short: tuple[float, float] = (0.7, 1.0),
    long: tuple[float, float] = (1.7, 2.0),
    base: float = 0.5,
    elements: tuple[int, int] = (2, 6),
    cell: str = "hexahedron",
) -> SolidMesh:
    """Mesh a thick ellipsoid of revolution about z, cut off at the plane z = base; its apex points down.

    Tags: "body", "endo" (the inner surface), "epi" (the outer one), "base".

    Args:
        comm: Communicator the mesh is distributed on.
        short: Inner and outer half-axes across [cm].
        long: Inner and outer half-axes along z [cm].
        base: Height of the cut [cm].
        elements: Number of elements through the wall; from the apex to the base.
        cell: "hexahedron" or "tetrahedron"; their faces are curved.

    Note:
        Collective.
    """
    _check(cell, ("hexahedron", "tetrahedron"), elements=min(elements))
    through, along = elements
    centre = max(1, along // 3)

    def to_ellipsoid(X: Array) -> Array:
        rho, phi, t = np.hypot(X[:, 0], X[:, 1]), np.arctan2(X[:, 1], X[:, 0]), X[:, 2]
        across, tall = short[0] + (short[1] - short[0]) * t, long[0] + (long[1] - long[0]) * t
        u = rho * (math.pi - np.arccos(base / tall))
        return np.stack(
            [across * np.sin(u) * np.cos(phi), across * np.sin(u) * np.sin(phi), -tall * np.cos(u)], axis=1
        )

    def build(gmsh: Gmsh) -> None:
        q = math.sqrt(0.5)
        inner = centre / along
        corners: dict[str, tuple[float, float]] = {}
        for k, (x, y) in enumerate(((q, q), (-q, q), (-q, -q), (q, -q))):
            corners[f"o{k}"], corners[f"i{k}"] = (x, y), (inner * x, inner * y)
        patches = [("i0", "i1", "i2", "i3")]
        patches += [(f"i{k}", f"o{k}", f"o{(k + 1) % 4}", f"i{(k + 1) % 4}") for k in range(4)]
        counts = {frozenset((f"i{k}", f"o{k}")): along - centre for k in range(4)}
        quarter = max(2, 2 * centre)
        _extruded(gmsh, (corners, patches), (quarter, counts), through, recombine=cell == "hexahedron")
        sides = {"endo": _level(0.0), "epi": _level(1.0), "base": _on_circle}
        _tag_sides(gmsh, sides)
        gmsh.model.mesh.generate(3)
        _move_nodes(gmsh, to_ellipsoid)

    return mesh_from_gmsh(build, comm, source="truncated_ellipsoid")


def leaflet(
    comm: MPI.Comm,
    *,
    radius: float = 1.25,
    height: float = 1.4,
    thickness: float = 0.04,
    half_angle: float = 55.0,
    elements: tuple[int, int] = (8, 5),
    cell: str = "hexahedron",
) -> SolidMesh:
    """Mesh one open leaflet: a patch of a cylinder about z, attached along a parabola, its upper edge free.

    Tags: "body", "outer" (away from the axis), "inner", "attached" (the parabola), "sides", "free" (the top).

    Args:
        comm: Communicator the mesh is distributed on.
        radius: Radius of the middle surface [cm].
        height: From the lowest point to the free edge [cm].
        thickness: Thickness [cm].
        half_angle: Half the angle that the leaflet spans [deg].
        elements: Number of elements around and up; one through the thickness.
        cell: "hexahedron" or "tetrahedron"; their faces are curved.

    Note:
        Collective.
    """
    _check(cell, ("hexahedron", "tetrahedron"), elements=min(elements))

    def to_leaflet(X: Array) -> Array:
        around = 2 * X[:, 0] - 1
        phi, r = math.radians(half_angle) * around, radius + thickness * (X[:, 2] - 0.5)
        low = 0.6 * height * around**2
        return np.stack([r * np.cos(phi), r * np.sin(phi), low + (height - low) * X[:, 1]], axis=1)

    def build(gmsh: Gmsh) -> None:
        corners = {"a": (0, 0), "b": (1, 0), "c": (1, 1), "d": (0, 1)}
        counts = {frozenset("bc"): elements[1], frozenset("da"): elements[1]}
        plan = (corners, [("a", "b", "c", "d")])
        _extruded(gmsh, plan, (elements[0], counts), 1, recombine=cell == "hexahedron")
        sides = {"inner": _level(0.0), "outer": _level(1.0), "attached": _at(1, 0.0), "free": _at(1, 1.0)}
        _tag_sides(gmsh, {**sides, "sides": lambda X: True})
        gmsh.model.mesh.generate(3)
        _move_nodes(gmsh, to_leaflet)

    return mesh_from_gmsh(build, comm, source="leaflet")


def _at(axis: int, value: float) -> Callable[[Array], bool]:
    """Return whether all points of a surface have this coordinate."""
    return lambda X: bool(np.all(np.abs(X[:, axis] - value) < 1e-9))


def _level(z: float) -> Callable[[Array], bool]:
    """Return whether all points of a surface lie at the height z of the logical domain."""
    return lambda X: bool(np.all(np.abs(X[:, 2] - z) < 1e-9))


def _no_share(axis: int) -> Callable[[Array], bool]:
    """Return whether all points of a surface have nothing of an axis in the logical triangle."""

    def on_side(X: Array) -> bool:
        share = np.stack([1 - X[:, 0] - X[:, 1], X[:, 0], X[:, 1]], axis=1)
        return bool(np.all(np.abs(share[:, axis]) < 1e-9))

    return on_side


def _on_circle(X: Array) -> bool:
    return bool(np.all(np.abs(np.hypot(X[:, 0], X[:, 1]) - 1) < 1e-6))


def _extruded(
    gmsh: Gmsh,
    plan: tuple[Mapping[str, tuple[float, float]], Sequence[tuple[str, ...]]],
    counts: int | tuple[int, Mapping[frozenset[str], int]],
    layers: int,
    *,
    recombine: bool,
) -> None:
    """Make four-sided patches in the plane and extrude them by 1; corners "o..." are joined by circle arcs.

    Args:
        gmsh: Gmsh.
        plan: Corners by name, and the patches as names in order.
        counts: Elements of all edges, or (of most edges, of some by the names of their ends).
        layers: Elements along the extrusion.
        recombine: Whether hexahedra are wanted.
    """
    corners, patches = plan
    most, some = counts if isinstance(counts, tuple) else (counts, {})
    geo = gmsh.model.geo
    points = {name: geo.addPoint(x, y, 0) for name, (x, y) in corners.items()}
    origin = geo.addPoint(0, 0, 0) if any(name[0] == "o" for name in corners) else 0
    lines: dict[tuple[str, str], int] = {}
    surfaces = []
    for patch in patches:
        loop = []
        for a, b in itertools.pairwise([*patch, patch[0]]):
            if (b, a) in lines:
                loop.append(-lines[b, a])
                continue
            arc = a[0] == b[0] == "o"
            ends = points[a], points[b]
            lines[a, b] = geo.addCircleArc(ends[0], origin, ends[1]) if arc else geo.addLine(*ends)
            geo.mesh.setTransfiniteCurve(lines[a, b], some.get(frozenset((a, b)), most) + 1)
            loop.append(lines[a, b])
        surface = geo.addPlaneSurface([geo.addCurveLoop(loop)])
        geo.mesh.setTransfiniteSurface(surface, "Left", [points[name] for name in patch])
        if recombine:
            geo.mesh.setRecombine(2, surface)
        surfaces.append((2, surface))
    made = geo.extrude(surfaces, 0, 0, 1, numElements=[layers], recombine=recombine)
    geo.synchronize()
    _name(gmsh, 3, {"body": [tag for dim, tag in made if dim == 3]})


def _tag_sides(gmsh: Gmsh, sides: Mapping[str, Callable[[Array], bool]]) -> None:
    """Name the outer surfaces by where the points of their boundary lie."""
    volumes = gmsh.model.getEntities(3)
    groups: dict[str, list[int]] = {name: [] for name in sides}
    for _, tag in gmsh.model.getBoundary(volumes, combined=True, oriented=False):
        ends = gmsh.model.getBoundary([(2, tag)], combined=False, oriented=False, recursive=True)
        X = np.array([gmsh.model.getValue(0, point, []) for dim, point in ends if dim == 0])
        name = next(name for name, on_side in sides.items() if on_side(X))
        groups[name].append(tag)
    _name(gmsh, 2, groups)


def _move_nodes(gmsh: Gmsh, move: Callable[[Array], Array]) -> None:
    """Make the cells quadratic and move their nodes, those between the corners included."""
    gmsh.model.mesh.setOrder(2)
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    for tag, x in zip(tags, move(np.asarray(coordinates).reshape(-1, 3)), strict=True):
        gmsh.model.mesh.setNode(tag, x, [])


def _check_radii(radii: Sequence[float]) -> None:
    if not 0 < radii[0] < radii[1]:
        raise CaseError("expected 0 < inner < outer", key="radii", value=list(radii))


def _check(cell: str, cells: Sequence[str], **counts: int) -> None:
    """Refuse unknown cells and counts below 1."""
    if cell not in cells:
        raise CaseError(f'expected "{cells[0]}" or "{cells[1]}"', key="cell", value=cell)
    for key, value in counts.items():
        if value < 1 or value != int(value):
            raise CaseError("expected a whole number of at least 1", key=key, value=value)


def _name(gmsh: Gmsh, dim: int, groups: Mapping[str, Sequence[int]]) -> None:
    """Make a named physical group of each list of entities."""
    for number, (name, entities) in enumerate(groups.items(), start=1):
        gmsh.model.addPhysicalGroup(dim, entities, tag=number, name=name)
