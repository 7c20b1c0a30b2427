"""Pictures of series of immersed runs: histories over time, quantities over kernels and meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullLocator, ScalarFormatter

from valvefsi.post.plots.base import INK, LINES, MUTED, STYLE, plain, saved, typeset

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import ArrayLike

MANY = 8
"""Lines in a panel from which on one legend stands beside all panels."""


@dataclass(frozen=True, kw_only=True)
class Line:
    """One line of a panel.

    Attributes:
        label: Its name in the legend; "" for none.
        x: Abscissae.
        y: Ordinates.
        colour: Number of its colour.
        style: "-", "--", ":" or a marker such as "o-".
    """

    label: str
    x: ArrayLike
    y: ArrayLike
    colour: int = 0
    style: str = "-"


@dataclass(frozen=True, kw_only=True)
class Panel:
    """One panel.

    Attributes:
        lines: What is drawn.
        xlabel: Quantity and unit of the abscissa.
        ylabel: Quantity and unit of the ordinate.
        reference: A value to compare with.
        reference_label: Where it is from.
        log: Axes that are logarithmic, of "x" and "y".
        band: Lowest and highest accepted value.
    """

    lines: Sequence[Line]
    xlabel: str
    ylabel: str
    reference: float | None = None
    reference_label: str = ""
    log: str = ""
    band: tuple[float, float] | None = None


def panels(
    path: Path, shown: Sequence[Panel], *, title: str = "", caption: str = "", columns: int | None = None
) -> Path:
    """Draw panels under one heading.

    Args:
        path: The picture.
        shown: The panels, one or more.
        title: Heading.
        caption: Line under the heading.
        columns: Panels side by side; None for all in one row.

    Returns:
        The path.
    """
    many = max(len(panel.lines) for panel in shown) > MANY
    across = min(columns or len(shown), len(shown))
    rows = -(-len(shown) // across)
    width, height = 5.2 * across + (2.2 if many else 0.0), 4.4 + 3.9 * (rows - 1)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width, height), dpi=160, facecolor="white")
        every = figure.subplots(rows, across, squeeze=False).ravel()
        right, low, high = 1 - (2.4 if many else 0.15) / width, 0.57 / height, 1 - 0.84 / height
        figure.subplots_adjust(left=0.98 / width, right=right, top=high, bottom=low, wspace=0.34, hspace=0.25)
        for axes, panel in zip(every, shown, strict=False):
            _draw(axes, panel, legend=not many)
        for axes in every[len(shown) :]:
            axes.set_visible(False)
        if many:
            handles, labels = every[0].get_legend_handles_labels()
            figure.legend(handles, labels, loc="center right", frameon=False, fontsize=8)
        figure.text(0.03, 1 - 0.31 / height, typeset(title), fontsize=12.5, fontweight="bold", va="baseline")
        figure.text(0.03, 1 - 0.57 / height, typeset(caption), fontsize=9.5, color=MUTED, va="baseline")
        return saved(figure, path)


def _draw(axes: Axes, panel: Panel, *, legend: bool) -> None:
    if panel.band is not None:
        axes.axhspan(*panel.band, color="#e69f00", alpha=0.15, linewidth=0)
    if panel.reference is not None:
        label = panel.reference_label or None
        axes.axhline(panel.reference, color=INK, linewidth=1.0, dashes=(5, 3), label=label)
    for line in panel.lines:
        colour = LINES[line.colour % len(LINES)]
        axes.plot(
            np.asarray(line.x, dtype=float),
            np.asarray(line.y, dtype=float),
            line.style,
            color=colour,
            linewidth=1.4,
            markersize=4.5,
            label=line.label or None,
        )
    for axis in panel.log:
        getattr(axes, f"set_{axis}scale")("log")
    if "x" in panel.log:
        ticks = sorted({float(x) for line in panel.lines for x in np.ravel(np.asarray(line.x, dtype=float))})
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xticks(ticks, labels=[f"{x:g}" for x in ticks])
    else:
        axes.xaxis.set_major_locator(MaxNLocator(5))
    if "y" not in panel.log:
        axes.ticklabel_format(axis="y", scilimits=(-3, 4))
    elif axes.get_ylim()[1] < 10.0 * axes.get_ylim()[0]:  # less than a decade has no powers of ten in it
        axes.yaxis.set_major_locator(MaxNLocator(4))
        axes.yaxis.set_major_formatter(ScalarFormatter())
        axes.yaxis.set_minor_locator(NullLocator())
    axes.set_xlabel(panel.xlabel)
    axes.set_ylabel(panel.ylabel, fontsize=9)
    plain(axes)
    if legend and (panel.reference_label or any(line.label for line in panel.lines)):
        axes.legend(frameon=False, fontsize=8)
