"""Offsets of surfaces in any direction, against sums over the planes and diagonals of a grid."""

from __future__ import annotations

import math

import numpy as np
import pytest

from valvefsi.coupling.kernels import BSPLINE, weights_at
from valvefsi.coupling.offsets import surface_offset
from valvefsi.coupling.wall_offset import wall_offset

X, Z = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
DIAGONAL = np.array([[1.0, 1.0, 0.0]]) / math.sqrt(2.0)


@pytest.mark.parametrize("kernel", ["piecewise_linear", "bspline3", "bspline5"])
def test_along_the_grid_it_is_that_of_one_plane(kernel):
    assert surface_offset(kernel, np.array([X]), Z) == pytest.approx(wall_offset(kernel), rel=1e-3)


def diagonal_offset(points_x, points_y):
    """The offset at 45 degrees by summation: along diagonals i + j = m the grid's Laplacian is twice that of a line.

    A plane's density on the diagonals is the mean of its points' weights along it; the flow in front of it as in
    `valvefsi.coupling.wall_offset`, with diagonals 1 / sqrt(2) apart.
    """
    wx, wy, offset, n = np.zeros(points_x), np.zeros(points_y), 0.0, 60
    for place in np.arange(n) / n:
        density = np.zeros(24)
        for s in (np.arange(n) + 0.5) / n:
            i = weights_at(wx, BSPLINE, points_x, 6.0 + s)
            j = weights_at(wy, BSPLINE, points_y, 6.0 + place - s)
            for a, b in np.ndindex(points_x, points_y):
                density[i + j + a + b] += wx[a] * wy[b] / n
        m = np.arange(24)
        offset += 0.5 / math.sqrt(2.0) * density @ np.abs(m[:, None] - m) @ density / n
    return offset


def test_at_45_degrees_it_is_that_of_sums_over_diagonals():
    expected = diagonal_offset(2, 2)
    assert surface_offset("piecewise_linear", DIAGONAL, Z) == pytest.approx(expected, rel=2e-3)
    assert surface_offset("composite_bspline32", DIAGONAL, Z) == pytest.approx(expected, rel=2e-3)


def test_a_composite_kernel_is_wider_along_the_component_that_flows():
    """Flow along (1, -1, 0) past (1, 1, 0): three points along x, two along y, and the other way round."""
    expected = diagonal_offset(3, 2)
    assert expected > 1.05 * diagonal_offset(2, 2)
    assert surface_offset("composite_bspline32", DIAGONAL, (1.0, -1.0, 0.0)) == pytest.approx(
        expected, rel=2e-3
    )


def test_kernels_other_than_splines_are_refused():
    with pytest.raises(ValueError, match="that of B-splines, ib4 is none"):
        surface_offset("ib4", DIAGONAL, Z)


def test_what_of_the_flow_is_normal_to_the_surface_does_not_count():
    tilted = (1.0, 1.0, 0.7)
    assert surface_offset("composite_bspline32", DIAGONAL, tilted) == pytest.approx(
        surface_offset("composite_bspline32", DIAGONAL, Z)
    )
