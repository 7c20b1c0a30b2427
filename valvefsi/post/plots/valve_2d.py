"""Pictures of leaflets in a channel: displacements of their tips over time, and their outlines in the flow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from valvefsi.post.plots.base import INK, LINES, MUTED, STYLE, plain, saved

if TYPE_CHECKING:
    from valvefsi.types import Array

SPAN = (1.0, 5.0)
"""Stretch of the channel that is drawn [cm]."""


def tips(
    path: Path,
    history: Mapping[str, Array],
    known: Mapping[str, tuple[float, tuple[float, float]]],
    title: str = "",
) -> Path:
    """Draw both tips' displacements with the published extremes, and the gap between the leaflets.

    Args:
        path: The picture.
        history: ``t``, ``upper_dx``, ``upper_dy``, ``lower_dx``, ``lower_dy`` and ``gap`` [s, cm].
        known: Published value and range of ``max_dx`` and ``max_dy`` [cm].
        title: Heading.

    Returns:
        The path.
    """
    t = history["t"]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 7.2), dpi=150, facecolor="white")
        along, across, between = figure.subplots(3, 1, sharex=True)
        for axes, key, sign in ((along, "dx", 1.0), (across, "dy", -1.0)):
            value, (low, high) = known[f"max_{key}"]
            axes.axhspan(low, high, color="#e69f00", alpha=0.2, linewidth=0, label="largest, over codes")
            axes.axhline(
                value, color=INK, linewidth=1.0, dashes=(5, 3), label="largest, Kamensky et al. 2015"
            )
            axes.plot(t, history[f"upper_{key}"], color=LINES[0], linewidth=1.6, label="upper tip")
            mirrored = sign * history[f"lower_{key}"]
            label = "lower tip" if sign > 0.0 else "lower tip, mirrored"
            axes.plot(t, mirrored, color=LINES[1], linewidth=1.2, dashes=(3, 2), label=label)
            axes.set_ylabel(f"{key} [cm]")
        between.plot(t, history["gap"], color=LINES[2], linewidth=1.6)
        between.set(
            ylabel="gap of the leaflets [cm]", xlabel="t [s]", ylim=(min(0.0, history["gap"].min()), None)
        )
        for axes in (along, across, between):
            plain(axes)
        along.legend(
            frameon=False, fontsize=8, labelcolor=MUTED, ncols=4, loc="lower left", bbox_to_anchor=(0, 1)
        )
        figure.suptitle(title, x=0.02, ha="left", fontweight="bold")
        figure.subplots_adjust(left=0.1, right=0.97, top=0.9, bottom=0.08, hspace=0.15)
        return saved(figure, path)


def in_the_flow(path: Path, snapshots: Sequence[Mapping[str, Any]], *, title: str = "") -> Path:
    """Draw leaflets over the speed of the flow at several times, one under the other.

    Args:
        path: The picture.
        snapshots: Of each time ``t`` [s], ``edges`` of the cells along both axes [cm], speed in the cells as
            ``field`` ``(nx, ny)`` [cm/s], and ``outlines`` of the leaflets, ``(n, 2)`` each [cm].
        title: Heading.

    Returns:
        The path.
    """
    top = max(float(np.max(s["field"])) for s in snapshots)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.4, 0.6 + 2.65 * len(snapshots)), dpi=130, facecolor="white")
        every = figure.subplots(len(snapshots), 1, sharex=True, squeeze=False)[:, 0]
        for axes, snapshot in zip(every, snapshots, strict=True):
            edges, speed = snapshot["edges"], snapshot["field"]
            shown = axes.pcolormesh(*edges, speed.T, cmap="viridis", vmin=0.0, vmax=top, rasterized=True)
            for outline in snapshot["outlines"]:
                axes.fill(*outline.T, facecolor="white", edgecolor="#a3212d", linewidth=0.8)
            axes.set(xlim=SPAN, ylim=(edges[1][0], edges[1][-1]), aspect="equal", ylabel="y [cm]")
            axes.set_title(f"t = {snapshot['t']:.3g} s", loc="left", fontsize=9.5)
        every[-1].set_xlabel("x [cm]")
        height = 0.6 + 2.65 * len(snapshots)
        figure.subplots_adjust(left=0.09, right=0.86, top=1 - 0.75 / height, bottom=0.55 / height, hspace=0.2)
        bar = figure.colorbar(shown, cax=figure.add_axes((0.89, 0.3, 0.02, 0.4)))
        bar.set_label("speed [cm/s]")
        figure.suptitle(title, x=0.02, y=1 - 0.15 / height, va="top", ha="left", fontweight="bold")
        return saved(figure, path)
