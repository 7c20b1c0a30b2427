"""Pictures of how answers converge under refinement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from valvefsi.post.plots.base import INK, LINES, STYLE, headings, plain, saved

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, kw_only=True)
class Convergence:
    """One panel: a quantity under refinement.

    Attributes:
        label: Quantity and unit.
        lines: Unknowns and values by kind of cell.
        known: References: value or None, band or None, source.
    """

    label: str
    lines: Mapping[str, tuple[Sequence[float], Sequence[float]]]
    known: Sequence[tuple[float | None, tuple[float, float] | None, str]] = ()


def convergence(path: Path, panels: Sequence[Convergence], *, title: str = "") -> Path:
    """Draw answers over the number of unknowns, with what they are compared with.

    Args:
        path: The picture, PNG or PDF.
        panels: The quantities, one panel each.
        title: Heading.

    Returns:
        The path.
    """
    with mpl.rc_context(STYLE):
        height = 2.5 * len(panels) + 1.2
        figure = Figure(figsize=(7.2, height), dpi=160, facecolor="white")
        every = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        figure.subplots_adjust(left=0.15, right=0.97, top=1 - 0.8 / height, bottom=0.5 / height, hspace=0.2)
        for axes, panel in zip(every, panels, strict=True):
            _draw_convergence(axes, panel)
        every[-1].set_xlabel("unknowns")
        figure.align_ylabels(every)
        headings(figure, title, "answers under refinement")
        return saved(figure, path)


def _draw_convergence(axes: Axes, panel: Convergence) -> None:
    for value, band, source in panel.known:
        text = source if len(source) < 60 else f"{source[:57]}..."
        if band is not None:
            axes.axhspan(*band, color="#e69f00", alpha=0.15, linewidth=0, label=text)
        elif value is not None:
            axes.axhline(value, color=INK, linewidth=1.0, dashes=(5, 3), label=text)
    for (name, (unknowns, values)), colour in zip(panel.lines.items(), LINES, strict=False):
        axes.plot(unknowns, values, "o-", color=colour, linewidth=1.5, markersize=4.5, label=name)
    axes.set_xscale("log")
    ticks = sorted({int(n) for unknowns, _ in panel.lines.values() for n in unknowns})
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xticks(ticks, labels=[f"{n:,}" for n in ticks], rotation=20 if len(ticks) > 5 else 0)
    axes.set_ylabel(panel.label, fontsize=9)
    plain(axes)
    axes.margins(y=0.15)
    axes.legend(frameon=False, fontsize=8)
