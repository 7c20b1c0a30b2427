"""Surfaces in space from two or three sides, with a scale: orthographic, far facets first, lengths in mm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from valvefsi.post.plots.base import INK, MUTED, STYLE, draw_bar, headings, saved
from valvefsi.post.plots.ticks import length_axes
from valvefsi.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable

BOTH_SIDES = {"from the front, above": (28.0, -60.0), "from behind, below": (-28.0, 120.0)}
"""Height and azimuth of the eye by the name of the view [deg]."""
TAGS = (
    *("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9", "#b8a800", "#7b5ea7"),
    *("#7f5539", "#4c956c", "#f08080", "#264653", "#a7c957", "#9d0208", "#84a9c0", "#f2cc8f"),
)
"""Colours of tags, taken in turn."""
PLAIN = "#c9d3db"
"""Colour of facets without a tag."""


@dataclass(frozen=True, kw_only=True)
class Surface:
    """Facets with their colours.

    Attributes:
        polygons: Corners of each facet, one after the other around it, ``(n, 3 or 4, 3)`` [cm].
        colours: Colour of each facet, ``(n, 4)``.
        names: Texts in the picture, each at a place, ``(3,)`` [cm], seen from the side that its normal faces.
        shade: Part of its light that a facet loses that does not face it.
        outward: Whether the corners run such that the normals point out of a closed body: its far side is left out.
    """

    polygons: Array
    colours: Array
    names: Mapping[str, tuple[Array, Array]]
    shade: float = 0.38
    outward: bool = True


def tagged_surface(groups: Mapping[str, Array], *, named: bool = True) -> tuple[Surface, dict[str, str]]:
    """Return the facets of tags in a colour each, and the colours by tag.

    Args:
        groups: Corners of the facets of each tag, ``(n, k, 3)`` [cm]; those of "" have none.
        named: Whether the tags stand in the picture.
    """
    colours = {name: TAGS[k % len(TAGS)] for k, name in enumerate(name for name in groups if name)}
    names = {}
    for name in colours if named else ():
        vectors = area_vectors(groups[name])
        size = np.linalg.norm(vectors, axis=1)
        middle = size @ groups[name].mean(axis=1) / size.sum()
        facet = groups[name].mean(axis=1)
        nearest = int(np.argmin(np.linalg.norm(facet - middle, axis=1)))
        names[name] = (facet[nearest], vectors[nearest])
    rows = [
        np.tile(to_rgba(colours.get(name, PLAIN)), (len(polygons), 1)) for name, polygons in groups.items()
    ]
    polygons = np.concatenate(list(groups.values()))
    return Surface(polygons=polygons, colours=np.concatenate(rows), names=names), colours


def area_vectors(polygons: Array) -> Array:
    """Return the area vector of each facet, ``(n, 3)``, half the product of its diagonals."""
    if polygons.shape[1] == 3:
        return 0.5 * np.cross(polygons[:, 1] - polygons[:, 0], polygons[:, 2] - polygons[:, 0])
    return 0.5 * np.cross(polygons[:, 2] - polygons[:, 0], polygons[:, 3] - polygons[:, 1])


def views(
    path: Path,
    surface: Surface,
    *,
    title: str = "",
    caption: str = "",
    legend: Mapping[str, str] | None = None,
    scale: tuple[ScalarMappable, str] | None = None,
    sides: Mapping[str, tuple[float, float]] = BOTH_SIDES,
) -> Path:
    """Draw a surface from several sides, all in one scale, with its lengths where they are seen as they are.

    Args:
        path: The picture, PNG or PDF.
        surface: The facets.
        title: Heading.
        caption: Second line under it.
        legend: Colours by name.
        scale: Colour scale of the facets, and what it shows.
        sides: Height and azimuth of the eye by the name of the view [deg].

    Returns:
        The path.
    """
    turns = {name: turn(*angles) for name, angles in sides.items()}
    seen = {name: 10.0 * surface.polygons @ turn.T for name, turn in turns.items()}
    flat = {name: np.stack([x[..., :2].min((0, 1)), x[..., :2].max((0, 1))]) for name, x in seen.items()}
    across = max(float(np.ptp(ends[:, 0])) for ends in flat.values())
    tall = max(float(np.ptp(ends[:, 1])) for ends in flat.values())
    margin = 0.17 * max(across, tall)
    with mpl.rc_context(STYLE):
        width, rows = 9.6, -(-len(legend or ()) // 4)
        each = (width - 0.3) / len(sides)
        body = min(max(each * (tall + 1.2 * margin) / (across + 2 * margin), 1.6), 6.0)
        foot = 0.25 + 0.24 * rows if legend else 0.75 if scale else 0.2
        height = body + foot + 0.95
        figure = Figure(figsize=(width, height), dpi=150, facecolor="white")
        for k, (name, ends) in enumerate(flat.items()):
            axes = figure.add_axes(
                (0.15 / width + k * each / width, foot / height, each / width, body / height)
            )
            _view(axes, surface, seen[name], turns[name])
            middle = ends.mean(axis=0)
            reach = 0.5 * np.array([across, tall]) + margin
            axes.set(
                xlim=middle[0] + reach[0] * np.array([-1, 1]), ylim=middle[1] + reach[1] * np.array([-1, 1])
            )
            axes.set_aspect("equal")
            axes.set_axis_off()
            axes.set_title(name, fontsize=9.5, color=MUTED, pad=2)
            _scale_bar(axes, ends, margin)
            if abs(sides[name][0]) in (0.0, 90.0):
                _lengths(axes, ends, margin)
        if legend:
            handles = [Patch(color=colour, label=name) for name, colour in legend.items()]
            figure.legend(handles=handles, loc="lower center", ncols=4, frameon=False, fontsize=8.5)
        if scale is not None:
            place = (0.3, 0.5 / height, 0.4, 0.12 / height)
            bar = figure.colorbar(scale[0], cax=figure.add_axes(place), orientation="horizontal")
            bar.set_label(scale[1], labelpad=2, fontsize=9)
            bar.outline.set_visible(False)
        headings(figure, title, caption)
        return saved(figure, path)


def turn(height: float, azimuth: float) -> Array:
    """Return right, up and towards the eye as rows, ``(3, 3)``."""
    e, a = np.radians([height, azimuth])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    towards = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    return np.stack([right, np.cross(towards, right), towards])


def _view(axes: Axes, surface: Surface, seen: Array, turn: Array) -> None:
    """Draw the facets, the far ones first, the ones that face the eye brighter, and the names that face it."""
    normals = area_vectors(surface.polygons) @ turn.T
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    light = 1.0 - surface.shade * (1.0 - np.abs(normals @ np.array([0.35, 0.45, 0.82])))
    colours = surface.colours.copy()
    colours[:, :3] *= light[:, None]
    order = np.argsort(seen[..., 2].mean(axis=1))
    if surface.outward:
        order = order[normals[order, 2] > 0.0]
    edge = 0.25 if len(seen) < 4000 else 0.0
    facets = PolyCollection(list(seen[order, :, :2]), facecolors=colours[order], linewidths=edge)
    facets.set_edgecolor("#1b273355" if edge else colours[order])
    axes.add_collection(facets)
    for name, (place, normal) in surface.names.items():
        if (turn @ normal)[2] > 0.0:
            x, y, _ = 10.0 * turn @ place
            box = {"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.75}
            axes.annotate(name, (x, y), ha="center", va="center", fontsize=7.5, bbox=box)


def _lengths(axes: Axes, ends: Array, margin: float) -> None:
    """Draw how far the body reaches across and up."""
    (left, bottom), (right, top) = ends
    look = {"arrowstyle": "<->", "color": MUTED, "linewidth": 0.9, "shrinkA": 0, "shrinkB": 0}
    below, beside = bottom - 0.28 * margin, right + 0.28 * margin
    axes.annotate("", (left, below), (right, below), arrowprops=look)
    axes.annotate("", (beside, bottom), (beside, top), arrowprops=look)
    paper = {"facecolor": "white", "edgecolor": "none", "boxstyle": "round,pad=0.15"}
    size = {"fontsize": 8.5, "color": INK, "ha": "center", "va": "center", "bbox": paper}
    axes.text((left + right) / 2, below, f"{right - left:.3g} mm", **size)
    axes.text(beside, (bottom + top) / 2, f"{top - bottom:.3g} mm", rotation=90, **size)


def _scale_bar(axes: Axes, ends: Array, margin: float) -> None:
    """Draw a bar of a round length under a body."""
    (left, bottom), (right, top) = ends
    draw_bar(axes, (left, bottom - 0.72 * margin), max(right - left, top - bottom))


def outlines(path: Path, groups: Mapping[str, Array], cells: Sequence[Array], *, title: str = "") -> Path:
    """Draw a mesh in the plane, the edges of its sides coloured by tag.

    Args:
        path: The picture, PNG or PDF.
        groups: Ends of the edges of each tag, ``(n, 2, 3)`` [cm]; those of "" have none.
        cells: Corners of each cell, ``(k, 2)`` [cm].
        title: Heading.

    Returns:
        The path.
    """
    with mpl.rc_context(STYLE):
        x = np.concatenate([np.asarray(cell) for cell in cells])
        shape = float(np.clip(np.ptp(x[:, 1]) / np.ptp(x[:, 0]), 0.2, 1.2))
        figure = Figure(figsize=(7.2, 6.2 * shape + 1.3), dpi=150, facecolor="white", layout="constrained")
        axes = figure.add_subplot()
        axes.add_collection(PolyCollection(cells, facecolors="#eef2f5", edgecolors="#c9d3db", linewidths=0.5))
        for k, (name, lines) in enumerate(groups.items()):
            colour = TAGS[k % len(TAGS)] if name else INK
            ends = np.concatenate([lines[..., :2], np.full((len(lines), 1, 2), np.nan)], axis=1).reshape(
                -1, 2
            )
            axes.plot(*ends.T, color=colour, linewidth=2.4, label=name or "no tag")
        axes.set_aspect("equal")
        axes.margins(0.05)
        length_axes(axes)
        axes.set_title(title, loc="left", fontweight="bold")
        figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize=8.5)
        return saved(figure, path)
