"""Order, Richardson value and grid convergence index against printed examples; norms against integrals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.verification.convergence import extrapolated, grid_convergence, observed_order, ratios_of
from valvefsi.verification.norms import error_norms, normalised_difference, time_norm

# Values from the coarsest grid on, cells of the plane grids; order, extrapolated, e_a, e_ext and index [%] as printed.
CELIK = [
    ((5.863, 5.972, 6.063), (4500, 8000, 18000), (1.53, 6.1685, 1.5, 1.7, 2.2)),
    ((10.6050, 10.7250, 10.7880), (980, 4500, 18000), (0.75, 10.8801, 0.6, 0.9, 1.1)),
    ((6.0909, 5.9624, 6.0042), (980, 4500, 18000), (1.51, 6.0269, 0.7, 0.4, 0.5)),
]


@pytest.mark.parametrize(("values", "cells", "printed"), CELIK)
def test_the_examples_of_celik_et_al_2008_come_out_as_printed(values, cells, printed):
    found = grid_convergence(values, ratios_of([math.sqrt(n) for n in cells]))
    order, limit, change, error, index = printed
    assert found.order == pytest.approx(order, abs=6e-3)
    assert found.extrapolated == pytest.approx(limit, abs=5e-4)  # half of the last digit of the values
    assert 100 * found.change == pytest.approx(change, abs=0.051)
    assert 100 * found.error == pytest.approx(error, abs=0.055)  # there from an order rounded to 0.75
    assert 100 * found.index == pytest.approx(index, abs=0.051)
    assert found.oscillating == (values is CELIK[2][0])


def test_the_pressure_recovery_example_of_the_nparc_alliance_comes_out_as_printed():
    """Slater's tutorial: 0.96178, 0.96854, 0.97050 on grids of ratio 2."""
    found = grid_convergence([0.96178, 0.96854, 0.97050])
    assert found.order == pytest.approx(1.78618, abs=2e-5)
    assert found.extrapolated == pytest.approx(0.97130, abs=5e-6)
    assert found.index == pytest.approx(1.03083e-3, abs=1e-8)
    assert grid_convergence([0.96178, 0.96854, 0.97050, 0.97050 + 1e-3]) != found, "the last three count"


@pytest.mark.parametrize("ratios", [2.0, 1.5, [3.0, 2.0, 1.25]])
@pytest.mark.parametrize("order", [0.5, 1.0, 2.5])
def test_a_series_of_known_order_is_seen_through(ratios, order):
    steps = ratios if isinstance(ratios, list) else [ratios] * 3
    sizes = np.cumprod([1.0, *steps])
    values = list(3.0 + 0.7 * sizes**-order)
    assert ratios_of(list(sizes)) == pytest.approx(steps)
    assert observed_order(values, ratios) == pytest.approx(order)
    assert observed_order(values, ratios, exact=3.0) == pytest.approx(order)
    assert extrapolated(values, ratios) == pytest.approx(3.0)
    assert grid_convergence(values, ratios).extrapolated == pytest.approx(3.0)


def test_what_shows_no_order_has_none():
    assert observed_order([1.0, 2.0]) is None
    assert observed_order([2.0, 1.5], exact=1.0) == pytest.approx(1.0)
    assert observed_order([1.0, 1.1, 1.05]) is None, "the differences change sign"
    assert observed_order([1.0, 1.0, 1.0]) is None
    assert observed_order([0.5, -0.1], exact=0.0) is None
    assert observed_order([1.0, 2.0, 4.0]) == pytest.approx(-1.0), "it diverges"
    assert observed_order([1.0, 2.0, 4.0], [1.5, 2.0]) < 0.0
    assert extrapolated([1.0, 2.0, 4.0]) is None
    assert grid_convergence([1.0, 2.0]) is None
    assert grid_convergence([1.0, 2.0, 4.0]) is None
    with pytest.raises(ValueError, match="a ratio above 1"):
        observed_order([1.0, 2.0, 3.0], [2.0])
    with pytest.raises(ValueError, match="a ratio above 1"):
        observed_order([1.0, 2.0, 3.0], 0.5)


def test_norms_over_time_are_those_of_the_integrals():
    t = np.linspace(0.0, 2.0, 20001)
    x = np.sin(np.pi * t)
    assert time_norm(t, x, 1.0) == pytest.approx(4.0 / np.pi, rel=1e-7)
    assert time_norm(t, x, 2.0) == pytest.approx(1.0, rel=1e-7)
    assert time_norm(t, x, math.inf) == pytest.approx(1.0, rel=1e-7)
    for q in (1.0, 2.0, math.inf):
        assert normalised_difference(t, 1.03 * x, x, q) == pytest.approx(0.03, rel=1e-9)
    uneven = np.concatenate([t[:10000:7], t[10000:]])
    assert time_norm(uneven, np.sin(np.pi * uneven)) == pytest.approx(1.0, rel=1e-5), "whatever the spacing"
    with pytest.raises(ValueError, match="1, 2 or infinity"):
        time_norm(t, x, 3.0)


def test_norms_of_errors_count_the_points_of_all_ranks(comm):
    found = error_norms(np.array([3.0, -4.0]))
    assert (found.L1, found.L2, found.largest) == pytest.approx((3.5, math.sqrt(12.5), 4.0))
    mine = np.full(3, 1.0 + comm.rank)
    norms = error_norms(mine, comm)
    ranks = np.arange(1.0, comm.size + 1.0)
    assert pytest.approx((ranks.mean(), math.sqrt((ranks**2).mean()))) == (norms.L1, norms.L2)
    assert norms.largest == comm.size
    assert error_norms(np.zeros(0) if comm.rank else np.ones(2), MPI.COMM_WORLD).L1 == 1.0
