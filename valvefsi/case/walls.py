"""The walls around a case's valve: the housing and its stent in patches, the dam outside, posts rigid or flexible."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from valvefsi.bodies.elastic import Elastic
from valvefsi.bodies.filling import Filling
from valvefsi.bodies.on_posts import OnPosts
from valvefsi.bodies.patches import PatchedSurface
from valvefsi.bodies.posts import Oscillator
from valvefsi.bodies.rigid import RigidSurface, explicit_springs
from valvefsi.case.meshes import mesh_path
from valvefsi.case.models import Case
from valvefsi.case.valve import LeafletEdges, error_of_leaflets, valve_of
from valvefsi.case.valve_tables import Housing
from valvefsi.coupling.offsets import surface_offset
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import CaseError, StabilityError, raise_together
from valvefsi.geometry.aortic_section import PointSurface, joined
from valvefsi.geometry.patches import patch_labels
from valvefsi.geometry.stent import FormulaEdge, LineEdge, StentEdge, edge_line, stent_wall, widest_seam
from valvefsi.geometry.stent_posts import StentPosts, stent_posts
from valvefsi.geometry.wall import radius_at, read_wall, wall_points
from valvefsi.grid import MacGrid
from valvefsi.types import Array, Indices, Mask

KERNEL = "composite_bspline32"
"""Kernel of rigid surfaces: it turns a uniform pressure on them into the gradient of one."""

SEAM = 0.75
"""Largest distance of the attached edge from the walls' points, in spacings, that their kernels close."""

LINE = 720
"""Points around the axis that mark where the leaflets are attached."""


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
    walls, edges = _walls(case, housing, grid.comm, edges or {}), edges or {}
    posts = find_posts(case, edges)
    kept = walls if posts is None else walls.part(~walls.on(posts))
    rigid = _patched(case, housing, Coupling(grid, KERNEL), kept, name="housing")
    if not housing.fill or housing.stent is None:
        return (rigid,)
    return rigid, _filling(case, housing, grid, edges)


def on_posts(case: Case, leaflets: Elastic, edges: Mapping[int, LeafletEdges]) -> Elastic | OnPosts:
    """Return the leaflets of the stent on its flexible posts; any other solid, and one of rigid posts, as it is.

    Args:
        case: The case.
        leaflets: A solid of it as a body.
        edges: Edges of leaflets that are read from files, by the number of their solid.

    Raises:
        CaseError: The stent has no posts.

    Note:
        Collective.
    """
    housing, posts = case.housing, find_posts(case, edges)
    if housing is None or housing.posts is None or posts is None or housing.stent != leaflets.name:
        return leaflets
    grid, bar = leaflets.coupling.grid, housing.posts
    walls, coupling = _walls(case, housing, grid.comm, edges), Coupling(grid, KERNEL)
    stiffness = bar.stiffness or 0.0
    return OnPosts(
        leaflets,
        _patched(case, housing, coupling, walls.part(walls.on(posts)), name="posts"),
        coupling,
        places=posts,
        oscillator=Oscillator(
            mass=bar.mass,
            stiffness=stiffness,
            damping=2.0 * bar.damping * math.sqrt(stiffness * bar.mass),
        ),
        tags=_attached_tags(case),
    )


def find_posts(case: Case, edges: Mapping[int, LeafletEdges]) -> StentPosts | None:
    """Return where the flexible posts of a case stand, None where they are rigid.

    Raises:
        CaseError: The stent has no posts, or not of the length given.
    """
    housing = case.housing
    if housing is None or housing.posts is None:
        return None
    try:
        return stent_posts(_stent_edge(case, housing, edges), housing.posts.length)
    except CaseError as error:
        if error.file is not None:
            raise
        key = f"housing.posts.{error.key}"
        raise CaseError(error.reason, file=case.file, key=key, value=error.value) from None


def _attached_tags(case: Case) -> tuple[str, ...]:
    own = case.solid[valve_of(case).number].mesh.leaflets
    return ("attached",) if own is None else own.attached


@dataclass(frozen=True, kw_only=True)
class _Walls:
    """Points of the housing and its stent.

    Attributes:
        surface: Points outside of the surfaces by the kernel's offset, so that the fluid is at rest on them.
        labels: Patch of each.
        stent: Which are the stent's.
    """

    surface: PointSurface
    labels: Indices
    stent: Mask

    def on(self, posts: StentPosts) -> Mask:
        """Return which points move with posts, whole patches where one of their points does."""
        moves: Mask = self.stent & posts.shape(self.surface.points).any(axis=1)
        together = np.unique(self.labels[moves & (self.labels >= 0)])
        return moves | np.isin(self.labels, together)

    def part(self, those: Mask) -> _Walls:
        """Return some of the points; faces for pictures where all of their corners are among them."""
        s, number = self.surface, np.cumsum(those) - 1
        faces = number[s.faces[those[s.faces].all(axis=1)]]
        surface = PointSurface(
            points=s.points[those], areas=s.areas[those], normals=s.normals[those], faces=faces
        )
        return _Walls(surface=surface, labels=self.labels[those], stent=self.stent[those])


def _patched(case: Case, housing: Housing, coupling: Coupling, walls: _Walls, *, name: str) -> PatchedSurface:
    """Return walls held in patches. Collective."""
    hold = explicit_springs(KERNEL, case.grid.spacing, case.dt, housing.hold, case.fluid.density)
    problem = rigid = None
    surface = walls.surface
    try:
        rigid = PatchedSurface(
            surface,
            walls.labels,
            coupling,
            name=name,
            slip=_end_slip(case, surface),
            **hold,
        )
    except StabilityError as error:
        widest = float(np.hypot(surface.points[:, 0], surface.points[:, 1]).max())
        message = f"the housing does not fit into the core of the box: {error}"
        problem = CaseError(message, file=case.file, key="housing", value=f"radius {widest:.4g} cm")
    raise_together(coupling.grid.comm, problem)
    assert rigid is not None  # or all ranks have raised
    return rigid


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


def _walls(case: Case, housing: Housing, comm: MPI.Comm, edges: Mapping[int, LeafletEdges]) -> _Walls:
    """Return the points of the housing and its stent, and the patch of each. Collective."""
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
    moved = whole.moved(h * surface_offset(KERNEL, whole.normals, (0.0, 0.0, 1.0)))
    return _Walls(surface=moved, labels=labels, stent=np.arange(len(labels)) >= len(wall.points))


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
        raise error_of_leaflets(case, valve.number, error) from None
    if edge.lowest < housing.annulus:
        raise CaseError(
            f"the leaflets' attachment begins below the housing's annulus, at z = {edge.lowest:.4g} cm",
            file=case.file,
            key="housing.annulus",
            value=housing.annulus,
        )
    return edge
