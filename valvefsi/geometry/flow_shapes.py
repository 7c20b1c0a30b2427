"""Shapes of the flow benchmarks: a flag, two leaflets, the box around a cylinder; by gmsh."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

from mpi4py import MPI

from valvefsi.geometry.mesh import SolidMesh, mesh_from_gmsh
from valvefsi.types import Gmsh

GROWTH = 0.12
"""By how much elements become longer per length away from the cylinder."""
WAKE = (9.0, 1.8, 4.0)
"""Length and half width of the near wake, and the size of its elements over that at the cylinder."""


def flag(
    comm: MPI.Comm, *, along: Sequence[float], thickness: float, centre: float, size: float
) -> SolidMesh:
    """Mesh a flag with quadrilaterals; tags "body" and "root", what lies in the cylinder that holds it.

    Args:
        comm: Communicator the mesh is distributed on.
        along: Where it begins, leaves the cylinder and ends [cm].
        thickness: Its thickness [cm].
        centre: Height of its middle [cm].
        size: Length of an element [cm].

    Note:
        Collective.
    """
    x, half = along, 0.5 * thickness
    counts = [max(1, round((b - a) / size)) for a, b in itertools.pairwise(x)]
    across = max(1, round(thickness / size))

    def build(gmsh: Gmsh) -> None:
        geo, surfaces = gmsh.model.geo, []
        ends = [[geo.addPoint(a, centre + s * half, 0.0) for s in (-1.0, 1.0)] for a in x]
        ups = [geo.addLine(*pair) for pair in ends]
        for k, count in enumerate(counts):
            low, high = (geo.addLine(ends[k][s], ends[k + 1][s]) for s in (0, 1))
            surface = geo.addPlaneSurface([geo.addCurveLoop([low, ups[k + 1], -high, -ups[k]])])
            for line in (low, high):
                geo.mesh.setTransfiniteCurve(line, count + 1)
            corners = [ends[k][0], ends[k + 1][0], ends[k + 1][1], ends[k][1]]
            surfaces.append((surface, corners))
        for line in ups:
            geo.mesh.setTransfiniteCurve(line, across + 1)
        for surface, corners in surfaces:
            geo.mesh.setTransfiniteSurface(surface, "Left", corners)
            geo.mesh.setRecombine(2, surface)
        geo.synchronize()
        for (surface, _), name in zip(surfaces, ("root", "body"), strict=True):
            gmsh.model.addPhysicalGroup(2, [surface], name=name)
        gmsh.model.mesh.generate(2)

    return mesh_from_gmsh(build, comm, source="flag")


def two_leaflets(
    comm: MPI.Comm,
    *,
    root: float,
    height: float,
    size: tuple[float, float],
    elements: tuple[int, int] = (1, 40),
) -> SolidMesh:
    """Mesh both leaflets, from wall to tip, with quadrilaterals; tag "body".

    Args:
        comm: Communicator the mesh is distributed on.
        root: Where they are along the channel [cm].
        height: Height of the channel [cm].
        size: Thickness and length [cm].
        elements: Elements across and along each.

    Note:
        Collective.
    """

    def build(gmsh: Gmsh) -> None:
        geo, surfaces = gmsh.model.geo, []
        left, right = root - 0.5 * size[0], root + 0.5 * size[0]
        for foot, tip in ((0.0, size[1]), (height, height - size[1])):
            corners = [(left, foot), (right, foot), (right, tip), (left, tip)]
            points = [geo.addPoint(x, y, 0.0) for x, y in corners]
            lines = [geo.addLine(points[k], points[(k + 1) % 4]) for k in range(4)]
            surface = geo.addPlaneSurface([geo.addCurveLoop(lines)])
            for k, line in enumerate(lines):
                geo.mesh.setTransfiniteCurve(line, elements[k % 2] + 1)
            geo.mesh.setTransfiniteSurface(surface, "Left", points)
            geo.mesh.setRecombine(2, surface)
            surfaces.append(surface)
        geo.synchronize()
        gmsh.model.addPhysicalGroup(2, surfaces, name="body")
        gmsh.model.mesh.generate(2)

    return mesh_from_gmsh(build, comm, source="leaflets")


def box_around_cylinder(size: float, width: float, comm: MPI.Comm) -> SolidMesh:
    """Mesh the box around the cylinder with curved triangles; tags "inlet", "sides", "outlet" and "cylinder".

    Args:
        size: Length of the elements at the cylinder, in diameters.
        width: Width of the box in diameters; the box is ten longer, behind the cylinder.
        comm: Communicator.

    Note:
        Collective.
    """
    half = 0.5 * width

    def build(gmsh: Gmsh) -> None:
        shapes, field = gmsh.model.occ, gmsh.model.mesh.field
        box = shapes.addRectangle(-half, -half, 0.0, width + 10.0, width)
        shapes.cut([(2, box)], [(2, shapes.addDisk(0.0, 0.0, 0.0, 0.5, 0.5))])
        shapes.synchronize()
        sides: dict[str, list[int]] = {"inlet": [], "sides": [], "outlet": [], "cylinder": []}
        for _, line in gmsh.model.getEntities(1):
            x, y, _ = gmsh.model.occ.getCenterOfMass(1, line)
            on_side = abs(abs(y) - half) < 1e-6
            end = "inlet" if abs(x + half) < 1e-6 else "outlet"
            sides["cylinder" if math.hypot(x, y) < 1.0 else "sides" if on_side else end].append(line)
        for name, lines in sides.items():
            gmsh.model.addPhysicalGroup(1, lines, name=name)
        gmsh.model.addPhysicalGroup(2, [tag for _, tag in gmsh.model.getEntities(2)], name="fluid")
        away = field.add("MathEval")
        field.setString(away, "F", f"{size} + {GROWTH} * (sqrt(x * x + y * y) - 0.5)")
        wake = field.add("Box")
        length, across, coarser = WAKE
        within = {"XMin": 0.0, "XMax": length, "YMin": -across, "YMax": across, "Thickness": half}
        for key, value in {**within, "VIn": coarser * size, "VOut": half / 8.0}.items():
            field.setNumber(wake, key, value)
        least = field.add("Min")
        field.setNumbers(least, "FieldsList", [away, wake])
        field.setAsBackgroundMesh(least)
        for key in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
            gmsh.option.setNumber(f"Mesh.MeshSize{key}", 0)
        gmsh.model.mesh.generate(2)
        gmsh.model.mesh.setOrder(2)

    return mesh_from_gmsh(build, comm, source="box around a cylinder")
