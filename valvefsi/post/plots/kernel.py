"""The picture of the kernel study: maps of a measure over kernels and ratios of mesh to grid."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from valvefsi.post.plots.base import INK, MUTED, STYLE, saved

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WORSE = LinearSegmentedColormap.from_list("worse", ["#2f7fb5", "#a3cbe2", "#f7f5f3", "#f3b59a", "#c2452d"])
"""Blue where small, red where large."""
BROKEN = "#e4e7ea"
CELL, ROW, LEFT, GAP, HEAD, NARROWEST = 0.6, 0.3, 2.0, 0.35, 1.05, 2.4
"""Width and height of a cell, room for names, between panels, above rows of panels, least width of a panel [inch]."""


@dataclass(frozen=True, kw_only=True)
class HeatMap:
    """One map.

    Attributes:
        title: Its heading.
        values: The measure by row and column, None where the run broke down.
        leaks: Which runs leak, by row and column.
        label: Quantity and unit.
        limits: Values that have the first and the last colour, on a logarithmic scale.
    """

    title: str
    values: Sequence[Sequence[float | None]]
    leaks: Sequence[Sequence[bool]]
    label: str
    limits: tuple[float, float]


def heat_maps(
    path: Path,
    panels: Mapping[str, Sequence[HeatMap]],
    *,
    rows: Sequence[str],
    columns: Sequence[float],
    title: str = "Kernels, ratios of mesh to grid, couplings, stabilisation",
) -> Path:
    """Draw rows of maps, each row under its heading.

    Args:
        path: The picture.
        panels: The maps of each row by its heading.
        rows: Names of the kernels.
        columns: The ratios.
        title: Heading of the picture.

    Returns:
        The path.
    """
    count = max(len(maps) for maps in panels.values())
    wide, high = max(CELL * len(columns), NARROWEST), ROW * len(rows)
    width = max(LEFT + count * (wide + GAP), 6.5)
    height = 0.75 + len(panels) * (high + HEAD) + 0.15
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width, height), dpi=150, facecolor="white")
        figure.text(0.15 / width, 1 - 0.35 / height, title, fontsize=13, fontweight="bold", va="baseline")
        note = "across: element size over grid spacing; framed: leaks; x: broke down; colours logarithmic"
        figure.text(0.15 / width, 1 - 0.6 / height, note, fontsize=10, color=MUTED, va="baseline")
        top = 0.75
        for heading, maps in panels.items():
            place = 1 - (top + 0.32) / height
            figure.text(0.15 / width, place, heading, fontsize=11, fontweight="bold", va="baseline")
            for k, shown in enumerate(maps):
                left, bottom = LEFT + k * (wide + GAP), top + HEAD - 0.25 + high
                box = (left / width, 1 - bottom / height, wide / width, high / height)
                _draw(figure.add_axes(box), shown, rows if k == 0 else None, columns)
            top += high + HEAD
        return saved(figure, path)


def _draw(axes: Axes, shown: HeatMap, rows: Sequence[str] | None, columns: Sequence[float]) -> None:
    values = np.array([[np.nan if v is None else abs(v) for v in line] for line in shown.values], dtype=float)
    norm = LogNorm(*shown.limits, clip=True)
    axes.imshow(
        np.ma.masked_invalid(np.maximum(values, shown.limits[0])),
        norm=norm,
        cmap=WORSE.with_extremes(bad=BROKEN),
        aspect="auto",
    )
    for (i, j), value in np.ndenumerate(values):
        text = _short(value) if np.isfinite(value) else "x"
        share = float(norm(max(value, shown.limits[0]))) if np.isfinite(value) else 0.5
        colour = "white" if share in (0.0, 1.0) or abs(share - 0.5) > 0.42 else INK
        axes.text(j, i, text, ha="center", va="center", fontsize=9, color=colour)
        if shown.leaks[i][j]:
            axes.add_patch(Rectangle((j - 0.46, i - 0.44), 0.92, 0.88, fill=False, ec=INK, lw=1.2))
    axes.set_xticks(range(len(columns)), labels=[f"{x:g}" for x in columns], fontsize=9)
    axes.set_yticks(range(len(values)), labels=rows if rows is not None else [], fontsize=9.5)
    axes.tick_params(length=0, pad=2)
    axes.spines[:].set_visible(False)
    axes.set_title(f"{shown.title}\n{shown.label}", fontsize=9.5, loc="left", pad=3)


def _short(value: float) -> str:
    """Return a value in two digits and few characters."""
    if value == 0 or 0.0095 <= value < 1000:
        return f"{value:.2g}" if value < 100 else f"{value:.0f}"
    mantissa, exponent = f"{value:.0e}".split("e")
    return f"{mantissa}e{int(exponent)}"
