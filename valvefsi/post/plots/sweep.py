"""Pictures of a sweep: numbers against what is varied, and the waveforms of the members over one another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from valvefsi.post.columns import LAB, Units
from valvefsi.post.plots.base import LINES, MUTED, STYLE, headings, plain, saved, typeset
from valvefsi.post.plots.ticks import EvenTicks
from valvefsi.units import MMHG

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from valvefsi.types import Array

COLUMNS, HEAD, FOOT = 2, 0.98, 0.5
"""Panels of numbers in a row; room above the panels and below them [inch]."""
ROW, GAP, WAVE, LEGEND = 1.25, 0.6, 1.6, 0.22
"""Heights of a panel of numbers, of what is between two, of a panel of waveforms, of a line of their legend [inch]."""
KEYS: dict[str, Any] = {"frameon": False, "fontsize": 8.5, "handlelength": 1.8}
LETTERS = 32
"""Letters that go under an axis of a panel of numbers."""
SHORT = 0.1
"""Time below which waveforms are drawn over milliseconds [s]."""
APART = 0.12
"""Part of an axis that two ticks must be apart."""


@dataclass(frozen=True, kw_only=True)
class SweepPicture:
    """What a sweep is drawn from.

    Attributes:
        label: What is varied, with its unit.
        x: Its values in the order of the members, numbers or texts.
        names: What tells the members with one value apart, in the same order; empty where nothing does.
        numbers: Values of the members by name with unit, NaN where one has none, ``(num_members,)`` each.
        waves: Waveforms by member, in the order of the members, empty for none: ``t`` [s], ``p_lv``, ``p_ao``
            [dyn/cm^2], ``q`` [cm^3/s], ``pdva`` [cm^2], ``(n,)`` each.
        members: What the members are called.
        title: Heading.
        caption: Second line under it.
        units: Units of the numbers.
    """

    label: str
    x: Sequence[float | str]
    names: Sequence[str]
    numbers: Mapping[str, Array]
    waves: Sequence[Mapping[str, Array]] = ()
    members: Sequence[str] = field(default_factory=tuple)
    title: str = ""
    caption: str = ""
    units: Units = LAB


def sweep_picture(path: Path, picture: SweepPicture) -> Path:
    """Draw the numbers of the members, and below them their waveforms.

    Args:
        path: The picture, PNG or PDF.
        picture: What is drawn.

    Returns:
        The path.
    """
    rows, panels = -(-len(picture.numbers) // COLUMNS), _wave_panels(picture)
    above = rows * (ROW + GAP) - GAP * bool(rows)
    legend = LEGEND * (1 + -(-(len(picture.waves) + 2) // _in_a_line(picture.members))) * bool(panels)
    below = len(panels) * WAVE + legend
    names = [name for name in dict.fromkeys(picture.names) if name]
    head = HEAD + LEGEND * -(-len(names) // _in_a_line(names)) * bool(rows)
    height = head + above + 0.55 * bool(rows and panels) + below + FOOT
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.6, height), dpi=160, facecolor="white")
        if rows:
            _draw_numbers(figure, picture, 1 - head / height, 1 - (head + above) / height)
        if panels:
            _draw_waves(figure, picture, panels, (FOOT + below - legend) / height, FOOT / height)
        headings(figure, picture.title, picture.caption)
        return saved(figure, path)


def _draw_numbers(figure: Figure, picture: SweepPicture, top: float, bottom: float) -> None:
    """Draw a panel for each number; the last of each column says what is varied."""
    rows = -(-len(picture.numbers) // COLUMNS)
    place = {"left": 0.115, "right": 0.965, "top": top, "bottom": bottom}
    across = min(COLUMNS, len(picture.numbers))
    grid = figure.add_gridspec(rows, across, hspace=GAP / ROW, wspace=0.3, **place)
    for number, (column, values) in enumerate(picture.numbers.items()):
        axes = figure.add_subplot(grid[number // across, number % across])
        shown = picture.units.of(column)
        _draw_number(axes, picture, shown.factor * np.asarray(values, dtype=float))
        axes.set_title(typeset(shown.label.removesuffix(" [-]")), fontsize=9.5, loc="left", pad=5)
        if number + COLUMNS >= len(picture.numbers):
            axes.set_xlabel(typeset(picture.label), fontsize=9)
        if number == 0 and any(picture.names):
            where = {"loc": "lower left", "bbox_to_anchor": (-0.02, 1.0 + 0.25 / ROW), "borderaxespad": 0.0}
            axes.legend(ncols=_in_a_line(picture.names), **where, **KEYS)


def _draw_number(axes: Axes, picture: SweepPicture, values: Array) -> None:
    numeric = all(not isinstance(x, str) for x in picture.x)
    places = list(dict.fromkeys(picture.x))
    x = np.array([value if numeric else places.index(value) for value in picture.x], dtype=float)
    for name, colour in zip(dict.fromkeys(picture.names), _colours(len(set(picture.names))), strict=True):
        own = np.array([other == name for other in picture.names]) & np.isfinite(values)
        order = np.argsort(x[own])
        style = {"color": colour, "marker": "o", "markersize": 4.5, "linewidth": 1.5 if numeric else 0}
        axes.plot(x[own][order], values[own][order], label=typeset(name), clip_on=False, zorder=3, **style)
    plain(axes)
    axes.margins(x=0.06 if numeric else 0.18, y=0.14)
    axes.tick_params(labelsize=8.5)
    axes.yaxis.set_major_locator(MaxNLocator(4, min_n_ticks=3))
    axes.yaxis.set_major_formatter(EvenTicks())
    ticks = np.array(sorted(places) if numeric else range(len(places)), dtype=float)
    if not numeric or np.min(np.diff(ticks), initial=np.inf) > APART * np.ptp(ticks):
        axes.set_xticks(
            ticks, [f"{x:g}" for x in ticks] if numeric else [typeset(text) for text in _cut(places)]
        )


def _cut(places: Sequence[float | str]) -> list[str]:
    """Return names that fit beside one another under an axis."""
    most = max(3, LETTERS // len(places) - 1)
    return [
        text if len(text) <= most else f"{text[: most - 1]}\N{HORIZONTAL ELLIPSIS}"
        for text in map(str, places)
    ]


def _wave_panels(picture: SweepPicture) -> list[tuple[str, tuple[str, ...], float]]:
    """Return label, waveforms and unit of the panels that there is something for."""
    panels = (
        ("pressure [mmHg]", ("p_lv", "p_ao"), MMHG),
        ("flow [ml/s]", ("q",), 1.0),
        ("open area [cm$^2$]", ("pdva",), 1.0),
    )
    return [panel for panel in panels if any(panel[1][0] in waves for waves in picture.waves)]


def _draw_waves(
    figure: Figure,
    picture: SweepPicture,
    panels: Sequence[tuple[str, tuple[str, ...], float]],
    top: float,
    bottom: float,
) -> None:
    """Draw the waveforms of all members, a colour for each; the pressure downstream is dashed."""
    grid = figure.add_gridspec(len(panels), 1, left=0.115, right=0.965, top=top, bottom=bottom, hspace=0.14)
    axes: list[Axes] = []
    colours = _colours(len(picture.waves))
    short = max(waves["t"][-1] for waves in picture.waves if waves) < SHORT
    unit_t, factor = ("ms", 1e3) if short else ("s", 1.0)
    for number, (label, names, unit) in enumerate(panels):
        axes.append(figure.add_subplot(grid[number, 0], sharex=axes[0] if axes else None))
        for waves, colour in zip(picture.waves, colours, strict=True):
            for name, dashes in zip(names, ((None, None), (3.5, 1.5)), strict=False):
                if name in waves:
                    t, values = factor * waves["t"], waves[name] / unit
                    axes[-1].plot(t, values, color=colour, linewidth=1.5, dashes=dashes)
        axes[-1].set_ylabel(label, fontsize=9)
        axes[-1].tick_params(labelsize=8.5, labelbottom=number == len(panels) - 1)
        axes[-1].yaxis.set_major_locator(MaxNLocator(5))
        axes[-1].margins(x=0, y=0.1)
        plain(axes[-1])
    axes[-1].set_xlabel(f"t [{unit_t}]", fontsize=9)
    figure.align_ylabels(axes)
    handles = [
        Line2D([], [], color=colour, linewidth=1.8, label=typeset(name))
        for name, colour, waves in zip(picture.members, colours, picture.waves, strict=True)
        if waves
    ]
    if "p_ao" in panels[0][1]:
        for name, dashes in (("upstream", (None, None)), ("downstream", (3.5, 1.5))):
            handles.append(Line2D([], [], color=MUTED, linewidth=1.5, dashes=dashes, label=name))
    options = {"frameon": False, "fontsize": 8.5, "ncols": _in_a_line(picture.members), "handlelength": 1.8}
    axes[0].legend(
        handles=handles, loc="lower left", bbox_to_anchor=(-0.01, 1.0), borderaxespad=0.2, **options
    )


def _in_a_line(names: Sequence[str]) -> int:
    """Return how many names go into a line of a legend."""
    return max(1, int(90 / (8 + max((len(name) for name in (*names, "downstream")), default=0))))


def _colours(count: int) -> list[str]:
    """Return a colour for each of some lines: far apart for a few, in a row for many."""
    if count <= len(LINES):
        return list(LINES[:count])
    return [mpl.colors.to_hex(colour) for colour in mpl.colormaps["viridis"](np.linspace(0, 0.92, count))]
