"""Polynomial chaos: orthonormal polynomials, closed-form indices, its own error against independent points."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import ndtri

from valvefsi.studies.polynomial_chaos import basis, fit_chaos, latin_hypercube, terms_of

# Ishigami and Homma (1990) with a = 7, b = 0.1: closed forms of Saltelli et al. (2008), section 4.
A, B = 7.0, 0.1
VARIANCE = A**2 / 8 + B * np.pi**4 / 5 + B**2 * np.pi**8 / 18 + 0.5
FIRST = np.array([0.5 * (1 + B * np.pi**4 / 5) ** 2, A**2 / 8, 0.0]) / VARIANCE
TOTAL = FIRST + np.array([1.0, 0.0, 1.0]) * B**2 * np.pi**8 * (1 / 18 - 1 / 50) / VARIANCE


def ishigami(u):
    x = np.pi * (2 * u - 1)
    return np.sin(x[:, 0]) + A * np.sin(x[:, 1]) ** 2 + B * x[:, 2] ** 4 * np.sin(x[:, 0])


def test_the_polynomials_are_orthonormal():
    terms = terms_of(2, 3)
    assert terms[0] == (0, 0)
    assert len(terms) == math.comb(5, 3) == len(set(terms))
    x, wx = np.polynomial.legendre.leggauss(12)
    z, wz = np.polynomial.hermite_e.hermegauss(12)
    u = np.stack(
        np.meshgrid((x + 1) / 2, 0.5 * (1 + np.vectorize(math.erf)(z / np.sqrt(2))), indexing="ij"), -1
    )
    weights = np.outer(wx / 2, wz / wz.sum()).ravel()
    psi = basis(u.reshape(-1, 2), ("uniform", "normal"), terms)
    assert psi.T @ (weights[:, None] * psi) == pytest.approx(np.eye(len(terms)), abs=1e-9)


def test_a_polynomial_is_found_exactly_with_its_indices():
    """y = 3 + 2 z1 - x2 + z1 x2, z1 normal, x2 uniform in -1..1: variances 4, 1/3, 1/3."""
    u = latin_hypercube(2, 30, 1)
    z, x = ndtri(u[:, 0]), 2 * u[:, 1] - 1
    chaos = fit_chaos(u, 3 + 2 * z - x + z * x, ("normal", "uniform"), 4)
    assert (chaos.degree >= 2, chaos.relative_error < 1e-20) == (True, True)
    assert (chaos.mean, chaos.variance) == (pytest.approx(3.0), pytest.approx(14 / 3))
    first, about = chaos.indices(("z", "x"), "first")
    assert first == pytest.approx([12 / 14, 1 / 14])
    assert about == pytest.approx(np.array([[12 / 14] * 2, [1 / 14] * 2]))
    assert chaos.indices(("z", "x"), "total")[0] == pytest.approx([13 / 14, 2 / 14])
    assert chaos.indices(("both", "both"), "first")[0] == pytest.approx([1.0]), (
        "a group keeps its interactions"
    )


def test_the_indices_of_ishigamis_function_lie_in_the_intervals_of_few_runs():
    u = latin_hypercube(3, 250, 3)
    chaos = fit_chaos(u, ishigami(u), ("uniform",) * 3, 7)
    for kind, exact in (("first", FIRST), ("total", TOTAL)):
        found, about = chaos.indices(("a", "b", "c"), kind)
        assert found == pytest.approx(exact, abs=0.05)
        assert ((about[:, 0] - 0.01 <= exact) & (exact <= about[:, 1] + 0.01)).all()
        assert (np.diff(about, axis=1) < 0.2).all()


def test_the_leave_one_out_error_is_that_of_refits_and_near_that_at_new_points():
    u = latin_hypercube(2, 24, 5)
    y = np.exp(u[:, 0]) * np.sin(3 * u[:, 1])
    chaos = fit_chaos(u, y, ("uniform",) * 2, 2)
    missed = []
    for k in range(len(y)):
        rest = np.arange(len(y)) != k
        psi = basis(u, chaos.germs, chaos.terms)
        c = np.linalg.lstsq(psi[rest], y[rest])[0]
        assert c == pytest.approx(chaos.left_out[k], rel=1e-6, abs=1e-9)
        missed.append(y[k] - psi[k] @ c)
    assert chaos.error == pytest.approx(np.sqrt(np.mean(np.square(missed))), rel=1e-6)
    new = np.random.default_rng(0).random((4000, 2))
    truth = np.exp(new[:, 0]) * np.sin(3 * new[:, 1])
    actual = np.sqrt(np.mean((chaos(new) - truth) ** 2))
    assert actual / 2 < chaos.error < 3 * actual
    assert chaos.relative_error >= chaos.error**2 / np.var(y)


def test_what_no_polynomial_of_the_inputs_follows_has_a_large_error():
    u = latin_hypercube(2, 40, 2)
    noise = np.random.default_rng(1).standard_normal(40)
    assert fit_chaos(u, noise, ("uniform",) * 2, 4).relative_error > 0.8


def test_too_few_runs_and_tables_of_samples_are_refused():
    u = latin_hypercube(3, 5, 0)
    with pytest.raises(ValueError, match="5 runs are too few for 3 variates: 6 or more"):
        fit_chaos(u, u[:, 0], ("uniform",) * 3, 2)
    with pytest.raises(ValueError, match="no polynomial follows rows"):
        fit_chaos(latin_hypercube(1, 9, 0), np.arange(9.0), ("none",), 2)


def test_a_latin_hypercube_has_one_point_in_every_layer():
    u = latin_hypercube(3, 17, 4)
    for column in u.T:
        assert sorted((17 * column).astype(int)) == list(range(17))
    assert not np.allclose(u[:, 0], u[:, 1])
