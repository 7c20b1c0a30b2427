"""Pictures of planes of the fluid, with the solids cut by them: `valvefsi plot --slice`, frames of movies."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from valvefsi.post.plots.base import INK, MUTED, STYLE, saved
from valvefsi.post.plots.ticks import length_axes
from valvefsi.post.slices import Slice, scale_of
from valvefsi.types import Array

SHADES = 32
"""Colours of a palette between the two inks and white, for text and lines."""


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
