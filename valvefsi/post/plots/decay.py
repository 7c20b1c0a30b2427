"""Pictures of flows over time: energy that is lost, forces, profiles, leaks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from valvefsi.post.plots.base import INK, LINES, MUTED, STYLE, legend_above, saved, typeset
from valvefsi.types import Array


def decay(
    path: Path,
    curves: tuple[Array, Array, Array, Array],
    published: tuple[Array, Array, Array] | None,
    *,
    title: str = "",
    source: str = "published",
) -> Path:
    """Draw energy, its loss and what of the loss the grid resolves, over time, with a published curve.

    Args:
        path: The picture, PNG or PDF.
        curves: Times, energy, loss and resolved dissipation, ``(n,)`` each.
        published: Times, energy and loss of a reference, ``(m,)`` each, None without one.
        title: Heading.
        source: Label of the reference.

    Returns:
        The path.
    """
    t, energy, loss, resolved = curves
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 6.0), dpi=160, facecolor="white")
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(1, 1.6))
        above.plot(t, energy, color=LINES[0])
        above.set_ylabel("kinetic energy")
        below.plot(t, 1e3 * loss, color=LINES[0], label="lost")
        below.plot(t, 1e3 * resolved, color=LINES[1], label="of that resolved by the grid")
        if published is not None:
            above.plot(*published[:2], "--", color=INK, linewidth=1.0)
            below.plot(published[0], 1e3 * published[2], "--", color=INK, linewidth=1.0, label=source)
        below.set(xlabel="t", ylabel="loss of energy [$10^{-3}$]", xlim=(0, t[-1]), ylim=(0, None))
        legend_above(below)
        figure.suptitle(typeset(title), x=0.1, ha="left", fontweight="bold")
        return saved(figure, path)


def forces(
    path: Path,
    curves: tuple[Array, Array, Array],
    ranges: dict[str, tuple[float, float]],
    *,
    title: str = "",
) -> Path:
    """Draw the coefficients of drag and lift over time with published ranges.

    The ordinates hold the last third, of which the numbers are, and the ranges; a start may go beyond them.

    Args:
        path: The picture, PNG or PDF.
        curves: Times, drag and lift, ``(n,)`` each.
        ranges: Range of the mean ``drag`` and of the amplitude of the ``lift``; empty without a reference.
        title: Heading.

    Returns:
        The path.
    """
    t, drag, lift = curves
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 5.4), dpi=160, facecolor="white")
        above, below = figure.subplots(2, 1, sharex=True)
        for axes, curve, key in ((above, drag, "drag"), (below, lift, "lift")):
            axes.plot(t, curve, color=LINES[0], linewidth=1.0)
            shown = [*curve[t >= t[0] + 2.0 / 3.0 * (t[-1] - t[0])]]
            if key in ranges:
                low, high = ranges[key]
                for sign in (1, -1) if key == "lift" else (1,):
                    label = "published" if sign == 1 else None
                    shown += [sign * low, sign * high]
                    axes.axhspan(*sorted((sign * low, sign * high)), color=LINES[1], alpha=0.5, label=label)
            axes.set_ylabel(f"{key} coefficient")
            pad = 0.15 * float(np.ptp(shown)) or 1.0
            axes.set_ylim(min(shown) - pad, max(shown) + pad)
        if ranges:
            above.legend(
                frameon=False, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderpad=0.2, labelcolor=MUTED
            )
        below.set(xlabel="t U / D", xlim=(0, t[-1]))
        figure.suptitle(typeset(title), x=0.1, ha="left", fontweight="bold")
        return saved(figure, path)


def profiles(path: Path, curves: dict[str, list[Any]], *, title: str = "") -> Path:
    """Draw velocity profiles across a channel, one panel for each flow.

    Args:
        path: The picture, PNG or PDF.
        curves: By name of the flow heights ``(n,)``, pairs of time and profile ``(n,)``, and the exact profiles on
            equal heights from 0 to 1.
        title: Heading.

    Returns:
        The path.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 4.9), dpi=160, facecolor="white")
        for axes, (name, (y, computed, exact)) in zip(
            figure.subplots(1, len(curves), sharey=True), curves.items(), strict=True
        ):
            for number, ((t, u), known) in enumerate(zip(computed, exact, strict=True)):
                colour = LINES[number % len(LINES)]
                axes.plot(
                    known, [k / (len(known) - 1) for k in range(len(known))], color=colour, linewidth=1.2
                )
                axes.plot(u, y, ".", color=colour, markersize=4, label=f"t = {t:.3g} s")
            axes.set(title=name, xlabel="u [cm/s]")
            place = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.17), "ncols": 3, "handletextpad": 0.1}
            axes.legend(frameon=False, fontsize=8, labelcolor=MUTED, columnspacing=0.8, **place)
        figure.axes[0].set(ylabel="y [cm]", ylim=(0, 1))
        figure.suptitle(f"{typeset(title)}; lines: closed form", x=0.1, ha="left", fontweight="bold")
        figure.subplots_adjust(top=0.85, bottom=0.3)
        return saved(figure, path)


def centre_lines(
    path: Path,
    curves: dict[str, tuple[Array, Array]],
    known: dict[str, tuple[tuple[float, float], ...]],
    *,
    title: str = "",
) -> Path:
    """Draw velocities on the centre lines of a cavity with published points.

    Args:
        path: The picture, PNG or PDF.
        curves: Positions and velocity ``(n,)`` of ``u`` and ``v``.
        known: Pairs of position and velocity of both.
        title: Heading.

    Returns:
        The path.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 3.8), dpi=160, facecolor="white")
        for axes, (name, (at, values)) in zip(figure.subplots(1, 2), curves.items(), strict=True):
            points = tuple(zip(*known[name], strict=True))
            line, marks = ((values, at), points[::-1]) if name == "u" else ((at, values), points)
            axes.plot(*line, color=LINES[0], label="computed")
            axes.plot(*marks, "o", color=INK, markersize=3.5, label="Ghia et al. 1982")
            axes.set(**({"xlabel": "u", "ylabel": "y"} if name == "u" else {"xlabel": "x", "ylabel": "v"}))
            axes.legend(frameon=False, fontsize=7.5, labelcolor=MUTED)
        figure.suptitle(typeset(title), x=0.1, ha="left", fontweight="bold")
        figure.subplots_adjust(top=0.86, bottom=0.16, wspace=0.3)
        return saved(figure, path)


def leak(path: Path, t: Array, flow: Array, late: float, *, title: str = "") -> Path:
    """Draw a leak over time, its size on a logarithmic axis, and its running mean.

    Args:
        path: The picture, PNG or PDF.
        t: Times, ``(n,)`` [s].
        flow: Leak, ``(n,)`` [cm^3/s].
        late: Part of the run, up to its end, that is averaged.
        title: Heading.

    Returns:
        The path.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 4.2), dpi=160, facecolor="white")
        axes = figure.subplots()
        axes.semilogy(1e3 * t, np.abs(flow), color=LINES[0], linewidth=0.6, alpha=0.5, label="flow, its size")
        width = max(1, len(flow) // 20)
        mean = np.convolve(flow, np.full(width, 1.0 / width), mode="valid")
        axes.semilogy(
            1e3 * t[width - 1 :], np.abs(mean), color=INK, linewidth=1.4, label="mean of a twentieth"
        )
        axes.axvspan(1e3 * (1.0 - late) * t[-1], 1e3 * t[-1], color=MUTED, alpha=0.12, linewidth=0)
        average = abs(flow[-max(1, round(late * len(flow))) :].mean())
        axes.axhline(average, color=LINES[1], linewidth=1.0, label=f"last part: {average:.3g} ml/s")
        axes.set(xlabel="t [ms]", ylabel="leak [ml/s]", xlim=(0, 1e3 * t[-1]))
        legend_above(axes)
        figure.suptitle(typeset(title), x=0.1, ha="left", fontweight="bold")
        return saved(figure, path)
