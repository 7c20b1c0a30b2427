"""What grids say of a quantity: converging, oscillating, diverging, slow; uncertainties against printed rules."""

from __future__ import annotations

import math

import pytest

from valvefsi.verification.convergence import STEEPEST, order_of_differences, ratios_of
from valvefsi.verification.refinement import refinement, two_grid_error, uncertainty_of

# Celik et al. (2008), table 1: values from the coarsest grid on, cells; order and index [%] as printed there.
CELIK = [
    ((5.863, 5.972, 6.063), (4500, 8000, 18000), "monotone", 1.53, 2.2),
    ((10.6050, 10.7250, 10.7880), (980, 4500, 18000), "monotone", 0.75, 1.1),
    ((6.0909, 5.9624, 6.0042), (980, 4500, 18000), "oscillating", 1.51, 0.5),
]


@pytest.mark.parametrize(("values", "cells", "kind", "order", "index"), CELIK)
def test_the_examples_of_celik_et_al_2008_are_judged_as_printed(values, cells, kind, order, index):
    found = refinement(values, ratios_of([math.sqrt(n) for n in cells]), 2.0)
    assert found.kind == kind
    assert found.order == pytest.approx(order, abs=6e-3)
    assert 100 * found.index == pytest.approx(index, abs=0.051)
    assert ("OSCILLATING" in found.text) == (kind == "oscillating")
    assert (found.extrapolated is None) == (kind == "oscillating")


@pytest.mark.parametrize("order", [1.0, 2.0, 3.3])
def test_the_exact_value_lies_within_the_uncertainty_of_a_series_of_known_order(order):
    h = [1.0, 0.7, 0.4]
    found = refinement([3.0 + 0.2 * x**order for x in h], [1 / 0.7, 7 / 4], order)
    assert (found.kind, found.order) == ("monotone", pytest.approx(order))
    assert found.extrapolated == pytest.approx(3.0)
    assert found.uncertainty == pytest.approx(1.25 * 0.2 * 0.4**order)


def test_an_order_above_the_expected_one_is_not_taken_at_its_word():
    """p = 4 where 2 is expected: 3 |v1 - v2| / (2^2 - 1) and not 1.25 / (2^4 - 1) (Oberkampf and Roy 2010)."""
    found = refinement([2.0 + 4.0**-2, 2.0 + 4.0**-4, 2.0 + 4.0**-6], [2.0, 2.0], 2.0)
    assert found.order == pytest.approx(4.0)
    assert found.uncertainty == pytest.approx(4.0**-4 - 4.0**-6)
    assert found.uncertainty > 5 * found.index * 2.0
    assert "above the expected 2" in found.text


@pytest.mark.parametrize(
    ("values", "kind", "order", "said"),
    [
        ([1.0, 2.0, 4.0], "diverging", -1.0, "DIVERGING"),
        ([1.0, 2.0, -1.0], "diverging", -math.log2(3.0), "DIVERGING"),
        ([1.0, 1.0, 1.5], "diverging", None, "DIVERGING"),
        ([1.0, 2.0, 2.9], "slow", math.log2(1 / 0.9), "too slow"),
        ([1.0, 2.0, 2.0], "unchanged", None, "the same on the last grids"),
        ([0.0, 0.0, 0.0], "unchanged", None, "no order"),
        ([4.0, 1.0, 0.0], "slow", math.log2(3.0), "the finest value is 0"),
    ],
)
def test_what_does_not_converge_has_no_index_and_says_so(values, kind, order, said):
    found = refinement(values, [2.0, 2.0], 2.0)
    assert found.kind == kind
    assert found.order == (None if order is None else pytest.approx(order))
    assert said in found.text
    if kind != "unchanged":
        assert found.index is None
        assert found.extrapolated is None
    if kind == "diverging":
        assert found.uncertainty >= 3 * (max(values) - min(values))


def test_what_grows_apart_is_no_surer_than_three_times_its_spread():
    assert refinement([1.0, 2.0, 3.1], [3.0, 3.0], 1.0).uncertainty == pytest.approx(3 * 2.1)


def test_two_grids_have_an_uncertainty_and_one_has_none():
    found = refinement([1.0, 1.1], [1.5], 2.0)
    assert (found.kind, found.order, found.index) == ("two grids", None, None)
    assert found.uncertainty == pytest.approx(3 * 0.1 / 1.25)
    assert two_grid_error(-0.1, 1.5, 2.0) == pytest.approx(found.uncertainty)
    assert refinement([1.0], [], 2.0).uncertainty is None
    with pytest.raises(ValueError, match="a ratio above 1"):
        refinement([1.0, 2.0, 3.0], [2.0, 1.0], 2.0)
    with pytest.raises(ValueError, match="a ratio above 1"):
        refinement([1.0, 2.0], [2.0, 2.0], 2.0)


def test_the_uncertainty_of_a_low_order_is_taken_with_half_an_order_at_least():
    assert uncertainty_of((1.0, 2.0, 2.9), 2.0, 0.15, 2.0) == pytest.approx(3 * 0.9 / (math.sqrt(2) - 1))


def test_differences_steeper_than_any_method_have_an_end_and_no_error():
    assert order_of_differences(1e9, 1e-9, 1.01, 1.02) == STEEPEST
    assert order_of_differences(1e-9, 1e9, 1.01, 1.02) == -STEEPEST
    assert order_of_differences(-1e-9, 1e9, 1.01, 1.02) == -STEEPEST
