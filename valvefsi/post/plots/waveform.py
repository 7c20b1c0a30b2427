"""Pictures of circuits fitted to measured waveforms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from valvefsi.post.plots.base import INK, LINES, MUTED, STYLE, can_be_seen, plain, saved, typeset
from valvefsi.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D


LETTERS = 15
"""Letters of a caption on an inch."""


@dataclass(frozen=True, kw_only=True)
class CircuitPicture:
    """A circuit over the record it was fitted to.

    Attributes:
        t: Times, ``(n,)`` [s].
        data: What was measured, ``(n,)``.
        curve: What the circuit gives, ``(n,)``.
        band: Half the width of the confidence band, ``(n,)``.
        output: Label of the three.
        inputs: What drives it, by symbol; flows [ml/s], pressures [mmHg].
        title: Heading.
        caption: Second line under it.
    """

    t: Array
    data: Array
    curve: Array
    band: Array | None = None
    output: str
    inputs: Mapping[str, Array] = field(default_factory=dict)
    title: str = ""
    caption: str = ""


def circuit_fit(path: Path, picture: CircuitPicture) -> Path:
    """Draw data, curve with its band, the difference, and what drives the circuit."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.6, 7.0), dpi=160, facecolor="white")
        above, middle, below = figure.subplots(3, 1, sharex=True, height_ratios=(3, 1.2, 1.6))
        figure.subplots_adjust(left=0.14, right=0.89, top=0.885, bottom=0.075, hspace=0.13)
        t, p = picture.t, picture
        if p.band is not None:
            low, high = p.curve - p.band, p.curve + p.band
            span = float(np.ptp(np.concatenate([p.data, p.curve])))
            seen = can_be_seen(p.band, p.curve, x=t, frame=(float(np.ptp(t)), span))
            said = "95 % band" if seen else "95 % band, narrower than the line"
            above.fill_between(t, low, high, color=LINES[0], alpha=0.22, linewidth=0, label=said)
            middle.fill_between(t, -p.band, p.band, color=LINES[0], alpha=0.22, linewidth=0)
        above.plot(t, p.data, color=INK, linewidth=0, marker="o", markersize=2.2, label="measured", zorder=2)
        above.plot(t, p.curve, color=LINES[1], linewidth=1.6, label="circuit", zorder=3)
        above.set_ylabel(p.output)
        above.legend(frameon=False, fontsize=8.5, ncols=3, loc="upper right")
        middle.axhline(0, color=MUTED, linewidth=0.8, label="zero")
        middle.plot(t, p.curve - p.data, color=LINES[1], linewidth=1.2, label="circuit less measured")
        middle.set_ylabel("difference\n[mmHg]")
        _draw_inputs(below, picture)
        below.set_xlabel("t [s]")
        for axes in (above, middle, below):
            plain(axes)
            axes.margins(x=0, y=0.12)
        above.margins(x=0, y=0.16)
        below.margins(x=0, y=0.3)
        middle.ticklabel_format(axis="y", scilimits=(-2, 4))
        figure.align_ylabels([above, middle, below])
        headings_at(figure, 0.14, picture.title, picture.caption)
        return saved(figure, path)


def _draw_inputs(axes: Axes, picture: CircuitPicture) -> None:
    """Draw flows on the left, pressures on the right where there are both."""
    flows = {name: y for name, y in picture.inputs.items() if name.startswith("$Q")}
    pressures = {name: y for name, y in picture.inputs.items() if name not in flows}
    right = axes.twinx() if flows and pressures else axes
    drawn: list[Line2D] = []
    for target, group, unit in ((axes, flows, "flow [ml/s]"), (right, pressures, "pressure [mmHg]")):
        for name, y in group.items():
            colour = LINES[(2 + len(drawn)) % len(LINES)]
            drawn += target.plot(picture.t, y, color=colour, linewidth=1.4, label=name)
        if group:
            target.set_ylabel(unit)
    if right is not axes:
        right.spines[["top", "left"]].set_visible(False)
        right.margins(x=0, y=0.3)
    axes.legend(handles=drawn, frameon=False, fontsize=8.5, ncols=4, loc="upper right")


def headings_at(figure: Figure, x: float, title: str, caption: str) -> None:
    """Put a heading and a line under it at the top of a figure, from x on; a long one is cut at a sentence's end."""
    width, height = figure.get_size_inches()
    if len(caption) > (room := int((1 - x) * width * LETTERS)):
        short = caption[:room].rpartition(";")[0]
        caption = short or caption[: room - 4] + " ..."
    figure.text(x, 1 - 0.36 / height, typeset(title), fontsize=12, fontweight="bold", va="baseline")
    figure.text(x, 1 - 0.61 / height, typeset(caption), fontsize=9, color=MUTED, va="baseline")
