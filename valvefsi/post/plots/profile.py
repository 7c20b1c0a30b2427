"""Pictures of profiles along lines: velocity and turbulence kinetic energy (as Figures S10 to S13)."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from valvefsi.post.plots.base import LINES, MUTED, STYLE, headings, plain, saved
from valvefsi.post.plots.ticks import length_axes

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axes import Axes

    from valvefsi.types import Array

    Profile = Mapping[str, Array]

TKE = "tke_cm2_per_s2"
ACROSS = 4
"""Most panels beside one another."""


def read_profiles(folder: Path) -> dict[str, dict[str, Array]]:
    """Return the profiles in a folder by name, their columns by name."""
    found = {}
    for path in sorted(Path(folder).glob("*.csv")):
        with path.open(newline="") as file:
            rows = list(csv.reader(file))
        found[path.stem] = dict(zip(rows[0], np.array(rows[1:], dtype=float).T, strict=True))
    return found


def draw_profiles(path: Path, profiles: Mapping[str, Profile], *, title: str = "", caption: str = "") -> Path:
    """Draw a velocity along each line, its mean where there is one, and the turbulence kinetic energy below it.

    Of the velocity the component is shown that is largest on all lines.

    Args:
        path: The picture, PNG or PDF.
        profiles: Columns of ``profiles/NAME.csv`` by name.
        title: Heading.
        caption: Second line under it.

    Returns:
        The path.
    """
    velocity = largest_velocity(profiles)
    shown = [name for name in (velocity, TKE) if all(name in columns for columns in profiles.values())]
    across = min(len(profiles), ACROSS)
    blocks = -(-len(profiles) // across)
    with mpl.rc_context(STYLE):
        height = (2.3 if blocks == 1 else 2.6) * blocks * len(shown) + 1.7
        figure = Figure(figsize=(2.35 * across + 1.0, height), dpi=160, facecolor="white")
        width = figure.get_figwidth()
        figure.subplots_adjust(
            0.85 / width,
            0.5 / height,
            1 - 0.2 / width,
            1 - 0.95 / height,
            0.14,
            0.42 if blocks == 1 else 0.75,
        )
        panels = figure.subplots(blocks * len(shown), across, squeeze=False, sharey=False)
        for row in panels:
            for axes in row:
                axes.set_visible(False)
        for k, (name, columns) in enumerate(profiles.items()):
            for down, column in enumerate(shown):
                axes = panels[(k // across) * len(shown) + down, k % across]
                axes.set_visible(True)
                _panel(axes, columns, column, _range(profiles, column))
                axes.set_ylabel(_told(column) if k % across == 0 else "")
                axes.tick_params(labelleft=k % across == 0)
                length_axes(axes, names=_along(columns)[:1])
                if down < len(shown) - 1:
                    axes.set_xlabel("")
                if down == 0:
                    axes.set_title(f"{name}\n{_where(columns)}", fontsize=9)
        headings(figure, title, caption)
        return saved(figure, path)


def largest_velocity(profiles: Mapping[str, Profile]) -> str:
    """Name of the velocity's column with the largest value on any line; that of the mean where there is one."""
    some = next(iter(profiles.values()))
    names = [name for name in some if name.startswith("mean_u_")] or [n for n in some if n.startswith("u_")]
    return max(names, key=lambda name: max(np.abs(columns[name]).max() for columns in profiles.values()))


def _range(profiles: Mapping[str, Profile], column: str) -> tuple[float, float]:
    values = np.concatenate([columns[column] for columns in profiles.values()])
    low, high = min(values.min(), 0.0), max(values.max(), 0.0)
    room = 0.06 * (high - low) or 1.0
    return low - room, high + room


def _panel(axes: Axes, columns: Profile, column: str, limits: tuple[float, float]) -> None:
    colour = LINES[1] if column == TKE else LINES[0]
    axes.plot(_along(columns)[1], columns[column], color=colour, linewidth=1.5)
    axes.axhline(0.0, color=MUTED, linewidth=0.7, zorder=1)
    axes.set_ylim(limits)
    axes.margins(x=0)
    plain(axes)


def _along(columns: Profile) -> tuple[str, Array]:
    """Name and values of the coordinate along a line; the distance where more than one changes."""
    moving = [axis for axis in "xyz" if f"{axis}_cm" in columns and np.ptp(columns[f"{axis}_cm"]) > 1e-9]
    return (moving[0], columns[f"{moving[0]}_cm"]) if len(moving) == 1 else ("s", columns["s_cm"])


def _where(columns: Profile) -> str:
    still = [axis for axis in "xyz" if f"{axis}_cm" in columns and np.ptp(columns[f"{axis}_cm"]) <= 1e-9]
    return ", ".join(f"{axis} = {10.0 * columns[f'{axis}_cm'][0]:.3g} mm" for axis in still)


def _told(column: str) -> str:
    if column == TKE:
        return "TKE [cm$^2$/s$^2$]"
    words = column.removesuffix("_cm_per_s").split("_")
    return f"{'mean ' if words[0] == 'mean' else ''}$u_{words[-1]}$ [cm/s]"
