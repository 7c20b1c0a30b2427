"""Picture of a study of grids: numbers over the spacing with what they go to, waveforms' differences under them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

from valvefsi.post.columns import LAB, Units
from valvefsi.post.plots.base import INK, LINES, MUTED, STYLE, headings, plain, saved, typeset
from valvefsi.post.plots.ticks import EvenTicks

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLUMNS, HEAD, FOOT = 2, 1.1, 0.55
"""Panels in a row; room above the panels and below them [inch]."""
ROW, GAP, WAVE = 1.45, 0.75, 2.0
"""Heights of a panel of a number, of what is between two, and of the panel of the waveforms [inch]."""
LETTERS = 44
"""Letters of the heading of a panel."""


@dataclass(frozen=True, kw_only=True)
class RefinedNumber:
    """A number on several grids.

    Attributes:
        name: Its name, with its unit.
        values: From the coarsest grid on, ``(num_grids,)``.
        extrapolated: What it goes to, None where it does not converge.
        uncertainty: Of the finest value, None where there is none.
        text: What the grids say of it, short.
    """

    name: str
    values: Sequence[float]
    extrapolated: float | None
    uncertainty: float | None
    text: str


@dataclass(frozen=True, kw_only=True)
class RefinementPicture:
    """What a study of grids is drawn from.

    Attributes:
        h: Spacings, coarse to fine, ``(num_grids,)`` [cm].
        numbers: The numbers.
        waves: Differences between successive grids by waveform, ``(num_grids - 1,)`` each, relative, and the order.
        expected: Expected order, drawn as a slope.
        title: Heading.
        caption: Second line under it.
        units: Units of the numbers.
    """

    h: Sequence[float]
    numbers: Sequence[RefinedNumber]
    waves: Mapping[str, tuple[Sequence[float], float | None]]
    expected: float
    title: str = ""
    caption: str = ""
    units: Units = LAB


def refinement_picture(path: Path, picture: RefinementPicture) -> Path:
    """Draw numbers and waveforms under refinement.

    Args:
        path: The picture, PNG or PDF.
        picture: What is drawn.

    Returns:
        The path.
    """
    rows = -(-len(picture.numbers) // COLUMNS)
    above, below = rows * (ROW + GAP) - GAP * bool(rows), WAVE * bool(picture.waves)
    height = HEAD + above + GAP * bool(rows and picture.waves) + below + FOOT
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.6, height), dpi=160, facecolor="white")
        place = {"left": 0.115, "right": 0.965}
        if rows:
            ends = {"top": 1 - HEAD / height, "bottom": 1 - (HEAD + above) / height}
            grid = figure.add_gridspec(rows, COLUMNS, hspace=GAP / ROW, wspace=0.3, **place, **ends)
            for number, one in enumerate(picture.numbers):
                axes = figure.add_subplot(grid[number // COLUMNS, number % COLUMNS])
                _draw_number(axes, 10.0 * np.asarray(picture.h), one, picture.units)
                if number + COLUMNS >= len(picture.numbers):
                    axes.set_xlabel("h [mm]", fontsize=9)
        if picture.waves:
            ends = {"top": (FOOT + below) / height, "bottom": FOOT / height}
            grid = figure.add_gridspec(1, 1, left=0.115, right=0.62, **ends)
            _draw_waves(figure.add_subplot(grid[0, 0]), picture)
        headings(figure, picture.title, picture.caption)
        return saved(figure, path)


def _draw_number(axes: Axes, h: np.ndarray, one: RefinedNumber, units: Units) -> None:
    values = np.asarray(one.values, dtype=float)
    quantity = units.of(one.name)
    label, factor = typeset(quantity.label.removesuffix(" [-]")), quantity.factor
    values = factor * values
    axes.plot(h, values, "o-", color=LINES[0], markersize=4.5, linewidth=1.5, clip_on=False, zorder=3)
    if one.uncertainty is not None:
        bar = {"color": LINES[1], "capsize": 3.0, "linewidth": 1.2, "zorder": 2}
        axes.errorbar(h[-1:], values[-1:], yerr=[factor * one.uncertainty], fmt="none", **bar)
    if one.extrapolated is not None:
        ends = [float(values[-1]), factor * one.extrapolated]
        axes.plot([h[-1], 0.0], ends, "--", color=LINES[2], linewidth=1.2, zorder=2)
        axes.plot([0.0], ends[1:], "D", color=LINES[2], markersize=4.5, clip_on=False, zorder=3)
    shown = label if len(label) <= LETTERS else f"{label[: LETTERS - 1]}\N{HORIZONTAL ELLIPSIS}"
    axes.set_title(shown, fontsize=9.5, loc="left", pad=14)
    axes.annotate(one.text, (0.0, 1.03), xycoords="axes fraction", fontsize=8, color=MUTED, va="bottom")
    plain(axes)
    axes.set_xlim(0.0, 1.06 * float(h[0]))
    axes.margins(y=0.16)
    axes.tick_params(labelsize=8.5)
    axes.yaxis.set_major_locator(MaxNLocator(4, min_n_ticks=3))
    axes.yaxis.set_major_formatter(EvenTicks())


def _draw_waves(axes: Axes, picture: RefinementPicture) -> None:
    """Draw the differences of waveforms over the finer spacing, with the slope that is expected."""
    h = 10.0 * np.asarray(picture.h)[1:]
    colours = [LINES[k % len(LINES)] for k in range(len(picture.waves))]
    marks = "osD^vP"
    for number, ((name, (gaps, order)), colour) in enumerate(
        zip(picture.waves.items(), colours, strict=True)
    ):
        said = "" if order is None else f", order {order:.2f}"
        style = {"color": colour, "markersize": 4.5, "linewidth": 1.5}
        shape = f"{marks[number % len(marks)]}-"
        axes.plot(
            h,
            100 * np.asarray(gaps),
            shape,
            label=f"{_short(typeset(picture.units.of(name).label))}{said}",
            **style,
        )
    largest = 100 * max(gaps[0] for gaps, _ in picture.waves.values())
    slope = largest * (h / h[0]) ** picture.expected
    axes.plot(h, slope, color=INK, linewidth=1.0, dashes=(5, 3), label=f"slope {picture.expected:g}")
    axes.set(xscale="log", yscale="log")
    axes.set_xlabel("h of the finer grid [mm]", fontsize=9)
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:.3g}")
    axes.yaxis.set_minor_locator(NullLocator())
    axes.set_title("waveforms: difference between grids, L2 [%]", fontsize=9.5, loc="left", pad=5)
    axes.set_xticks(h, [f"{value:.4g}" for value in h])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.tick_params(labelsize=8.5)
    axes.margins(x=0.12)
    plain(axes)
    axes.legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1.02, 1.0), borderaxespad=0.0)


def _short(label: str) -> str:
    return label.partition(" [")[0]
