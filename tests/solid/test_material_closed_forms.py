"""Stresses of the materials in simple states against closed forms, written by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.solid.energies import (
    FAMILIES,
    MATERIAL_LIST,
    along,
    central_difference,
    name,
    planar,
    pointwise,
    random_gradients,
    random_rotation,
)
from valvefsi.solid.materials import (
    HGO,
    Fung,
    HolzapfelOgden,
    LeeSacks,
    MayNewmanYin,
    MooneyRivlin,
    NeoHookean,
    SaintVenantKirchhoff,
    Volumetric,
)
from valvefsi.solid.materials.fibre_reinforced import FibreFamily


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
            straight = min(E, f.lam_max**2 - 1) if f.lam_max else E
            growth = np.exp(f.k2 * straight**2)
            slope = f.k1 * growth * (straight + (1 + 2 * f.k2 * straight**2) * (E - straight))
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
