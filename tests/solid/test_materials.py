"""Energies: stress, tangent, objectivity, symmetry, the stress-free state, closed cycles, plane strain."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.solid.energies import (
    ENERGIES,
    FUNG,
    HOLZAPFEL_OGDEN,
    ISOTROPIC,
    MATERIAL_LIST,
    VOLUMETRIC,
    WITH_FIBRES,
    along,
    central_difference,
    name,
    pointwise,
    random_gradients,
    random_rotation,
)
from tests.solid.pointwise import Pointwise
from valvefsi.errors import CaseError
from valvefsi.solid.materials import HGO
from valvefsi.solid.materials.fibre_reinforced import FibreFamily

every_energy = pytest.mark.parametrize("energy", ENERGIES, ids=name)
every_dim = pytest.mark.parametrize("dim", [2, 3])


@every_dim
@every_energy
def test_stress_is_the_derivative_of_the_energy_and_the_tangent_that_of_the_stress(energy, dim):
    at = pointwise(energy, dim)
    for F in random_gradients(dim):
        P, A = at(F)[1], at.tangent(F)
        difference = central_difference(lambda G: at(G)[0], F)
        assert np.abs(P - difference).max() < 1e-7 * max(1.0, np.abs(P).max())
        difference = central_difference(lambda G: at(G)[1], F)
        assert np.abs(A - difference).max() < 1e-6 * max(1.0, np.abs(A).max())
        assert np.abs(A - A.transpose(2, 3, 0, 1)).max() < 1e-12 * np.abs(A).max()


@every_dim
@every_energy
def test_energy_does_not_see_a_rotation_and_the_reference_state_is_stress_free(energy, dim):
    at, Q = pointwise(energy, dim), random_rotation(dim)
    for F in random_gradients(dim):
        (W, P), (W_rotated, P_rotated) = at(F), at(Q @ F)
        assert W_rotated == pytest.approx(W, rel=1e-12, abs=1e-13)
        np.testing.assert_allclose(P_rotated, Q @ P, atol=1e-11 * np.abs(P).max())
        torque = P @ F.T
        np.testing.assert_allclose(torque, torque.T, atol=1e-11 * np.abs(torque).max())
    W, P = at(np.eye(dim))
    assert abs(W) < 1e-12
    assert np.abs(P).max() < 1e-11 * max(1.0, getattr(energy, "shear_modulus", 374.24))


@pytest.mark.parametrize("energy", [e for e in MATERIAL_LIST if e is not ISOTROPIC[4]], ids=name)
def test_isochoric_energies_do_not_see_a_change_of_volume(energy):
    at = pointwise(energy, 3)
    for F in random_gradients(3):
        assert at(1.7 * F)[0] == pytest.approx(at(F)[0], rel=1e-12)


@every_energy
def test_plane_strain_is_three_dimensions_with_unit_stretch_across(energy):
    plane, solid = pointwise(energy, 2), pointwise(energy, 3)
    for F in random_gradients(2):
        whole = np.eye(3)
        whole[:2, :2] = F
        (W, P), (W_3d, P_3d) = plane(F), solid(whole)
        assert pytest.approx(W_3d, rel=1e-12, abs=1e-13) == W
        np.testing.assert_allclose(P, P_3d[:2, :2], rtol=1e-11, atol=1e-10)


def turn(axis, angle):
    """Rotation about an axis, by Rodrigues' formula."""
    a = np.asarray(axis, dtype=float)
    K = np.cross(np.eye(3), a)
    return np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * K @ K


@pytest.mark.parametrize("energy", ISOTROPIC + VOLUMETRIC, ids=name)
def test_an_isotropic_energy_does_not_see_a_rotation_of_the_reference_state(energy):
    at, Q = pointwise(energy), random_rotation(3)
    for F in random_gradients(3):
        assert at(F @ Q)[0] == pytest.approx(at(F)[0], rel=1e-12, abs=1e-13)


SYMMETRIES = [
    (WITH_FIBRES[0], turn(along(25), 0.9), True),
    (WITH_FIBRES[0], turn([0, 0, 1], math.pi), True),
    (WITH_FIBRES[0], turn([0, 0, 1], 0.9), False),
    (WITH_FIBRES[1], turn([0, 0, 1], math.pi), True),
    (WITH_FIBRES[1], turn(along(25), 0.9), False),
    (HOLZAPFEL_OGDEN, turn(along(30), math.pi), True),
    (HOLZAPFEL_OGDEN, turn(along(120), math.pi), True),
    (HOLZAPFEL_OGDEN, turn(along(30), math.pi / 2), False),
    (WITH_FIBRES[3], turn(along(40), 0.9), True),
    (WITH_FIBRES[3], turn(along(130), math.pi), True),
    (WITH_FIBRES[3], turn(along(130), 0.9), False),
    (FUNG, turn(along(20), math.pi), True),
    (FUNG, turn(along(110), math.pi), True),
    (FUNG, turn(along(20), math.pi / 2), False),
]


@pytest.mark.parametrize(
    ("energy", "Q", "same"),
    SYMMETRIES,
    ids=[f"{name(e)}-{k}-{same}" for k, (e, _, same) in enumerate(SYMMETRIES)],
)
def test_an_energy_with_fibres_has_the_symmetry_of_its_fibres_and_no_more(energy, Q, same):
    at = pointwise(energy)
    stretch = np.diag([1.2, 1.1, 1 / 1.32])
    gradients = [G @ stretch for G in random_gradients(3)]
    agree = [math.isclose(at(F @ Q)[0], at(F)[0], rel_tol=1e-11) for F in gradients]
    assert all(agree) if same else not any(agree)


@pytest.mark.parametrize(("stretch", "size", "tolerance"), [(1.25, 0.05, 1e-10), (1.0, 0.2, 5e-4)])
@every_dim
@every_energy
def test_the_work_around_a_closed_cycle_is_zero(energy, dim, stretch, size, tolerance):
    # The first cycle keeps every fibre in tension, where the trapezoidal rule converges faster than any power; the
    # second crosses the cut, where the stress of dispersed fibres jumps, and converges as 1/n.
    at = pointwise(energy, dim)
    rng = np.random.default_rng(11)
    A, B, C = (size * rng.uniform(-1, 1, (dim, dim)) for _ in range(3))
    start = np.diag([stretch, stretch, stretch**-2][:dim])
    n = 128
    work = scale = 0.0
    for s in 2 * np.pi * np.arange(n) / n:
        F = start + A * np.cos(s) + B * np.sin(s) + C * np.sin(2 * s)
        power = np.sum(at(F)[1] * (-A * np.sin(s) + B * np.cos(s) + 2 * C * np.cos(2 * s)))
        work, scale = work + power / n, scale + abs(power) / n
    assert abs(work) < tolerance * scale


def test_a_direction_may_be_an_angle_a_vector_or_a_field():
    def with_direction(direction):
        return HGO(c10=3.0, c01=0.8, families=[FibreFamily(k1=9.0, k2=2.0, fibre=direction)])

    F = random_gradients(3)[1]
    given = [
        pointwise(with_direction(d))(F)[0] for d in (60.0, (0.5, math.sqrt(0.75), 0), (1, math.sqrt(3), 0))
    ]
    given.append(Pointwise(with_direction("fibre"), fibres={"fibre": along(60)})(F)[0])
    np.testing.assert_allclose(given, given[0], rtol=1e-12)
    with pytest.raises(CaseError, match=r'no such fibre field .*did you mean "fibre"'):
        Pointwise(with_direction("fiber"), fibres={"fibre": along(60)})
    with pytest.raises(CaseError, match="expected 2 components"):
        pointwise(with_direction((1, 0, 0)), dim=2)


@pytest.mark.parametrize("material", [*ISOTROPIC, WITH_FIBRES[0], HOLZAPFEL_OGDEN, WITH_FIBRES[3]], ids=name)
def test_shear_modulus_is_the_slope_of_the_shear_stress(material):
    F = np.eye(3)
    F[1, 2] = 1e-6
    slope = pointwise(material)(F)[1][1, 2] / 1e-6
    assert slope == pytest.approx(material.shear_modulus, rel=1e-5, abs=1e-4)


@pytest.mark.parametrize("material", [WITH_FIBRES[0], WITH_FIBRES[1], HOLZAPFEL_OGDEN], ids=name)
def test_the_fibre_modulus_bounds_the_fastest_wave(material):
    at, rng = pointwise(material), np.random.default_rng(5)
    f = along(30.0 if material is HOLZAPFEL_OGDEN else 25.0)
    A = at.tangent(np.eye(3) + 1e-7 * (np.outer(f, f) + np.eye(3)))
    bound = 4 / 3 * material.shear_modulus + material.fibre_modulus
    normals = [f, *rng.normal(size=(200, 3))]
    waves = [np.linalg.eigvalsh(np.einsum("iajb,a,b->ij", A, n, n) / (n @ n)).max() for n in normals]
    assert max(waves) <= bound * (1 + 1e-5)
    if material is WITH_FIBRES[0]:  # one family: attained along the fibre
        assert waves[0] == pytest.approx(bound, rel=1e-5)
