"""Benchmark shapes with structured meshes and named tags, by gmsh."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

from valvefsi.errors import CaseError
from valvefsi.geometry.mesh import SolidMesh, mesh_from_gmsh

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mpi4py import MPI

    from valvefsi.types import Gmsh


def rectangle(
    comm: MPI.Comm,
    *,
    lower: Sequence[float] = (0.0, 0.0),
    size: Sequence[float] = (1.0, 1.0),
    elements: Sequence[int] = (8, 8),
    cell: str = "quadrilateral",
) -> SolidMesh:
    """Mesh a rectangle; tags "body", "x_lower", "x_upper", "y_lower", "y_upper".

    Args:
        comm: Communicator the mesh is distributed on.
        lower: Lower left corner, ``(2,)`` [cm].
        size: Edge lengths, ``(2,)`` [cm].
        elements: Number of elements along each edge, ``(2,)``.
        cell: "quadrilateral" or "triangle".

    Note:
        Collective.
    """
    _check(lower, size, elements, cell, ("quadrilateral", "triangle"))

    def build(gmsh: Gmsh) -> None:
        surface, (bottom, right, (top,), left) = _block(gmsh, lower, size, elements, [(1.0, elements[0])])
        _finish_surface(gmsh, surface, cell)
        tags = {"x_lower": [left], "x_upper": [right], "y_lower": [bottom], "y_upper": [top]}
        _name_groups(gmsh, 1, tags)
        _name_groups(gmsh, 2, {"body": [surface]})
        gmsh.model.mesh.generate(2)

    return mesh_from_gmsh(build, comm, source="rectangle")


def compressed_block(
    comm: MPI.Comm,
    *,
    lower: Sequence[float] = (10.0, 15.0),
    size: Sequence[float] = (20.0, 10.0),
    elements: Sequence[int] = (32, 16),
    cell: str = "quadrilateral",
    load_width: float = 10.0,
) -> SolidMesh:
    """Mesh the block of supplement E.1, loaded on the central part of its top.

    Tags: "block" (cells); "bottom", "sides", "top_loaded", "top_outer" (the top left and right of the load).

    Args:
        comm: Communicator the mesh is distributed on.
        lower: Lower left corner, ``(2,)`` [cm].
        size: Edge lengths, ``(2,)`` [cm].
        elements: Number of elements along each edge, ``(2,)``.
        cell: "quadrilateral" or "triangle".
        load_width: Width of the loaded part of the top [cm].

    Raises:
        CaseError: The ends of the load fall between nodes.

    Note:
        Collective.
    """
    _check(lower, size, elements, cell, ("quadrilateral", "triangle"))
    outer = (size[0] - load_width) / 2 / size[0]
    count = round(outer * elements[0])
    if not 0 < load_width < size[0] or count < 1 or abs(count - outer * elements[0]) > 1e-9 * elements[0]:
        message = f"with {elements[0]} elements along {size[0]:g} cm the load's ends are not on nodes"
        raise CaseError(message, key="load_width", value=load_width)

    def build(gmsh: Gmsh) -> None:
        parts = [(outer, count), (1 - 2 * outer, elements[0] - 2 * count), (outer, count)]
        surface, (bottom, right, top, left) = _block(gmsh, lower, size, elements, parts)
        _finish_surface(gmsh, surface, cell)
        tags = {
            "bottom": [bottom],
            "sides": [left, right],
            "top_loaded": [top[1]],
            "top_outer": [top[0], top[2]],
        }
        _name_groups(gmsh, 1, tags)
        _name_groups(gmsh, 2, {"block": [surface]})
        gmsh.model.mesh.generate(2)

    return mesh_from_gmsh(build, comm, source="compressed_block")


def box(
    comm: MPI.Comm,
    *,
    lower: Sequence[float] = (0.0, 0.0, 0.0),
    size: Sequence[float] = (1.0, 1.0, 1.0),
    elements: Sequence[int] = (4, 4, 4),
    cell: str = "hexahedron",
) -> SolidMesh:
    """Mesh a box; tags "body", "x_lower", "x_upper", "y_lower", "y_upper", "z_lower", "z_upper".

    Args:
        comm: Communicator the mesh is distributed on.
        lower: Lower corner, ``(3,)`` [cm].
        size: Edge lengths, ``(3,)`` [cm].
        elements: Number of elements along each edge, ``(3,)``.
        cell: "hexahedron" or "tetrahedron".

    Note:
        Collective.
    """
    _check(lower, size, elements, cell, ("hexahedron", "tetrahedron"))

    def build(gmsh: Gmsh) -> None:
        bottom, _ = _block(gmsh, lower, size, elements, [(1.0, elements[0])])
        hexahedra = cell == "hexahedron"
        if hexahedra:
            gmsh.model.geo.mesh.setRecombine(2, bottom)
        made = gmsh.model.geo.extrude(
            [(2, bottom)], 0, 0, size[2], numElements=[elements[2]], recombine=hexahedra
        )
        gmsh.model.geo.synchronize()
        top, volume, *sides = (tag for _, tag in made)
        names = ("z_lower", "z_upper", "y_lower", "x_upper", "y_upper", "x_lower")
        _name_groups(gmsh, 2, {name: [tag] for name, tag in zip(names, (bottom, top, *sides), strict=True)})
        _name_groups(gmsh, 3, {"body": [volume]})
        gmsh.model.mesh.generate(3)

    return mesh_from_gmsh(build, comm, source="box")


SHAPES = {"rectangle": rectangle, "compressed_block": compressed_block, "box": box}
"""Shapes by the name a case file uses."""


def _check(
    lower: Sequence[float], size: Sequence[float], elements: Sequence[int], cell: str, cells: tuple[str, str]
) -> None:
    """Refuse sizes that are not positive and unknown cells."""
    dim = 2 if "quadrilateral" in cells else 3
    for key, value in (("lower", lower), ("size", size), ("elements", elements)):
        if len(value) != dim:
            raise CaseError(f"expected {dim} numbers", key=key, value=list(value))
    if not all(length > 0 for length in size):
        raise CaseError("expected positive lengths", key="size", value=list(size))
    if not all(count >= 1 and count == int(count) for count in elements):
        raise CaseError("expected whole numbers of at least 1", key="elements", value=list(elements))
    if cell not in cells:
        raise CaseError(f'expected "{cells[0]}" or "{cells[1]}"', key="cell", value=cell)


def _block(
    gmsh: Gmsh,
    lower: Sequence[float],
    size: Sequence[float],
    elements: Sequence[int],
    top_parts: Sequence[tuple[float, int]],
) -> tuple[int, tuple[int, int, list[int], int]]:
    """Make a transfinite rectangle in the plane z = lower z, its top edge in parts (fraction, elements).

    Returns:
        The surface, and its curves (bottom, right, [top from left to right], left).
    """
    geo = gmsh.model.geo
    (x, y), (width, height) = lower[:2], size[:2]
    z = lower[2] if len(lower) == 3 else 0.0
    fractions = [0.0]
    for fraction, _ in top_parts[:-1]:
        fractions.append(fractions[-1] + fraction)
    top_points = [geo.addPoint(x + f * width, y + height, z) for f in (*fractions, 1.0)]
    corners = [geo.addPoint(x, y, z), geo.addPoint(x + width, y, z)]
    bottom = geo.addLine(*corners)
    right = geo.addLine(corners[1], top_points[-1])
    top = [geo.addLine(b, a) for a, b in itertools.pairwise(top_points)]
    left = geo.addLine(top_points[0], corners[0])
    surface = geo.addPlaneSurface([geo.addCurveLoop([bottom, right, *reversed(top), left])])
    geo.mesh.setTransfiniteCurve(bottom, elements[0] + 1)
    geo.mesh.setTransfiniteCurve(right, elements[1] + 1)
    geo.mesh.setTransfiniteCurve(left, elements[1] + 1)
    for curve, (_, count) in zip(top, top_parts, strict=True):
        geo.mesh.setTransfiniteCurve(curve, count + 1)
    geo.mesh.setTransfiniteSurface(surface, "AlternateRight", [*corners, top_points[-1], top_points[0]])
    return surface, (bottom, right, top, left)


def _finish_surface(gmsh: Gmsh, surface: int, cell: str) -> None:
    """Ask for quadrilaterals where they are wanted and hand the geometry to the mesher."""
    if cell == "quadrilateral":
        gmsh.model.geo.mesh.setRecombine(2, surface)
    gmsh.model.geo.synchronize()


def _name_groups(gmsh: Gmsh, dim: int, groups: dict[str, list[int]]) -> None:
    """Make a named physical group of each list of entities; numbers count from 1 in each dimension."""
    for number, (name, entities) in enumerate(groups.items(), start=1):
        gmsh.model.addPhysicalGroup(dim, entities, tag=number, name=name)
