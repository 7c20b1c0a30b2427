"""Several runs beside one another at the same instants, as in the figures of Lee2020's supplement (S6 to S19)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure

from valvefsi.post.plots.base import INK, LINES, MUTED, STYLE, plain, saved
from valvefsi.post.plots.valve_comparison import LABELS
from valvefsi.post.plots.valve_waveform import draw_end_view
from valvefsi.post.slices import Slice, scale_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from valvefsi.types import Array

MARGIN, HEAD, NAMES, BAR, ROOM = 0.15, 0.85, 0.55, 0.75, 0.55
"""Inches: around a figure, for its headings, for the names of rows, for a colour bar, between two profiles."""
AREA = 1.6
"""Height of the open areas above leaflets [inch]."""
ROOT = 0.4
"""Power of a stress that goes with its colour: it is large in the shut valve only."""
HEAT = mpl.colormaps["viridis"]


@dataclass(frozen=True, kw_only=True)
class Wave:
    """One run's or a record's waveforms over a cycle.

    Attributes:
        name: What it is called.
        t: Times, ``(n,)`` [s].
        values: Waveforms by quantity, see `valvefsi.post.plots.valve_comparison.LABELS`, ``(n,)``.
        deviations: Standard deviations of a record, ``(n,)``.
        measured: Whether it is a record.
    """

    name: str
    t: Array
    values: Mapping[str, Array]
    deviations: Mapping[str, Array] = field(default_factory=dict)
    measured: bool = False


@dataclass(frozen=True, kw_only=True)
class PlanePanel:
    """A field in a plane at an instant.

    Attributes:
        t: Time in the cycle [s].
        found: The field.
        solids: Where the plane cuts solids, segments ``(2, 2)`` each [cm].
        lines: Dashed lines, ``(2, 2)`` each [cm].
    """

    t: float
    found: Slice
    solids: Sequence[Array] = ()
    lines: Sequence[Array] = ()


def waves_figure(
    path: Path, waves: Sequence[Wave], quantities: Sequence[str], *, title: str, caption: str
) -> Path:
    """Draw waveforms of runs and a record over one another, one panel for each quantity."""
    across = min(len(quantities), 2)
    down = -(-len(quantities) // across)
    with mpl.rc_context(STYLE):
        head = HEAD + 0.15 * caption.count("\n")
        height = 2.7 * down + head + 0.75
        figure = Figure(figsize=(4.7 * across + 0.3, height), dpi=160, facecolor="white")
        axes = np.ravel(figure.subplots(down, across, squeeze=False, sharex=True))
        figure.subplots_adjust(
            0.16 / across, 0.55 / height, 0.985, 1 - (head + 0.2) / height, wspace=0.25, hspace=0.12
        )
        for panel, quantity in zip(axes, quantities, strict=False):
            wave_panel(panel, waves, quantity)
        for panel in axes[len(quantities) - across : len(quantities)]:
            panel.set_xlabel("t in the cycle [s]")
        for panel in axes[len(quantities) :]:
            panel.set_axis_off()
        _legend(figure, axes[0], (head - 0.2) / height)
        _headings(figure, 0.16 / across, title, caption)
        return saved(figure, path)


def wave_panel(axes: Axes, waves: Sequence[Wave], quantity: str) -> None:
    """Draw one quantity of all that have it."""
    label, unit = LABELS[quantity]
    colours = iter(LINES)
    for wave in waves:
        colour = INK if wave.measured else next(colours, MUTED)
        if quantity not in wave.values:
            continue
        y = wave.values[quantity] / unit
        if quantity in wave.deviations:
            band = 2.0 * wave.deviations[quantity] / unit
            axes.fill_between(wave.t, y - band, y + band, color=INK, alpha=0.18, linewidth=0)
        axes.plot(wave.t, y, color=colour, linewidth=1.5, label=wave.name)
    axes.set_ylabel(label)
    axes.margins(x=0, y=0.08)
    plain(axes)


def _legend(figure: Figure, axes: Axes, top: float) -> None:
    where = {"loc": "upper right", "bbox_to_anchor": (0.99, 1 - top)}
    figure.legend(*axes.get_legend_handles_labels(), frameon=False, fontsize=8.5, ncols=4, **where)


def plane_rows(
    path: Path, rows: Mapping[str, Sequence[PlanePanel | None]], *, label: str, title: str, caption: str
) -> Path:
    """Draw a field in a plane, a row for each run and a column for each instant, on one scale.

    Args:
        path: The picture.
        rows: Panels of each run by its name, None where it has no frame.
        label: Name and unit of the field.
        title: Heading.
        caption: Second line under it.
    """
    panels = [panel for row in rows.values() for panel in row if panel is not None]
    limits = scale_of(np.concatenate([panel.found.values.ravel() for panel in panels]))
    across, tall = np.ptp(panels[0].found.x), np.ptp(panels[0].found.y)
    columns = max(len(row) for row in rows.values())
    size = (1.5, 1.5 * tall / across)
    with mpl.rc_context(STYLE):
        figure, grid = _table(len(rows), columns, size, list(rows))
        mappable = None
        for axes_row, row in zip(grid, rows.values(), strict=True):
            for axes, panel in zip(axes_row, row, strict=False):
                if panel is None:
                    axes.text(0.5, 0.5, "no frame", ha="center", va="center", color=MUTED, fontsize=8)
                    continue
                mappable = plane_panel(axes, panel, limits)
                axes.set_title(f"t = {1e3 * panel.t:.1f} ms", fontsize=8, pad=2)
        assert mappable is not None  # or there was no panel
        _bar(figure, mappable, label)
        _headings(figure, _inches(figure, MARGIN)[0], title, caption)
        return saved(figure, path)


def plane_panel(axes: Axes, panel: PlanePanel, limits: tuple[float, float]) -> Any:
    """Draw a field in a plane with the solids over it; return what a colour bar takes."""
    low, high = limits
    signed = low == -high
    ink = INK if signed else "white"
    found = panel.found
    look = {"cmap": "RdBu_r" if signed else "viridis", "vmin": low, "vmax": high, "rasterized": True}
    picture = axes.pcolormesh(found.x, found.y, found.values.T, **look)
    axes.add_collection(LineCollection(panel.solids, colors=ink, linewidths=0.6, zorder=3))
    axes.add_collection(LineCollection(panel.lines, colors=ink, linewidths=0.8, linestyles="--", zorder=4))
    axes.set(xlim=found.x[[0, -1]], ylim=found.y[[0, -1]], aspect="equal")
    return picture


def leaflet_rows(
    path: Path,
    rows: Mapping[str, Sequence[Mapping[str, Any] | None]],
    *,
    radius: float,
    title: str,
    caption: str,
    scale: tuple[float, float, str] | None = None,
    waves: Sequence[Wave] = (),
) -> Path:
    """Draw leaflets from downstream, a row for each run and part of the cycle, a column for each instant.

    Args:
        path: The picture.
        rows: Views of each row by its name, see `valvefsi.post.plots.valve_waveform.valve_end_views`; a view's
            ``values`` colour its triangles on the scale, its ``radius`` is that of its own orifice. None where there
            is no frame.
        radius: Radius of the orifice [cm].
        title: Heading.
        caption: Second line under it.
        scale: Ends and label of the scale of the values.
        waves: Open areas to draw above, none for none.
    """
    columns, above = (
        max(len(row) for row in rows.values()),
        AREA + 0.6 + 0.15 * caption.count("\n") if waves else 0.0,
    )
    views = [view for row in rows.values() for view in row if view is not None]
    widest = max(float(np.abs(np.asarray(view["xyz"])[:, :2]).max()) for view in views)
    reach = max(1.02 * widest, 1.1 * radius)
    colours = ScalarMappable(PowerNorm(ROOT, *scale[:2]), HEAT) if scale else None
    with mpl.rc_context(STYLE):
        figure, grid = _table(len(rows), columns, (1.45, 1.6), list(rows), above, bar=scale is not None)
        for axes_row, row in zip(grid, rows.values(), strict=True):
            for axes, view in zip(axes_row, row, strict=False):
                if view is None:
                    axes.text(0.5, 0.5, "no frame", ha="center", va="center", color=MUTED, fontsize=8)
                    continue
                shown = dict(view)
                if colours is not None:
                    shown["colours"] = colours.to_rgba(np.asarray(view["values"]))[:, :3]
                draw_end_view(axes, shown, float(view.get("radius", radius)), reach, small=True)
        if waves:
            _area_above(figure, waves, above)
        if colours is not None and scale is not None:
            _bar(figure, colours, scale[2])
        _headings(figure, _inches(figure, MARGIN)[0], title, caption)
        return saved(figure, path)


def _area_above(figure: Figure, waves: Sequence[Wave], above: float) -> None:
    """Draw the open areas over time above the rows."""
    width, height = figure.get_size_inches()
    bottom = height - HEAD - above + 0.5
    axes = figure.add_axes((0.75 / width, bottom / height, 1 - 1.0 / width, AREA / height))
    wave_panel(axes, waves, "pdva")
    axes.set_xlabel("t in the cycle [s]", fontsize=9)
    axes.legend(frameon=False, fontsize=8.5, loc="upper right")


def mean_flow_figure(
    path: Path,
    planes: Mapping[str, PlanePanel],
    profiles: Mapping[str, Mapping[str, tuple[Array, Array]]],
    *,
    labels: tuple[str, str],
    title: str,
    caption: str,
) -> Path:
    """Draw an averaged field in a plane of each run, and its profiles along lines over one another.

    Args:
        path: The picture.
        planes: The field of each run in the middle plane by its name, with the lines.
        profiles: Place and value along each line, by the line's name and the run's.
        labels: Name of the field with its unit, for the scale and for the profiles, and of the place along a line.
        title: Heading.
        caption: Second line under it.
    """
    limits = scale_of(np.concatenate([panel.found.values.ravel() for panel in planes.values()]))
    found = next(iter(planes.values())).found
    tall = 4.2
    across, lines = tall * float(np.ptp(found.x) / np.ptp(found.y)), list(profiles)
    columns = max(1, -(-len(lines) // 2))
    with mpl.rc_context(STYLE):
        width = len(planes) * (across + 0.25) + 1.6 + 2.4 * columns + 0.4
        height = tall + HEAD + 0.75
        figure = Figure(figsize=(width, height), dpi=160, facecolor="white")
        mappable = None
        for k, (name, panel) in enumerate(planes.items()):
            place = ((0.6 + k * (across + 0.25)) / width, 0.55 / height, across / width, tall / height)
            axes = figure.add_axes(place)
            mappable = plane_panel(axes, panel, limits)
            axes.set_title(name, fontsize=9)
            axes.set(xlabel=f"{found.axes[0]} [cm]", ylabel=f"{found.axes[1]} [cm]" if k == 0 else "")
            axes.tick_params(labelleft=k == 0, labelsize=8)
        left = 0.6 + len(planes) * (across + 0.25)
        bar = figure.add_axes((left / width, 0.55 / height, 0.12 / width, tall / height))
        figure.colorbar(mappable, cax=bar).ax.tick_params(labelsize=8)
        bar.set_title(labels[0].replace(" [", "\n["), fontsize=8)
        _profiles(figure, profiles, (left + 1.35, columns), labels)
        _headings(figure, 0.15 / width, title, caption)
        return saved(figure, path)


def _profiles(
    figure: Figure,
    profiles: Mapping[str, Mapping[str, tuple[Array, Array]]],
    place: tuple[float, int],
    labels: tuple[str, str],
) -> None:
    """Draw the profiles along each line, two rows of panels to the right of a place."""
    (left, columns), (width, height) = place, figure.get_size_inches()
    down = min(2, len(profiles))
    inside = (height - HEAD - 0.75 + ROOM) / down
    every = [values for line in profiles.values() for _, values in line.values()]
    low, high = min(float(v.min()) for v in every), max(float(v.max()) for v in every)
    room = 0.06 * (high - low)
    for k, (name, runs) in enumerate(profiles.items()):
        row, column = divmod(k, columns)
        bottom = 0.55 + (down - 1 - row) * inside
        box = ((left + column * 2.4) / width, bottom / height, 1.9 / width, (inside - ROOM) / height)
        axes = figure.add_axes(box)
        for colour, (run, (x, values)) in zip(LINES, runs.items(), strict=False):
            axes.plot(x, values, color=colour, linewidth=1.4, label=run)
        axes.axhline(0.0, color=MUTED, linewidth=0.7, zorder=1)
        axes.set_title(name, fontsize=9)
        axes.set_ylim(low - room, high + room)
        axes.margins(x=0)
        axes.tick_params(labelsize=8)
        axes.set_xlabel(labels[1] if row == down - 1 else "")
        plain(axes)
        if k == 0 and len(runs) > 1:
            axes.legend(frameon=False, fontsize=7.5)


def _headings(figure: Figure, x: float, title: str, caption: str) -> None:
    """Put a heading and lines under it at the top of a figure, from x on."""
    height = figure.get_size_inches()[1]
    figure.text(x, 1 - 0.3 / height, title, fontsize=12, fontweight="bold", va="baseline")
    figure.text(x, 1 - 0.38 / height, caption, fontsize=8.5, color=MUTED, va="top", linespacing=1.25)


def _inches(figure: Figure, across: float) -> tuple[float, float]:
    """Return a length as parts of a figure's width and height."""
    width, height = figure.get_size_inches()
    return across / width, across / height


def _table(
    rows: int,
    columns: int,
    size: tuple[float, float],
    names: Sequence[str],
    above: float = 0.0,
    *,
    bar: bool = True,
) -> tuple[Figure, Any]:
    """Return a figure with panels of a size in rows and columns, without axes, the rows named [inch]."""
    across, tall = size[0] + 0.08, size[1] + 0.22
    right = BAR if bar else MARGIN
    width, height = NAMES + columns * across + right, HEAD + above + rows * tall + MARGIN
    figure = Figure(figsize=(max(width, 6.0), height), dpi=160, facecolor="white")
    width = figure.get_size_inches()[0]
    grid = np.empty((rows, columns), dtype=object)
    for i in range(rows):
        bottom = MARGIN + (rows - 1 - i) * tall
        for j in range(columns):
            place = (NAMES + j * across, bottom, *size)
            axes = figure.add_axes((place[0] / width, place[1] / height, size[0] / width, size[1] / height))
            axes.set_axis_off()
            grid[i, j] = axes
        middle = (bottom + 0.5 * size[1]) / height
        figure.text(0.28 / width, middle, names[i], rotation=90, ha="center", va="center", fontsize=9)
    return figure, grid


def _bar(figure: Figure, mappable: Any, label: str) -> None:
    """Draw the colour bar at the right of a table of panels."""
    width, height = figure.get_size_inches()
    axes = figure.add_axes(
        (1 - 0.68 / width, MARGIN / height + 0.05, 0.1 / width, min(2.6, height - 1.6) / height)
    )
    bar = figure.colorbar(mappable, cax=axes)
    bar.ax.tick_params(labelsize=7.5)
    axes.set_title(label.replace(" [", "\n["), fontsize=8, loc="center")
