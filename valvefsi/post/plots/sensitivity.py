"""Picture of uncertain inputs: which of them an output depends on, and the output over the one that counts most."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from valvefsi.post.plots.base import INK, LINES, MUTED, STYLE, headings, plain, saved, typeset

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from valvefsi.types import Array

HEAD, FOOT, GAP, BAR = 1.4, 0.6, 0.95, 0.28
"""Room above and below the panels and between them, height of a bar [inch]."""
LEAST = 1.25
"""Least height of a panel [inch]."""


@dataclass(frozen=True, kw_only=True)
class SensitivityPanel:
    """An output.

    Attributes:
        name: Its name, with its unit.
        groups: Groups of inputs.
        first: First-order indices, ``(num_groups,)``.
        first_interval: Ends of their intervals, ``(num_groups, 2)``.
        total: Total indices, ``(num_groups,)``.
        total_interval: Ends of their intervals, ``(num_groups, 2)``.
        x: The input that counts most, ``(num_samples,)``.
        x_label: What it is called, with its unit.
        y: The output, ``(num_samples,)``.
        interval: Ends of its 95 % interval, and its median between them.
        text: How the indices were found.
    """

    name: str
    groups: Sequence[str]
    first: Array
    first_interval: Array
    total: Array
    total_interval: Array
    x: Array
    x_label: str
    y: Array
    interval: tuple[float, float, float]
    text: str


def sensitivity_picture(
    path: Path, panels: Sequence[SensitivityPanel], *, title: str = "", caption: str = ""
) -> Path:
    """Draw a row for each output: Sobol indices with intervals, and the samples over the strongest input.

    Args:
        path: The picture, PNG or PDF.
        panels: The outputs.
        title: Heading.
        caption: Second line under it.

    Returns:
        The path.
    """
    row = max(LEAST, BAR * 2 * max(len(panel.groups) for panel in panels) / 1.5)
    height = HEAD + len(panels) * row + (len(panels) - 1) * GAP + FOOT
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.2, height), dpi=160, facecolor="white")
        ends = {"top": 1 - HEAD / height, "bottom": FOOT / height, "left": 0.17, "right": 0.97}
        grid = figure.add_gridspec(
            len(panels), 2, hspace=GAP / row, wspace=0.32, width_ratios=(1.25, 1.0), **ends
        )
        for k, panel in enumerate(panels):
            _draw_bars(figure.add_subplot(grid[k, 0]), panel, last=k == len(panels) - 1)
            _draw_samples(figure.add_subplot(grid[k, 1]), panel)
        headings(figure, title, caption)
        _key(figure, height)
        return saved(figure, path)


def _draw_bars(axes: Axes, panel: SensitivityPanel, *, last: bool) -> None:
    order = np.argsort(panel.total)
    rows = np.arange(len(order))
    kinds: Mapping[str, Any] = {
        "total": (panel.total, panel.total_interval, -0.19, LINES[5]),
        "first": (panel.first, panel.first_interval, 0.19, LINES[0]),
    }
    for values, ends, place, colour in kinds.values():
        shown = values[order]
        about = np.abs(ends[order].T - shown)
        axes.barh(rows + place, shown, 0.36, color=colour, zorder=2)
        bars = {"ecolor": INK, "elinewidth": 1.0, "capsize": 2.0, "zorder": 3}
        axes.errorbar(shown, rows + place, xerr=about, fmt="none", **bars)
    axes.set_yticks(rows, [panel.groups[k] for k in order])
    axes.set_xlim(-0.02, 1.1)
    axes.set_title(typeset(panel.name), fontsize=9.5, loc="left", pad=16)
    axes.annotate(panel.text, (0.0, 1.03), xycoords="axes fraction", fontsize=8, color=MUTED, va="bottom")
    plain(axes)
    axes.grid(axis="y", visible=False)
    axes.tick_params(labelsize=8.5)
    if last:
        axes.set_xlabel("part of the variance", fontsize=9)


def _draw_samples(axes: Axes, panel: SensitivityPanel) -> None:
    low, median, high = panel.interval
    axes.axhspan(low, high, color=LINES[4], alpha=0.18, linewidth=0, zorder=1)
    axes.axhline(median, color=LINES[4], linewidth=1.2, zorder=2)
    size = 10.0 if len(panel.x) < 400 else 3.0
    axes.scatter(panel.x, panel.y, s=size, color=LINES[0], linewidths=0, alpha=0.6, zorder=3)
    axes.set_xlabel(re.sub(r"\^(-?\d)", r"$^{\1}$", panel.x_label), fontsize=9)
    spread = f"{median:.4g} ({low:.4g} to {high:.4g})"
    axes.set_title(spread.replace("-", "\N{MINUS SIGN}"), fontsize=9, loc="left", pad=5, color=INK)
    plain(axes)
    axes.tick_params(labelsize=8.5)
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.yaxis.set_major_locator(MaxNLocator(4, min_n_ticks=3))
    axes.margins(x=0.04, y=0.1)


def _key(figure: Figure, height: float) -> None:
    """Say what the colours are."""
    from matplotlib.patches import Patch

    handles = [
        Patch(color=LINES[5], label="total"),
        Patch(color=LINES[0], label="first order"),
        Patch(color=LINES[4], alpha=0.3, label="median and 95 % of the output"),
    ]
    options = {"frameon": False, "fontsize": 8.5, "ncols": 3, "loc": "upper left", "borderaxespad": 0.0}
    figure.legend(handles=handles, bbox_to_anchor=(0.055, 1 - 0.66 / height), **options)
