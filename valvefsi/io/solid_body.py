"""A deformed solid with its fields, and its file for ParaView."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.errors import CaseError
from valvefsi.runtime.mesh_files import read_mesh_file

if TYPE_CHECKING:
    import meshio

    from valvefsi.types import Array, Indices

CORNERS = {5: 3, 9: 4, 10: 4, 12: 8, 22: 3, 28: 4, 24: 4, 69: 3, 70: 4, 71: 4, 72: 8}
"""Corners of VTK's cells, the first nodes of each."""
FLAT = (5, 9, 22, 28, 69, 70)
"""VTK's plane cells."""
FACES = {
    4: ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)),
    8: ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
}
"""Faces of cells in space with 4 corners and with 8, outward."""
KINDS = {"triangle": 5, "quad": 9, "tetra": 10, "hexahedron": 12, "triangle6": 22, "quad9": 28, "tetra10": 24}
KINDS |= {"VTK_LAGRANGE_HEXAHEDRON": 72}
NAMES = {5: "triangle", 9: "quad", 10: "tetra", 12: "hexahedron", 22: "triangle6", 28: "quad9", 24: "tetra10"}
NAMES |= {69: "triangle6", 70: "quad9", 71: "tetra10", 72: "VTK_LAGRANGE_HEXAHEDRON"}


@dataclass(frozen=True, kw_only=True)
class Body:
    """A deformed solid.

    Attributes:
        points: Positions of the nodes, ``(num_nodes, 3)`` [cm].
        cells: Nodes of the cells in VTK's order, ``(num_cells, k)``, by VTK cell type.
        values: Scalars or vectors of the nodes by name, the unit in brackets at its end.
        reference: Reference positions of the nodes, ``(num_nodes, 3)`` [cm]; drawn as an outline if given.
        shown: Which scalar is drawn; the first one if left out.
    """

    points: Array
    cells: Mapping[int, Indices]
    values: Mapping[str, Array] = field(default_factory=dict)
    reference: Array | None = None
    shown: str | None = None

    @property
    def dim(self) -> int:
        """2 where all cells are flat, else 3."""
        return 3 if any(kind in (10, 12, 24, 71, 72) for kind in self.cells) else 2

    def scalar(self) -> tuple[str, Array]:
        """Return name and values of the scalar that is drawn."""
        scalars = {name: np.asarray(v) for name, v in self.values.items() if np.ndim(v) == 1}
        name = self.shown if self.shown is not None else next(iter(scalars), None)
        if name is None:
            return "displacement [cm]", self._distance()
        if name not in scalars:
            raise CaseError(f"no such field; there are {', '.join(scalars)}", key="field", value=name)
        return name, scalars[name]

    def _distance(self) -> Array:
        if self.reference is None:
            return np.zeros(len(self.points))
        return np.linalg.norm(self.points - self.reference, axis=1)


def write_body(path: Path, body: Body) -> Path:
    """Write a body with all its fields for ParaView, one ``.vtu``."""
    import meshio

    data = {name: np.asarray(values) for name, values in body.values.items()}
    if body.reference is not None:
        data["displacement [cm]"] = body.points - body.reference
    cells = [(NAMES[int(kind)], np.asarray(nodes)) for kind, nodes in body.cells.items() if len(nodes)]
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}")
    meshio.Mesh(body.points, cells, point_data=data).write(temporary, file_format="vtu")
    temporary.replace(path)
    return path


def read_body(path: Path) -> Body:
    """Read a ``.vtu`` that `write_body` or a run has written.

    Raises:
        CaseError: It is missing or holds no solid.
    """
    mesh = read_mesh_file(Path(path), ("vtu",))
    cells = {KINDS[block.type]: block.data for block in mesh.cells if block.type in KINDS}
    if not cells:
        raise CaseError("no cells that can be drawn", file=path)
    points = np.asarray(mesh.points, dtype=float)
    values = {name: np.asarray(data).squeeze() for name, data in mesh.point_data.items()}
    for name, blocks in mesh.cell_data.items():
        values.setdefault(name, _to_nodes(len(points), mesh.cells, blocks))
    moved = values.get("displacement [cm]", values.get("displacement"))
    return Body(
        points=points, cells=cells, values=values, reference=None if moved is None else points - moved
    )


def _to_nodes(count: int, cells: Sequence[meshio.CellBlock], blocks: Sequence[Array]) -> Array:
    """Average values of cells in their nodes."""
    sums, number = np.zeros(count), np.zeros(count)
    for block, data in zip(cells, blocks, strict=True):
        np.add.at(sums, block.data, np.asarray(data, dtype=float).reshape(-1, 1))
        np.add.at(number, block.data, 1.0)
    return sums / np.maximum(number, 1.0)


def outer_faces(body: Body) -> list[Array]:
    """Return the faces that belong to one cell only, and flat cells, one array for each number of corners."""
    found: dict[int, list[Indices]] = {}
    for kind, block in body.cells.items():
        if not len(block):
            continue
        corners = CORNERS[int(kind)]
        for face in (range(corners),) if int(kind) in FLAT else FACES[corners]:
            found.setdefault(len(face), []).append(np.asarray(block)[:, list(face)])
    outer = []
    for parts in found.values():
        faces = np.concatenate(parts)
        _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
        outer.append(faces[first[count == 1]])
    return outer
