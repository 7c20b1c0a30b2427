"""The valve of a case: which solid it is, and where its leaflets are attached and free."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from valvefsi.case.models import Case
from valvefsi.case.valve_tables import SURFACES
from valvefsi.errors import CaseError
from valvefsi.geometry.mesh import SolidMesh
from valvefsi.geometry.ribbons import MiddleLine, middle_lines, middle_of
from valvefsi.geometry.tagged import TaggedSurfaces, gather_surfaces
from valvefsi.run.recording import Orifice

ROUND = 0.2
"""Largest difference of the mean distance of the attached edge from the axis to half of the diameter, as a part."""


@dataclass(frozen=True, kw_only=True)
class Valve:
    """The valve of a case.

    Attributes:
        number: Number of its solid.
        name: Name of its solid.
        diameter: Diameter of its orifice about the z axis [cm].
    """

    number: int
    name: str
    diameter: float


@dataclass(frozen=True, kw_only=True)
class LeafletEdges:
    """The edges of a valve's leaflets.

    Attributes:
        surfaces: Tagged facets of their mesh.
        free: Middle line of each free edge.
        attached: Middle line of each attached edge.
    """

    surfaces: TaggedSurfaces
    free: list[MiddleLine]
    attached: list[MiddleLine]


def find_valve(case: Case) -> Valve | None:
    """Return the valve of a case: that of the housing's stent, or the only solid with leaflets; None without one."""
    stent = case.housing.stent if case.housing is not None else None
    found = [
        Valve(number=number, name=solid.name, diameter=solid.mesh.valve_diameter)
        for number, solid in enumerate(case.solid)
        if solid.mesh.valve_diameter is not None and stent in (None, solid.name)
    ]
    return found[0] if len(found) == 1 else None


def valve_of(case: Case) -> Valve:
    """Return the valve of a case.

    Raises:
        CaseError: There is none, or more than one.
    """
    found = find_valve(case)
    if found is None:
        raise CaseError(
            "there is no valve, or more than one and no stent", file=case.file, key="housing.stent"
        )
    return found


def find_orifice(case: Case, meshes: Mapping[int, SolidMesh]) -> Orifice | None:
    """Return the orifice of a case with a valve, and the middles of the free edges, None without one.

    Args:
        case: The case.
        meshes: Meshes of the solids by their numbers.

    Note:
        Collective.
    """
    valve = find_valve(case)
    if valve is None:
        return None
    edges = leaflet_edges(case, valve.number, meshes[valve.number])
    lines = [line.at(edges.surfaces.points) for line in edges.free]
    middles = tuple(tuple(map(float, line[middle_of(line)[0]])) for line in lines)
    return Orifice(body=valve.number, radius=0.5 * valve.diameter, middles=middles)


def leaflet_edges(case: Case, number: int, mesh: SolidMesh) -> LeafletEdges:
    """Return the edges of the leaflets that a solid of a case consists of.

    Args:
        case: The case.
        number: Number of the solid.
        mesh: Its mesh.

    Raises:
        CaseError: A tag is missing or of cells, or facets do not form edges of leaflets.

    Note:
        Collective.
    """
    given = case.solid[number]
    own = given.mesh.leaflets
    tags = own.tags if own is not None else {name: (name,) for name in SURFACES}
    try:
        surfaces = gather_surfaces(mesh, tags)
        free, attached = (middle_lines(surfaces, name) for name in ("free", "attached"))
    except CaseError as error:
        raise error_of_leaflets(case, number, error) from None
    return LeafletEdges(surfaces=surfaces, free=free, attached=attached)


def check_leaflets(case: Case, meshes: Mapping[int, SolidMesh]) -> dict[int, LeafletEdges]:
    """Return the edges of all leaflets that are read from files, by the number of their solid.

    Raises:
        CaseError: Tags or facets are not those of leaflets, or are not where the case has them.

    Note:
        Collective.
    """
    found = {}
    for number, solid in enumerate(case.solid):
        own = solid.mesh.leaflets
        if own is None:
            continue
        edges = found[number] = leaflet_edges(case, number, meshes[number])
        x = np.concatenate([line.at(edges.surfaces.points) for line in edges.attached])
        ratio = float(np.hypot(x[:, 0], x[:, 1]).mean()) / (0.5 * own.diameter)
        if abs(ratio - 1.0) > ROUND:
            raise CaseError(
                f"the attached edge is on average {0.5 * own.diameter * ratio:.4g} cm from the z axis, not half "
                "of this diameter; is the mesh in cm, with its axis along z?",
                file=case.file,
                key=f"solid.{solid.name}.mesh.leaflets.diameter",
                value=own.diameter,
            )
    return found


def error_of_leaflets(case: Case, number: int, error: CaseError) -> CaseError:
    """Return an error of tagged facets with its place in the case, the name of the facets as key."""
    solid = case.solid[number]
    own = solid.mesh.leaflets
    value = error.value
    if value is None and own is not None and error.key in SURFACES:
        value = ", ".join(own.tags[error.key])
    key = f"solid.{solid.name}.mesh.leaflets.{error.key}"
    return CaseError(error.reason, file=case.file, key=key, value=value)
