"""Picture of two beats of a valve: each waveform of both over one another, and their difference below it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
from matplotlib.figure import Figure

from valvefsi.post.plots.base import INK, LINES, MUTED, STYLE, plain, saved
from valvefsi.post.plots.waveform import headings_at
from valvefsi.types import Array
from valvefsi.units import MMHG

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LABELS = {
    "p_lv": ("$P_\\mathrm{LV}$ [mmHg]", MMHG),
    "p_ao": ("$P_\\mathrm{Ao}$ [mmHg]", MMHG),
    "q_ao": ("flow [ml/s]", 1.0),
    "pdva": ("open area [cm$^2$]", 1.0),
}
"""Label and unit of each waveform."""
LEFT, RIGHT, HEAD, FOOT = 0.085, 0.985, 1.2, 0.55


@dataclass(frozen=True, kw_only=True)
class Overlay:
    """One waveform of both.

    Attributes:
        quantity: ``p_lv``, ``p_ao``, ``q_ao`` or ``pdva``.
        a: That of A, ``(n,)`` [dyn/cm^2, cm^3/s, cm^2].
        b: That of B, ``(n,)``.
        shifted: That of A with the common shift, ``(n,)``.
        deviation: Standard deviation of B over its cycles, ``(n,)``.
        text: What is said of the difference.
    """

    quantity: str
    a: Array
    b: Array
    shifted: Array
    deviation: Array | None = None
    text: str = ""


def valve_comparison(
    path: Path,
    t: Array,
    overlays: Sequence[Overlay],
    names: Mapping[str, str],
    *,
    title: str = "",
    caption: str = "",
) -> Path:
    """Draw waveforms of A over those of B with B's band of two standard deviations, and A less B below each.

    Args:
        path: The picture, PNG or PDF.
        t: Times in the cycle of B, ``(n,)`` [s].
        overlays: The waveforms.
        names: What ``a``, ``b`` and ``shifted`` are called.
        title: Heading.
        caption: Second line under it.

    Returns:
        The path.
    """
    across = min(len(overlays), 2)
    down = -(-len(overlays) // across)
    with mpl.rc_context(STYLE):
        height = 3.2 * down + HEAD + FOOT
        figure = Figure(figsize=(5.2 * across, height), dpi=160, facecolor="white")
        frame = {"left": LEFT * 2 / across, "right": RIGHT, "top": 1 - HEAD / height, "bottom": FOOT / height}
        blocks = figure.add_gridspec(down, across, wspace=0.24, hspace=0.2, **frame)
        rows: list[tuple[Axes, Axes]] = []
        for place, overlay in enumerate(overlays):
            inner = blocks[place // across, place % across].subgridspec(
                2, 1, height_ratios=(2.2, 1), hspace=0.08
            )
            above = figure.add_subplot(inner[0])
            below = figure.add_subplot(inner[1], sharex=above)
            _draw(above, below, t, overlay, names)
            rows.append((above, below))
        for _, below in rows[-across:]:
            below.set_xlabel(f"t in the cycle of {names['b']} [s]")
        for column in range(across):
            figure.align_ylabels([axes for pair in rows[column::across] for axes in pair])
        handles, labels = rows[0][0].get_legend_handles_labels()
        more, others = rows[0][1].get_legend_handles_labels()
        where = {"loc": "upper left", "bbox_to_anchor": (frame["left"] - 0.01, 1 - 0.62 / height)}
        figure.legend([*handles, *more], [*labels, *others], frameon=False, fontsize=8.5, ncols=5, **where)
        headings_at(figure, frame["left"], title, caption)
        return saved(figure, path)


def _draw(above: Axes, below: Axes, t: Array, overlay: Overlay, names: Mapping[str, str]) -> None:
    """Draw one waveform of both, and their difference."""
    label, unit = LABELS[overlay.quantity]
    a, b, shifted = overlay.a / unit, overlay.b / unit, overlay.shifted / unit
    if overlay.deviation is not None:
        band = 2.0 * overlay.deviation / unit
        above.fill_between(t, b - band, b + band, color=INK, alpha=0.2, linewidth=0)
        below.fill_between(t, -band, band, color=INK, alpha=0.2, linewidth=0, label=f"{names['b']}, 2 sd")
    above.plot(t, b, color=INK, linewidth=1.3, label=names["b"])
    above.plot(t, a, color=LINES[1], linewidth=1.6, label=names["a"])
    below.plot(t, a - b, color=LINES[1], linewidth=1.2)
    below.plot(t, shifted - b, color=LINES[0], linewidth=1.0, label=names["shifted"])
    below.axhline(0, color=MUTED, linewidth=0.8, zorder=1)
    above.set_ylabel(label)
    below.set_ylabel("difference")
    above.tick_params(labelbottom=False)
    above.set_title(overlay.text, fontsize=8.5, color=MUTED, loc="right", pad=3)
    for axes in (above, below):
        plain(axes)
        axes.margins(x=0, y=0.1)
