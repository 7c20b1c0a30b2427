"""Pictures of the free edges of a valve's leaflets over time (as Figures S14 and S15)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from valvefsi.post.plots.base import LINES, MUTED, STYLE, draw_bar, headings, plain, saved
from valvefsi.post.plots.ticks import EvenTicks

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axes import Axes

    from valvefsi.types import Array, Indices

MOST = 12
"""Most moments that one end view holds."""
LEAST = 0.01
"""Least span of the distances from the axis [cm]."""


def free_edges(
    path: Path, edges: Mapping[str, Array], *, radius: float, title: str = "", caption: str = ""
) -> Path:
    """Draw the free edges end on, until open widest and from then on, and where their middles are over time.

    Args:
        path: The picture, PNG or PDF.
        edges: ``t``, moments, ``(m,)`` [s]; ``pieces``, ends of the pieces of the edges end on, ``(m, k, 2, 2)``
            [cm]; ``middles``, how far the middle of each leaflet's edge is from the axis, negative beyond it,
            ``(m, leaflets)`` [cm]; ``top``, index of the moment at which the valve is open widest.
        radius: Radius of the orifice [cm].
        title: Heading.
        caption: Second line under it.

    Returns:
        The path.
    """
    t, top = np.asarray(edges["t"]), int(edges["top"])
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.2, 7.4), dpi=160, facecolor="white")
        views = {"until open widest": np.arange(top + 1), "from then on": np.arange(top, len(t))}
        if 0 < top == len(t) - 1:  # it was still opening at the end
            del views["from then on"]
        for k, (name, part) in enumerate(views.items()):
            left = 0.04 + 0.49 * k if len(views) > 1 else 0.3
            axes = figure.add_axes((left, 0.42, 0.36, 0.46))
            _end_on(figure, axes, edges, _chosen(edges, part), radius)
            axes.set_title(name, fontsize=10.5)
        below = figure.add_axes((0.14, 0.08, 0.82, 0.25))
        count = edges["middles"].shape[1]
        for k in range(count):
            # The last of several is dashed: in a flow that mirrors them two leaflets move alike.
            dashes: Any = (0, (4, 4)) if k == count - 1 > 0 else "-"
            colour = LINES[k % len(LINES)]
            line = {"color": colour, "linestyle": dashes, "linewidth": 1.6, "label": f"leaflet {k + 1}"}
            below.plot(t, edges["middles"][:, k], **line)
        below.set(xlabel="t [s]", ylabel="middle of the free edge\nfrom the axis [mm]")
        below.yaxis.set_major_formatter(EvenTicks(10.0))
        below.margins(x=0)
        low, high = below.get_ylim()
        below.set_ylim(min(low, (low + high - LEAST) / 2), max(high, (low + high + LEAST) / 2))
        plain(below)
        below.legend(frameon=False, fontsize=8.5, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
        orifice = f"orifice {20.0 * radius:.3g} mm across"
        headings(figure, title, f"{caption}; {orifice}" if caption else orifice)
        return saved(figure, path)


def _chosen(edges: Mapping[str, Array], part: Indices) -> Indices:
    """At most so many moments of a part, evenly along the way that the edges' middles go."""
    if len(part) <= MOST:
        return part
    way = np.abs(np.diff(edges["middles"][part], axis=0)).sum(axis=1)
    way = np.concatenate([[0.0], np.cumsum(way + 1e-3 * way.sum() / len(way) + 1e-12)])
    near = np.abs(way[:, None] - np.linspace(0.0, way[-1], MOST)).argmin(axis=0)
    return part[np.unique(near)]


def _end_on(figure: Figure, axes: Axes, edges: Mapping[str, Array], chosen: Indices, radius: float) -> None:
    """Draw the edges of some moments in one view, coloured by their order."""
    t = np.asarray(edges["t"])[chosen]
    span, colours = Normalize(0, max(len(chosen) - 1, 1)), mpl.colormaps["viridis_r"]
    for place, k in enumerate(chosen):
        axes.add_collection(
            LineCollection(
                edges["pieces"][k], colors=[colours(span(place))], linewidths=1.3, capstyle="round"
            )
        )
    axes.add_patch(Circle((0, 0), radius, fill=False, edgecolor=MUTED, linewidth=1.0))
    axes.set(xlim=(-1.08 * radius, 1.08 * radius), ylim=(-1.2 * radius, 1.08 * radius), aspect="equal")
    draw_bar(axes, (-1.04 * radius, -1.13 * radius), 2.0 * radius, 0.1)
    axes.set_axis_off()
    place = axes.get_position()
    bar = figure.add_axes((place.x1 + 0.005, place.y0 + 0.06, 0.014, place.height - 0.12))
    figure.colorbar(ScalarMappable(span, colours), cax=bar, ticks=np.arange(len(chosen)))
    decimals = next((d for d in range(3, 9) if len({f"{when:.{d}f}" for when in t}) == len(t)), 9)
    bar.set_yticklabels([f"{when:.{decimals}f}" for when in t], fontsize=7.5)
    bar.set_title("t [s]", fontsize=8.5)
