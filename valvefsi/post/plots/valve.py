"""Picture of a valve: its leaflets in a colour each, from three sides, with a scale and dimensions."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import to_rgba

from valvefsi.post.plots.views import Surface, views

if TYPE_CHECKING:
    from valvefsi.types import Array, Indices

COLOURS = ("#d9a58f", "#8fb3d9", "#a9cf9b")
VIEWS = {"from downstream": (90.0, -90.0), "from the side": (0.0, -60.0), "from upstream": (-35.0, -60.0)}


def valve(
    path: Path, points: Array, facets: Mapping[str, Indices], *, title: str = "", caption: str = ""
) -> Path:
    """Draw the leaflets' outer surfaces in three views.

    Args:
        path: Picture to write.
        points: Nodes, leaflet by leaflet, ``(num_nodes, 3)`` [cm].
        facets: Corners of the outer facets by tag, ``(n, 3 or 4)``.
        title: Heading.
        caption: Second line under it.
    """
    faces = np.concatenate(list(facets.values()))
    owner = faces[:, 0] // (len(points) // len(COLOURS))
    colours = np.array([to_rgba(colour) for colour in COLOURS])[owner]
    surface = Surface(polygons=points[faces], colours=colours, names={}, outward=False)
    return views(path, surface, title=title, caption=caption, sides=VIEWS)
