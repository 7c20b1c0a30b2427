"""A picture of many comparisons: how far each computed value is from its reference."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from valvefsi.post.plots.base import GRID, LINES, MUTED, STYLE, saved

SMALLEST = 1e-3
"""What is nearer to its reference than this is drawn here [%]."""
NO_ROWS = "nothing is given as a part of a reference"


def differences(path: Path, rows: Sequence[tuple[str, str, float]], *, title: str = "") -> Path:
    """Draw the size of relative differences on a logarithmic axis, one row each.

    Args:
        path: The picture, PNG or PDF.
        rows: Group, label and difference from the reference [%].
        title: Heading.

    Returns:
        The path.
    """
    groups = list(dict.fromkeys(group for group, _, _ in rows))
    begins = np.array([k == 0 or row[0] != rows[k - 1][0] for k, row in enumerate(rows)], dtype=bool)
    places = np.arange(1.0, len(rows) + 1.0) + 0.7 * (np.cumsum(begins) - 1)
    last = float(places.max(initial=1.0)) + 1.0
    sizes = np.maximum([abs(value) for _, _, value in rows], SMALLEST)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 1.3 + 0.235 * last), dpi=130, facecolor="white", layout="constrained")
        axes = figure.subplots()
        for y, (group, _, value), size in zip(places, rows, sizes, strict=True):
            color = LINES[groups.index(group) % len(LINES)]
            axes.plot([SMALLEST, size], [y, y], color=GRID, linewidth=1.2, zorder=1)
            filled = "none" if value < 0.0 else color
            axes.scatter(
                size, y, s=26, facecolor=filled, edgecolor=color, linewidth=1.3, zorder=2, clip_on=False
            )
            axes.annotate(
                f"{value:+.2g} %", (size, y), (6, 0), textcoords="offset points", va="center", size=7.5
            )
        axes.text(0.5, 0.5, "" if rows else NO_ROWS, transform=axes.transAxes, ha="center")
        axes.set(xscale="log", xlim=(SMALLEST, max(100.0, 3.0 * sizes.max(initial=0.0))), ylim=(last, 0.0))
        axes.set_yticks(places, [label for _, label, _ in rows], fontsize=8)
        for y, group in zip(places[begins], groups, strict=True):
            axes.text(
                1.01, y, group, transform=axes.get_yaxis_transform(), fontsize=8.5, color=MUTED, va="center"
            )
        axes.grid(axis="x", color=GRID, linewidth=0.7)
        axes.set_axisbelow(True)
        axes.spines[["top", "right", "left"]].set_visible(False)
        axes.tick_params(axis="y", length=0)
        axes.set_xlabel("difference from the reference [%]; hollow where computed is the smaller")
        figure.suptitle(title, x=0.01, ha="left", fontweight="bold")
        return saved(figure, path)
