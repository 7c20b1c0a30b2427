"""Pictures of the leaflets of a run end on and of their free edges, from its frames (as Figures S14 and S15)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from valvefsi.case.meshes import solid_mesh
from valvefsi.case.models import Case
from valvefsi.case.valve import leaflet_edges, valve_of
from valvefsi.errors import CaseError
from valvefsi.geometry.ribbons import MiddleLine, middle_of
from valvefsi.geometry.tagged import TaggedSurfaces
from valvefsi.grid import Array
from valvefsi.io.grid_files import times_of
from valvefsi.io.solid_body import Body, read_body
from valvefsi.post.diagnostics.projected_area import end_view, projected_area
from valvefsi.post.diagnostics.surfaces import surface_triangles
from valvefsi.types import Indices

AXIS, CENTRE = np.array([0.0, 0.0, 1.0]), np.zeros(3)
MOMENTS = 8
"""Views in the picture."""
STILL = 0.25
"""How much of the choice of moments goes by time, the rest goes by the change of the open area."""


@dataclass(frozen=True, kw_only=True)
class Leaflets:
    """The leaflets of a run at its frames.

    Attributes:
        t: Times, ``(m,)`` [s].
        points: Nodes end on: to the right, upwards, towards the viewer, ``(m, n, 3)`` [cm].
        triangles: Corners of their surface, ``(k, 3)``.
        owner: Number of each triangle's leaflet from 0, ``(k,)``.
        lines: Middle line of each leaflet's free edge, of the nodes.
        area: Projected open area, ``(m,)`` [cm^2].
        inflow: Corners of their faces towards the inflow, in turn, ``(l, 3 or 4)``.
        inflow_owner: Number of the leaflet of each of these, ``(l,)``.
        free: Points along each free edge in the reference configuration, ``(p, 3)`` [cm].
        attached: The same of each attached edge.
    """

    t: Array
    points: Array
    triangles: Indices
    owner: Indices
    lines: tuple[MiddleLine, ...]
    area: Array
    inflow: Indices
    inflow_owner: Indices
    free: tuple[Array, ...]
    attached: tuple[Array, ...]

    def edges(self, k: int) -> Array:
        """Ends of the pieces of the free edges at a frame, ``(pieces, 2, 3)`` [cm]."""
        ends = [np.stack([x[:-1], x[1:]], axis=1) for x in (line.at(self.points[k]) for line in self.lines)]
        return np.concatenate(ends)

    def middles(self) -> Array:
        """How far the middle of each free edge is from the axis, negative beyond it, ``(m, leaflets)`` [cm]."""
        found = np.empty((len(self.t), len(self.lines)))
        for number, line in enumerate(self.lines):
            middle, way = middle_of(line.at(self.points[0]))
            for k in range(len(self.t)):
                found[k, number] = line.at(self.points[k])[middle, :2] @ way
        return found


def draw_leaflets(
    case: Case, folder: Path, out: Path, window: tuple[float, float] | None = None
) -> list[Path]:
    """Draw ``leaflets.png``, end views, and ``free_edges.png``; nothing for a run with fewer than two frames.

    Args:
        case: A case with a valve.
        folder: Folder of the run.
        out: Folder of the pictures.
        window: First and last time, such as those of a cycle; the whole run if None [s].
    """
    from valvefsi.post.plots.free_edge import free_edges

    valve = valve_of(case)
    if not (Path(folder) / "paraview" / f"{valve.name}.pvd").is_file():
        return []
    run = read_leaflets(case, folder, window)
    if len(run.t) < 2:
        return []
    edges: dict[str, Any] = {"t": run.t, "middles": run.middles(), "top": int(np.argmax(run.area))}
    edges["pieces"] = np.stack([run.edges(k)[..., :2] for k in range(len(run.t))])
    out, caption = Path(out), "free edges from downstream"
    heading: dict[str, Any] = {"radius": 0.5 * valve.diameter, "title": case.title}
    return [
        draw_moments(run, case, moments(run.t, run.area), out / "leaflets.png"),
        free_edges(out / "free_edges.png", edges, caption=caption, **heading),
    ]


def draw_moments(run: Leaflets, case: Case, frames: Indices, path: Path) -> Path:
    """Draw end views of the leaflets at some frames.

    Args:
        run: The leaflets.
        case: Their case.
        frames: Numbers of the frames, ``(k,)``.
        path: The picture.
    """
    from valvefsi.post.plots.valve_waveform import valve_end_views

    views = [
        {"xyz": np.concatenate([run.points[k], run.edges(k).reshape(-1, 3)]), "t": run.t[k]}
        | {"triangles": run.triangles, "owner": run.owner, "open_area": run.area[k]}
        | {"free_edges": len(run.points[k]) + np.arange(2 * len(run.edges(k))).reshape(-1, 2)}
        for k in frames
    ]
    seen = "leaflets from downstream; what is dark is open"
    return valve_end_views(path, views, radius=0.5 * valve_of(case).diameter, title=case.title, caption=seen)


def moments(t: Array, area: Array, count: int = MOMENTS) -> Indices:
    """Choose frames evenly along the change of the open area, and a little along time."""
    if len(t) <= count:
        return np.arange(len(t))
    change = np.abs(np.diff(area))
    way = STILL * np.diff(t) / (t[-1] - t[0]) + (1.0 - STILL) * change / max(change.sum(), 1e-300)
    along = np.concatenate([[0.0], np.cumsum(way)])
    chosen: list[int] = []
    for k, goal in enumerate(np.linspace(0.0, along[-1], count)):
        first = chosen[-1] + 1 if chosen else 0
        last = len(t) - (count - k) + 1
        chosen.append(first + int(np.abs(along[first:last] - goal).argmin()))
    return np.array(chosen)


def read_leaflets(case: Case, folder: Path, window: tuple[float, float] | None = None) -> Leaflets:
    """Read the leaflets of a run from its frames.

    Raises:
        CaseError: The frames are not of the case's valve.
    """
    valve = valve_of(case)
    series = Path(folder) / "paraview" / f"{valve.name}.pvd"
    low, high = window or (-np.inf, np.inf)
    found = [(t, path) for t, path in times_of(series) if low - 1e-9 <= t <= high + 1e-9]
    bodies = [read_body(path) for _, path in found]
    if not bodies:
        none, no = np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
        empty: dict[str, Any] = {"inflow": no, "inflow_owner": no, "free": (), "attached": ()}
        return Leaflets(t=none, points=none, triangles=no, owner=no, lines=(), area=none, **empty)
    edges = leaflet_edges(case, valve.number, solid_mesh(case, valve.number, MPI.COMM_SELF))
    node, rest = _nodes(edges.surfaces, bodies[0], series), edges.surfaces.points
    lines = tuple(replace(line, nodes=node[line.nodes]) for line in edges.free)
    triangles = np.concatenate([surface_triangles(kind, cells) for kind, cells in bodies[0].cells.items()])
    disk: dict[str, Any] = {"radius": 0.5 * valve.diameter, "axis": AXIS, "centre": CENTRE, "rows": 128}
    owner, inflow = _owners(triangles, lines, len(bodies[0].points)), node[edges.surfaces.faces["inflow"]]
    return Leaflets(
        t=np.array([t for t, _ in found]),
        points=np.stack([end_view(body.points, AXIS, CENTRE) for body in bodies]),
        triangles=triangles,
        owner=owner[triangles[:, 0]],
        lines=lines,
        area=np.array([projected_area(body.points, triangles, **disk).open_area for body in bodies]),
        inflow=inflow,
        inflow_owner=owner[inflow[:, 0]],
        free=tuple(line.at(rest) for line in edges.free),
        attached=tuple(line.at(rest) for line in edges.attached),
    )


def _nodes(surfaces: TaggedSurfaces, body: Body, series: Path) -> Indices:
    """Return the node of a frame at each corner of the tagged facets."""
    reference = body.reference if body.reference is not None else body.points
    distance, node = cKDTree(reference).query(surfaces.points)
    corners = surfaces.points[surfaces.faces["free"]]
    edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).min()
    if distance.max() > 0.01 * edge:
        raise CaseError("these frames are not of the case's valve", file=series)
    return node


def _owners(triangles: Indices, lines: tuple[MiddleLine, ...], count: int) -> Indices:
    """Return the leaflet of each node: the first whose free edge is on the same connected piece, else 0."""
    edges = np.concatenate([triangles[:, :2], triangles[:, 1:]])
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(count, count))
    pieces, piece = connected_components(graph, directed=False)
    owner = np.zeros(pieces, dtype=np.int64)
    for number, line in reversed(list(enumerate(lines))):
        owner[piece[line.nodes[0, 0]]] = number
    return owner[piece]
