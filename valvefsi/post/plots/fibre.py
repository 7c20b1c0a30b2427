"""Picture of a fibre field: a short line along each fibre, coloured by direction."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from valvefsi.post.plots.base import MUTED, STYLE, draw_bar, headings, plain, saved
from valvefsi.post.plots.views import BOTH_SIDES, turn

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from valvefsi.types import Array

WIDTH, HEAD, FOOT = 8.6, 0.95, 0.85
"""Width of the picture, heights of what is above and below its axes [inch]."""


def fibre_picture(
    path: str | Path, points: Array, vectors: Array, *, title: str = "", caption: str = ""
) -> Path:
    """Draw fibres, in space from two sides where they are not in one plane; lengths in mm.

    Args:
        path: The picture, PNG or PDF.
        points: Middles of the fibres, ``(n, 3)`` [cm].
        vectors: Unit vectors there, ``(n, 3)``; their colour is red for x, green for y and blue for z.
        title: Heading.
        caption: Second line under it; their number if left out.

    Returns:
        The file.
    """
    flat = np.ptp(points[:, 2]) == 0 and not np.any(vectors[:, 2])
    extent = np.ptp(points[:, : 2 if flat else 3], axis=0)
    length = 0.8 * (np.prod(extent[extent > 0]) / len(points)) ** (1 / np.count_nonzero(extent > 0))
    half = 0.5 * length * np.asarray(vectors)
    lines = 10.0 * np.stack([points - half, points + half], axis=1)
    colours = 0.15 + 0.75 * np.abs(vectors)
    turns = {"": np.eye(3)} if flat else {name: turn(*angles) for name, angles in BOTH_SIDES.items()}
    seen = {name: lines @ each.T for name, each in turns.items()}
    across, tall = (max(float(np.ptp(x[..., k])) for x in seen.values()) for k in (0, 1))
    each = WIDTH / len(seen)
    body = float(np.clip(0.9 * each * tall / across, 1.2, 5.5))
    with mpl.rc_context(STYLE):
        height = body + HEAD + FOOT
        figure = Figure(figsize=(WIDTH, height), dpi=150, facecolor="white")
        for k, (name, x) in enumerate(seen.items()):
            place = (k + (0.09 if flat else 0.05), FOOT / height, 0.86 if flat else 0.9, body / height)
            axes = figure.add_axes((place[0] / len(seen), place[1], place[2] / len(seen), place[3]))
            order = np.argsort(x[..., 2].mean(axis=1))
            axes.add_collection(LineCollection(x[order, :, :2], colors=colours[order], linewidths=1.4))
            _frame(axes, x[..., :2], name, flat=flat)
        keys = [
            Line2D([], [], color=0.15 + 0.75 * np.eye(3)[k], label=f"along {a}") for k, a in enumerate("xyz")
        ]
        figure.legend(
            handles=keys[: 2 if flat else 3], loc="lower center", ncols=3, frameon=False, fontsize=8.5
        )
        headings(figure, title, caption or f"{len(points)} lines along the fibres")
        return saved(figure, Path(path))


def _frame(axes: Axes, seen: Array, name: str, *, flat: bool) -> None:
    """Give a view its limits, and axes or a scale bar."""
    (left, bottom), (right, top) = seen.min((0, 1)), seen.max((0, 1))
    pad = 0.03 * max(right - left, top - bottom)
    axes.set(xlim=(left - pad, right + pad), ylim=(bottom - (pad if flat else 4 * pad), top + pad))
    axes.set_aspect("equal")
    if flat:
        axes.set(xlabel="x [mm]", ylabel="y [mm]")
        plain(axes)
        return
    axes.set_axis_off()
    axes.set_title(name, fontsize=9.5, color=MUTED, pad=2)
    draw_bar(axes, (left, bottom - 2.5 * pad), max(right - left, top - bottom))
