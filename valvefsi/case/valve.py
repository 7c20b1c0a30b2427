"""The valve of a case: which solid it is, where its leaflets are attached and free, and the rigid walls around it."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from valvefsi.bodies.filling import Filling
from valvefsi.bodies.patches import PatchedSurface
from valvefsi.bodies.rigid import RigidSurface
from valvefsi.case.meshes import mesh_path
from valvefsi.case.models import Case
from valvefsi.case.valve_tables import SURFACES, Housing
from valvefsi.coupling.kernel_properties import largest_square_sum
from valvefsi.coupling.offsets import surface_offset
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import CaseError, StabilityError, raise_together
from valvefsi.geometry.aortic_section import PointSurface, joined
from valvefsi.geometry.mesh import SolidMesh
from valvefsi.geometry.patches import patch_labels
from valvefsi.geometry.ribbons import MiddleLine, middle_lines, middle_of
from valvefsi.geometry.stent import FormulaEdge, LineEdge, StentEdge, edge_line, stent_wall, widest_seam
from valvefsi.geometry.tagged import TaggedSurfaces, gather_surfaces
from valvefsi.geometry.wall import radius_at, read_wall, wall_points
from valvefsi.grid import MacGrid
from valvefsi.run.recording import Orifice
from valvefsi.types import Array, Indices

KERNEL = "composite_bspline32"
"""Kernel of rigid surfaces: it turns a uniform pressure on them into the gradient of one."""

LINE = 720
"""Points around the axis that mark where the leaflets are attached."""

SEAM = 0.75
"""Largest distance of the attached edge from the walls' points, in spacings, that their kernels close."""

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


def wall_radius(case: Case, phi: Array, z: Array) -> Array | None:
    """Return the distance of a case's housing from the z axis, None without a housing.

    Args:
        case: The case.
        phi: Azimuths, ``(n,)`` [rad].
        z: Heights, ``(m,)`` [cm].

    Returns:
        Distances, ``(n, m)`` [cm].
    """
    housing = case.housing
    if housing is None:
        return None
    if housing.file is None:
        return housing.section().radius(phi[:, None], np.broadcast_to(z, (len(phi), len(z))))
    h, (low, high) = case.grid.spacing, case.grid.bounds[2]
    wall, _ = _wall(case, housing, (low + 0.5 * h, high - 0.5 * h), MPI.COMM_SELF)
    return np.stack([radius_at(wall, float(at), phi) for at in z], axis=1)


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
        raise _of_leaflets(case, number, error) from None
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


def _of_leaflets(case: Case, number: int, error: CaseError) -> CaseError:
    """Return an error of tagged facets with its place in the case, the name of the facets as key."""
    solid = case.solid[number]
    own = solid.mesh.leaflets
    value = error.value
    if value is None and own is not None and error.key in SURFACES:
        value = ", ".join(own.tags[error.key])
    key = f"solid.{solid.name}.mesh.leaflets.{error.key}"
    return CaseError(error.reason, file=case.file, key=key, value=value)


def build_rigid(
    case: Case, grid: MacGrid, edges: Mapping[int, LeafletEdges] | None = None
) -> tuple[RigidSurface, ...]:
    """Build the housing of a case, with its stent, and what fills the box outside.

    Springs and dampers are a given part of what an explicit step carries on the mass that the kernel moves, see
    `valvefsi.run.planning`.

    Args:
        case: The case.
        grid: Its grid.
        edges: Edges of leaflets that are read from files, by the number of their solid.

    Raises:
        CaseError: The housing does not fit into the part of the box that has cells of the smallest width, its file
            cannot be used, or the leaflets' attachment leaves the stent open.

    Note:
        Collective.
    """
    housing = case.housing
    if housing is None:
        return ()
    surface, labels = _patched_section(case, housing, grid.comm, edges or {})
    h = case.grid.spacing
    share = housing.hold * case.fluid.density * h / largest_square_sum(KERNEL)
    problem = rigid = None
    try:
        rigid = PatchedSurface(
            surface,
            labels,
            Coupling(grid, KERNEL),
            name="housing",
            stiffness=share / case.dt**2,
            damping=share / case.dt,
            slip=_end_slip(case, surface),
        )
    except StabilityError as error:
        widest = float(np.hypot(surface.points[:, 0], surface.points[:, 1]).max())
        message = f"the housing does not fit into the core of the box: {error}"
        problem = CaseError(message, file=case.file, key="housing", value=f"radius {widest:.4g} cm")
    raise_together(grid.comm, problem)
    assert rigid is not None  # or all ranks have raised
    if not housing.fill or housing.stent is None:
        return (rigid,)
    return rigid, _filling(case, housing, grid, edges or {})


def _filling(case: Case, housing: Housing, grid: MacGrid, edges: Mapping[int, LeafletEdges]) -> Filling:
    """Return what holds the fluid outside the housing still beside the stent, where little flows along the wall."""
    h, (low, high) = case.grid.spacing, case.grid.bounds[2]
    share = housing.hold * case.fluid.density
    _, heights = _stent_edge(case, housing, edges).at(np.linspace(0.0, 2.0 * math.pi, LINE))
    return Filling(
        _wall(case, housing, (low + 0.5 * h, high - 0.5 * h), grid.comm)[0],
        Coupling(grid, KERNEL),
        between=(housing.annulus, 0.5 * (housing.annulus + float(heights.max()))),
        name="filling",
        stiffness=share / case.dt**2,
        damping=share / case.dt,
    )


def _end_slip(case: Case, surface: PointSurface) -> Array:
    """Return the rates at which points slip back, ``(num_points, 3, 3)`` [1/s].

    Points whose kernel reaches the faces of a side see the velocity there, which no force changes: along the side's
    normal they would be carried on for as long as a run lasts, and push the fluid beside them harder and harder. There
    they slip back half their way in a step; what bears pressures, across the wall, is held as everywhere.
    """
    h, (low, high) = case.grid.spacing, case.grid.bounds[2]
    z, reach = surface.points[:, 2], 1.5 * h - 1e-9
    slip = np.zeros((len(z), 3, 3))
    slip[(z < low + reach) | (z > high - reach), 2, 2] = 0.5 / case.dt
    return slip


def _patched_section(
    case: Case, housing: Housing, comm: MPI.Comm, edges: Mapping[int, LeafletEdges]
) -> tuple[PointSurface, Indices]:
    """Return the points of the housing and its stent, and the patch of each.

    The points lie outside the surfaces by the kernel's offset, so that the fluid is at rest on them.
    """
    h, (low, high) = case.grid.spacing, case.grid.bounds[2]
    ends = (low + 0.5 * h, high - 0.5 * h)
    wall, radius = _wall(case, housing, ends, comm)
    surfaces, seam = [wall], None
    if housing.stent is not None:
        edge = _stent_edge(case, housing, edges)
        surfaces.append(stent_wall(edge, housing.annulus, radius, h))
        seam = edge_line(edge, LINE)
        if comm.rank == 0:
            _say_seam(edge, joined(*surfaces).points, h)
    labels = patch_labels(surfaces, h, ends, seam)
    whole = joined(*surfaces)
    return whole.moved(h * surface_offset(KERNEL, whole.normals, (0.0, 0.0, 1.0))), labels


def _say_seam(edge: StentEdge, points: Array, h: float) -> None:
    """Warn where the leaflets' attachment is away from the walls, so that fluid passes between them."""
    apart, x = widest_seam(edge, points)
    if apart > SEAM * h:
        place = ", ".join(f"{value:.3g}" for value in x)
        warnings.warn(
            f"fluid may leak beside the leaflets: their attached edge is {apart / h:.2f} h from the stent and the "
            f"housing at ({place}) cm, at most {SEAM:g} h is safe",
            stacklevel=2,
        )


def _wall(
    case: Case, housing: Housing, ends: tuple[float, float], comm: MPI.Comm
) -> tuple[PointSurface, Callable[[Array], Array]]:
    """Return the housing between two planes, and its distance from the axis at the annulus. Collective."""
    h = case.grid.spacing
    if housing.file is None:
        section = housing.section()
        return section.housing(h, ends), lambda phi: section.radius(phi, np.full_like(phi, housing.annulus))
    wall = problem = None
    if comm.rank == 0:
        try:
            path = mesh_path(housing.file, case.file)
            points, triangles = read_wall(path, scale=housing.file_unit or 1.0, tags=housing.tags)
            _check_width(case, points[np.unique(triangles)])
            wall = wall_points(points, triangles, h, ends)
        except CaseError as error:
            key, value = f"housing.{error.key or 'file'}", error.value or housing.file
            problem = CaseError(error.reason, file=case.file, key=key, value=value)
    raise_together(comm, problem)
    wall = comm.bcast(wall)
    assert wall is not None  # or all ranks have raised
    return wall, lambda phi: radius_at(wall, housing.annulus, phi)


def _check_width(case: Case, points: Array) -> None:
    """Refuse a wall that is wider than the box."""
    for axis, (low, high) in enumerate(case.grid.bounds[:2]):
        first, last = float(points[:, axis].min()), float(points[:, axis].max())
        if first < low or last > high:
            raise CaseError(
                f"the wall is wider than the box: it spans {'xy'[axis]} = {first:.4g} ... {last:.4g} cm; is file_unit "
                "that of the file, and its axis z?"
            )


def _stent_edge(case: Case, housing: Housing, edges: Mapping[int, LeafletEdges]) -> StentEdge:
    """Return the upper edge of the stent."""
    valve = valve_of(case)
    shape = case.solid[valve.number].mesh.valve
    if shape is not None:
        return FormulaEdge(shape.geometry(), shape.base)
    found = edges[valve.number]
    try:
        edge = LineEdge([line.at(found.surfaces.points) for line in found.attached])
    except CaseError as error:
        raise _of_leaflets(case, valve.number, error) from None
    if edge.lowest < housing.annulus:
        raise CaseError(
            f"the leaflets' attachment begins below the housing's annulus, at z = {edge.lowest:.4g} cm",
            file=case.file,
            key="housing.annulus",
            value=housing.annulus,
        )
    return edge
