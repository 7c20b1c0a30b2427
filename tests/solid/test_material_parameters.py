"""Parameters that materials refuse, numerical moduli, and materials of one's own."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from tests.gent import GENT
from tests.solid.energies import MATERIAL_LIST, planar
from valvefsi.errors import CaseError
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
    load_material,
    stabilisation,
)
from valvefsi.solid.materials.fibre_reinforced import FibreFamily


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
        (FibreFamily, {"k1": 1.0, "k2": 1.0, "fibre": 0.0, "lam_max": 0.9}, "lam_max = 0.9: expected 0 or a"),
        (
            FibreFamily,
            {"k1": 1.0, "k2": 50.0, "fibre": 0.0, "lam_max": 9.0},
            "lam_max = 9.0: the stress grows",
        ),
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


def test_a_material_of_ones_own_is_loaded_by_its_file_and_nothing_beside_it_is(tmp_path):
    (tmp_path / "gent.py").write_text(GENT, encoding="utf-8")
    (tmp_path / "ufl.py").write_text("raise SystemExit('a file beside the case ran')", encoding="utf-8")
    path = list(sys.path)
    gent = find_material(load_material(tmp_path / "gent.py", "Gent"))(mu=8.0, limit=30.0)
    assert sys.path == path
    l1, l2 = 1.3, 1.1
    I1 = l1**2 + l2**2 + 1 / (l1 * l2) ** 2
    expected = 8.0 * 30 / (30 - I1 + 3) * (np.array([l1, l2]) ** 2 - 1 / (l1 * l2) ** 2)
    np.testing.assert_allclose(planar(gent, l1, l2), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("import no_such_module", "cannot load this material .ModuleNotFoundError"),
        ("class Other: pass", "cannot load this material .AttributeError"),
        ("class Gent: pass", "not a material"),
        ("class Gent:", "cannot load this material .IndentationError"),
    ],
)
def test_a_file_without_the_material_is_refused(tmp_path, text, message):
    (tmp_path / "own.py").write_text(text, encoding="utf-8")
    with pytest.raises(CaseError, match=message):
        load_material(tmp_path / "own.py", "Gent")


@pytest.mark.parametrize("model", ["no_such_module.Gent", "math.cos", "neo_hooke", "never/loaded.py:Gent"])
def test_a_name_is_never_imported(model):
    with pytest.raises(CaseError, match=r'no such material; one of your own is "FILE\.py:CLASS"'):
        find_material(model)


def test_every_material_is_registered():
    assert {type(material) for material in MATERIAL_LIST} == set(MATERIALS.values())
