"""Pictures: the deformed solid over the flow, and histories against their references."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure

from valvefsi.io.folder import replacing
from valvefsi.post.columns import LAB, Units
from valvefsi.post.plots.paper import for_paper, save_for_paper
from valvefsi.post.plots.ticks import length_axes, tick_texts
from valvefsi.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INK, MUTED, GRID = "#1b2733", "#5b6b7a", "#dfe5ea"
LINES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Okabe and Ito's colours, told apart by colour-blind readers."""
BARS = ("#56b4e9", "#e69f00", "#7fc9ae", "#d9a3c4", "#f0e442", "#8fa9bf", "#d98f5c", "#c9d3db")
FLOW = LinearSegmentedColormap.from_list("flow", ["#ffffff", "#e3ebf1", "#bccddb", "#8fa9bf"])
PRESSURE = LinearSegmentedColormap.from_list("pressure", ["#8d7bb0", "#fbfaf8", "#d9a25f"])
DILATION = LinearSegmentedColormap.from_list(
    "dilation", ["#a3212d", "#d9604d", "#f3b59a", "#f7f5f3", "#a3cbe2", "#4a90c2", "#1f5a99"]
)
"""Red where compressed, blue where dilated, near white at J = 1."""
CORNERS = {5: 3, 9: 4, 22: 3, 28: 4, 69: 3, 70: 4}
"""Corners of the plane cells of VTK, the first nodes of each."""
POWERS = str.maketrans("-0123456789", "\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079")
SEEN = 0.012
"""Width of a band over the length of an axis, above which it can be seen beside a line."""
PART = 0.1
"""Part of a line along which its band must be seen."""
STYLE = {
    "font.family": "sans-serif",
    "font.size": 10.0,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.8,
    "axes.titlecolor": INK,
    "text.color": INK,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
}


@dataclass(frozen=True, kw_only=True)
class PlaneFlow:
    """The flow in a plane, in cell centres.

    Attributes:
        x: Centres along the first axis, ``(nx,)`` [cm].
        y: Centres along the second axis, ``(ny,)`` [cm].
        u: First component of the velocity, ``(nx, ny)`` [cm/s].
        v: Second component of the velocity, ``(nx, ny)`` [cm/s].
        pressure: Pressure, drawn in place of the speed if given, ``(nx, ny)`` [dyn/cm^2].
    """

    x: Array
    y: Array
    u: Array
    v: Array
    pressure: Array | None = None


@dataclass(frozen=True, kw_only=True)
class PlaneSolid:
    """A deformed solid in the plane, as `Structure.cells_on_root` gives it.

    Attributes:
        points: Positions of the nodes, ``(num_nodes, 2 or 3)`` [cm].
        cells: Nodes of the cells, ``(num_cells, k)``, by VTK cell type.
        J: det F of each cell, ``(num_cells,)``.
        outline: Reference outline, closed, ``(n, 2)`` [cm]; drawn dashed if given.
    """

    points: Array
    cells: Mapping[int, Array]
    J: Array
    outline: Array | None = None

    @property
    def polygons(self) -> list[Array]:
        """Corners of each cell."""
        return [
            self.points[nodes[:, : CORNERS[int(kind)]], :2]
            for kind, nodes in self.cells.items()
            if len(nodes)
        ]


@dataclass(frozen=True, kw_only=True)
class Series:
    """One panel of a history.

    Attributes:
        label: What it shows, with its unit.
        lines: Values over time by name, one array each.
        reference: A value to compare with.
        reference_label: Where that value is from.
    """

    label: str
    lines: Mapping[str, Sequence[float] | Array]
    reference: float | None = None
    reference_label: str = "reference"


def flow_and_solid(
    path: Path,
    flow: PlaneFlow,
    solids: Sequence[PlaneSolid],
    *,
    title: str = "",
    caption: str = "",
    units: Units = LAB,
) -> Path:
    """Draw deformed solids, coloured by J, over the flow.

    Args:
        path: The picture, PNG or PDF.
        flow: The flow.
        solids: The solids.
        title: Heading.
        caption: Second line under it.
        units: Units of the lengths.

    Returns:
        The path.
    """
    with mpl.rc_context(STYLE):
        extent = (*_ends(flow.x), *_ends(flow.y))
        ratio = (extent[3] - extent[2]) / (extent[1] - extent[0])
        width, left, share = 7.6, 0.1, 0.83
        tall = share * width * ratio
        height = tall + 2.15
        figure = Figure(figsize=(width, height), dpi=160, facecolor="white")
        bottom = 1.4 / height
        axes = figure.add_axes((left, bottom, share, tall / height))
        bars = [_draw_flow(axes, flow, extent), *_draw_solids(axes, solids)]
        axes.set(xlim=extent[:2], ylim=extent[2:])
        length_axes(axes, units)
        axes.set_aspect("equal")
        span = (share - 0.09) / 2
        for number, (mappable, label) in enumerate(bars):
            place = (left + number * (span + 0.09), 0.58 / height, span, 0.12 / height)
            _bar(figure, place, mappable, label)
        _headings(figure, left, bottom + tall / height, title, caption, height)
        return saved(figure, path)


class ShownFigure(Figure):  # type: ignore[misc]  # matplotlib has no annotations here
    """A figure that a notebook shows by itself, whether pyplot was imported or not."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png")
        return buffer.getvalue()


def histories(
    path: Path, t: Sequence[float], series: Sequence[Series], *, title: str = "", caption: str = ""
) -> Path:
    """Draw histories into a file, see `history_figure`.

    Args:
        path: The picture, PNG or PDF.
        t: Times [s].
        series: The panels.
        title: Heading.
        caption: Second line under it.

    Returns:
        The path.
    """
    return saved(history_figure(t, series, title=title, caption=caption), path)


def history_figure(
    t: Sequence[float] | Array, series: Sequence[Series], *, title: str = "", caption: str = ""
) -> ShownFigure:
    """Draw histories one under the other, each with the reference it is compared with.

    Args:
        t: Times [s].
        series: The panels.
        title: Heading.
        caption: Second line under it.
    """
    with mpl.rc_context(STYLE):
        height = 2.35 * len(series) + 1.15
        figure = ShownFigure(figsize=(7.6, height), dpi=160, facecolor="white")
        top = 1 - 0.78 / height
        panels = figure.subplots(len(series), 1, sharex=True, squeeze=False)[:, 0]
        figure.subplots_adjust(left=0.13, right=0.84, top=top, bottom=0.5 / height, hspace=0.16)
        for axes, panel in zip(panels, series, strict=True):
            _draw_history(axes, np.asarray(t), panel)
        panels[-1].set_xlabel("t [s]")
        figure.align_ylabels(panels)
        _headings(figure, 0.13, top, title, caption, height)
    return figure


def phase_bars(
    path: Path, steps: Mapping[str, Mapping[str, float]], *, title: str = "Where a step goes"
) -> Path:
    """Draw how the time of a step divides into its phases, one bar for each run.

    Args:
        path: The picture, PNG or PDF.
        steps: Time of each phase by name, by name of the run [ms].
        title: Heading.

    Returns:
        The path.
    """
    with mpl.rc_context(STYLE):
        height = 0.52 * len(steps) + 1.9
        figure = Figure(figsize=(7.6, height), dpi=160, facecolor="white")
        axes = figure.add_axes((0.11, 1.0 / height, 0.75, 0.52 * len(steps) / height))
        names = list(dict.fromkeys(name for phases in steps.values() for name in phases))
        totals = np.array([sum(phases.values()) for phases in steps.values()])
        rows, left = np.arange(len(steps)), np.zeros(len(steps))
        for name, colour in zip(names, BARS * (len(names) // len(BARS) + 1), strict=False):
            times = np.array([phases.get(name, 0.0) for phases in steps.values()])
            share = 100 * times / np.where(totals > 0, totals, 1.0)
            axes.barh(rows, share, 0.62, left, color=colour, label=name, edgecolor="white", linewidth=1.2)
            for row in rows[share >= 7]:
                place = (left[row] + share[row] / 2, row)
                axes.annotate(f"{share[row]:.0f} %", place, ha="center", va="center", fontsize=8.5)
            left += share
        for row, total in zip(rows, totals, strict=True):
            axes.annotate(f"{total:.3g} ms", (101.5, row), va="center", annotation_clip=False)
        axes.set(xlim=(0, 100), ylim=(len(steps) - 0.5, -0.5), xlabel="share of a step [%]")
        axes.set_yticks(rows, [typeset(name) for name in steps])
        axes.tick_params(left=False)
        axes.spines[["top", "right", "left"]].set_visible(False)
        figure.legend(
            loc="lower left", bbox_to_anchor=(0.1, 0.0), ncols=min(len(names), 4), frameon=False, fontsize=8.5
        )
        _headings(figure, 0.11, 1.0 / height + 0.52 * len(steps) / height - 0.1 / height, title, "", height)
        return saved(figure, path)


def _draw_flow(axes: Axes, flow: PlaneFlow, extent: tuple[float, ...]) -> tuple[ScalarMappable, str]:
    """Draw speed or pressure as a background, and streamlines whose width follows the speed."""
    speed = np.hypot(flow.u, flow.v)
    largest = float(speed.max())
    image = {"origin": "lower", "extent": extent, "interpolation": "bilinear", "zorder": 0}
    if flow.pressure is None:
        shown = (
            axes.imshow(speed.T, cmap=FLOW, vmin=0.0, vmax=round_up(largest), **image),
            "fluid speed [cm/s]",
        )
    else:
        reach = round_up(float(np.abs(flow.pressure).max()))
        background = axes.imshow(flow.pressure.T, cmap=PRESSURE, vmin=-reach, vmax=reach, **image)
        shown = (background, "pressure [dyn/cm$^2$]")
    if largest > 0:
        widths = 0.25 + 1.1 * np.sqrt(speed.T / largest)
        options = {"density": 1.5, "arrowsize": 0.7, "color": "#3d5a73", "zorder": 1}
        lines = axes.streamplot(flow.x, flow.y, flow.u.T, flow.v.T, linewidth=widths, **options)
        lines.lines.set_alpha(0.75)
    return shown


def _draw_solids(axes: Axes, solids: Sequence[PlaneSolid]) -> list[tuple[ScalarMappable, str]]:
    """Draw the cells coloured by J; 1 is at the middle of the scale."""
    if not solids:
        return []
    reach = max(round_up(max(float(np.abs(solid.J - 1).max()) for solid in solids)), 1e-3)
    scale = ScalarMappable(Normalize(1 - reach, 1 + reach), DILATION)
    for solid in solids:
        ends = np.cumsum([len(polygons) for polygons in solid.polygons])[:-1]
        for polygons, J in zip(solid.polygons, np.split(solid.J, ends), strict=True):
            cells = PolyCollection(polygons, array=J, cmap=scale.cmap, norm=scale.norm, zorder=3)
            cells.set(edgecolor="#1b273366", linewidth=0.35)
            axes.add_collection(cells)
        if solid.outline is not None:
            axes.plot(*np.asarray(solid.outline).T, color=INK, linewidth=1.0, dashes=(4, 3), zorder=4)
    return [(scale, "$J = \\det F$, mean of each cell [-]")]


def round_up(value: float) -> float:
    """Return the next number of the kind 1, 1.2, 1.6, 2, 3, 4, 5, 6, 8 times a power of ten; 1 for 0."""
    if not value > 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    steps = (1, 1.2, 1.6, 2, 3, 4, 5, 6, 8, 10)
    return float(next(k * power for k in steps if k * power >= value * (1 - 1e-9)))


def _draw_history(axes: Axes, t: Array, panel: Series) -> None:
    if panel.reference is not None:
        axes.axhline(panel.reference, color=INK, linewidth=1.1, dashes=(5, 3), zorder=2)
        text = f"{panel.reference_label}\n{panel.reference:.5g}"
        axes.annotate(
            text, (1.015, panel.reference), xycoords=("axes fraction", "data"), va="center", fontsize=8.5
        )
    for (name, values), colour in zip(panel.lines.items(), LINES, strict=False):
        axes.plot(t, values, color=colour, linewidth=1.8, label=name, zorder=3, solid_capstyle="round")
    axes.set_ylabel(panel.label)
    plain(axes)
    axes.margins(x=0, y=0.12)
    if len(panel.lines) > 1:
        _legend_over_curves(axes, list(panel.lines))


def _legend_over_curves(axes: Axes, names: Sequence[str]) -> None:
    """Put the legend of a history into a strip of its axes that is added above the curves."""
    width, height = axes.get_position().size * axes.figure.get_size_inches()
    entry = 0.075 * max(map(len, names)) + 0.55  # inches, with the piece of line before the name
    columns = max(1, min(3, int(width / entry)))
    strip = (0.18 * math.ceil(len(names) / columns) + 0.05) / height
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + (high - low) * strip / (1.0 - strip))
    axes.legend(frameon=False, fontsize=8.5, ncols=columns, loc="upper left", borderaxespad=0.1)


def _bar(figure: Figure, place: tuple[float, ...], mappable: ScalarMappable, label: str) -> None:
    bar = figure.colorbar(mappable, cax=figure.add_axes(place), orientation="horizontal")
    bar.set_label(label, labelpad=3)
    bar.outline.set_visible(False)
    bar.ax.tick_params(length=2.5, labelsize=8.5)
    low, high = mappable.get_clim()
    ticks = np.linspace(low, high, 5)
    bar.set_ticks(ticks, labels=tick_texts(ticks))


def typeset(text: str) -> str:
    """Return a text with its powers, as in 64^3, cm^2 and cm**2, set as such."""
    return re.sub(r"(?:\^|\*\*)(-?\d+)", lambda found: found[1].translate(POWERS), text)


def can_be_seen(band: Array, values: Array, *, x: Array | None = None, frame: tuple[float, float]) -> bool:
    """Whether a band is wider than the line it lies about, over a tenth of the line at least.

    Args:
        band: Half its width along the ordinate, ``(n,)``.
        values: The line, ``(n,)``.
        x: Its abscissa, even if left out, ``(n,)``.
        frame: Lengths of the two axes as they are drawn, in units of the abscissa and the ordinate.

    Note:
        A steep line hides a band along the ordinate: what counts is its width across the line.
    """
    x = np.linspace(0.0, frame[0], len(values)) if x is None else np.asarray(x)
    steps = np.hypot(np.diff(x) / frame[0], np.diff(values) / frame[1])
    across = np.divide(np.abs(np.diff(x)) / frame[0], steps, out=np.ones_like(steps), where=steps > 0)
    wide = (band[1:] + band[:-1]) / frame[1] * across > SEEN
    return bool(steps[wide].sum() > PART * steps.sum())


def _headings(figure: Figure, x: float, top: float, title: str, caption: str, height: float) -> None:
    figure.text(x, top + 0.38 / height, typeset(title), fontsize=12.5, fontweight="bold", va="baseline")
    figure.text(x, top + 0.14 / height, typeset(caption), fontsize=9.5, color=MUTED, va="baseline")


def _ends(centres: Array) -> tuple[float, float]:
    """Return the ends of an axis from its cell centres."""
    half = (centres[1] - centres[0]) / 2
    return float(centres[0] - half), float(centres[-1] + half)


def plain(axes: Axes) -> None:
    """Give a plot a light grid behind its curves, and no frame above and to the right."""
    axes.grid(color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def legend_above(axes: Axes, columns: int = 4) -> None:
    """Put the legend of axes above them, to the right, where it covers no curve."""
    place = {"loc": "lower right", "bbox_to_anchor": (1.01, 0.99), "ncols": columns, "handlelength": 1.6}
    axes.legend(frameon=False, fontsize=8.5, labelcolor=MUTED, **place)


def draw_bar(axes: Axes, place: tuple[float, float], size: float, millimetre: float = 1.0) -> None:
    """Draw a scale bar of a round length of up to a quarter of a size, and say its length.

    Args:
        axes: Axes without a frame.
        place: Its left end.
        size: How far the body reaches, in units of the axes.
        millimetre: A millimetre in units of the axes.
    """
    wanted = 0.25 * size / millimetre
    power = 10.0 ** np.floor(np.log10(wanted))
    bar = max(k * power for k in (1.0, 2.0, 5.0, 10.0) if k * power <= wanted * (1 + 1e-9))
    (left, level), length = place, bar * millimetre
    axes.plot(
        [left, left + length], [level, level], color=INK, linewidth=2.2, solid_capstyle="butt", zorder=6
    )
    look = {"ha": "left", "va": "center", "fontsize": 8.5, "color": INK}
    axes.text(left + length + 0.015 * size, level, f"{bar:g} mm", **look)


def headings(figure: Figure, title: str, caption: str) -> None:
    """Put a heading and a line under it at the top left of a figure."""
    height = figure.get_figheight()
    figure.text(0.06, 1 - 0.34 / height, typeset(title), fontsize=12.5, fontweight="bold", va="baseline")
    figure.text(0.06, 1 - 0.57 / height, typeset(caption), fontsize=9.5, color=MUTED, va="baseline")


def saved(figure: Figure, path: Path) -> Path:
    """Write a figure, its folder too, and return where it is; for papers see `valvefsi.post.plots.paper`."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    if for_paper():
        return save_for_paper(figure, path)
    with replacing(path) as temporary:
        figure.savefig(temporary)
    return path
