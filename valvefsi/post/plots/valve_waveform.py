"""Pictures of a valve at work: pressures, flow and open area over a cycle, and its leaflets end on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from valvefsi.post.plots.base import INK, LINES, MUTED, STYLE, draw_bar, plain, saved
from valvefsi.post.plots.waveform import headings_at
from valvefsi.units import MMHG

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from valvefsi.types import Array

CURVES = {
    "p_lv": ("$P_\\mathrm{LV}$", LINES[1], MMHG),
    "p_ao": ("$P_\\mathrm{Ao}$", LINES[0], MMHG),
    "q": ("flow", LINES[2], 1.0),
    "pdva": ("open area", LINES[3], 1.0),
}
"""Label, colour and unit of each waveform."""
SHADE, LUMEN, EDGE, RING = "#eaf1f6", "#2b4257", "#fffaf0", "#c9d3db"
LEAFLETS = ("#e3b5a2", "#a9c4de", "#b9d6ae")


def valve_waveforms(path: Path, waves: Mapping[str, Array], *, title: str = "", caption: str = "") -> Path:
    """Draw pressures, flow and open area over time, one above the other.

    Args:
        path: The picture, PNG or PDF.
        waves: Arrays by name: ``t`` [s], ``p_lv``, ``p_ao`` [dyn/cm^2], ``q`` [cm^3/s], each ``(n,)``. If
            given: ``pdva`` [cm^2]; ``forward``, starts and ends of forward flow, shaded, ``(k, 2)`` [s];
            ``positive``, those of the positive pressure difference, filled, ``(k, 2)`` [s]; measurements to
            compare with, ``t_data`` and any of ``p_lv_data``, ``p_ao_data``, ``q_data``, ``pdva_data``.
        title: Heading.
        caption: Second line under it.

    Returns:
        The path.
    """
    panels = [("p_lv", "p_ao"), ("q",), *([("pdva",)] if "pdva" in waves else [])]
    units = ("pressure [mmHg]", "flow [ml/s]", "open area [cm$^2$]")
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.6, 2.1 + 1.95 * len(panels)), dpi=160, facecolor="white")
        ratios = (1.55, 1.15, 0.8)[: len(panels)]
        rows = figure.subplots(len(panels), 1, sharex=True, height_ratios=ratios)
        height = figure.get_size_inches()[1]
        figure.subplots_adjust(
            left=0.14, right=0.965, top=1 - 0.86 / height, bottom=0.58 / height, hspace=0.1
        )
        for axes, names, unit in zip(rows, panels, units, strict=False):
            _panel(axes, waves, names)
            axes.set_ylabel(unit)
        if "positive" in waves:
            _difference(rows[0], waves)
        _legends(rows)
        forward = np.atleast_2d(waves.get("forward", np.zeros((0, 2))))
        if len(forward):
            where = {"transform": rows[1].get_xaxis_transform(), "ha": "center", "va": "bottom"}
            rows[1].text(forward[0].mean(), 0.05, "forward flow", fontsize=8.5, color=MUTED, **where)
        rows[-1].set_xlabel("t [s]")
        rows[-1].yaxis.label.set_size(9)
        figure.align_ylabels(list(rows))
        headings_at(figure, 0.14, title, caption)
        return saved(figure, path)


def _panel(axes: Axes, waves: Mapping[str, Array], names: Sequence[str]) -> None:
    """Draw waveforms of one unit, with the measurements over them."""
    for start, end in np.atleast_2d(waves.get("forward", np.zeros((0, 2)))):
        axes.axvspan(start, end, color=SHADE, linewidth=0, zorder=0)
    for name in names:
        label, colour, unit = CURVES[name]
        axes.plot(waves["t"], waves[name] / unit, color=colour, linewidth=1.8, label=label, zorder=3)
        if f"{name}_data" in waves:
            y = waves[f"{name}_data"] / unit
            axes.plot(
                waves["t_data"],
                y,
                color=INK,
                linewidth=1,
                dashes=(4, 2),
                label=f"{label}, measured",
                zorder=4,
            )
    plain(axes)
    axes.margins(x=0, y=0.12)
    axes.yaxis.set_major_locator(mpl.ticker.MaxNLocator(5))
    if names != ("p_lv", "p_ao"):
        axes.axhline(0, color=MUTED, linewidth=0.8, zorder=1)


def _legends(rows: Sequence[Axes]) -> None:
    """Name the pressures above their panel, and the rest where a panel holds more than one curve."""
    above = {"loc": "lower right", "bbox_to_anchor": (1.01, 0.99), "ncols": 5, "handlelength": 1.6}
    rows[0].legend(frameon=False, fontsize=8.5, **above)
    for axes in rows[1:]:
        if len(axes.get_legend_handles_labels()[1]) > 1:
            axes.legend(frameon=False, fontsize=8.5, loc="upper right")


def _difference(axes: Axes, waves: Mapping[str, Array]) -> None:
    """Fill between the pressures where their difference counts as positive."""
    label: str | None = "positive difference"
    for start, end in np.atleast_2d(waves["positive"]):
        t = np.unique(np.concatenate([[start, end], waves["t"][(waves["t"] > start) & (waves["t"] < end)]]))
        above, below = (np.interp(t, waves["t"], waves[name]) / MMHG for name in ("p_lv", "p_ao"))
        axes.fill_between(t, below, above, color=LINES[4], alpha=0.45, linewidth=0, label=label, zorder=2)
        label = None


def valve_end_views(
    path: Path, views: Sequence[Mapping[str, Array]], *, radius: float, title: str = "", caption: str = ""
) -> Path:
    """Draw the leaflets end on, as a camera downstream sees them; what is dark is open.

    Args:
        path: The picture, PNG or PDF.
        views: One mapping for each moment: ``xyz``, nodes to the right, upwards and towards the viewer with
            the axis at 0, ``(n, 3)`` [cm]; ``triangles``, corners, ``(m, 3)``. If given: ``owner``, number
            of each triangle's leaflet from 0, ``(m,)``; ``free_edges``, ends of the pieces of the free
            edges, ``(k, 2)``; ``open_area`` [cm^2]; ``t`` [s].
        radius: Radius of the orifice [cm].
        title: Heading.
        caption: Second line under it.

    Returns:
        The path.
    """
    across = min(len(views), 4)
    down = -(-len(views) // across)
    with mpl.rc_context(STYLE):
        head = 0.85 if title or caption else 0.1
        figure = Figure(figsize=(2.35 * across + 0.3, 2.85 * down + head), dpi=160, facecolor="white")
        height = figure.get_size_inches()[1]
        figure.subplots_adjust(0.02, 0.02, 0.98, 1 - head / height, wspace=0.06, hspace=0.06)
        grid = np.ravel(figure.subplots(down, across, squeeze=False))
        for axes in grid:
            axes.set_axis_off()
        reach = 1.02 * max(float(np.abs(np.asarray(view["xyz"])[:, :2]).max(initial=0.0)) for view in views)
        for axes, view in zip(grid, views, strict=False):
            draw_end_view(axes, view, radius, max(reach, 1.1 * radius))
        low = -max(reach, 1.1 * radius)
        draw_bar(grid[0], (0.99 * low, 1.27 * low), 2.0 * radius, 0.1)
        orifice = f"orifice {20.0 * radius:.3g} mm across"
        headings_at(figure, 0.03, title, f"{caption}; {orifice}" if caption else orifice)
        return saved(figure, path)


def draw_end_view(
    axes: Axes, view: Mapping[str, Array], radius: float, reach: float, *, small: bool = False
) -> None:
    """Draw one moment: orifice, leaflets from the farthest triangle to the nearest, free edges, ring.

    Args:
        axes: Where.
        view: The moment, see `valve_end_views`; ``colours`` of the triangles, if given, ``(m, 3)``.
        radius: Radius of the orifice [cm].
        reach: How far the picture goes [cm].
        small: Draw thinner lines and say the time alone, in ms.
    """
    xyz, triangles = np.asarray(view["xyz"]), np.asarray(view["triangles"], dtype=int).reshape(-1, 3)
    axes.add_patch(Circle((0, 0), radius, facecolor=LUMEN, edgecolor="none", zorder=1))
    if len(triangles):
        corners = xyz[triangles]
        order = np.argsort(corners[..., 2].mean(axis=1))
        owner = np.asarray(view.get("owner", np.zeros(len(triangles))), dtype=int)
        colours = (np.asarray(view["colours"]) if "colours" in view else _lit(corners, owner))[order]
        axes.add_collection(
            # Edges in the faces' own colours close the hairlines between neighbours.
            PolyCollection(
                corners[order, :, :2], facecolors=colours, edgecolors=colours, linewidths=0.4, zorder=2
            )
        )
    if "free_edges" in view:
        pieces = xyz[np.asarray(view["free_edges"], dtype=int)][..., :2]
        for colour, width in ((INK, 1.6), (EDGE, 0.7)) if small else ((INK, 2.8), (EDGE, 1.3)):
            axes.add_collection(
                LineCollection(pieces, colors=colour, linewidths=width, capstyle="round", zorder=3)
            )
    axes.add_patch(
        Circle((0, 0), 1.035 * radius, fill=False, edgecolor=RING, linewidth=2.5 if small else 5, zorder=4)
    )
    axes.add_patch(Circle((0, 0), radius, fill=False, edgecolor=MUTED, linewidth=0.8, zorder=5))
    axes.set(xlim=(-reach, reach), ylim=((-1.22 if small else -1.34) * reach, reach), aspect="equal")
    if small:
        axes.text(0, -1.08 * reach, f"{1e3 * float(view['t']):.1f} ms", ha="center", va="top", fontsize=8)
        return
    text = [f"t = {float(view['t']):.3f} s"] if "t" in view else []
    if "open_area" in view:
        text.append(f"{float(view['open_area']):.2f} cm$^2$")
    axes.text(0, -1.05 * reach, "   ".join(text), ha="center", va="top", fontsize=9)


def _lit(corners: Array, owner: Array) -> Array:
    """Colours of the triangles, lighter where they face a lamp up and to the left of the viewer."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = normal * np.where(normal[:, 2:] < 0, -1.0, 1.0)
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    lamp = np.array([-0.4, 0.5, 0.77]) / np.linalg.norm([-0.4, 0.5, 0.77])
    facing = np.clip(np.divide(normal, size, out=np.zeros_like(normal), where=size > 0) @ lamp, 0, 1)
    base = np.array([to_rgb(colour) for colour in LEAFLETS])[owner % len(LEAFLETS)]
    return np.clip(base * (0.62 + 0.45 * facing[:, None]), 0, 1)
