"""Ticks of pictures: texts that differ, and lengths in the unit that is asked for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import Formatter

from valvefsi.post.columns import LAB, Units
from valvefsi.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def tick_texts(ticks: Sequence[float] | Array) -> list[str]:
    """Return even ticks as texts that differ, with as many decimals as that takes, or powers of ten."""
    largest, step = float(np.max(np.abs(ticks))), float(np.ptp(ticks)) / max(len(ticks) - 1, 1)
    if not step > 0:
        return [f"{tick:.4g}" for tick in ticks]
    power = int(np.floor(np.log10(largest))) if largest >= 1e5 or largest < 1e-3 else 0
    scaled = np.asarray(ticks) / 10.0**power
    decimals = max(0, int(np.ceil(-np.log10(step / 10.0**power))) + 1)
    if np.abs(scaled - np.round(scaled, decimals)).max() > 1e-6 * step / 10.0**power:
        decimals += 1  # 1.25 and 3.75 are no 1.2 and 3.8
    texts = [f"{tick + 0.0:.{decimals}f}" for tick in scaled]
    while decimals and all(text.endswith("0") for text in texts):
        decimals -= 1
        texts = [f"{tick + 0.0:.{decimals}f}" for tick in scaled]
    if not power:
        return texts
    return ["0" if float(text) == 0 else f"${text} \\cdot 10^{{{power}}}$" for text in texts]


class EvenTicks(Formatter):  # type: ignore[misc]  # matplotlib has no annotations here
    """Ticks as `tick_texts` writes them, in another unit than that of the axis: so many of it are one of the axis'."""

    def __init__(self, factor: float = 1.0) -> None:
        self.factor = factor

    def format_ticks(self, values: Sequence[float]) -> list[str]:
        """Return the texts of all ticks of an axis."""
        texts = tick_texts(self.factor * np.asarray(values)) if len(values) else []
        return [text.replace("-", "\N{MINUS SIGN}") if "$" not in text else text for text in texts]

    def __call__(self, x: float, pos: int | None = None) -> str:
        """Return the text of one value."""
        return f"{self.factor * x:.6g}"


def length_axes(axes: Axes, units: Units = LAB, names: Sequence[str] = ("x", "y")) -> None:
    """Name axes over lengths in cm, and show these in the unit that is asked for."""
    length = units.of("length_cm")
    for axis, name in zip((axes.xaxis, axes.yaxis), names, strict=False):
        axis.set_label_text(f"{name} [{length.unit}]")
        axis.set_major_formatter(EvenTicks(length.factor))
