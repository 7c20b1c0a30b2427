"""Size and quality of meshes, against cells whose numbers are known."""

from __future__ import annotations

import numpy as np
import pytest

from valvefsi.io.solid_body import Body
from valvefsi.post.mesh_numbers import mesh_numbers

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
CUBE = np.concatenate([SQUARE, SQUARE + [0, 0, 1]])
REGULAR = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])[[0, 2, 1, 3]]
SHEARED = CUBE + CUBE[:, 2:] * [1.0, 0, 0]
EQUILATERAL = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, np.sqrt(0.75), 0]])


@pytest.mark.parametrize(
    ("kind", "points", "quality", "edges"),
    [
        (12, CUBE, 1.0, (1, 1)),
        (12, CUBE * [3, 1, 1], 1.0, (1, 3)),
        (12, SHEARED, np.sqrt(0.5), (1, np.sqrt(2))),
        (12, CUBE[[4, 5, 6, 7, 0, 1, 2, 3]], -1.0, (1, 1)),
        (10, REGULAR, 1.0, (np.sqrt(8), np.sqrt(8))),
        (9, SQUARE, 1.0, (1, 1)),
        (9, SQUARE[::-1], -1.0, (1, 1)),
        (5, EQUILATERAL, 1.0, (1, 1)),
        (5, EQUILATERAL * [1, 0, 0], 0.0, (0.5, 1)),
        (9, SQUARE @ np.array([[1, 0, 0], [0, 0, 1], [0, 1, 0.0]]), 1.0, (1, 1)),
    ],
)
def test_cells_have_their_edges_and_their_scaled_jacobian(kind, points, quality, edges):
    found = mesh_numbers(Body(points=points, cells={kind: np.arange(len(points))[None]}))
    assert found["smallest_scaled_jacobian"] == pytest.approx(quality, abs=1e-12)
    assert (found["smallest_edge_cm"], found["largest_edge_cm"]) == pytest.approx(edges)
    assert (found["nodes"], found["cells"]) == (len(points), 1)


def test_a_body_is_measured_without_its_load():
    body = Body(points=CUBE * 5.0, cells={12: np.arange(8)[None]}, reference=CUBE)
    assert mesh_numbers(body)["largest_edge_cm"] == pytest.approx(1.0)
