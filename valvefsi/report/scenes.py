"""Scenes to turn: the bodies of a run at its frames, and a plane of its fluid, over one slider."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from valvefsi.errors import CaseError
from valvefsi.io.grid_files import GridFields, is_complete, list_times, read_grid, times_of
from valvefsi.io.solid_body import Body, outer_faces, read_body
from valvefsi.post.slices import Plane, cut, outline, scale_of
from valvefsi.report.blocks import Figure, Section, missing, packed
from valvefsi.report.geometry import solid_series
from valvefsi.report.runs import Run
from valvefsi.types import Array, Indices

MOST_FRAMES = 60
"""Frames of a scene; of more, as many are chosen evenly."""
MOST_NUMBERS = 1_600_000
"""Coordinates and values of a scene, by which its frames are thinned further."""
STILL_TRIANGLES = 24_000
"""Triangles of a body that stays above which it is simplified."""
KILOPASCAL = 1.0e4


@dataclass(frozen=True, kw_only=True)
class Frames:
    """The frames of a run that a scene shows.

    Attributes:
        times: Their times, ``(m,)`` [s].
        panels: Panels of the scene.
        count: Number of frames that the run has.
    """

    times: Array
    panels: Sequence[dict[str, Any]]
    count: int


def the_scene(run: Run, window: tuple[float, float] | None = None) -> Section:
    """Return the scene of a run, of all its frames or those in a window of time [s]."""
    title = "Scene"
    try:
        found = frames_of(run, window=window)
    except CaseError as error:
        return Section(title=title, blocks=[missing(f"The frames cannot be read: {error}")])
    if found is None:
        why = f" (output.frames = {run.case.output.frames})" if run.case is not None else ""
        said = f"The run has no frames to show{why}."
        return Section(title=title, blocks=[missing(said)])
    return Section(title=title, blocks=[scene_of(found)])


def scene_of(found: Frames) -> Figure:
    """Return frames as a scene of a page."""
    scene = {"t": found.times.tolist(), "unit": "s", "clock": "time", "panels": found.panels}
    shown = len(found.times)
    thin = "" if shown == found.count else f" {shown} of {found.count} frames are shown."
    through = ", move the slider (or use the arrow keys on it) to go through time" if shown > 1 else ""
    steps = "Positions and values are kept in 65535 steps of their range."
    caption = f"Drag to turn or zoom{through}. {steps}{thin}"
    names = ", ".join(str(panel["title"]) for panel in found.panels)
    until = f"from t = {found.times[0]:.4g} s to {found.times[-1]:.4g} s"
    alt = f"{names} {until}." if shown > 1 else f"{names} at t = {found.times[0]:.4g} s."
    return Figure(kind="scene", alt=alt, caption=caption, data=scene)


def frames_of(
    run: Run, *, window: tuple[float, float] | None = None, times: Sequence[float] | None = None
) -> Frames | None:
    """Return the frames of a run for a scene, None where it has none.

    Args:
        run: The run.
        window: First and last time, all of the run if None [s].
        times: Times to which the nearest frames are taken instead [s].

    Raises:
        CaseError: A file of a frame is damaged.
    """
    return _frames(run, {path.stem: _times(path) for path in _series(run.folder)}, window, times)


def newest_frame(run: Run, after: float = -np.inf) -> Frames | None:
    """Return the newest frame of a run that may be going on, None where no frame is whole.

    Args:
        run: The run.
        after: Time of a frame that is known [s]: there is None, too, where no newer one is whole.

    Raises:
        CaseError: A file of the frame is damaged.
    """
    listed = {path.stem: list_times(path) for path in _newer(_series(run.folder), run.folder / "case.toml")}
    common = set.intersection(*({t for t, _ in entries} for entries in listed.values())) if listed else set()
    for t in sorted((t for t in common if t > after), reverse=True):
        frame = {name: [entry for entry in entries if entry[0] == t][-1:] for name, entries in listed.items()}
        if all(is_complete(path) for entries in frame.values() for _, path in entries):
            return _frames(run, frame, None, None)
    return None


Known = Mapping[str, Sequence[tuple[float, Path]]]
"""Times and files of each series by its name."""


def _series(folder: Path) -> list[Path]:
    """Return the series of bodies, of their stresses and of the fluid."""
    return [path for path in sorted((Path(folder) / "paraview").glob("*.pvd")) if path.stem != "averages"]


def _newer(series: Sequence[Path], case: Path) -> Sequence[Path]:
    """Return the series that the newest start of a run has gone on with: an earlier run may have left others."""
    start = case.stat().st_mtime if case.is_file() else 0.0
    return [path for path in series if path.stat().st_mtime >= start] or series


def _frames(
    run: Run, files: Known, window: tuple[float, float] | None, times: Sequence[float] | None
) -> Frames | None:
    """Return the frames of a run whose files are complete."""
    series = [path.stem for path in solid_series(run.folder) if _has_bodies(files[path.stem])]
    known = files[series[0]] if series else files.get("fluid", ())
    if not known:
        return None
    chosen, count = _chosen(np.array([t for t, _ in known]), window, times)
    panels: list[dict[str, Any]] = []
    bodies = {name: [read_body(files[name][k][1]) for k in chosen] for name in series}
    room = MOST_NUMBERS // max(1, sum(4 * len(frames[0].points) for frames in bodies.values()))
    if times is None and len(chosen) > room >= 2:
        kept = np.unique(np.linspace(0, len(chosen) - 1, room).round().astype(int))
        chosen, bodies = chosen[kept], {name: [frames[k] for k in kept] for name, frames in bodies.items()}
    if bodies and any(frames[0].dim == 3 for frames in bodies.values()):
        panels.append(_bodies_panel(run, files, bodies, chosen))
    plane = _plane_panel(files.get("fluid", ()), [known[k][0] for k in chosen], bodies)
    panels += [plane] if plane is not None else []
    for panel in panels:
        panel["frames"] = list(range(len(chosen)))
    return (
        Frames(times=np.array([known[k][0] for k in chosen]), panels=panels, count=count) if panels else None
    )


def _times(series: Path) -> list[tuple[float, Path]]:
    try:
        return times_of(series)
    except CaseError:
        return []


def _has_bodies(series: Sequence[tuple[float, Path]]) -> bool:
    return any(path.suffix == ".vtu" for _, path in series[:1])


def _chosen(
    known: Array, window: tuple[float, float] | None, times: Sequence[float] | None
) -> tuple[Indices, int]:
    """Return the numbers of the frames that are shown, and how many there are to choose from."""
    if times is not None:
        return np.abs(known[None, :] - np.asarray(times)[:, None]).argmin(axis=1), len(known)
    low, high = window or (-np.inf, np.inf)
    inside = np.flatnonzero((known >= low - 1e-9) & (known <= high + 1e-9))
    if len(inside) < 2:
        inside = np.arange(len(known))
    picked = np.linspace(0, len(inside) - 1, min(len(inside), MOST_FRAMES)).round().astype(int)
    return inside[np.unique(picked)], len(inside)


def _bodies_panel(run: Run, files: Known, bodies: dict[str, list[Body]], chosen: Indices) -> dict[str, Any]:
    """Return the panel of the bodies in space."""
    shapes = [_moving(files, name, frames, chosen) for name, frames in bodies.items()]
    still = [_still(path) for path in sorted((run.folder / "paraview").glob("*.vtu"))]
    corners = np.concatenate([shape.pop("corners") for shape in (*shapes, *still)])
    box = [corners.min(axis=0).tolist(), corners.max(axis=0).tolist()]
    return {"title": "Bodies, " + ", ".join(bodies), "bodies": [*shapes, *still], "box": box}


def _moving(files: Known, name: str, frames: list[Body], chosen: Indices) -> dict[str, Any]:
    """Return a body that moves: the nodes of its surface at every frame, and what colours it."""
    triangles = _triangles(frames[0])
    nodes, faces = np.unique(triangles, return_inverse=True)
    points = np.stack([body.points[nodes] for body in frames])
    fields = [_field("displacement", "mm", np.stack([10.0 * _moved(body)[nodes] for body in frames]))]
    fields += _stresses(files.get(f"{name}_stress", ()), nodes, chosen)
    for field, values in ((f, v) for body in frames[:1] for f, v in body.values.items()):
        if field == "J" and np.ndim(values) == 1:
            fields.append(_field("J = det F", "-", np.stack([body.values["J"][nodes] for body in frames])))
    return {
        "name": name,
        "still": False,
        "points": packed(points, "u2"),
        "triangles": packed(faces.reshape(-1), "u4"),
        "fields": fields,
        "corners": np.stack([points.min(axis=(0, 1)), points.max(axis=(0, 1))]),
    }


def _moved(body: Body) -> Array:
    """Return how far each node is from where it was."""
    return (
        np.zeros(len(body.points))
        if body.reference is None
        else np.linalg.norm(body.points - body.reference, axis=1)
    )


def _field(name: str, unit: str, values: Array) -> dict[str, Any]:
    """Return a field that colours a body; its scale leaves out the largest half per cent."""
    values = np.nan_to_num(values.astype(float))
    high = float(np.percentile(values, 99.5))
    low = min(float(np.percentile(values, 0.5)), high) if values.min() < 0 or name.startswith("J") else 0.0
    return {
        "name": name,
        "unit": unit,
        "values": packed(values, "u2"),
        "low": low,
        "high": high if high > low else low + 1,
    }


def _stresses(known: Sequence[tuple[float, Path]], nodes: Indices, chosen: Indices) -> list[dict[str, Any]]:
    """Return the scalars of the series of stresses at the same frames, where there is one."""
    if len(known) <= int(chosen.max()):
        return []
    bodies = [read_body(known[k][1]) for k in chosen]
    found = []
    for label, values in bodies[0].values.items():
        if np.ndim(values) == 1 and label != "J" and not label.startswith("displacement"):
            words, _, unit = label.rstrip("]").partition(" [")
            stress = unit == "dyn/cm^2"
            array = np.stack([body.values[label][nodes] for body in bodies]) / (KILOPASCAL if stress else 1.0)
            found.append(_field(words, "kPa" if stress else unit or "-", array))
    return found


def _still(path: Path) -> dict[str, Any]:
    """Return a body that stays, simplified where it is large."""
    body = read_body(path)
    points, triangles = simplified(body.points, _triangles(body), STILL_TRIANGLES)
    return {
        "name": path.stem,
        "still": True,
        "points": packed(points[None], "u2"),
        "triangles": packed(triangles.reshape(-1), "u4"),
        "fields": [],
        "corners": np.stack([points.min(axis=0), points.max(axis=0)]),
    }


def _triangles(body: Body) -> Indices:
    """Return the triangles of a body's surface, ``(n, 3)``."""
    parts = []
    for faces in outer_faces(body):
        parts += [faces[:, [0, k, k + 1]] for k in range(1, faces.shape[1] - 1)]
    return np.concatenate(parts)


def simplified(points: Array, triangles: Indices, most: int) -> tuple[Array, Indices]:
    """Return a surface of fewer triangles: nodes in one cell of a lattice become one, in their middle.

    Args:
        points: Nodes, ``(n, 3)``.
        triangles: Corners, ``(m, 3)``.
        most: Largest number of triangles that stays as it is.
    """
    if len(triangles) <= most:
        nodes, faces = np.unique(triangles, return_inverse=True)
        return points[nodes], faces.reshape(-1, 3)
    area = (
        0.5 * np.linalg.norm(np.cross(*np.diff(points[triangles], axis=1).transpose(1, 0, 2)), axis=1).sum()
    )
    size = float(np.sqrt(2.0 * area / most))
    _, cell = np.unique(
        np.floor((points - points.min(axis=0)) / size).astype(int), axis=0, return_inverse=True
    )
    cell = cell.reshape(-1)
    count = np.bincount(cell)
    middle = np.stack([np.bincount(cell, points[:, d]) / count for d in range(3)], axis=1)
    faces = cell[triangles]
    whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    _, first = np.unique(np.sort(faces[whole], axis=1), axis=0, return_index=True)
    return middle, faces[whole][first]


def _plane_panel(
    known: Sequence[tuple[float, Path]], times: Sequence[float], bodies: dict[str, list[Body]]
) -> dict[str, Any] | None:
    """Return the panel of the fluid in a plane along the axis; None where frames hold no fluid."""
    if not known:
        return None
    there = np.array([t for t, _ in known])
    grids = [read_grid(known[k][1], known[k][0]) for k in (int(np.abs(there - t).argmin()) for t in times)]
    plane, name = (
        (Plane(axis=1, position=0.0), "velocity_z")
        if grids[0].dim == 3
        else (Plane(axis=2, position=0.0), "speed")
    )
    edges = grids[0].edges[1]
    if grids[0].dim == 3 and not edges[0] <= 0.0 <= edges[-1]:
        plane = Plane(axis=1, position=float(0.5 * (edges[0] + edges[-1])))
    cuts = [_uniform(cut(grid, plane, name)) for grid in grids]
    values = np.stack([values.T for _, _, values in cuts])
    low, high = scale_of(values)
    segments = [_segments(frames, plane, grids[0]) for frames in _by_frame(bodies, len(grids))]
    x, y, _ = cuts[0]
    kept = [k for k in range(3) if k != plane.axis]
    where = "" if grids[0].dim == 2 else f", y = {10.0 * plane.position:g} mm"
    return {
        "title": f"Flow{where}",
        "name": "axial velocity" if name == "velocity_z" else "speed",
        "unit": "cm/s",
        "axes": ["xyz"[k] for k in kept],
        "x": packed(x),
        "y": packed(y),
        "values": packed(values, "u2"),
        "low": low,
        "high": high,
        "starts": np.cumsum([0, *map(len, segments)]).tolist(),
        "cuts": packed(np.concatenate([*segments, np.zeros((1, 4))]), "u2"),
    }


def _uniform(found: Any) -> tuple[Array, Array, Array]:
    """Return a slice on even centres, at its finest spacing, at most 160 along an axis: what a picture needs."""
    index, centres = [], []
    for edges in (found.x, found.y):
        count = int(min(160, max(2, round(float(np.ptp(edges)) / float(np.diff(edges).min())))))
        x = edges[0] + (np.arange(count) + 0.5) * np.ptp(edges) / count
        index.append(np.clip(np.searchsorted(edges, x) - 1, 0, len(edges) - 2))
        centres.append(x)
    return centres[0], centres[1], found.values[np.ix_(*index)]


def _by_frame(bodies: dict[str, list[Body]], count: int) -> list[list[Body]]:
    return [[frames[k] for frames in bodies.values()] for k in range(count)]


def _segments(bodies: Sequence[Body], plane: Plane, grid: GridFields) -> Array:
    """Return where a plane cuts bodies, in two dimensions their outlines, ``(n, 4)`` [cm]."""
    found: list[Array] = []
    for body in bodies:
        if grid.dim == 2:
            found.append(_edges(body))
        else:
            found += [np.asarray(piece).reshape(1, 4) for piece in outline(body, plane, grid.dim)]
    return np.concatenate(found) if found else np.zeros((0, 4))


def _edges(body: Body) -> Array:
    """Return the edges of a flat body that belong to one of its cells only, ``(n, 4)`` [cm]."""
    pairs = np.concatenate(
        [np.stack([f, np.roll(f, -1, axis=1)], axis=2).reshape(-1, 2) for f in outer_faces(body)]
    )
    _, first, count = np.unique(np.sort(pairs, axis=1), axis=0, return_index=True, return_counts=True)
    return body.points[pairs[first[count == 1]]][..., :2].reshape(-1, 4)
