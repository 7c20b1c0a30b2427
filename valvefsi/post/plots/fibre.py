"""Picture of a fibre field: a short line along each fibre, coloured by direction."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from valvefsi.io.folder import replacing
from valvefsi.types import Array


def fibre_picture(path: str | Path, points: Array, vectors: Array, *, title: str = "") -> Path:
    """Draw fibres, in space where they are not in one plane; off screen.

    Args:
        path: PNG file to write.
        points: Middles of the fibres, ``(n, 3)`` [cm].
        vectors: Unit vectors there, ``(n, 3)``; their colour is red for x, green for y and blue for z.
        title: Heading.

    Returns:
        The file.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    flat = np.ptp(points[:, 2]) == 0 and not np.any(vectors[:, 2])
    dim = 2 if flat else 3
    extent = np.ptp(points[:, :dim], axis=0)
    length = 0.8 * (np.prod(extent[extent > 0]) / len(points)) ** (1 / np.count_nonzero(extent > 0))
    half = 0.5 * length * vectors[:, :dim]
    lines = np.stack([points[:, :dim] - half, points[:, :dim] + half], axis=1)
    colours = 0.15 + 0.75 * np.abs(vectors)
    figure = Figure(figsize=(6.4, 5.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(projection=None if flat else "3d")
    kind = LineCollection if flat else Line3DCollection
    axes.add_collection(kind(lines, colors=colours, linewidths=1.4))
    for axis, label in zip("xyz"[:dim], "xyz", strict=False):
        values = lines[:, :, "xyz".index(axis)]
        getattr(axes, f"set_{axis}lim")(values.min(), values.max())
        getattr(axes, f"set_{axis}label")(f"{label} [cm]")
    if flat:
        axes.set_aspect("equal")
    else:
        axes.set_box_aspect(np.maximum(np.ptp(lines.reshape(-1, 3), axis=0), 1e-3 * length))
    axes.set_title(title or f"{len(points)} fibres (red x, green y, blue z)")
    with replacing(Path(path)) as temporary:
        figure.savefig(temporary, dpi=150)
    return Path(path)
