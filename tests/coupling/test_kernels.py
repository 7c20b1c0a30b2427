"""Moment conditions, continuity and published values of the one-dimensional kernels."""

from __future__ import annotations

import numpy as np
import pytest

from valvefsi.coupling.kernels import K5, K6, KERNELS, weights_at

SHIFTS = np.linspace(-2.0, 3.0, 1001)

# Per kernel: number of vanishing central moments from the first on, second moment, even-odd sums, sum of squares.
CONDITIONS = {
    "piecewise_linear": (1, None, False, None),
    "bspline3": (1, 1 / 4, False, None),
    "bspline4": (1, 1 / 3, False, None),
    "bspline5": (3, 5 / 12, False, None),
    "bspline6": (3, 1 / 2, False, None),
    "ib3": (1, None, False, 1 / 2),
    "ib4": (1, None, True, 3 / 8),
    "ib5": (3, K5, False, "constant"),
    "ib6": (3, K6, True, "constant"),
    "composite_bspline32": (1, 1 / 4, False, None),
    "composite_bspline43": (1, 1 / 3, False, None),
    "composite_bspline54": (3, 5 / 12, False, None),
    "composite_bspline65": (3, 1 / 2, False, None),
}


def weights(name, s):
    family, points, _ = KERNELS[name]
    w = np.full(points, np.nan)
    lowest = weights_at(w, family, points, s)
    return lowest + np.arange(points), w


def moment(name, s, power):
    position, w = weights(name, s)
    return (w * (position - s) ** power).sum()


@pytest.mark.parametrize("name", KERNELS)
def test_kernel_sums_to_one_and_keeps_the_centre_for_all_shifts(name):
    assert max(abs(moment(name, s, 0) - 1) for s in SHIFTS) < 2e-15
    assert max(abs(moment(name, s, 1)) for s in SHIFTS) < 5e-15


@pytest.mark.parametrize("name", [k for k, c in CONDITIONS.items() if c[1] is not None])
def test_second_moment_is_the_constant_of_the_kernel(name):
    assert max(abs(moment(name, s, 2) - CONDITIONS[name][1]) for s in SHIFTS) < 1e-14


@pytest.mark.parametrize("name", [k for k, c in CONDITIONS.items() if c[0] >= 3])
def test_third_moment_vanishes(name):
    assert max(abs(moment(name, s, 3)) for s in SHIFTS) < 1e-14


@pytest.mark.parametrize("name", [k for k, c in CONDITIONS.items() if c[2]])
def test_even_and_odd_sums_are_one_half(name):
    for s in SHIFTS:
        position, w = weights(name, s)
        assert abs(w[position % 2 == 0].sum() - 0.5) < 1e-15


@pytest.mark.parametrize("name", [k for k, c in CONDITIONS.items() if c[3] is not None])
def test_sum_of_squares_is_constant(name):
    squares = np.array([(weights(name, s)[1] ** 2).sum() for s in SHIFTS])
    expected = squares[0] if CONDITIONS[name][3] == "constant" else CONDITIONS[name][3]
    assert np.abs(squares - expected).max() < 1e-14


@pytest.mark.parametrize("name", KERNELS)
def test_kernel_is_even_not_negative_and_continuous(name):
    reach = KERNELS[name][1] / 2 + 1
    grid = np.linspace(-reach, reach, 4001)

    def phi(r):
        position, w = weights(name, r)
        return w[position == 0].sum()

    values = np.array([phi(r) for r in grid])
    assert np.abs(values - values[::-1]).max() < 1e-12
    assert values.min() > -1e-15
    steepest = 1.01 if name == "piecewise_linear" else 1.0
    assert np.abs(np.diff(values)).max() / (grid[1] - grid[0]) < steepest
    assert phi(KERNELS[name][1] / 2 + 1e-9) == pytest.approx(0, abs=1e-8)


@pytest.mark.parametrize(
    ("name", "r", "value"),
    [
        ("piecewise_linear", 0.3, 0.7),
        ("bspline3", 0.3, 3 / 4 - 0.09),  # Lee2020, S16
        ("bspline3", 1.0, 9 / 8 - 3 / 2 + 1 / 2),
        ("ib3", 0.0, 2 / 3),
        ("ib3", 1.0, 1 / 6),
        ("ib4", 0.0, 1 / 2),
        ("ib4", 1.0, 1 / 4),
        ("ib4", 0.5, (2 + np.sqrt(2)) / 8),
    ],
)
def test_kernel_takes_its_published_values(name, r, value):
    position, w = weights(name, r)
    assert w[position == 0].sum() == pytest.approx(value, abs=1e-14)
