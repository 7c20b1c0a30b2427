"""Planar stress of the materials: energies, complex steps, the stress of the solid, the stress-free state."""

from __future__ import annotations

import numpy as np
import pytest

from valvefsi.fitting import planar
from valvefsi.fitting.biaxial_problem import measured_from_pk2
from valvefsi.fitting.biaxial_records import BiaxialData
from valvefsi.fitting.planar import PlanarState
from valvefsi.fitting.planar_hgo import HGO
from valvefsi.fitting.planar_stability import stability

DEG = np.pi / 180
CASES = {
    "neo_hookean": (planar.NeoHookean(), [2.0]),
    "mooney_rivlin": (planar.MooneyRivlin(), [1.0, 2.0]),
    "lee_sacks": (planar.LeeSacks(), [1.0, 2.0, 3.0]),
    "may_newman_yin": (planar.MayNewmanYin(), [1.0, 2.0, 30.0, 20.0]),
    "fung": (planar.Fung(angle=None), [1.0, 20.0, 10.0, 0.3, 25.0, 4.0]),
    "fung without shear": (planar.Fung(angle=None, shear=False), [1.0, 20.0, 10.0, 0.3, 25.0]),
    "hgo": (HGO(), [0.5, 3.0, 0.1, 25.0, 4.0, 5.0]),
    "hgo, two families": (HGO(families="2"), [0.5, 3.0, 0.1, 25.0, 4.0, 5.0, 6.0, 3.0]),
    "hgo, two kappas": (HGO(families="2-kappas"), [0.5, 3.0, 0.1, 25.0, 4.0, 5.0, 6.0, 3.0, 0.2]),
    "hgo, symmetric": (HGO(families="symmetric"), [0.5, 3.0, 0.1, 25.0, 4.0, 5.0]),
}
each = pytest.mark.parametrize("case", CASES)


def deformations(count=40, seed=0):
    """Return deformations with shear, some of them compressing the fibres."""
    return np.eye(2) + np.random.default_rng(seed).uniform(-0.2, 0.35, (count, 2, 2))


def energy(case, v, C11, C22, C12):
    """Return W of the incompressible sheet, written out apart from the code under test."""
    C33 = 1 / (C11 * C22 - C12**2)
    I1, I2 = C11 + C22 + C33, C11 * C22 - C12**2 + C33 * (C11 + C22)

    def I4(angle):
        c, s = np.cos(angle * DEG), np.sin(angle * DEG)
        return C11 * c * c + C22 * s * s + 2 * C12 * c * s

    if case == "neo_hookean":
        return v[0] / 2 * (I1 - 3)
    if case == "mooney_rivlin":
        return v[0] * (I1 - 3) + v[1] * (I2 - 3)
    if case == "lee_sacks":
        return v[0] / 2 * (I1 - 3) + v[1] / 2 * (np.exp(v[2] * (I1 - 3) ** 2) - 1)
    if case == "may_newman_yin":
        return v[0] * (np.exp(v[1] * (I1 - 3) ** 2 + v[2] * (np.sqrt(I4(v[3])) - 1) ** 4) - 1)
    if case.startswith("fung"):
        c, a1, a2, r3, angle = v[:5]
        a3 = r3 * np.sqrt(a1 * a2)
        a4 = v[5] if len(v) > 5 else a1 + a2 - 2 * a3
        E1, E2 = (I4(angle) - 1) / 2, (I4(angle + 90) - 1) / 2
        co, si = np.cos(angle * DEG), np.sin(angle * DEG)
        E12 = co * si * (C22 - C11) / 2 + (co**2 - si**2) * C12 / 2
        return c / 2 * (np.exp(a1 * E1**2 + a2 * E2**2 + 2 * a3 * E1 * E2 + a4 * E12**2) - 1)
    families = {
        "hgo": [(v[3], *v[4:6], v[2])],
        "hgo, symmetric": [(v[3], *v[4:6], v[2]), (-v[3], *v[4:6], v[2])],
        "hgo, two families": [(v[3], *v[4:6], v[2]), (v[3] + 90, *v[6:8], v[2])],
        "hgo, two kappas": [(v[3], *v[4:6], v[2]), (v[3] + 90, *v[6:])],
    }[case]
    W = v[0] * (np.exp(v[1] * (I1 - 3)) - 1)
    for angle, k1, k2, kappa in families:
        taut = np.real(I4(angle)) > 1
        E = kappa * I1 + (1 - 3 * kappa) * np.where(taut, I4(angle), 1.0) - 1
        W = W + k1 / (2 * k2) * (np.exp(k2 * E**2) - 1)
    return W


@each
def test_stress_is_the_derivative_of_the_energy_of_the_incompressible_sheet(case):
    material, v = CASES[case]
    state = PlanarState.of(deformations())
    C, found = (state.C11, state.C22, state.C12), []
    for k, factor in ((0, 2.0), (1, 2.0), (2, 1.0)):  # C12 stands for two components
        moved = [part.astype(complex) for part in C]
        moved[k] += 1e-30j
        found.append(factor * energy(case, v, *moved).imag / 1e-30)
    S = material.stress(np.array(v), state)
    np.testing.assert_allclose(S, found, rtol=0, atol=2e-12 * np.abs(found).max())


@each
def test_the_jacobian_agrees_with_a_complex_step(case):
    material, v = CASES[case]
    state = PlanarState.of(deformations())
    G = material.gradient(np.array(v), state)
    assert len(G) == len(v)
    for i in range(len(v)):
        moved = np.array(v, dtype=complex)
        moved[i] += 1e-30j
        step = material.stress(moved, state).imag / 1e-30
        np.testing.assert_allclose(G[i], step, rtol=0, atol=1e-13 * np.abs(step).max())


@each
def test_the_reference_state_is_free_of_stress(case):
    material, v = CASES[case]
    S = material.stress(np.array(v), PlanarState.of(np.eye(2)[None]))
    assert np.abs(S).max() < 1e-13 * max(np.abs(v))


@pytest.mark.parametrize("measure", ["pk1", "pk2", "cauchy"])
def test_the_measures_of_stress_are_those_of_the_textbook(measure):
    F = deformations(6)
    S = np.random.default_rng(1).uniform(-1, 1, (6, 2, 2))
    S = S + S.transpose(0, 2, 1)
    P = F @ S
    expected = {"pk1": P, "pk2": S, "cauchy": P @ F.transpose(0, 2, 1)}[measure]
    components = ("11", "22", "12", "21")
    data = BiaxialData(
        F=F,
        measure=measure,
        components=components,
        stress=np.zeros((6, 4)),
        protocol=np.zeros(6, int),
        names=("1",),
    )
    maps = measured_from_pk2(data, F)
    found = np.einsum("knj,nj->kn", maps, np.array([S[:, 0, 0], S[:, 1, 1], S[:, 0, 1]]).T)
    for component, values in zip(components, found, strict=True):
        i, j = int(component[0]) - 1, int(component[1]) - 1
        np.testing.assert_allclose(values, expected[:, i, j], atol=1e-14)


@each
def test_the_stress_of_the_solid_on_one_element_is_the_same(case):
    """F of one trilinear element, its energy through DOLFINx, and the pressure from S33 = 0."""
    compat = pytest.importorskip("valvefsi.runtime.dolfinx_compat")
    import ufl
    from dolfinx import fem, mesh
    from mpi4py import MPI

    from valvefsi.solid.materials import MATERIALS
    from valvefsi.solid.materials.fibre_reinforced import FibreFamily
    from valvefsi.solid.materials.kinematics import Kinematics

    material, v = CASES[case]
    names = [
        p.name for p in material.parameters(planar.Extent(stress=1.0, I1=1.0, I4=(1.0, 1.0), shear=True))
    ]
    entries = material.entries(dict(zip(names, v, strict=True)))
    entries.pop("width", None)  # the published corner
    if "families" in entries:
        entries["families"] = tuple(FibreFamily(**family) for family in entries["families"])
    solid = MATERIALS[material.model](**entries)
    element = mesh.create_unit_cube(MPI.COMM_SELF, 1, 1, 1, mesh.CellType.hexahedron)
    chi = fem.Function(fem.functionspace(element, ("Lagrange", 1, (3,))))
    gradient = ufl.variable(ufl.grad(chi))
    stress = compat.compile_expression(
        ufl.diff(solid.energy(Kinematics(gradient)), gradient), np.full((1, 3), 0.3), MPI.COMM_SELF
    )
    for F2 in deformations(8, seed=5):
        F = np.zeros((3, 3))
        F[:2, :2], F[2, 2] = F2, 1 / np.linalg.det(F2)
        chi.interpolate(lambda X, F=F: F @ X)
        P = compat.evaluate(stress, element, [0])[0].reshape(3, 3)
        inverse = np.linalg.inv(F)
        p = P[2, 2] * F[2, 2]  # P - p F^-T, P33 = 0
        P = P - p * inverse.T
        S = material.stress(np.array(v), PlanarState.of(F2[None]))[:, 0]
        expected = F2 @ np.array([[S[0], S[2]], [S[2], S[1]]])
        np.testing.assert_allclose(P[:2, :2], expected, rtol=0, atol=1e-10 * np.abs(expected).max())


def test_a_sheet_that_loses_ellipticity_is_noticed():
    F = np.array([np.diag([1 + s, 1 + s]) for s in np.linspace(0, 0.4, 5)])
    sound = stability(planar.Fung(angle=0.0), np.array([1.0, 20.0, 10.0, 0.3, 0.0, 12.0]), F)
    assert sound.convex == (1.0, 1.0)
    assert sound.elliptic == (1.0, 1.0)
    assert sound.worst is None
    bad = stability(planar.Fung(angle=0.0), np.array([1.0, 20.0, 10.0, 3.0, 0.0, 0.1]), F)  # a3^2 > a1 a2
    assert bad.convex[0] < 1
    assert bad.elliptic[0] < 1
    assert bad.worst is not None
