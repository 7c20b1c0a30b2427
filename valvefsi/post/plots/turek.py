"""Pictures of a flag behind a cylinder: histories of its tip and of the forces, and the vorticity around it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from valvefsi.post.plots.base import INK, LINES, MUTED, STYLE, plain, saved

if TYPE_CHECKING:
    from valvefsi.types import Array

NAMES = {"ux": "ux(A) [mm]", "uy": "uy(A) [mm]", "drag": "drag [N/m]", "lift": "lift [N/m]"}
SPAN = (5.0, 110.0)
"""Stretch of the channel that is drawn [cm]."""
LAST = 5.0
"""Published periods that the panels on the right show."""


def histories(
    path: Path,
    t: Array,
    signals: Mapping[str, Array],
    known: Mapping[str, Sequence[float]],
    *,
    title: str = "",
) -> Path:
    """Draw displacements of the tip and forces over the whole run, and over its last periods.

    Args:
        path: The picture.
        t: Times, ``(n,)`` [s].
        signals: ``ux``, ``uy`` [mm], ``drag``, ``lift`` [N/m], ``(n,)`` each.
        known: Published mean, amplitude and frequency of some of them.
        title: Heading.

    Returns:
        The path.
    """
    span = LAST / known["uy"][2] if "uy" in known else 1.0
    late = t >= max(0.5 * (t[0] + t[-1]), t[-1] - span)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 8.4), dpi=140, facecolor="white")
        panels = figure.subplots(4, 2, sharex="col", width_ratios=(3, 2))
        for number, (key, x) in enumerate(signals.items()):
            colour = LINES[number % len(LINES)]
            for axes, part in zip(panels[number], (slice(None), late), strict=True):
                if key in known:
                    mean, amplitude, _ = known[key]
                    for level in (mean - amplitude, mean + amplitude):
                        axes.axhline(level, color=INK, linewidth=0.9, dashes=(5, 3))
                axes.plot(t[part], x[part], color=colour, linewidth=0.8 if part is not late else 1.4)
                plain(axes)
            low, high = _span(x[late], known.get(key))
            panels[number, 1].set_ylim(low, high)
            if key == "drag":  # the start of the flow takes far larger forces
                panels[number, 0].set_ylim(min(0.0, low), 1.3 * high)
            panels[number, 0].set_ylabel(NAMES.get(key, key))
        for axes in panels[-1]:
            axes.set_xlabel("t [s]")
        if known:
            note = "dashed: published mean - and + amplitude"
            figure.text(0.98, 0.945, note, ha="right", fontsize=8.5, color=MUTED)
        figure.suptitle(title, x=0.02, ha="left", fontweight="bold")
        figure.subplots_adjust(left=0.09, right=0.98, top=0.93, bottom=0.07, hspace=0.14, wspace=0.18)
        return saved(figure, path)


def _span(x: Array, known: Sequence[float] | None) -> tuple[float, float]:
    ends = [float(x.min()), float(x.max())]
    if known is not None:
        ends += [known[0] - known[1], known[0] + known[1]]
    room = 0.06 * (max(ends) - min(ends)) or 1.0
    return min(ends) - room, max(ends) + room


def vorticity(
    path: Path,
    snapshots: Sequence[Mapping[str, Any]],
    body: tuple[float, float, float],
    *,
    scale: float,
    title: str = "",
) -> Path:
    """Draw the flag over the vorticity at several times, one under the other.

    Args:
        path: The picture.
        snapshots: Of each time ``t`` [s], ``edges`` of the cells along both axes [cm], vorticity in the cells as
            ``field`` ``(nx, ny)`` [1/s], and ``outlines``, of the flag alone, ``(n, 2)`` [cm].
        body: Centre and radius of the cylinder [cm].
        scale: Vorticity at the ends of the colours [1/s].
        title: Heading.

    Returns:
        The path.
    """
    height = 0.9 + 2.75 * len(snapshots)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.2, height), dpi=140, facecolor="white")
        every = figure.subplots(len(snapshots), 1, sharex=True, squeeze=False)[:, 0]
        for axes, snapshot in zip(every, snapshots, strict=True):
            edges, values = snapshot["edges"], np.asarray(snapshot["field"])
            shown = axes.pcolormesh(*edges, values.T, cmap="RdBu_r", vmin=-scale, vmax=scale, rasterized=True)
            axes.add_patch(Circle(body[:2], body[2], facecolor="#d5d7da", edgecolor=INK, linewidth=0.8))
            for outline in snapshot["outlines"]:
                axes.fill(*outline.T, facecolor="#e8b04a", edgecolor=INK, linewidth=0.8)
            axes.set(xlim=SPAN, ylim=(edges[1][0], edges[1][-1]), aspect="equal", ylabel="y [cm]")
            axes.set_title(f"t = {snapshot['t']:.4g} s", loc="left", fontsize=9.5)
        every[-1].set_xlabel("x [cm]")
        figure.subplots_adjust(left=0.08, right=0.87, top=1 - 0.7 / height, bottom=0.5 / height, hspace=0.18)
        bar = figure.colorbar(shown, cax=figure.add_axes((0.895, 0.3, 0.02, 0.4)), extend="both")
        bar.set_label("vorticity [1/s]")
        figure.suptitle(title, x=0.02, y=1 - 0.12 / height, va="top", ha="left", fontweight="bold")
        return saved(figure, path)
