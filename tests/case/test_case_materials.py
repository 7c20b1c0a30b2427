"""Materials, presets, fibres and the volumetric term in a case file."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
import warnings
from copy import deepcopy

import numpy as np
import pytest
from mpi4py import MPI

from tests.gent import GENT
from valvefsi.case import case_schema, load_case
from valvefsi.case.reading import parse_case
from valvefsi.case.writing import to_toml
from valvefsi.errors import CaseError
from valvefsi.solid.materials import MATERIALS

FAMILY = {"k1": "24 kPa", "k2": 57.6, "kappa": 0.1, "fibre": "around"}
HGO = {"model": "hgo", "c10": "1.21 kPa", "c01": 7.99, "families": [FAMILY]}
AROUND = {"name": "around", "rule": "circumferential", "through": ["2 cm", "2 cm"], "angle": "45 deg"}
CASE = {
    "grid": {"lower": [0, 0], "upper": [4, 4], "cells": [16, 16]},
    "time": {"dt": "1 ms", "t_end": "1 s"},
    "solid": [
        {
            "name": "leaflet",
            "mesh": {"shape": "rectangle", "lower": [1, 1], "size": [0.5, 0.5], "elements": [2, 2]},
            "material": HGO,
            "fibre": [AROUND],
        }
    ],
}


def case_of(material=None, **solid):
    raw = deepcopy(CASE)
    raw["solid"][0].update({"material": material or HGO, **solid})
    return parse_case(raw)


def build(case, comm):
    from valvefsi.case.build import build_solid

    return build_solid(case, 0, comm)


def test_a_material_with_families_is_read_in_cgs_and_written_so_that_it_reads_back(shared_tmp, comm):
    case = case_of(nu_stab="off", kappa="1 kPa", volumetric="simo_taylor")
    family = {"k1": 2.4e5, "k2": 57.6, "kappa": 0.1, "lam_max": 0.0, "fibre": "around"}
    expected = {"c10": 1.21e4, "c01": 7.99, "families": (family,), "width": 0.0}
    assert case.solid[0].material.parameters == expected
    path = shared_tmp / "case.toml"
    if comm.rank == 0:
        path.write_text(to_toml(case), encoding="utf-8")
    comm.barrier()
    again = load_case(path)
    assert again.model_dump() == case.model_dump()
    assert again.solid[0].material.parameters == expected
    assert again.solid[0].fibre == case.solid[0].fibre


def test_the_solid_is_built_with_its_material_its_fibres_and_its_volumetric_term(comm):
    solid = build(case_of(kappa=5e3, volumetric="quadratic", volumetric_degree=1), comm)
    assert solid.material.families[0].k1 == 2.4e5
    assert solid.volumetric.form == "quadratic"
    assert solid.kappa == 5e3
    assert solid.discretisation.volumetric_degree == 1
    assert set(solid.mesh.fibres) == {"around"}
    F = solid.elasticity.force(1.2 * solid.X)
    assert np.isfinite(F).all()


@pytest.mark.parametrize(
    ("fibre", "expected"),
    [
        ({"rule": "constant", "direction": [3, 4]}, [0.6, 0.8]),
        ({"rule": "blend", "angles": {"x_lower": "30 deg", "x_upper": 30}}, [-0.5, 0.75**0.5]),
    ],
)
def test_each_rule_makes_its_field(comm, fibre, expected):
    solid = build(case_of(fibre=[{"name": "around", **fibre}]), comm)
    vectors = np.abs(solid.mesh.fibres["around"].x.array.reshape(-1, 2))
    np.testing.assert_allclose(vectors, np.broadcast_to(np.abs(expected), vectors.shape), rtol=1e-9)


def test_fibres_are_read_from_a_file_beside_the_case(shared_tmp, comm):
    import meshio

    if comm.rank == 0:
        corners = np.array([[x, y, 0.0] for y in (1, 1.25, 1.5) for x in (1, 1.25, 1.5)])
        quads = [[k, k + 1, k + 4, k + 3] for k in (0, 1, 3, 4)]
        data = {"fibre": [np.tile([0.0, 1.0, 0.0], (4, 1))]}
        meshio.Mesh(corners, [("quad", quads)], cell_data=data).write(shared_tmp / "fibres.vtu")
        case = deepcopy(CASE)
        case["solid"][0]["fibre"] = [{"name": "around", "rule": "constant", "direction": [1, 0]}]
        text = to_toml(parse_case(case)).replace('"constant"', '"data"\nfile = "fibres.vtu"')
        text = text.replace("direction = [1.0, 0.0]\n", "")
        (shared_tmp / "case.toml").write_text(text, encoding="utf-8")
    comm.barrier()
    solid = build(load_case(shared_tmp / "case.toml"), comm)
    vectors = solid.mesh.fibres["around"].x.array.reshape(-1, 2)
    np.testing.assert_allclose(vectors, np.broadcast_to([0.0, 1.0], vectors.shape))
    with pytest.raises(CaseError, match=r"fibre\.around\.file = 'fibre\.vtu': no such file; did you mean"):
        load_case(shared_tmp / "case.toml", ["solid.leaflet.fibre.around.file=fibre.vtu"])


def test_a_preset_says_aloud_that_nobody_has_checked_it(comm):
    case = case_of({"preset": "porcine_leaflet_hgo", "c10": "2 kPa"}, fibre=[{**AROUND, "name": "fibre"}])
    material = case.solid[0].material
    assert (material.model, material.preset) == ("hgo", "porcine_leaflet_hgo")
    assert material.parameters["c10"] == 2e4
    assert material.parameters["families"][0]["k2"] == 57.62
    if comm.rank == 0:
        with pytest.warns(UserWarning, match='preset "porcine_leaflet_hgo" is unverified'):
            build(case, comm)
    else:
        build(case, comm)
    published = case_of({"preset": "bovine_pericardium_lee_sacks"})
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        build(published, comm)


def own_material(folder, comm):
    """Write a case with a material of its own beside it."""
    if comm.rank == 0:
        (folder / "my_gent.py").write_text(GENT, encoding="utf-8")
        text = to_toml(case_of({"model": "neo_hookean", "c1": 1.0}))
        text = text.replace('model = "neo_hookean"', 'model = "my_gent.py:Gent"\nmu = "3 kPa"\nlimit = 20')
        (folder / "case.toml").write_text(text.replace('c1 = "1 dyn/cm^2"\n', ""), encoding="utf-8")
    comm.barrier()
    return folder / "case.toml"


def test_a_material_of_ones_own_beside_the_case_is_used_where_it_is_trusted(shared_tmp, comm):
    case = load_case(own_material(shared_tmp, comm), trust=True)
    assert case.solid[0].material.parameters == {"mu": 3e4, "limit": 20.0}
    solid = build(case, comm)
    assert solid.stiffness().shear_modulus == 3e4
    assert solid.energy(solid.X * [1.2, 1.0, 1.0]) > 0
    again = parse_case(tomllib.loads(to_toml(case)), trust=True)  # as a run keeps it, from anywhere
    assert again.solid == case.solid


@pytest.mark.serial
def test_a_material_of_ones_own_runs_only_where_it_is_trusted(shared_tmp, comm, monkeypatch):
    path = own_material(shared_tmp, comm)
    bite = shared_tmp / "bitten"
    with (shared_tmp / "my_gent.py").open("a", encoding="utf-8") as file:
        file.write(f"open({str(bite)!r}, 'w').close()\n")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(shared_tmp / "config"))
    with pytest.raises(CaseError, match=r"this would run .*my_gent\.py; allow it with --trust") as caught:
        load_case(path)
    assert "\n" not in str(caught.value)
    assert not bite.exists()
    (shared_tmp / "config" / "valvefsi").mkdir(parents=True, exist_ok=True)
    user = shared_tmp / "config" / "valvefsi" / "config.toml"
    user.write_text(f'trust = ["{shared_tmp / "config"}"]', encoding="utf-8")
    with pytest.raises(CaseError, match="this would run"):
        load_case(path)
    assert not bite.exists()
    user.write_text('trust = ["."]', encoding="utf-8")
    with pytest.raises(CaseError, match=r"trust = '\.': expected whole paths"):
        load_case(path)
    user.write_text(f'trusted = ["{shared_tmp}"]', encoding="utf-8")
    with pytest.raises(CaseError, match=r"config\.toml: trusted: unknown key; did you mean 'trust'\?$"):
        load_case(path)
    user.write_text(f'trust = ["{shared_tmp}"]', encoding="utf-8")
    assert load_case(path).solid[0].material.parameters["limit"] == 20.0
    assert bite.exists()


@pytest.mark.serial
@pytest.mark.parametrize("how", [["-c", "from valvefsi.cli import main; main()"], ["-m", "valvefsi"]])
def test_files_beside_a_case_do_not_stand_for_libraries(tmp_path, how):
    path = own_material(tmp_path, MPI.COMM_SELF)
    bite = f"open({str(tmp_path / 'bitten')!r}, 'w').close()\n"
    for name in ("pint", "meshio", "typer"):
        (tmp_path / f"{name}.py").write_text(bite, encoding="utf-8")
    command = [
        sys.executable,
        *(["-P"] if how[0] == "-c" else []),
        *how,
        "run",
        str(path),
        "--trust",
        "--plan",
    ]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert not (tmp_path / "bitten").exists()


BAD = [
    ({**HGO, "c11": 1.0}, r"material\.c11 = 1\.0: unknown parameter of hgo; did you mean 'c10'"),
    ({**HGO, "c10": "2 cm"}, r"material\.c10 = '2 cm': expected a quantity in dyn/cm\^2"),
    ({**HGO, "c10": float("nan")}, r"material\.c10 = nan: expected a finite number"),
    ({**HGO, "families": [{**FAMILY, "kappa": 0.4}]}, r"families\.0\.kappa = 0\.4: .*at most 0\.333333"),
    ({**HGO, "families": [{**FAMILY, "kapa": 0.1}]}, r"families\.0\.kapa = 0\.1: unknown parameter"),
    ({**HGO, "families": [{"k1": 1.0, "fibre": 0}]}, r"families\.0\.k2: this parameter .* is required"),
    ({**HGO, "families": [{**FAMILY, "fibre": "45 cm"}]}, r"families\.0\.fibre = '45 cm': expected the name"),
    ({**HGO, "families": 3}, r"families = 3: expected a list of tables"),
    ({"preset": "porcine_leaflet"}, r"preset = 'porcine_leaflet': unknown preset"),
    (
        {"preset": "porcine_leaflet_hgo", "model": "fung"},
        r"model = 'fung': the preset .* is of the model \"hgo\"",
    ),
    (
        {"model": "no_such_module.Gent"},
        r"model = 'no_such_module.Gent': unknown material; one of your own is",
    ),
    ({"model": "none.py:Gent"}, r"model = 'none.py:Gent': there is no Python file"),
    ({"model": "hgoo"}, r"model = 'hgoo': unknown material; did you mean 'hgo'"),
    ({"families": []}, r"material\.model: this key is required"),
]


@pytest.mark.parametrize(("material", "message"), BAD, ids=[str(k) for k in range(len(BAD))])
def test_a_wrong_material_is_one_clear_line(material, message):
    with pytest.raises(CaseError, match=message) as caught:
        case_of(material)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("fibre", "message"),
    [
        ({"rule": "constant"}, r"direction: a .constant. fibre field needs this key"),
        ({"rule": "blend", "angles": {"x_lower": 1}}, r"angles: expected two facet tags"),
        (
            {"rule": "constant", "direction": [1, 0], "angle": 3},
            r"angle = 3.*a .constant. fibre field has direction",
        ),
        ({"rule": "circumferential", "axis": [0, 0, 0]}, r"axis = .*not all zero"),
        ({"rule": "circular"}, r"rule = 'circular': expected one of constant"),
    ],
)
def test_a_wrong_fibre_field_is_one_clear_line(fibre, message):
    with pytest.raises(CaseError, match=message):
        case_of(fibre=[{"name": "around", **fibre}])


def test_what_only_the_mesh_can_tell_is_one_clear_line_too(comm):
    blend = {"name": "around", "rule": "blend", "angles": {"x_lower": 0, "x_uper": 1}}
    for case, message in (
        (case_of(fibre=[]), r"solid\.leaflet\.fibre = 'around': no such fibre field; the mesh has none"),
        (case_of(fibre=[blend]), r'solid\.leaflet\.fibre\.around.*did you mean "x_upper"'),
        (
            case_of({"model": "may_newman_yin", "c0": 1, "c1": 1, "c2": 1}),
            r"leaflet\.nu_stab = 0\.4: .*no stiffness",
        ),
    ):
        with pytest.raises(CaseError, match=message):
            build(case, comm)


def test_the_schema_knows_families_and_presets():
    entries = {e["properties"]["model"]["const"]: e for e in case_schema()["$defs"]["Material"]["oneOf"][:-1]}
    family = entries["hgo"]["properties"]["families"]["items"]
    assert family["required"] == ["k1", "k2", "fibre"]
    assert "porcine_leaflet_hgo" in entries["hgo"]["properties"]["preset"]["enum"]
    assert "unverified" in entries["hgo"]["properties"]["preset"]["description"]


def test_the_schema_takes_a_material_of_ones_own_by_its_file():
    own = case_schema()["$defs"]["Material"]["oneOf"][-1]
    pattern = own["properties"]["model"]["pattern"]
    assert own["required"] == ["model"]
    assert re.search(pattern, "my_materials.py:Gent")
    assert not any(re.search(pattern, model) for model in MATERIALS)
