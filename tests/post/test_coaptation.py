"""Coaptation, places of a leaflet and volumes of its nodes, on plates and blocks."""

from __future__ import annotations

import numpy as np
import pytest

from valvefsi.post.coaptation import coaptation
from valvefsi.post.leaflet_places import PLACES, largest, node_volumes, places

COUNT = 10


def plate(x=0.0, normal=1.0, shift=0.0, count=COUNT):
    """A unit square across the x axis, normal along or against it: points, faces."""
    y, z = np.meshgrid(np.linspace(0, 1, count + 1), np.linspace(0, 1, count + 1) + shift, indexing="ij")
    points = np.stack([np.full(y.size, x), y.ravel(), z.ravel()], axis=1)
    index = np.arange(y.size).reshape(y.shape)
    faces = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 4)
    return points, faces if normal > 0 else faces[:, ::-1]


def together(*plates):
    points, faces, owner, count = [], [], [], 0
    for number, (x, corners) in enumerate(plates):
        points.append(x)
        faces.append(corners + count)
        owner.append(np.full(len(corners), number))
        count += len(x)
    return np.concatenate(points), np.concatenate(faces), np.concatenate(owner)


def turned(surface, angle):
    """The same surface elsewhere in space."""
    points, faces, owner = surface
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    return points @ R.T + [3.0, -1.0, 2.0], faces, owner


@pytest.mark.parametrize("angle", [0.0, 0.7])
@pytest.mark.parametrize(("shift", "overlap"), [(0.0, 1.0), (0.3, 0.7), (-0.6, 0.4)])
def test_two_plates_touch_where_they_overlap(shift, overlap, angle):
    facing = turned(together(plate(), plate(0.08, -1.0, shift)), angle)
    found = coaptation(*facing, edge=2.0, reach=0.1)
    # A face at the seam counts, or not: one row in ten.
    assert found.area == pytest.approx(overlap, abs=0.051 if overlap < 1 else 1e-12)
    assert found.height == pytest.approx(overlap, abs=0.051 if overlap < 1 else 1e-12)
    assert found.gap == pytest.approx(0.08, rel=1e-9)


@pytest.mark.parametrize("count", [8, 32])
def test_the_overlap_is_right_to_less_than_a_row_of_faces(count):
    for shift in np.linspace(0.1, 0.9, 9):
        facing = together(plate(count=count), plate(0.08, -1.0, shift, count=count))
        assert coaptation(*facing, edge=2.0, reach=0.1).area == pytest.approx(1.0 - shift, abs=0.71 / count)


def test_plates_apart_turned_away_or_of_one_leaflet_do_not_touch():
    apart = coaptation(*together(plate(), plate(0.11, -1.0)), edge=2.0, reach=0.1)
    assert (apart.area, apart.height, apart.gap) == (0.0, 0.0, None)
    assert coaptation(*together(plate(), plate(0.08, 1.0)), edge=2.0, reach=0.1).area == 0.0
    points, faces, owner = together(plate(), plate(0.08, -1.0))
    assert coaptation(points, faces, 0 * owner, edge=2.0, reach=0.1).area == 0.0
    assert coaptation(*together(plate(), plate(0.08, -1.0)), edge=2.0, reach=0.07).area == 0.0


def test_three_leaflets_that_meet_count_every_contact_once():
    """Three pairs of plates in turn, each plate touching one of the next leaflet."""
    pairs = [(plate(4.0 * k), plate(4.0 * k + 0.05, -1.0)) for k in range(3)]
    points, faces, _ = together(*[p for pair in pairs for p in pair])
    owner = np.repeat([0, 1, 1, 2, 2, 0], COUNT**2)
    found = coaptation(points, faces, owner, edge=6.0, reach=0.1)
    assert found.area == pytest.approx(3.0, rel=1e-12)
    assert found.height == pytest.approx(1.0, rel=1e-12)


def test_the_places_of_a_rectangular_leaflet():
    y, z = (a.ravel() for a in np.meshgrid(np.linspace(0, 2, 41), np.linspace(0, 1, 21), indexing="ij"))
    nodes = np.stack([0.0 * y, y, z], axis=1)
    free = [np.stack([np.zeros(81), np.linspace(0, 2, 81), np.ones(81)], axis=1)]
    s = np.linspace(0, 1, 81)
    sides = [
        np.stack([0 * s, 0 * s, s], 1),
        np.stack([0 * s, 2 * s, 0 * s], 1),
        np.stack([0 * s, 2 + 0 * s, s], 1),
    ]
    found = places(nodes, free, [np.concatenate(sides)], 0.22)
    for place, inside in (
        ("belly", (np.abs(y - 1) < 0.75) & (np.abs(z - 0.5) < 0.25)),
        ("free_edge", (np.abs(y - 1) < 0.75) & (z > 0.8)),
        ("commissure", ((y < 0.15) | (y > 1.85)) & (z > 0.85)),
        ("attached_edge", (np.abs(y - 1) < 0.75) & (z < 0.2)),
    ):
        assert inside.any()
        assert (found[inside] == PLACES.index(place)).all(), place
    assert set(found) == {0, 1, 2, 3}


def block(count):
    """Hexahedra of a skewed box, whose volume is 6, and their corners in VTK's order."""
    n = count + 1
    i, j, k = (a.ravel() for a in np.meshgrid(*3 * [np.arange(n)], indexing="ij"))
    points = (
        np.stack([i, j, k], axis=1) / count @ np.array([[1.0, 0.2, 0.0], [0.0, 2.0, 0.5], [0.3, 0.0, 3.0]])
    )
    index = np.arange(n**3).reshape(n, n, n)
    a, b = slice(None, -1), slice(1, None)
    order = [(a, a, a), (b, a, a), (b, b, a), (a, b, a), (a, a, b), (b, a, b), (b, b, b), (a, b, b)]
    return points, np.stack([index[place].ravel() for place in order], axis=1)


def test_the_volumes_of_nodes_are_those_of_the_body():
    points, cells = block(3)
    volumes = node_volumes(points, cells)
    expected = abs(np.linalg.det([[1.0, 0.2, 0.0], [0.0, 2.0, 0.5], [0.3, 0.0, 3.0]]))
    assert volumes.sum() == pytest.approx(expected, rel=1e-12)
    assert volumes.min() == pytest.approx(expected / 27 / 8, rel=1e-12), "a corner has an eighth of a cell"
    tetrahedron = node_volumes(
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]), np.array([[0, 1, 2, 3]])
    )
    assert tetrahedron == pytest.approx(np.full(4, 1 / 24))


def test_the_largest_values_are_by_place_and_by_volume():
    values, volumes = np.array([1.0, 2.0, 9.0, 4.0]), np.array([1.0, 1.0, 0.001, 1.0])
    found = largest({"s": values}, volumes, np.array([0, 0, 0, 3]))
    assert found == {"belly": {"s": (2.0, 9.0)}, "attached_edge": {"s": (4.0, 4.0)}}
