"""Pictures of planes of the fluid, with the solids cut by them: `valvefsi plot --slice`, frames of movies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from valvefsi.errors import CaseError
from valvefsi.io.grid_files import GridFields
from valvefsi.io.solid_body import CORNERS, Body, outer_faces
from valvefsi.post.diagnostics.shear import cell_gradient
from valvefsi.post.plots.base import INK, MUTED, STYLE, saved
from valvefsi.post.plots.ticks import length_axes
from valvefsi.types import Array
from valvefsi.units import MMHG

DERIVED = {
    "speed": "cm/s",
    "velocity_x": "cm/s",
    "velocity_y": "cm/s",
    "velocity_z": "cm/s",
    "vorticity": "1/s",
    "vorticity_magnitude": "1/s",
    "q": "1/s^2",
}
"""Fields that are made of the velocity, and their units."""
UNITS = {
    "pressure": "mmHg",
    "mean_pressure": "mmHg",
    "turbulence_kinetic_energy": "cm^2/s^2",
    "mean_velocity": "cm/s",
    "velocity": "cm/s",
}

SHADES = 32
"""Colours of a palette between the two inks and white, for text and lines."""


@dataclass(frozen=True, kw_only=True)
class Plane:
    """A plane across the box.

    Attributes:
        axis: Axis it is normal to.
        position: Where it cuts that axis [cm].
    """

    axis: int
    position: float


@dataclass(frozen=True, kw_only=True)
class Slice:
    """A field in a plane.

    Attributes:
        x: Edges of the cells along the picture's first axis [cm].
        y: Along its second axis [cm].
        values: The field, ``(nx, ny)``.
        axes: Names of the two axes.
        name: Name of the field.
        unit: Its unit.
    """

    x: Array
    y: Array
    values: Array
    axes: tuple[str, str]
    name: str
    unit: str


def cut(grid: GridFields, plane: Plane, name: str) -> Slice:
    """Return a field in a plane, that of the cells that the plane goes through.

    Args:
        grid: The fields.
        plane: The plane; any position in two dimensions.
        name: A field of the file, one of `DERIVED`, or ``NAME_x``, ``NAME_y``, ``NAME_z`` of a vector.

    Raises:
        CaseError: No such field, or the plane is outside the box.
    """
    edges, axis = grid.edges, plane.axis
    if grid.dim == 2:
        axis, index = 2, 0
    else:
        e = edges[axis]
        if not e[0] <= plane.position <= e[-1]:
            message = f"the box goes from {e[0]:g} to {e[-1]:g} cm along {'xyz'[axis]}"
            raise CaseError(message, key="--slice", value=f"{'xyz'[axis]}={plane.position:g} cm")
        index = min(int(np.searchsorted(e, plane.position, side="right")) - 1, len(e) - 2)
    values, unit = field_of(grid, name, axis)
    a, b = (k for k in range(3) if k != axis)
    return Slice(
        x=edges[a],
        y=edges[b],
        values=np.take(values, index, axis=axis),
        axes=("xyz"[a], "xyz"[b]),
        name=name,
        unit=unit,
    )


def field_of(grid: GridFields, name: str, axis: int = 2) -> tuple[Array, str]:
    """Return a scalar field by name and its unit, ``(nx, ny, nz)``.

    ``vorticity`` is its component along ``axis``; derivatives are centred differences between the cells' centres.

    Raises:
        CaseError: There is no such field.
    """
    fields = grid.fields
    if name in fields and fields[name].ndim == 3:
        unit = UNITS.get(name, "")
        return fields[name].astype(float) / (MMHG if unit == "mmHg" else 1.0), unit
    vector, _, part = name.rpartition("_")
    if vector in fields and fields[vector].ndim == 4 and part in "xyz":
        return fields[vector][..., "xyz".index(part)].astype(float), UNITS.get(vector, "")
    if name in ("mean_speed", "speed"):
        source = name.replace("speed", "velocity")
        if source in fields:
            return np.linalg.norm(fields[source].astype(float), axis=-1), "cm/s"
    if name in DERIVED and "velocity" in fields:
        G = cell_gradient(fields["velocity"].astype(float), grid.centres)
        if name == "q":
            return -0.5 * np.einsum("...ij,...ji->...", G, G), DERIVED[name]
        curl = np.stack(
            [G[..., (k + 2) % 3, (k + 1) % 3] - G[..., (k + 1) % 3, (k + 2) % 3] for k in range(3)], -1
        )
        found = np.linalg.norm(curl, axis=-1) if name.endswith("magnitude") else curl[..., axis]
        return found, DERIVED[name]
    scalars = [key for key, value in fields.items() if value.ndim == 3]
    vectors = [f"{key}_{c}" for key, value in fields.items() if value.ndim == 4 for c in "xyz"]
    derived = [key for key in DERIVED if "velocity" in fields and key not in vectors]
    raise CaseError(f"expected one of {', '.join(scalars + vectors + derived)}", key="--field", value=name)


def outline(body: Body, plane: Plane, dim: int) -> list[Array]:
    """Return where a plane cuts a solid's surface, segments ``(2, 2)``; polygons of a flat solid [cm]."""
    if dim == 2:
        return [
            body.points[nodes[: CORNERS[kind]], :2] for kind, block in body.cells.items() for nodes in block
        ]
    segments: list[Array] = []
    kept = [k for k in range(3) if k != plane.axis]
    for faces in outer_faces(body):
        segments += list(_cut_faces(body.points[faces], plane, kept))
    return segments


def _cut_faces(corners: Array, plane: Plane, kept: Sequence[int]) -> Array:
    """Segments in which a plane cuts polygons ``(n, k, 3)``, ``(m, 2, 2)``."""
    height = corners[..., plane.axis] - plane.position
    following, above = np.roll(corners, -1, axis=1), np.roll(height, -1, axis=1)
    crossing = (height > 0) != (above > 0)
    rows = np.flatnonzero(crossing.sum(axis=1) == 2)
    if not len(rows):
        return np.zeros((0, 2, 2))
    hit = crossing[rows]
    h, g = height[rows][hit], above[rows][hit]
    s = (h / (h - g))[:, None]
    points = (1 - s) * corners[rows][hit] + s * following[rows][hit]
    return points[:, kept].reshape(-1, 2, 2)


def draw_slice(
    path: Path,
    found: Slice,
    *,
    solids: Sequence[Sequence[Array]] = (),
    lines: Sequence[Array] = (),
    limits: tuple[float, float] | None = None,
    title: str = "",
    caption: str = "",
) -> Path:
    """Draw a field in a plane, with the solids over it.

    Args:
        path: The picture.
        found: The field.
        solids: Segments or polygons of each solid, see `outline`.
        lines: Dashed lines over all of it, ``(2, 2)`` each [cm].
        limits: Ends of the scale; those of the field if left out.
        title: Heading.
        caption: Second line under it.
    """
    low, high = limits or scale_of(found.values)
    signed = low == -high  # a diverging map only where its middle is zero
    ink = INK if signed else "white"  # the other map is dark at its low end
    width, height = np.ptp(found.x), np.ptp(found.y)
    longest = 7.0 / max(width, height)
    size = (max(longest * width, 2.4), max(longest * height, 2.0))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(size[0] + 1.9, size[1] + 1.5), dpi=140, facecolor="white")
        whole = figure.get_size_inches()
        place = (0.75 / whole[0], 0.6 / whole[1], size[0] / whole[0], size[1] / whole[1])
        axes = figure.add_axes(place)
        picture = axes.pcolormesh(
            found.x,
            found.y,
            found.values.T,
            cmap=_map(low, high),
            vmin=low,
            vmax=high,
            rasterized=True,
        )
        for parts in solids:
            segments = [part for part in parts if len(part) == 2]
            polygons = [part for part in parts if len(part) > 2]
            axes.add_collection(LineCollection(segments, colors=ink, linewidths=0.9, zorder=3))
            axes.add_collection(
                PolyCollection(polygons, facecolor="#f3ede4", edgecolor=INK, linewidths=0.3, zorder=3)
            )
        axes.add_collection(LineCollection(lines, colors=ink, linewidths=1.0, linestyles="--", zorder=4))
        axes.set(xlim=found.x[[0, -1]], ylim=found.y[[0, -1]], aspect="equal")
        length_axes(axes, names=found.axes)
        bar = figure.add_axes((place[0] + place[2] + 0.2 / whole[0], place[1], 0.16 / whole[0], place[3]))
        unit = f" [{found.unit.replace('^2', '²')}]" if found.unit else ""
        figure.colorbar(picture, cax=bar, label=f"{found.name.replace('_', ' ')}{unit}")
        figure.text(place[0], 1 - 0.38 / whole[1], title, fontsize=13, fontweight="bold")
        figure.text(place[0], 1 - 0.66 / whole[1], caption, fontsize=9.5, color=MUTED)
        return saved(figure, path)


def _map(low: float, high: float) -> str:
    """Return the name of the colour map of a scale, a diverging one only where its middle is zero."""
    return "RdBu_r" if low == -high else "viridis"


def palette(limits: tuple[float, float]) -> Array:
    """Return the colours that pictures of a scale are made of, for formats with few: its map's, and inks to white.

    Args:
        limits: Ends of the scale.

    Returns:
        Red, green and blue from 0 to 255, ``(256, 3)``.
    """
    ramp = mpl.colormaps[_map(*limits)](np.linspace(0.0, 1.0, 256 - SHADES))[:, :3]
    white = np.linspace(0.0, 1.0, SHADES // 2)[:, None]
    shades = [ink + white * (1.0 - ink) for ink in map(np.array, map(to_rgb, (INK, MUTED)))]
    colours: Array = np.rint(255.0 * np.concatenate([ramp, *shades]))
    return colours


def scale_of(values: Array) -> tuple[float, float]:
    """Return the ends of a scale: all but the outermost half per cent, even about 0 where the field has both signs."""
    low, high = (float(v) for v in np.percentile(values, [0.5, 99.5]))
    if low < 0 < high and min(-low, high) > 0.02 * max(-low, high):
        high = max(-low, high)
        return -high, high
    if high <= low:
        high = low + max(1e-12, abs(low) * 1e-6)
    return (0.0 if 0 <= low < 0.2 * high else low), high
