"""Pictures of a valve: its leaflets from above, from the side, and unshaded edges of their elements."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from valvefsi.io.folder import replacing

if TYPE_CHECKING:
    from valvefsi.types import Array, Indices

COLOURS = ("#d9a58f", "#8fb3d9", "#a9cf9b")
VIEWS = {"from downstream": (90, -90), "from the side": (10, -60), "from upstream": (-35, -60)}


def valve(path: Path, points: Array, faces: Indices, owner: Indices, *, title: str = "") -> Path:
    """Draw the leaflets' outer surfaces in three views.

    Args:
        path: Picture to write.
        points: Nodes, ``(num_nodes, 3)`` [cm].
        faces: Corners of the outer faces, ``(num_faces, 3 or 4)``.
        owner: Number of each face's leaflet, 1 to 3, ``(num_faces,)``.
        title: Heading.
    """
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    with mpl.rc_context({"font.size": 9}):
        figure = Figure(figsize=(12, 4.6), dpi=130)
        low, high = points.min(axis=0), points.max(axis=0)
        for place, (name, (elevation, azimuth)) in enumerate(VIEWS.items(), start=1):
            axes = figure.add_subplot(1, 3, place, projection="3d", proj_type="ortho")
            colours = [COLOURS[k - 1] for k in owner]
            drawn = Poly3DCollection(
                points[faces], facecolors=colours, edgecolors="#404040", linewidths=0.15, shade=True
            )
            axes.add_collection3d(drawn)
            axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]), title=name)
            axes.set_box_aspect(high - low, zoom=1.2)
            axes.view_init(elevation, azimuth)
            axes.set_axis_off()
        figure.suptitle(title)
        with replacing(path) as temporary:
            figure.savefig(temporary)
    return path


def outer_faces(facets: dict[str, Indices], num_nodes: int) -> tuple[Indices, Indices]:
    """Return all tagged faces and the leaflet of each, from its first node."""
    faces = np.concatenate(list(facets.values()))
    return faces, 1 + faces[:, 0] // (num_nodes // 3)
