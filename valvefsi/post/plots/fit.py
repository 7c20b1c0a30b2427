"""Pictures of fits: data, curve, confidence band and residuals block by block; profiles of the parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from scipy.interpolate import PchipInterpolator

from valvefsi.post.plots.base import INK, LINES, MUTED, STYLE, can_be_seen, plain, saved
from valvefsi.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.gridspec import SubplotSpec


@dataclass(frozen=True, kw_only=True)
class Curve:
    """Data and the fitted curve through them.

    Attributes:
        name: Name in the legend.
        x: Abscissa, ``(n,)``.
        data: Measured values, ``(n,)``.
        curve: Fitted values, ``(n,)``.
        band: Half the width of the confidence band, ``(n,)``; none if not given.
    """

    name: str
    x: Array
    data: Array
    curve: Array
    band: Array | None = None


@dataclass(frozen=True, kw_only=True)
class Block:
    """One panel: a protocol, or a cycle.

    Attributes:
        title: What it is.
        curves: What it shows.
        predicted: It was not fitted.
    """

    title: str
    curves: Sequence[Curve]
    predicted: bool = False


@dataclass(frozen=True, kw_only=True)
class ProfilePanel:
    """The profile of one parameter.

    Attributes:
        name: The parameter.
        unit: Its unit.
        values: Where it was held.
        costs: Least cost there, over the least of all.
        threshold: The cost where the interval ends, over the least of all.
        best: Value found.
        interval: Ends of the interval.
        verdict: What is said of it.
        log: Draw it on a logarithmic axis.
        bounds: Whether the lower and the upper end are bounds of the parameter, which a profile does not pass.
    """

    name: str
    unit: str
    values: Array
    costs: Array
    threshold: float
    best: float
    interval: tuple[float, float]
    verdict: str
    log: bool = False
    bounds: tuple[bool, bool] = (False, False)


def blocks_picture(
    path: Path, blocks: Sequence[Block], *, x_label: str, y_label: str, title: str = "", caption: str = ""
) -> Path:
    """Draw data, curves and bands, one panel for each block, and the residuals under each.

    Args:
        path: The picture, PNG or PDF.
        blocks: The panels.
        x_label: Abscissa with its unit.
        y_label: Ordinate with its unit.
        title: Heading.
        caption: Second line under it.

    Returns:
        The path.
    """
    with mpl.rc_context(STYLE):
        across = 1 if len(blocks) == 1 else 2 if len(blocks) in (2, 4) else 3 if len(blocks) < 7 else 4
        down = -(-len(blocks) // across)
        width, height = (7.6 if across < 3 else 3.1 * across + 0.6), 3.3 * down + 1.6
        figure = Figure(figsize=(width, height), dpi=150, facecolor="white")
        places = figure.add_gridspec(
            down,
            across,
            left=0.85 / width,
            right=1 - 0.2 / width,
            top=1 - 1.3 / height,
            bottom=0.55 / height,
            wspace=0.16,
            hspace=0.28,
        )
        values = [np.concatenate([c.data, c.curve]) for block in blocks for c in block.curves]
        errors = [c.curve - c.data for block in blocks for c in block.curves]
        limits = (
            min(v.min() for v in values),
            max(v.max() for v in values),
            max(np.abs(e).max() for e in errors),
        )
        for number, block in enumerate(blocks):
            row, column = divmod(number, across)
            upper, lower = _panel(figure, places[row, column], block, limits)
            if column == 0:
                upper.set_ylabel(y_label)
                lower.set_ylabel(f"residual\n{y_label[y_label.find('[') :]}", fontsize=8.5)
                figure.align_ylabels([upper, lower])
            else:
                upper.tick_params(labelleft=False)
                lower.tick_params(labelleft=False)
            if number + across >= len(blocks):
                lower.set_xlabel(x_label)
        _legend(figure, blocks)
        figure.text(0.75 / width, 1 - 0.36 / height, title, fontsize=12.5, fontweight="bold", va="baseline")
        figure.text(0.75 / width, 1 - 0.6 / height, caption, fontsize=9.5, color=MUTED, va="baseline")
        return saved(figure, path)


def profiles_picture(
    path: Path, panels: Sequence[ProfilePanel], *, title: str = "", caption: str = ""
) -> Path:
    """Draw how the least cost grows as each parameter is moved, with the interval it leaves.

    Args:
        path: The picture, PNG or PDF.
        panels: The parameters.
        title: Heading.
        caption: Second line under it.

    Returns:
        The path.
    """
    with mpl.rc_context(STYLE):
        across = min(len(panels), 4 if len(panels) != 6 else 3)
        down = -(-len(panels) // across)
        width, height = max(2.9 * across + 0.7, 6.4), 2.7 * down + 1.0
        figure = Figure(figsize=(width, height), dpi=150, facecolor="white")
        grid = figure.subplots(down, across, squeeze=False)
        figure.subplots_adjust(
            left=0.95 / width,
            right=1 - 0.2 / width,
            top=1 - 1.15 / height,
            bottom=0.6 / height,
            wspace=0.3,
            hspace=0.6,
        )
        for axes in grid.ravel()[len(panels) :]:
            axes.set_visible(False)
        for number, (axes, panel) in enumerate(zip(grid.ravel(), panels, strict=False)):
            _profile(axes, panel)
            if number % across == 0:
                axes.set_ylabel("cost / least cost")
        figure.text(0.95 / width, 1 - 0.36 / height, title, fontsize=12.5, fontweight="bold", va="baseline")
        figure.text(0.95 / width, 1 - 0.6 / height, caption, fontsize=9.5, color=MUTED, va="baseline")
        return saved(figure, path)


def _panel(
    figure: Figure, place: SubplotSpec, block: Block, limits: tuple[float, float, float]
) -> tuple[Axes, Axes]:
    """Draw one block: the curves above, the residuals below."""
    inner = place.subgridspec(2, 1, height_ratios=(3.2, 1), hspace=0.08)
    upper = figure.add_subplot(inner[0])
    lower = figure.add_subplot(inner[1], sharex=upper)
    for curve, colour in zip(block.curves, LINES, strict=False):
        step, marks = max(len(curve.x) // 60, 1), {"markersize": 3.2, "alpha": 0.55, "markeredgewidth": 0}
        said = f"{curve.name}, data"
        upper.plot(curve.x[::step], curve.data[::step], "o", color=colour, label=said, **marks)
        if curve.band is not None and np.isfinite(curve.band).all():
            low, high, said = curve.curve - curve.band, curve.curve + curve.band, f"{curve.name}, 95 % band"
            upper.fill_between(curve.x, low, high, color=colour, alpha=0.22, linewidth=0, label=said)
        dashes = {"dashes": (4, 2)} if block.predicted else {}
        upper.plot(curve.x, curve.curve, color=colour, linewidth=1.7, label=curve.name, **dashes)
        left = curve.curve - curve.data
        lower.plot(curve.x, left, color=colour, linewidth=1.2, label=f"{curve.name}, residual")
    lower.axhline(0, color=MUTED, linewidth=0.8, label="zero")
    said = f"{block.title} (predicted)" if block.predicted else block.title
    upper.set_title(said, fontsize=10, loc="left", pad=4)
    spread = limits[1] - limits[0]
    upper.set_ylim(limits[0] - 0.05 * spread, limits[1] + 0.06 * spread)
    lower.set_ylim(-1.1 * limits[2] - 1e-300, 1.1 * limits[2] + 1e-300)
    upper.tick_params(labelbottom=False)
    lower.locator_params(axis="y", nbins=3)
    lower.locator_params(axis="x", nbins=5)
    for axes in (upper, lower):
        plain(axes)
    return upper, lower


def _legend(figure: Figure, blocks: Sequence[Block]) -> None:
    """Say once what the colours and marks mean."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    names = list(dict.fromkeys(curve.name for block in blocks for curve in block.curves))
    handles = [
        Line2D([], [], color=colour, linewidth=2, label=name)
        for name, colour in zip(names, LINES, strict=False)
    ]
    handles.append(Line2D([], [], color=MUTED, marker="o", linestyle="none", markersize=4, label="data"))
    curves = [curve for block in blocks for curve in block.curves]
    if any(curve.band is not None for curve in curves):
        height = float(np.ptp(np.concatenate([curve.curve for curve in curves])))
        seen = any(_seen(block, curve, height) for block in blocks for curve in block.curves)
        said = "95 % band of the curve" if seen else "95 % band, narrower than the line"
        handles.append(Patch(color=MUTED, alpha=0.3, label=said))
    if any(block.predicted for block in blocks):
        handles.append(
            Line2D([], [], color=MUTED, dashes=(4, 2), linewidth=1.7, label="predicted, not fitted")
        )
    width, height = figure.get_size_inches()
    place = (1 - 0.2 / width, 1 - 0.66 / height)
    figure.legend(
        handles=handles, loc="upper right", bbox_to_anchor=place, ncols=5, frameon=False, fontsize=8.5
    )


def _seen(block: Block, curve: Curve, height: float) -> bool:
    """Whether the band of a curve can be seen in its panel, whose ordinate is of some length."""
    if curve.band is None or not np.isfinite(curve.band).all():
        return False
    x = np.concatenate([each.x for each in block.curves])
    return can_be_seen(curve.band, curve.curve, x=curve.x, frame=(float(np.ptp(x)), height))


def _profile(axes: Axes, panel: ProfilePanel) -> None:
    """Draw one profile, cut a little above the threshold."""
    if panel.log:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(mpl.ticker.LogLocator(subs=(1, 2, 5), numticks=6))
        axes.xaxis.set_major_formatter(mpl.ticker.FuncFormatter(lambda value, _: f"{value:.7g}"))
        axes.xaxis.set_minor_locator(mpl.ticker.NullLocator())
    else:
        axes.locator_params(axis="x", nbins=5)
    axes.axvspan(*panel.interval, color=LINES[5], alpha=0.22, linewidth=0)
    for end, is_bound in zip(panel.interval, panel.bounds, strict=True):
        if is_bound:
            axes.axvline(end, color=MUTED, linewidth=1.2, dashes=(1, 1.5), label="bound")
    axes.axhline(panel.threshold, color=INK, linewidth=1.0, dashes=(4, 3), label="95 % threshold")
    axes.plot(*_between(panel), color=LINES[0], linewidth=1.7, label="profile")
    axes.plot(panel.values, panel.costs, "o", color=LINES[0], markersize=3.2, label="computed")
    axes.plot(panel.best, 1.0, "D", color=LINES[1], markersize=5.5, zorder=4, label="best")
    top = 1 + 1.7 * (panel.threshold - 1)
    axes.set_ylim(1 - 0.12 * (top - 1), top)
    low, high = panel.interval
    inside = panel.values[panel.costs <= top]
    low, high = min(low, inside.min(initial=low)), max(high, inside.max(initial=high))
    if panel.log and low > 0 and high > low:
        room = (high / low) ** 0.12
        axes.set_xlim(low / room, high * room)
        if high / low > 100:
            axes.xaxis.set_major_locator(mpl.ticker.LogLocator(subs=(1,), numticks=5))
            axes.xaxis.set_major_formatter(mpl.ticker.LogFormatterMathtext())
        elif high / low < 8:
            axes.xaxis.set_major_locator(mpl.ticker.MaxNLocator(3))
    elif high > low:
        axes.set_xlim(low - 0.12 * (high - low), high + 0.12 * (high - low))
    unit = "" if panel.unit == "-" else f" [{panel.unit}]"
    axes.set_title(f"{panel.name}{unit}", fontsize=10.5, loc="left", pad=16)
    axes.annotate(
        panel.verdict, (0, 1.03), xycoords="axes fraction", fontsize=8.5, color=MUTED, annotation_clip=False
    )
    axes.ticklabel_format(axis="y", useOffset=False)
    plain(axes)


def _between(panel: ProfilePanel) -> tuple[Array, Array]:
    """Return the profile between the points where it was computed: the root of the rise is nearly a straight line."""
    x = np.log(panel.values) if panel.log else panel.values
    best = np.log(panel.best) if panel.log else panel.best
    order = np.unique(x, return_index=True)[1]
    x, costs = x[order], panel.costs[order]
    least = min(float(costs.min()), 1.0)
    root = np.sign(x - best) * np.sqrt(np.maximum(costs - least, 0.0))
    if len(x) < 3 or not np.isfinite(root).all():
        return panel.values, panel.costs
    fine = np.unique(np.concatenate([np.linspace(x[0], x[-1], 200), x]))
    return np.exp(fine) if panel.log else fine, least + PchipInterpolator(x, root)(fine) ** 2
