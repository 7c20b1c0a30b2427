"""Open area of an orifice under sheets, rings and leaflets of known area."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import zeta

from tests.valve_shapes import UP, leaflets, rectangle, ring, together, turn
from valvefsi.post.diagnostics.projected_area import end_view, open_image, projected_area


def test_without_leaflets_the_whole_orifice_is_open():
    got = projected_area(np.zeros((0, 3)), np.zeros((0, 3), dtype=int), radius=1.25, **UP)
    assert got.open_area == pytest.approx(np.pi * 1.25**2, rel=1e-14)
    assert (got.fraction, got.error) == (1.0, 0.0)


def test_a_sheet_over_the_orifice_leaves_nothing_open():
    got = projected_area(*rectangle(-3, 3, -3, 3), radius=1.25, **UP)
    assert got.open_area == pytest.approx(0, abs=1e-13)
    assert got.error < 1e-13


def test_half_a_sheet_leaves_half_open():
    got = projected_area(*rectangle(-3, 3, 0, 3), radius=1.25, **UP)
    assert got.fraction == pytest.approx(0.5, abs=1e-4)
    off = projected_area(*rectangle(-3, 3, 0.4, 3), radius=1.25, **UP)
    cap = 1.25**2 * np.arccos(0.4 / 1.25) - 0.4 * np.sqrt(1.25**2 - 0.4**2)
    assert off.covered_area == pytest.approx(cap, abs=5e-4)


def test_what_lies_twice_over_a_place_counts_once():
    one = rectangle(-1, 0.5, -0.5, 0.5)
    single, double = (
        projected_area(*mesh, radius=2, **UP)
        for mesh in (one, together(one, rectangle(-1, 0.5, -0.5, 0.5, 0.3)))
    )
    assert double.covered_area == pytest.approx(single.covered_area, rel=1e-13)
    crossed = projected_area(*together(one, rectangle(-0.5, 1, -0.3, 0.3, 0.2)), radius=2, **UP)
    assert crossed.covered_area == pytest.approx(1.5 + 0.5 * 0.6, abs=1e-3)


def test_a_ring_covers_its_own_area_only():
    points, triangles, area = ring(0.6, 1.0)
    got = projected_area(points, triangles, radius=1.25, **UP)
    assert got.covered_area == pytest.approx(area, rel=2e-4)
    wide, triangles, _ = ring(0.6, 3.0)
    got = projected_area(wide, triangles, radius=1.25, **UP)
    assert got.open_area == pytest.approx(
        0.36 * np.pi * 120 / (2 * np.pi) * np.sin(2 * np.pi / 120), rel=3e-4
    )


@pytest.mark.parametrize("angle", [0.3, 1.0, 1.5])
def test_a_tilted_disc_covers_its_cosine(angle):
    points, triangles, area = ring(0.0, 1.0)
    tilted = points @ turn((1, 2, 0), angle).T + (0, 0, 4)
    got = projected_area(tilted, triangles, radius=1.25, **UP)
    assert got.covered_area == pytest.approx(area * np.cos(angle), abs=4e-4)


def test_a_sheet_seen_from_its_edge_covers_nothing():
    points, triangles, _ = ring(0.0, 1.0)
    got = projected_area(points @ turn((1, 0, 0), np.pi / 2).T, triangles, radius=1.25, **UP)
    assert got.covered_area == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("angle", [0.2, 0.9, 2.2])
def test_a_turn_about_the_axis_changes_nothing(angle):
    points, triangles, *_, area = leaflets(0.7)
    around = turn((0, 0, 1), angle)
    got = projected_area(points @ around.T, triangles, radius=1.25, **UP)
    assert got.open_area == pytest.approx(area, abs=4e-4)


def test_a_turn_and_a_shift_of_everything_change_nothing():
    points, triangles, *_, area = leaflets(0.4)
    whole, shift = turn((1, -2, 0.5), 1.1), np.array([3.0, -1.0, 7.0])
    got = projected_area(
        points @ whole.T + shift, triangles, axis=5 * whole[:, 2], centre=shift + whole[:, 2], radius=1.25
    )
    assert got.open_area == pytest.approx(area, abs=4e-4)


@pytest.mark.parametrize("opening", [0.05, 0.3, 0.6, 0.95])
def test_the_error_is_no_less_than_what_is_found(opening):
    points, triangles, *_, area = leaflets(opening)
    got = projected_area(points, triangles, radius=1.25, **UP)
    assert abs(got.open_area - area) <= got.error + 1e-12
    assert got.error < 4e-4 * got.orifice_area


def test_the_error_falls_with_the_lines_as_on_paper():
    """Over all directions and places of the lines, a distance h apart, the mean square error is known.

    An edge at an angle a to the lines leaves h^2 cot(a) [B2(u) - B2(v)]/2, with u and v the places of its ends
    between two lines. The mean square over u and the integral over a are zeta(3)/(2 pi^2) l h^3 for the length l,
    all of it from edges nearly along the lines: order 1.5, not 2. Here opposite edges err alike, two directions
    are averaged and edges repeat every 30 degrees.
    """
    points, triangles, area = ring(0.45, 1.0, corners=12)
    turns = np.arange(400)

    def error(rows):
        found = [
            projected_area(points @ turn((0, 0, 1), a).T, triangles, radius=r, rows=rows, **UP).covered_area
            for a, r in zip(
                np.pi / 6 * (turns + 0.5) / 400, 1.2 + 0.1 * np.mod(0.618034 * turns, 1), strict=True
            )
        ]
        return np.sqrt(np.mean((np.array(found) - area) ** 2))

    def on_paper(rows):
        edges = [(2 * r * np.sin(np.pi / 12), r * np.cos(np.pi / 12)) for r in (0.45, 1.0)]
        squares = [length * (np.pi / rows * np.sqrt(1.25**2 - y**2)) ** 3 for length, y in edges]
        return np.sqrt(sum(squares) * zeta(3) / (2 * np.pi**2) * 2**2 / 2 / (np.pi / 6))

    # At 1024 lines some 50 of the 800 directions hold the error: its sample is good to about 15 %.
    for rows in (64, 256, 1024):
        assert error(rows) == pytest.approx(on_paper(rows), rel=0.3), rows


def test_the_image_shows_the_area():
    points, triangles, *_ = leaflets(0.6)
    got = projected_area(points, triangles, radius=1.25, **UP)
    image = open_image(points, triangles, radius=1.25, pixels=500, **UP)
    assert image.sum() * (2.5 / 500) ** 2 == pytest.approx(got.open_area, rel=5e-3)
    assert open_image(*rectangle(-3, 3, -3, 3), radius=1.25, pixels=101, **UP).sum() == 0
    upper = open_image(*rectangle(-3, 3, -3, 0), radius=1.25, pixels=100, **UP)
    assert upper[50:].any()
    assert not upper[:50].any()


def test_the_view_is_right_handed_and_from_downstream():
    points = np.array([[1.0, 2.0, 3.0]])
    np.testing.assert_allclose(end_view(points, (0, 0, 2), (0, 0, 1)), [[1, 2, 2]])
    frame = end_view(np.eye(3), (1, 2, -0.5), (0, 0, 0))
    np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-14)
    assert np.linalg.det(frame) == pytest.approx(1)
    np.testing.assert_allclose(end_view([[1, 2, -0.5]], (1, 2, -0.5), (0, 0, 0))[0, :2], 0, atol=1e-14)


def test_wrong_surfaces_are_refused():
    points, triangles = rectangle(-1, 1, -1, 1)
    with pytest.raises(ValueError, match="triangles: expected points 0 to 3, found 1 to 4"):
        projected_area(points, triangles + 1, radius=1, **UP)
    with pytest.raises(ValueError, match="radius: expected a positive length"):
        projected_area(points, triangles, radius=0, **UP)
    with pytest.raises(ValueError, match="axis: expected a direction"):
        projected_area(points, triangles, radius=1, axis=(0, 0, 0), centre=(0, 0, 0))
    with pytest.raises(ValueError, match="points: expected finite positions"):
        projected_area(points * np.nan, triangles, radius=1, **UP)
