"""Energies: stress, tangent, objectivity, symmetry, the stress-free state, closed cycles, plane strain."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest

from valvefsi.errors import CaseError
from valvefsi.solid.fibre_materials import FibreFamily
from valvefsi.solid.materials import (
    HGO,
    MATERIALS,
    Fung,
    HolzapfelOgden,
    LeeSacks,
    MayNewmanYin,
    MooneyRivlin,
    NeoHookean,
    SaintVenantKirchhoff,
    Volumetric,
    find_material,
    kappa_stab,
    stabilisation,
)
from valvefsi.solid.pointwise import Pointwise

FAMILIES = (
    FibreFamily(k1=4.0, k2=1.5, kappa=0.1, fibre=25.0),
    FibreFamily(k1=2.0, k2=0.5, kappa=0.0, fibre=-60.0),
)
ISOTROPIC = [
    NeoHookean(c1=80.194),
    MooneyRivlin(c1=3.0, c2=5.0),
    LeeSacks(c0=6.0, c1=2.0, c2=0.7),
    HGO(c10=3.0, c01=0.8),
    SaintVenantKirchhoff(mu=4.0, lam=3.0),
]
VOLUMETRIC = [Volumetric(kappa=374.24, form=form) for form in Volumetric.FORMS]
HOLZAPFEL_OGDEN = HolzapfelOgden(
    a=2.0, b=0.9, a_f=3.0, b_f=1.2, a_s=1.0, b_s=0.8, a_fs=0.7, b_fs=1.1, fibre=30.0, sheet=120.0
)
FUNG = Fung(
    c=2.0, a1=2.0, a2=1.0, a3=0.4, a4=3.0, a5=1.5, a6=0.2, a7=-0.3, a8=2.0, a9=1.0, fibre=20, sheet=110
)
WITH_FIBRES = [
    HGO(c10=3.0, c01=0.8, families=FAMILIES[:1]),
    HGO(c10=3.0, c01=0.8, families=FAMILIES),
    HOLZAPFEL_OGDEN,
    MayNewmanYin(c0=5.0, c1=0.8, c2=3.0, fibre=40.0),
    FUNG,
]
MATERIAL_LIST = ISOTROPIC + WITH_FIBRES
ENERGIES = MATERIAL_LIST + VOLUMETRIC


def name(energy):
    extra = len(energy.families) if isinstance(energy, HGO) else getattr(energy, "form", "")
    return f"{type(energy).__name__}{extra}"


@functools.cache
def pointwise(energy, dim=3):
    """Return the compiled energy; all tests share it."""
    return Pointwise(energy, dim)


every_energy = pytest.mark.parametrize("energy", ENERGIES, ids=name)
every_dim = pytest.mark.parametrize("dim", [2, 3])


def random_gradients(dim, count=4):
    rng = np.random.default_rng(7)
    return [np.eye(dim) + 0.35 * rng.uniform(-1, 1, (dim, dim)) for _ in range(count)]


def random_rotation(dim):
    Q, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(dim, dim)))
    return Q if np.linalg.det(Q) > 0 else Q[:, ::-1]


def central_difference(function, F, step=1e-5):
    shape = np.shape(function(F))
    difference = np.zeros((*shape, *F.shape))
    for i, j in np.ndindex(F.shape):
        change = np.zeros_like(F)
        change[i, j] = step
        difference[..., i, j] = (function(F + change) - function(F - change)) / (2 * step)
    return difference


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


def along(degrees):
    return np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees)), 0.0])


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


def planar_closed_form(material, l1, l2):
    """Cauchy stresses s1 - s3, s2 - s3 of an incompressible sheet with principal stretches, by hand."""
    l3 = 1 / (l1 * l2)
    squares = np.array([l1, l2]) ** 2
    I1 = l1**2 + l2**2 + l3**2
    excess = I1 - 3

    def isotropic(W1, W2=0.0):
        return 2 * (W1 + W2 * squares[::-1]) * (squares - l3**2)

    def fibre_stretch(degrees):
        a = along(degrees)[:2]
        return np.sum(a**2 * squares), a**2 * squares

    if isinstance(material, NeoHookean):
        return isotropic(material.c1 / 2)
    if isinstance(material, MooneyRivlin):
        return isotropic(material.c1, material.c2)
    if isinstance(material, LeeSacks):
        return isotropic(
            material.c0 / 2 + material.c1 * material.c2 * excess * np.exp(material.c2 * excess**2)
        )
    if isinstance(material, HGO):
        stress = isotropic(material.c10 * material.c01 * np.exp(material.c01 * excess))
        for f in material.families:
            I4, dyad = fibre_stretch(f.fibre)
            E = f.kappa * I1 + (1 - 3 * f.kappa) * max(I4, 1) - 1
            slope = f.k1 * E * np.exp(f.k2 * E**2)
            stress = stress + 2 * slope * f.kappa * (squares - l3**2)
            if I4 > 1:
                stress = stress + 2 * slope * (1 - 3 * f.kappa) * dyad
        return stress
    if isinstance(material, HolzapfelOgden):
        m = material
        stress = isotropic(m.a / 2 * np.exp(m.b * excess))
        for a, b, angle in ((m.a_f, m.b_f, m.fibre), (m.a_s, m.b_s, m.sheet)):
            I4, dyad = fibre_stretch(angle)
            if I4 > 1:
                stress = stress + 2 * a * (I4 - 1) * np.exp(b * (I4 - 1) ** 2) * dyad
        f, s = along(m.fibre)[:2], along(m.sheet)[:2]
        I8 = np.sum(f * s * squares)
        return stress + m.a_fs * I8 * np.exp(m.b_fs * I8**2) * 2 * f * s * squares
    if isinstance(material, MayNewmanYin):
        I4, dyad = fibre_stretch(material.fibre)
        stretch = np.sqrt(I4)
        e = np.exp(material.c1 * excess**2 + material.c2 * (stretch - 1) ** 4)
        stress = isotropic(2 * material.c0 * material.c1 * excess * e)
        return stress + 2 * material.c0 * material.c2 * 4 * (stretch - 1) ** 3 / (2 * stretch) * e * dyad
    raise NotImplementedError(name(material))


def planar(material, l1, l2):
    F = np.diag([l1, l2, 1 / (l1 * l2)])
    cauchy = pointwise(material)(F)[1] @ F.T
    return np.diag(cauchy)[:2] - cauchy[2, 2]


@pytest.mark.parametrize(
    "material", [m for m in MATERIAL_LIST if not isinstance(m, SaintVenantKirchhoff | Fung)], ids=name
)
def test_biaxial_and_uniaxial_stretch_give_the_closed_form(material):
    for stretch in (1.05, 1.3):
        for l1, l2 in (
            (stretch, stretch),
            (stretch, 1 / math.sqrt(stretch)),
            (1 / stretch, stretch),
            (1, stretch),
        ):
            np.testing.assert_allclose(
                planar(material, l1, l2), planar_closed_form(material, l1, l2), rtol=1e-10, atol=1e-10
            )


def test_a_fung_sheet_has_its_closed_form():
    sheet = Fung(c=2.0, a1=2.0, a2=1.0, a3=0.4, a4=3.0)
    for l1, l2 in ((1.2, 1.1), (0.9, 1.3)):
        E1, E2 = (l1**2 - 1) / 2, (l2**2 - 1) / 2
        e = sheet.c * np.exp(sheet.a1 * E1**2 + sheet.a2 * E2**2 + 2 * sheet.a3 * E1 * E2)
        S = e * np.array([sheet.a1 * E1 + sheet.a3 * E2, sheet.a2 * E2 + sheet.a3 * E1])
        np.testing.assert_allclose(planar(sheet, l1, l2), S * np.array([l1, l2]) ** 2, rtol=1e-11)
    gamma = 0.3  # simple shear: E12 = gamma/2, E22 = gamma^2/2, P12 = (F S)_12
    F = np.eye(3)
    F[0, 1] = gamma
    E = np.array([[0.0, gamma / 2], [gamma / 2, gamma**2 / 2]])
    e = sheet.c * np.exp(sheet.a2 * E[1, 1] ** 2 + sheet.a4 * E[0, 1] ** 2)
    S = e * np.array(
        [[sheet.a3 * E[1, 1], sheet.a4 / 2 * E[0, 1]], [sheet.a4 / 2 * E[0, 1], sheet.a2 * E[1, 1]]]
    )
    cauchy = pointwise(sheet)(F)[1] @ F.T
    expected = F[:2, :2] @ S @ F[:2, :2].T
    np.testing.assert_allclose(cauchy[0, 1], expected[0, 1], rtol=1e-11)
    np.testing.assert_allclose(cauchy[0, 0] - cauchy[1, 1], expected[0, 0] - expected[1, 1], rtol=1e-10)


def test_saint_venant_kirchhoff_has_its_cubic_in_uniaxial_strain():
    material = SaintVenantKirchhoff(mu=4.0, lam=3.0)
    for stretch in (0.9, 1.2):
        F = np.diag([stretch, 1.0, 1.0])
        E = (stretch**2 - 1) / 2
        np.testing.assert_allclose(pointwise(material)(F)[1][0, 0], stretch * (3.0 + 8.0) * E, rtol=1e-12)


@pytest.mark.parametrize("form", Volumetric.FORMS)
def test_a_volumetric_energy_has_its_pressure_and_its_modulus(form):
    at = pointwise(Volumetric(kappa=10.0, form=form))
    slope = {"log": lambda J: 10 * math.log(J) / J, "quadratic": lambda J: 10 * (J - 1)}
    slope["simo_taylor"] = lambda J: 5 * (J - 1 / J)
    for J in (0.7, 1.0, 1.4):
        F = J ** (1 / 3) * random_rotation(3)
        cauchy = at(F)[1] @ F.T / J
        np.testing.assert_allclose(cauchy, slope[form](J) * np.eye(3), atol=1e-12)
    J = 1 + 1e-6
    assert at(J ** (1 / 3) * np.eye(3))[0] / (1e-12 / 2) == pytest.approx(10.0, rel=1e-3)


def test_fibres_carry_no_load_in_compression():
    matrix, fibres = (
        HGO(c10=3.0, c01=0.8),
        HGO(c10=3.0, c01=0.8, families=[FibreFamily(k1=9.0, k2=2.0, fibre=0.0)]),
    )
    shorter, longer = np.diag([0.8, 1.2, 1 / 0.96]), np.diag([1.2, 0.8, 1 / 0.96])
    np.testing.assert_array_equal(pointwise(fibres)(shorter)[1], pointwise(matrix)(shorter)[1])
    assert pointwise(fibres)(longer)[1][0, 0] > pointwise(matrix)(longer)[1][0, 0] + 1


def test_a_rounded_corner_makes_the_stress_of_dispersed_fibres_continuous():
    def material(width):
        return HGO(c10=3.0, c01=0.8, families=FAMILIES[:1], width=width)

    # Stretch across the fibres so that I4bar is 1 while the dispersed part of the fibre strain is not zero.
    a, b = along(25.0), along(115.0)
    c = np.cross(a, b)

    def F(I4):
        return math.sqrt(I4) * np.outer(a, a) + 1.3 * np.outer(b, b) + np.outer(c, c) / (1.3 * math.sqrt(I4))

    def jump(width):
        at = pointwise(material(width))
        return np.abs(at(F(1 + 1e-9))[1] - at(F(1 - 1e-9))[1]).max()

    assert jump(0.0) > 0.05
    assert jump(0.05) < 1e-6
    rounded, corner = pointwise(material(0.05)), pointwise(material(0.0))
    np.testing.assert_array_equal(rounded(F(0.9))[1], corner(F(0.9))[1])
    for I4 in (1.02, 1.0499, 1.0501, 1.3):
        difference = central_difference(lambda G: rounded(G)[0], F(I4))
        np.testing.assert_allclose(rounded(F(I4))[1], difference, atol=1e-6)


def test_full_dispersion_is_isotropic():
    random = HGO(c10=3.0, c01=0.8, families=[FibreFamily(k1=9.0, k2=2.0, kappa=1 / 3, fibre=10.0)])
    at, Q = pointwise(random), random_rotation(3)
    for F in random_gradients(3):
        assert at(F @ Q)[0] == pytest.approx(at(F)[0], rel=1e-12)


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


def test_the_stabilisation_has_the_published_moduli():
    assert kappa_stab(NeoHookean(c1=80.194).shear_modulus, 0.4) == pytest.approx(374.24, abs=0.005)
    assert kappa_stab(MooneyRivlin(c1=9000, c2=9000).shear_modulus, 0.4) == pytest.approx(168000, rel=1e-12)
    assert kappa_stab(80.194, None) == 0
    assert kappa_stab(80.194, -1) == 0


def test_the_stabilisation_can_be_stated_and_must_be_where_there_is_no_modulus():
    soft = MayNewmanYin(c0=5.0, c1=0.8, c2=3.0)
    assert stabilisation(soft, 0.4, "quadratic", 50.0) == Volumetric(kappa=50.0, form="quadratic")
    assert stabilisation(soft, None).kappa == 0
    with pytest.raises(CaseError, match="no stiffness at F = I"):
        stabilisation(soft, 0.4)


@pytest.mark.parametrize("nu_stab", [0.5, 0.6, -1.1, float("nan")])
def test_an_impossible_numerical_poisson_ratio_is_refused(nu_stab):
    with pytest.raises(CaseError, match="nu_stab"):
        kappa_stab(1.0, nu_stab)


NAN, INFINITY = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("kind", "values", "message"),
    [
        (NeoHookean, {"c1": -1.0}, "c1 = -1.0: expected a number above 0"),
        (NeoHookean, {"c1": 0.0}, "c1 = 0.0"),
        (NeoHookean, {"c1": NAN}, "c1 = nan: expected a finite number"),
        (NeoHookean, {"c1": "80"}, "c1 = '80': expected a finite number"),
        (MooneyRivlin, {"c1": 1.0, "c2": -1.0}, "c2 = -1.0"),
        (MooneyRivlin, {"c1": 0.0, "c2": 0.0}, "c1 ="),
        (LeeSacks, {"c0": 1.0, "c1": INFINITY, "c2": 1.0}, "c1 = inf"),
        (HGO, {"c10": 1.0, "c01": 0.0}, "c01 = 0.0"),
        (HGO, {"c10": 1.0, "c01": 1.0, "families": [1.0]}, "expected a list of FibreFamily"),
        (
            FibreFamily,
            {"k1": 1.0, "k2": 1.0, "kappa": 0.34, "fibre": 0.0},
            "kappa = 0.34: .*at most 0.333333",
        ),
        (FibreFamily, {"k1": 1.0, "k2": 1.0, "kappa": -0.01, "fibre": 0.0}, "kappa = -0.01"),
        (FibreFamily, {"k1": 1.0, "k2": 0.0, "fibre": 0.0}, "k2 = 0.0"),
        (FibreFamily, {"k1": 1.0, "k2": 1.0, "fibre": (0.0, 0.0, 0.0)}, "fibre = .*not zero"),
        (FibreFamily, {"k1": 1.0, "k2": 1.0, "fibre": NAN}, "fibre = nan"),
        (FibreFamily, {"k1": 1.0, "k2": 1.0, "fibre": (1.0, "x")}, "fibre = "),
        (HolzapfelOgden, {"a": 1.0, "b": 1.0, "a_f": -1.0}, "a_f = -1.0"),
        (Fung, {"c": 1.0, "a1": 1.0, "a2": 1.0, "a3": 2.0, "a4": 1.0}, "a3 = 2.0: expected a1 a2 >= a3"),
        (Fung, {"c": 1.0, "a1": 1.0, "a2": 1.0, "a4": 1.0, "a7": 1.0}, "negative values"),
        (MayNewmanYin, {"c0": 1.0, "c1": -1.0, "c2": 1.0}, "c1 = -1.0"),
        (SaintVenantKirchhoff, {"mu": 1.0, "lam": -1.0}, "lam = -1.0"),
        (Volumetric, {"kappa": -1.0}, "kappa = -1.0"),
        (Volumetric, {"kappa": 1.0, "form": "cubic"}, "expected one of log, quadratic, simo_taylor"),
    ],
)
def test_a_material_refuses_a_parameter_that_cannot_be(kind, values, message):
    with pytest.raises(CaseError, match=message):
        kind(**values)


GENT = """
from dataclasses import dataclass
import ufl
from valvefsi.solid.parameters import parameter

@dataclass(frozen=True, kw_only=True)
class Gent:
    mu: float = parameter("dyn/cm^2", above=0.0)
    limit: float = parameter("1", above=0.0)

    @property
    def shear_modulus(self):
        return self.mu

    def energy(self, kinematics):
        return -self.mu * self.limit / 2 * ufl.ln(1 - (kinematics.I1_bar - 3) / self.limit)
"""


def test_a_material_of_ones_own_is_found_by_its_import_path(tmp_path, monkeypatch):
    (tmp_path / "gent_material.py").write_text(GENT, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    gent = find_material("gent_material.Gent")(mu=8.0, limit=30.0)
    l1, l2 = 1.3, 1.1
    I1 = l1**2 + l2**2 + 1 / (l1 * l2) ** 2
    expected = 8.0 * 30 / (30 - I1 + 3) * (np.array([l1, l2]) ** 2 - 1 / (l1 * l2) ** 2)
    np.testing.assert_allclose(planar(gent, l1, l2), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("model", "message"),
    [
        ("no_such_module.Gent", "cannot import this material .ModuleNotFoundError"),
        ("math.cosine", "cannot import this material .AttributeError"),
        ("math.cos", "not a material"),
        ("not a path", "no such material"),
        ("neo_hooke", "no such material"),
    ],
)
def test_an_import_path_that_leads_to_no_material_is_refused(model, message):
    with pytest.raises(CaseError, match=message):
        find_material(model)


def test_every_material_is_registered():
    assert {type(material) for material in MATERIAL_LIST} == set(MATERIALS.values())
