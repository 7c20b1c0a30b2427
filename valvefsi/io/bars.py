"""Picture of where the time of a step goes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from valvefsi.io.plots import GRID, LINES, STYLE


def phase_bars(path: Path, phases: Mapping[str, Mapping[str, float]], *, title: str = "") -> Path:
    """Draw one bar per grid, divided into phases, each as its share of the step.

    Args:
        path: The picture, PNG or PDF.
        phases: Time of each phase by grid [ms].
        title: Heading.

    Returns:
        The path.
    """
    names = list(dict.fromkeys(name for parts in phases.values() for name in parts))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.6, 1.7 + 0.55 * len(phases)), dpi=160, facecolor="white", layout="constrained")
        axes = figure.subplots()
        for row, (grid, parts) in enumerate(phases.items()):
            total, left = sum(parts.values()), 0.0
            for colour, name in zip(LINES, names, strict=False):
                share = 100.0 * parts.get(name, 0.0) / total
                label = name if row == 0 else None
                axes.barh(row, share, left=left, color=colour, edgecolor="white", label=label, height=0.62)
                if share > 6:
                    axes.text(left + share / 2, row, f"{share:.0f}", ha="center", va="center", color="white")
                left += share
            axes.text(101, row, f"{total:.3g} ms", va="center")
        axes.set(xlim=(0, 112), xlabel="share of a step [%]", title=title)
        axes.set_yticks(range(len(phases)), list(phases))
        axes.invert_yaxis()
        axes.grid(axis="x", color=GRID)
        axes.set_axisbelow(True)
        axes.spines[["top", "right", "left"]].set_visible(False)
        figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=8.5)
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path)
    return path
