"""Case files: units, overrides, and one line for everything that is wrong."""

import json
import re
import tomllib
from dataclasses import fields

import numpy as np
import pytest

from valvefsi.case import (
    apply_overrides,
    case_defaults,
    case_schema,
    check_against_mesh,
    load_case,
    parse_case,
    split_override,
    to_dict,
    to_toml,
)
from valvefsi.case.checks import REACH
from valvefsi.case.models import SHAPES
from valvefsi.case.quantities import USUAL_UNITS, Quantity
from valvefsi.case.target_tables import Target
from valvefsi.errors import CaseError
from valvefsi.units import MMHG


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(case_defaults())
    (tmp_path / "valve.msh").write_text("")
    return path


def message(file, *overrides):
    with pytest.raises(CaseError) as caught:
        load_case(file, overrides)
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_the_printed_case_is_a_case_with_every_key_in_it(file):
    case = load_case(file)
    assert case.solid[0].material.parameters == {"c1": 80.194}
    text = case_defaults()
    for definition in case_schema()["$defs"].values():
        for key, entry in definition.get("properties", {}).items():
            assert re.search(rf"^(# )?\[*(# )?[\w.]*\b{key}\b(\]+$| = )", text, re.M) or key.startswith(
                "z_"
            ), key
            assert entry.get("description"), key


def test_a_case_written_as_toml_reads_back_as_the_same_case(file, tmp_path):
    case = load_case(file, ["solid.block.nu_stab=off", "fluid.viscosity='1.1 cP'", "time.dt='0.3 ms'"])
    again = tmp_path / "again.toml"
    again.write_text(to_toml(case))
    assert to_dict(load_case(again)) == to_dict(case)
    assert to_dict(case)["solid"][0]["nu_stab"] == "off"
    assert to_dict(parse_case(json.loads(json.dumps(to_dict(case))))) == to_dict(case)


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("5 l/min", "cm^3/s"),
        ("0.887 mmHg*s/ml", "dyn*s/cm^5"),
        ("2.43 ml/mmHg", "cm^5/dyn"),
        ("0.00131 mmHg*s^2/ml", "dyn*s^2/cm^5"),
        ("80 mmHg", "dyn/cm^2"),
        ("1234.57 dyn/cm^2", "dyn/cm^2"),
        ("4.5 cm", "cm"),
    ],
)
def test_a_quantity_is_written_as_people_write_it(text, unit):
    assert Quantity(unit).text(Quantity(unit).parse(text)) == text


@pytest.mark.parametrize("unit", [*USUAL_UNITS, "cm", "s"])
def test_every_quantity_reads_back_as_the_same_number(unit):
    rng, quantity = np.random.default_rng(1), Quantity(unit)
    values = 10.0 ** rng.uniform(-9, 9, 100)
    values[::2] = [float(f"{value:.3g}") for value in values[::2]]
    people = [quantity.parse(f"{value:.4g} {USUAL_UNITS.get(unit, [unit])[0]}") for value in values]
    for value in (0.0, *values, *-values, *people):
        assert quantity.parse(quantity.text(float(value))) == value


def test_no_default_of_a_case_is_a_long_number():
    shown = case_defaults()
    assert not re.findall(r"\d\.\d{7,}", shown)
    keys = (
        'cardiac_output = "5 l/min"',
        'mean_aortic_pressure = "100 mmHg"',
        'R_p = "0.887 mmHg*s/ml"',
        "80 mmHg",
    )
    for text in keys:
        assert text in shown
    assert Quantity("cm^3/s").parse("5 l/min") == Target().cardiac_output


@pytest.mark.parametrize(
    ("override", "read", "value"),
    [
        ("fluid.viscosity='3.5 cP'", lambda c: c.fluid.viscosity, 0.035),
        ("fluid.viscosity=0.16", lambda c: c.fluid.viscosity, 0.16),
        ("fluid.density='1060 kg/m^3'", lambda c: c.fluid.density, 1.06),
        ("time.dt='1 ms'", lambda c: c.dt, 1e-3),
        ("time.dt_per_h=0.002", lambda c: c.dt, 0.002 * 40 / 64),
        ("solid.block.material.c1='10 kPa'", lambda c: c.solid[0].material.parameters["c1"], 1e5),
        ("solid.block.load.0.traction=[0, '-15 mmHg']", lambda c: c.solid[0].load[0].traction[1], -15 * MMHG),
        ("solid.block.damping=4", lambda c: c.solid[0].damping, 4),
        ("solid.block.mesh.lower=['100 mm', '0.15 m']", lambda c: c.solid[0].mesh.lower[1], 15),
        ("solid.block.tether.0.stiffness='1 kPa/mm'", lambda c: c.solid[0].tether[0].stiffness, 1e5),
        ("grid.upper=['0.4 m', 40]", lambda c: c.grid.spacing, 0.625),
    ],
)
def test_quantities_are_cgs_inside_whatever_their_unit(file, override, read, value):
    assert read(load_case(file, [override])) == pytest.approx(value, rel=1e-14)


WRONG = {
    "fluid.viscosity='3 cm'": "--set: fluid.viscosity = '3 cm': expected a quantity in dyn*s/cm^2",
    "fluid.viscosity='3'": "expected a quantity in dyn*s/cm^2: write 3 without quotes, or a unit after it",
    "fluid.viscosity='sin'": "expected a quantity in dyn*s/cm^2: this text begins with no number",
    "fluid.viscosity='3 *'": "expected a quantity in dyn*s/cm^2: what follows the number is no unit",
    "fluid.viscosity='3 kPa'": "expected a quantity in dyn*s/cm^2, kPa measures something else",
    "fluid.viscosity='3 cPP'": 'unknown unit "cPP", did you mean "cP"?',
    "fluid.viscosity=true": "fluid.viscosity = True: expected a quantity",
    "fluid.viscosity=nan": "expected a finite number",
    "fluid.viscosity=-1": "fluid.viscosity = -1.0: expected a number greater than 0",
    "fluid.density=0": "fluid.density = 0.0: expected a number greater than 0",
    "fluid.viscosty=1": "fluid.viscosty = 1: unknown key; did you mean 'viscosity'?",
    "fluid.density.x=1": "fluid.density is a value",
    "flud.density=1": "--set: flud: unknown key; did you mean 'fluid'?",
    "fluid.sides.x_lower.type=periodc": "expected one of wall, periodic, free_slip, open, mixed; did you",
    "fluid.sides.x_lower.type=periodic": "fluid.sides.x_upper.type = 'wall': the opposite side is periodic",
    "fluid.sides.x_lower.velocity=[1]": "fluid.sides.x_lower.velocity = [1.0]: expected 2 entries",
    "fluid.sides.x_lower.velocity=[1, 0]": "let 40 cm^2/s into the box",
    "fluid.sides.z_lower.velocity=[1, 0]": "two dimensions has no such side",
    "grid.cells=[64, 65]": "[64, 64] would do",
    "grid.cells=[64, 3]": "grid.cells.1 = 3: expected a number of at least 4",
    "grid.cells=[64]": "grid.cells = [64]: expected 2 entries",
    "grid.cells=[6.5, 64]": "expected a whole number",
    "grid.upper=[-1, 40]": "grid.upper = [-1.0, 40.0]: expected each entry above that of lower",
    "time.t_end=0": "time.t_end = 0.0: expected a number greater than 0",
    "time.t_end='1 us'": "time.t_end = 1e-06: expected at least one time step",
    "time.dt=-1": "time.dt = -1: expected a number greater than 0",
    "time.cfl_max=2": "expected a number of at most 1",
    "solid.blok.degree=2": "solid.blok: no such item; did you mean 'block'?",
    "solid.1.degree=2": "no such item",
    "solid.block.degree=3": "solid.block.degree = 3: expected one of 1, 2",
    "solid.block.kernel=bspline33": "did you mean 'bspline3'?",
    "solid.block.nu_stab=0.5": "solid.block.nu_stab = 0.5: expected a number above -1 and below 0.5",
    "solid.block.nu_stab=-1": "expected a number above -1",
    "solid.block.nu_stab=of": 'or "off"',
    "solid.block.material.model=neohookean": "unknown material; did you mean 'neo_hookean'?",
    "solid.block.material.c11=1": "unknown parameter of neo_hookean; did you mean 'c1'?",
    "solid.block.material.c1=-1": "solid.block.material.c1 = -1: expected",
    "solid.block.material.c1='1 cm'": "solid.block.material.c1 = '1 cm': expected a quantity in dyn/cm^2",
    "solid.0.material={model = 'mooney_rivlin', c1 = 1}": "c2: this parameter of mooney_rivlin is required",
    "solid.block.mesh.lower=[-1, 15]": "the solid is outside the box",
    "solid.block.mesh.shape=box": "a box needs 3 entries",
    "solid.block.mesh={file = 'valv.msh'}": "'valv.msh': no such mesh file; did you mean 'valve.msh'?",
    "solid.block.mesh.file=valve.msh": "give file, shape or valve; both are given",
    "solid.block.tether.0.on=[botom]": "expected key",
    "solid.block.tether.0.on=['botom']": "= 'botom': the mesh has no such tag; did you mean 'bottom'?",
    "solid.block.tether.0.stiffness='1 dyn/cm^4'": "expected a quantity in dyn/cm^3",
    "solid.block.tether.0.components=['z']": "in two dimensions there are 'x', 'y'",
    "solid.block.load.0.on=['top']": "did you mean 'top_outer'?",
    "solid.block.load.0.on=[]": "expected at least 1 entry",
    "solid.block.load.0.traction=[1]": "solid.block.load.0.traction = [1.0]: expected 2 entries",
    "solid.block.probe.top_centre.at=[50, 20]": "the nearest position is 30, 20 cm",
    "output.history_every=0": "expected a number of at least 1",
    "title": "expected key=value",
}


@pytest.mark.parametrize("override", WRONG)
def test_what_is_wrong_is_said_in_one_line(file, override):
    if override == "solid.block.tether.0.on=[botom]":  # not TOML, so a plain string, and no list
        assert "expected a list" in message(file, override)
    else:
        assert WRONG[override] in message(file, override)


def test_solids_may_touch_walls_and_not_come_near_open_sides(file):
    near = "solid.block.mesh.lower=[0, 15]"
    assert load_case(file, overrides=[near]).solid[0].mesh.lower == (0.0, 15.0)
    found = message(file, near, "fluid.sides.x_lower={type = 'open'}")
    assert "within the reach of bspline3 from an open side: it spans x = 0 ... 20 cm" in found


def test_an_error_in_the_file_names_the_file(file):
    file.write_text(case_defaults().replace('viscosity = "0.01 dyn*s/cm^2"', 'viscosity = "3 cm"'))
    assert (
        message(file)
        == f"{file}: fluid.viscosity = '3 cm': expected a quantity in dyn*s/cm^2, cm measures something else"
    )
    file.write_text(case_defaults().replace('t_end = "30 s"', ""))
    assert message(file) == f"{file}: time.t_end: this key is required"
    file.write_text("a = = 1")
    assert message(file).startswith(f"{file}: not TOML")
    file.write_text(case_defaults())
    near = message(file.with_name("cas.toml"))
    assert near.endswith("cas.toml: no such case file; did you mean 'case.toml'?")


def test_mesh_files_are_relative_to_the_case_file(file):
    file.write_text(
        re.sub(
            r"\[solid.mesh\].*?(?=\[solid.material\])",
            '[solid.mesh]\nfile = "valve.msh"\n',
            case_defaults(),
            flags=re.S,
        ).replace("# Where", "#")
    )
    case = load_case(file)
    assert case.solid[0].mesh.file == str(file.parent.resolve() / "valve.msh")
    box = {"lower": (10, 15, 0), "upper": (30, 25, 0)}
    check_against_mesh(case, 0, tags=("block", "bottom", "top_loaded"), **box)
    with pytest.raises(CaseError, match=r"solid.block.tether.0.on = 'bottom': .* did you mean 'botom'"):
        check_against_mesh(case, 0, tags=("botom", "top_loaded"), **box)
    with pytest.raises(CaseError, match=r"mesh.file = .* outside the box: it spans y = 35 ... 45 cm"):
        check_against_mesh(case, 0, tags=("bottom", "top_loaded"), lower=(10, 35, 0), upper=(30, 45, 0))


def test_periodic_sides_let_a_solid_come_near(file):
    sides = [f"fluid.sides.x_{end}.type=periodic" for end in ("lower", "upper")]
    case = load_case(file, [*sides, "solid.block.mesh.lower=[0, 15]", "solid.block.probe=[]"])
    assert case.fluid.sides.periodic(0)
    assert not case.fluid.sides.periodic(1)


def test_wall_velocities_that_balance_are_accepted(file):
    overrides = [f"fluid.sides.x_{end}.velocity=[1, 0]" for end in ("lower", "upper")]
    assert load_case(file, overrides).fluid.sides.x_lower.velocity == (1.0, 0.0)


def test_the_same_name_twice_is_refused(file):
    raw = tomllib.loads(file.read_text())
    raw["solid"].append(raw["solid"][0])
    with pytest.raises(CaseError, match="two solids have this name"):
        parse_case(raw)


def test_overrides_reach_items_by_name_by_number_and_by_alias(file):
    by_name, by_number = (load_case(file, [f"solid.{key}.nu_stab=0.3"]) for key in ("block", "0"))
    assert by_name.solid[0].nu_stab == by_number.solid[0].nu_stab == 0.3
    aliases = {"mu": "fluid.viscosity"}
    raw = tomllib.loads(file.read_text())
    assert parse_case(raw, ["mu=0.16"], aliases=aliases).fluid.viscosity == 0.16
    with pytest.raises(CaseError, match="nu = 1: unknown parameter; did you mean 'mu'"):
        parse_case(raw, ["nu=1"], aliases=aliases)
    assert raw["fluid"]["viscosity"] == "0.01 dyn*s/cm^2"


def test_the_last_override_wins_and_values_may_be_bare_words():
    raw = {"time": {"dt": 1}}
    assert apply_overrides(raw, ["a.b=1", "a.b=two words", "time.dt_per_h=3"]) == [
        "a.b",
        "a.b",
        "time.dt_per_h",
    ]
    assert raw == {"time": {"dt_per_h": 3}, "a": {"b": "two words"}}
    assert split_override(" a.b = [1, 'x=y']") == ("a.b", [1, "x=y"])


def test_the_tables_of_kernels_materials_and_shapes_are_those_of_the_code():
    from mpi4py import MPI

    from valvefsi.coupling.kernels import KERNELS
    from valvefsi.geometry.shapes import SHAPES as MADE
    from valvefsi.solid.materials import MATERIALS

    assert {name: max(kind[1:]) / 2 for name, kind in KERNELS.items()} == REACH
    assert set(MADE) == set(SHAPES)
    for name, (dim, tags) in SHAPES.items():
        options = {"load_width": 0.5} if name == "compressed_block" else {}
        box = {"lower": (0.0,) * dim, "size": (1.0,) * dim, "elements": (4,) * dim}
        mesh = MADE[name](MPI.COMM_SELF, **box, **options)
        assert set(mesh.names) == set(tags), name
    schemas = {
        entry["properties"]["model"]["const"]: entry
        for entry in case_schema()["$defs"]["Material"]["oneOf"][:-1]
    }
    for name, kind in MATERIALS.items():
        assert {field.name for field in fields(kind)} <= set(schemas[name]["properties"])


def test_the_schema_is_json():
    schema = json.loads(json.dumps(case_schema()))
    assert schema["type"] == "object"
    assert schema["additionalProperties"] is False


def test_a_run_of_one_step_is_a_run(file):
    overrides = ["time.dt_per_h=null", "time.dt='40 us'", "time.t_end='39.999999999999996 us'"]
    assert load_case(file, overrides).dt == pytest.approx(4e-5)
    with pytest.raises(CaseError, match=r"time\.t_end.*at least one time step"):
        load_case(file, [*overrides[:2], "time.t_end='39 us'"])
