"""Surfaces of meshes as triangles, from cells in VTK's order, linear and quadratic."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

TETRAHEDRON = [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]
HEXAHEDRON = [[0, 1, 2, 3], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
# Corners, then the middles of the edges between them, then the middle of the face.
QUADRATIC_TETRAHEDRON = [[0, 1, 2, 4, 5, 6], [0, 1, 3, 4, 8, 7], [0, 2, 3, 6, 9, 7], [1, 2, 3, 5, 9, 8]]
QUADRATIC_HEXAHEDRON = [
    [0, 1, 2, 3, 8, 9, 10, 11, 24],
    [4, 5, 6, 7, 12, 13, 14, 15, 25],
    [0, 1, 5, 4, 8, 17, 12, 16, 22],
    [1, 2, 6, 5, 9, 18, 13, 17, 21],
    [2, 3, 7, 6, 10, 19, 14, 18, 23],
    [3, 0, 4, 7, 11, 16, 15, 19, 20],
]
FACES = {
    10: (TETRAHEDRON, 3),
    12: (HEXAHEDRON, 4),
    71: (QUADRATIC_TETRAHEDRON, 3),
    72: (QUADRATIC_HEXAHEDRON, 4),
}
"""Nodes of the faces of a cell and how many of them are corners, by its VTK type (Lagrange cells of degree 2)."""
PIECES = {
    3: [[0, 1, 2]],
    4: [[0, 1, 2], [0, 2, 3]],
    6: [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]],
    9: [[k, (k + 1) % 8, 8] for k in range(8)],
}
"""Triangles of a face, by its number of nodes; of nine, the eight around the middle, walked by `AROUND`."""
AROUND = [0, 4, 1, 5, 2, 6, 3, 7, 8]


def surface_triangles(kind: int, cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the faces that belong to one cell alone, as triangles ``(num_triangles, 3)`` of node numbers.

    Args:
        kind: VTK's type of the cells, a key of `FACES`.
        cells: Nodes in VTK's order, ``(num_cells, k)``.
    """
    sides, corners = FACES[kind]
    faces = cells[:, sides].reshape(-1, len(sides[0]))
    ends = np.sort(faces[:, :corners], axis=1)
    _, first, count = np.unique(ends, axis=0, return_index=True, return_counts=True)
    outer = faces[first[count == 1]]
    if outer.shape[1] == len(AROUND):
        outer = outer[:, AROUND]
    return np.concatenate([outer[:, piece] for piece in PIECES[outer.shape[1]]])
