"""Picture of the flow in a tube that starts from rest."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from valvefsi.post.plots.base import INK, LINES, MUTED, STYLE, saved
from valvefsi.types import Array


def start_up_flow(path: Path, curves: tuple[Array, Array, Array, Array], *, title: str = "") -> Path:
    """Draw a flow over time with its closed form, and its error below.

    Args:
        path: The picture, PNG or PDF.
        curves: Times [s], flow and its closed form over the final flow, error [%], ``(n,)`` each.
        title: Heading.

    Returns:
        The path.
    """
    t, flow, exact, error = curves
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 5.0), dpi=160, facecolor="white")
        above, below = figure.subplots(2, 1, sharex=True)
        above.semilogx(t, flow, color=LINES[0], label="computed")
        above.semilogx(t, exact, "--", color=INK, linewidth=1.0, label="start-up series")
        above.set(ylabel="flow / final flow", ylim=(0, None))
        above.legend(frameon=False, loc="upper left", labelcolor=MUTED)
        below.semilogx(t, error, color=LINES[0])
        below.axhline(0.0, color=MUTED, linewidth=0.8)
        below.set(xlabel="t [s]", ylabel="error [% of final flow]", xlim=(t[0], t[-1]))
        figure.suptitle(title, x=0.1, ha="left", fontweight="bold")
        return saved(figure, path)
