"""Saltelli's design and its indices against closed forms: Ishigami, a linear model, a product of Gaussians."""

from __future__ import annotations

import builtins

import numpy as np
import pytest
from scipy.special import ndtri

from tests.studies.test_polynomial_chaos import FIRST, TOTAL, ishigami
from valvefsi.errors import SurroundingsError
from valvefsi.studies.sobol_design import independent_points, saltelli_design, sobol_indices, whole_blocks

THREE = ("a", "b", "c")


@pytest.fixture(autouse=True)
def _salib(request):
    if "without" not in request.node.name:
        pytest.importorskip("SALib", reason="make setup installs it")


def found(function, of_variates=THREE, size=4096):
    u = saltelli_design(of_variates, size, 0)
    return sobol_indices(of_variates, function(u), 0)


def assert_indices(indices, first, total):
    assert indices.first == pytest.approx(first, abs=0.03)
    assert indices.total == pytest.approx(total, abs=0.03)


def test_ishigamis_function():
    assert_indices(found(ishigami), FIRST, TOTAL)


def test_the_intervals_hold_the_closed_forms_about_as_often_as_they_say():
    """Of 40 designs of 256 blocks, for six indices each: 95 % by the normal theory of the resamples."""
    inside = []
    for seed in range(40):
        indices = sobol_indices(THREE, ishigami(saltelli_design(THREE, 256, seed)), seed)
        for exact, about in ((FIRST, indices.first_interval), (TOTAL, indices.total_interval)):
            inside += list((about[:, 0] <= exact) & (exact <= about[:, 1]))
    assert 0.9 <= np.mean(inside) <= 1.0


def test_a_linear_model_of_normal_inputs():
    """y = z1 + 2 z2 + 3 z3: parts 1, 4 and 9 of 14, and nothing together."""
    parts = np.array([1.0, 4.0, 9.0]) / 14
    assert_indices(found(lambda u: ndtri(np.clip(u, 1e-9, 1 - 1e-9)) @ [1.0, 2.0, 3.0]), parts, parts)


def test_a_product_of_gaussians():
    """y = z1 z2 z3 with means m: V_i = s_i^2 prod m_j^2, all of it prod(m^2 + s^2) - prod m^2."""
    m, s = np.array([1.0, 2.0, 1.5]), np.array([0.3, 0.5, 0.2])
    whole = np.prod(m**2 + s**2) - np.prod(m**2)
    first = s**2 * np.prod(m**2) / m**2 / whole
    total = s**2 * np.prod(m**2 + s**2) / (m**2 + s**2) / whole
    assert_indices(found(lambda u: np.prod(m + s * ndtri(np.clip(u, 1e-9, 1 - 1e-9)), axis=1)), first, total)


def test_variates_of_a_group_have_one_index_with_what_they_do_together():
    """y = z1 z2 + z3, the first two a group: halves, and nothing beyond."""
    of_variates = ("pair", "pair", "single")
    u = saltelli_design(of_variates, 4096, 0)
    assert u.shape == (4096 * 4, 3)
    z = ndtri(np.clip(u, 1e-9, 1 - 1e-9))
    indices = sobol_indices(of_variates, z[:, 0] * z[:, 1] + z[:, 2], 0)
    assert indices.groups == ("pair", "single")
    assert_indices(indices, np.array([0.5, 0.5]), np.array([0.5, 0.5]))


def test_a_block_with_a_run_that_failed_is_left_out_whole():
    u = saltelli_design(THREE, 128, 0)
    done = np.ones(len(u), dtype=bool)
    done[[7, 333]] = False
    kept = whole_blocks(THREE, done)
    assert (~kept).sum() == 10
    assert not kept[5:10].any()
    exact = ishigami(u)
    spoilt = np.where(done, exact, np.nan)
    assert np.isfinite(sobol_indices(THREE, spoilt[kept], 0).total).all()
    assert np.isnan(spoilt[~kept]).sum() == 2


def test_the_points_of_a_and_b_are_a_sample_of_the_inputs():
    u = saltelli_design(THREE, 64, 1)
    chosen = independent_points(THREE, len(u))
    assert chosen.sum() == 128
    assert len(np.unique(u[chosen], axis=0)) == 128
    assert u[chosen].mean(axis=0) == pytest.approx(0.5, abs=0.02)


def test_it_says_what_to_install_without_the_library(monkeypatch):
    real = builtins.__import__

    def missing(name, *args, **options):
        if name.startswith("SALib"):
            raise ImportError(name)
        return real(name, *args, **options)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(SurroundingsError, match=r"pip install .*\[uncertainty\]"):
        saltelli_design(THREE, 8, 0)
