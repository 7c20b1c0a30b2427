"""The mass matrix of elemental coupling against the assembled form, and the quadrature weights that are kept."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem, la

from tests.coupling.test_elemental import KINDS, make, nodal
from valvefsi.solid.elements import mass_kernels
from valvefsi.solid.elements.element_points import ElementPoints


def load(solid, values):
    """Integral of the field with nodal ``values`` times each shape function, assembled by DOLFINx, ``(n, 3)``."""
    field, n = fem.Function(solid.space), len(values)
    field.x.array[: n * solid.dim] = values[:, : solid.dim].ravel()
    field.x.scatter_forward()
    dx = ufl.dx(domain=solid.mesh.mesh, degree=4 * solid.space.ufl_element().degree)
    b = fem.assemble_vector(fem.form(ufl.inner(field, ufl.TestFunction(solid.space)) * dx))
    b.scatter_reverse(la.InsertMode.add)
    out = np.zeros((n, 3))
    out[:, : solid.dim] = b.array[: n * solid.dim].reshape(n, solid.dim)
    return out


@pytest.mark.parametrize(("kind", "degree"), [*KINDS, ("hexahedron", 2)])
def test_the_solution_is_the_field_whose_integrals_are_given(kind, degree):
    solid, _, _ = make(kind, degree)
    x = nodal(solid)
    mass = ElementPoints(solid).mass
    np.testing.assert_allclose(mass.solve(load(solid, x)), x, atol=1e-12 * np.abs(x).max())


def test_zero_stays_zero_and_what_is_not_finite_stays_so():
    solid, _, _ = make("hexahedron")
    mass = ElementPoints(solid).mass
    b = nodal(solid)
    b[:, 1] = 0.0
    assert (mass.solve(b)[:, 1] == 0.0).all()
    assert (mass.solve(0.0 * b) == 0.0).all()
    b[:, 2] = np.nan
    assert np.isnan(mass.solve(b)).all()


def factor(A, drop, room):
    """The incomplete factor of a dense matrix, and how many entries it has."""
    n = len(A)
    rows, columns, values, diagonal = out = (
        np.empty(n + 1, dtype=np.int64),
        np.empty(room, dtype=np.int64),
        np.empty(room),
        np.empty(n),
    )
    at = np.nonzero(A)
    starts = np.concatenate([[0], np.cumsum((A != 0.0).sum(axis=1))]).astype(np.uint32)
    count = mass_kernels.factorise(out, (starts, at[1].astype(np.uint32), A[at]), drop)
    L = np.diag(diagonal)
    for i in range(n if count >= 0 else 0):
        assert (np.diff(columns[rows[i] : rows[i + 1]]) > 0).all()
        L[i, columns[rows[i] : rows[i + 1]]] = values[rows[i] : rows[i + 1]]
    return L, count


def test_the_factor_is_that_of_cholesky_and_leaves_out_small_entries_only():
    rng = np.random.default_rng(2)
    A = np.where(rng.random((30, 30)) < 0.15, rng.standard_normal((30, 30)), 0.0)
    A = A + A.T + 12.0 * np.eye(30)
    exact = np.linalg.cholesky(A)
    whole, count = factor(A, 0.0, 900)
    np.testing.assert_allclose(whole, exact, atol=1e-13)
    assert factor(A, 0.0, count)[1] == count
    assert factor(A, 0.0, count - 1)[1] == -1
    part, fewer = factor(A, 1e-2, 900)
    assert fewer < 0.8 * count
    np.testing.assert_allclose(part, exact, atol=3e-2 * np.sqrt(A.diagonal().max()))
    left = np.abs(exact[(part == 0.0) & (exact != 0.0)])
    assert left.max() < 2e-2 * np.sqrt(A.diagonal().max())


def test_weights_that_are_kept_are_those_of_new_points():
    solid, chi, _ = make("quadrilateral")
    kept = ElementPoints(solid)
    for factor in (1.0, 1.5, 2.2, 1.3, 1.0):  # elements leave the groups and come back
        stretched = chi.copy()
        stretched[:, 0] = 0.5 + factor * np.maximum(solid.X[:, 0] - 0.5, 0.0) ** factor
        rule, new = kept.refined(stretched, 0.08), ElementPoints(solid).refined(stretched, 0.08)
        np.testing.assert_array_equal(rule.x, new.x)
        for a, b in zip(rule.groups, new.groups, strict=True):
            np.testing.assert_array_equal(a.cells, b.cells)
            np.testing.assert_allclose(a.weights, b.weights, rtol=1e-14)
