"""Meshes with tags as gmsh's model and files: facets and cells by name, vectors of the cells as cell data."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from valvefsi.types import Array, Gmsh, Indices

CELLS, FACETS = {8: 5, 4: 4}, {4: 3, 3: 2}
"""gmsh's numbers of the types of cells and facets, by their number of corners."""


def fill_model(
    gmsh: Gmsh, points: Array, facets: Mapping[str, Indices], cells: Mapping[str, Indices]
) -> None:
    """Fill gmsh's model: facets 1, 2, ... and then the cells, in the order in which gmsh writes them.

    Args:
        gmsh: The module, with an empty model.
        points: Nodes, ``(num_nodes, 3)`` [cm].
        facets: Corners of facets by tag, ``(n, 3 or 4)`` each.
        cells: Corners of cells by tag, ``(n, 4 or 8)`` each.
    """
    model, start = gmsh.model, 1
    for dim, groups in ((2, facets), (3, cells)):
        for number in range(1, len(groups) + 1):
            model.addDiscreteEntity(dim, number)
    model.mesh.addNodes(3, 1, np.arange(1, len(points) + 1), points.ravel())
    for dim, groups, kinds in ((2, facets, FACETS), (3, cells, CELLS)):
        for number, (name, corners) in enumerate(groups.items(), start=1):
            tags = np.arange(start, start + len(corners))
            model.mesh.addElementsByType(number, kinds[corners.shape[1]], tags, (corners + 1).ravel())
            model.addPhysicalGroup(dim, [number], tag=number, name=name)
            start += len(corners)


def write_model(gmsh: Gmsh, path: Path, num_facets: int, data: Mapping[str, Array]) -> None:
    """Write gmsh's model as `fill_model` made it, with vectors of the cells, ``(num_cells, 3)`` each, by name."""
    gmsh.option.setNumber("PostProcessing.SaveMesh", 0)  # or each view would bring the mesh again
    gmsh.write(str(path))
    for name, vectors in data.items():
        tags = np.arange(1, num_facets + len(vectors) + 1)
        padded = np.pad(vectors, ((num_facets, 0), (0, 0)))  # meshio wants data for the facets too
        view, model = gmsh.view.add(name), gmsh.model.getCurrent()
        gmsh.view.addHomogeneousModelData(view, 0, model, "ElementData", tags, padded.ravel(), 0.0, 3)
        gmsh.view.write(view, str(path), append=True)
