"""Energies: stress, objectivity, the stress-free state, plane strain, the stabilisation's modulus."""

from __future__ import annotations

import numpy as np
import pytest

from valvefsi import dolfinx_compat as compat

# isort: split
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from valvefsi.errors import CaseError
from valvefsi.solid.kinematics import Kinematics
from valvefsi.solid.materials import MATERIALS, MooneyRivlin, NeoHookean, Volumetric, kappa_stab

ENERGIES = [NeoHookean(c1=80.194), MooneyRivlin(c1=3.0, c2=5.0), Volumetric(kappa=374.24)]


class Pointwise:
    """An energy and its derivative at a given F, through the same compiler as the solid."""

    def __init__(self, energy, dim):
        cell = mesh.create_unit_square if dim == 2 else mesh.create_unit_cube
        self.mesh = cell(MPI.COMM_SELF, *[1] * dim)
        self.F = fem.Constant(self.mesh, np.eye(dim))
        F = ufl.variable(self.F)
        W = energy.energy(Kinematics(F))
        points = np.full((1, dim), 0.25)
        self.expressions = [
            compat.compile_expression(part, points, MPI.COMM_SELF) for part in (W, ufl.diff(W, F))
        ]

    def __call__(self, F):
        self.F.value[:] = F
        W, P = (compat.evaluate(expression, self.mesh, [0])[0] for expression in self.expressions)
        return W[0], P.reshape(F.shape)


def random_gradients(dim, count=4):
    rng = np.random.default_rng(7)
    return [np.eye(dim) + 0.35 * rng.uniform(-1, 1, (dim, dim)) for _ in range(count)]


def random_rotation(dim):
    Q, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(dim, dim)))
    return Q if np.linalg.det(Q) > 0 else Q[:, ::-1]


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("energy", ENERGIES, ids=lambda energy: type(energy).__name__)
def test_stress_is_the_derivative_of_the_energy(energy, dim):
    at = Pointwise(energy, dim)
    for F in random_gradients(dim):
        _, P = at(F)
        difference = np.zeros_like(P)
        for i, j in np.ndindex(dim, dim):
            step = np.zeros((dim, dim))
            step[i, j] = 1e-5
            difference[i, j] = (at(F + step)[0] - at(F - step)[0]) / 2e-5
        assert np.abs(P - difference).max() < 1e-7 * max(1.0, np.abs(P).max())


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("energy", ENERGIES, ids=lambda energy: type(energy).__name__)
def test_energy_does_not_see_a_rotation_and_the_reference_state_is_stress_free(energy, dim):
    at, Q = Pointwise(energy, dim), random_rotation(dim)
    for F in random_gradients(dim):
        (W, P), (W_rotated, P_rotated) = at(F), at(Q @ F)
        assert W_rotated == pytest.approx(W, rel=1e-12)
        np.testing.assert_allclose(P_rotated, Q @ P, atol=1e-11 * np.abs(P).max())
    W, P = at(np.eye(dim))
    assert abs(W) < 1e-12
    assert np.abs(P).max() < 1e-11 * getattr(energy, "shear_modulus", 374.24)


@pytest.mark.parametrize("energy", ENERGIES[:2], ids=lambda energy: type(energy).__name__)
def test_isochoric_energies_do_not_see_a_change_of_volume(energy):
    at = Pointwise(energy, 3)
    for F in random_gradients(3):
        assert at(1.7 * F)[0] == pytest.approx(at(F)[0], rel=1e-12)


@pytest.mark.parametrize("energy", ENERGIES, ids=lambda energy: type(energy).__name__)
def test_plane_strain_is_three_dimensions_with_unit_stretch_across(energy):
    plane, solid = Pointwise(energy, 2), Pointwise(energy, 3)
    for F in random_gradients(2):
        whole = np.eye(3)
        whole[:2, :2] = F
        (W, P), (W_3d, P_3d) = plane(F), solid(whole)
        assert pytest.approx(W_3d, rel=1e-12) == W
        np.testing.assert_allclose(P, P_3d[:2, :2], rtol=1e-11, atol=1e-10)


@pytest.mark.parametrize("material", ENERGIES[:2], ids=lambda energy: type(energy).__name__)
def test_shear_modulus_is_the_slope_of_the_shear_stress(material):
    F = np.eye(3)
    F[0, 1] = 1e-6
    assert Pointwise(material, 3)(F)[1][0, 1] / 1e-6 == pytest.approx(material.shear_modulus, rel=1e-5)


def test_the_stabilisation_has_the_published_moduli():
    assert kappa_stab(NeoHookean(c1=80.194).shear_modulus, 0.4) == pytest.approx(374.24, abs=0.005)
    assert kappa_stab(MooneyRivlin(c1=9000, c2=9000).shear_modulus, 0.4) == pytest.approx(168000, rel=1e-12)
    assert kappa_stab(80.194, None) == 0
    assert kappa_stab(80.194, -1) == 0


@pytest.mark.parametrize("nu_stab", [0.5, 0.6, -1.1, float("nan")])
def test_an_impossible_numerical_poisson_ratio_is_refused(nu_stab):
    with pytest.raises(CaseError, match="nu_stab"):
        kappa_stab(1.0, nu_stab)


@pytest.mark.parametrize(
    ("model", "values"),
    [
        ("neo_hookean", {"c1": -1.0}),
        ("neo_hookean", {"c1": 0.0}),
        ("neo_hookean", {"c1": float("nan")}),
        ("mooney_rivlin", {"c1": 1.0, "c2": -1.0}),
        ("mooney_rivlin", {"c1": 0.0, "c2": 0.0}),
    ],
)
def test_a_material_refuses_a_modulus_that_cannot_be(model, values):
    with pytest.raises(CaseError, match=r"c[12] ="):
        MATERIALS[model](**values)
