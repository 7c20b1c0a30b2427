"""Where every value of a case is from, and what a run keeps of it."""

from __future__ import annotations

import hashlib
import json

import pytest
from mpi4py import MPI

from valvefsi.case import load_case
from valvefsi.case.origins import entries_of, inputs_of, read_provenance, write_provenance

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="knows of no ranks")
CASE = """
title = "two blocks"
[grid]
lower = [0, 0]
upper = [4, 1]
cells = [16, 4]
[fluid]
viscosity = "1 cP"
[fluid.sides]
x_lower = { type = "open", pressure = 2.0 }
[time]
dt = 0.1
t_end = 1
[[solid]]
name = "block"
include = "block.toml"
nu_stab = 0.3
mesh = { shape = "rectangle", lower = [1, 0.2], size = [0.5, 0.5], elements = [2, 2] }
"""
BLOCK = """
nu_stab = 0.1
kernel = "ib4"
material = { include = "stuff.toml", c1 = 7.0 }
mesh = { file = "none.msh", cell = "triangle" }
"""
STUFF = 'model = "neo_hookean"\nc1 = 5.0\n'


@pytest.fixture
def file(tmp_path):
    """A case that includes a file that includes another."""
    for name, text in (("case.toml", CASE), ("block.toml", BLOCK), ("stuff.toml", STUFF)):
        (tmp_path / name).write_text(text)
    return tmp_path / "case.toml"


def entries(case, origins):
    return {entry.path: entry for entry in entries_of(case, origins)}


def test_each_value_knows_the_file_the_command_line_or_the_default_it_is_from(file):
    case = load_case(file, ["fluid.density=1.1 g/cm^3", "solid.block.mesh.elements=[4, 4]"])
    found = entries(case, case.origins)
    assert {path: found[path].origin for path in (
        "title",
        "grid.upper",
        "fluid.viscosity",
        "fluid.density",
        "fluid.advection",
        "fluid.sides.x_lower.pressure",
        "fluid.sides.x_lower.backflow",
        "fluid.sides.y_lower.type",
        "solid.block.nu_stab",
        "solid.block.kernel",
        "solid.block.material.model",
        "solid.block.material.c1",
        "solid.block.mesh.elements",
        "solid.block.mesh.size",
        "solid.block.mesh.cell",
        "output.frames",
    )} == {
        "title": "case.toml",
        "grid.upper": "case.toml",
        "fluid.viscosity": "case.toml",
        "fluid.density": "--set",
        "fluid.advection": "default",
        "fluid.sides.x_lower.pressure": "case.toml",
        "fluid.sides.x_lower.backflow": "default",
        "fluid.sides.y_lower.type": "default",
        "solid.block.nu_stab": "case.toml",
        "solid.block.kernel": "block.toml",
        "solid.block.material.model": "stuff.toml",
        "solid.block.material.c1": "block.toml",
        "solid.block.mesh.elements": "--set",
        "solid.block.mesh.size": "case.toml",
        "solid.block.mesh.cell": "default",
        "output.frames": "default",
    }  # fmt: skip
    viscosity = found["fluid.viscosity"]
    assert (viscosity.value, viscosity.unit) == (pytest.approx(0.01), "dyn*s/cm^2")
    assert "iscosity" in viscosity.meaning


def test_a_preset_is_the_origin_of_the_parameters_that_are_not_given(file):
    (file.parent / "stuff.toml").write_text('preset = "bovine_pericardium_lee_sacks"\nc2 = 30.0\n')
    (file.parent / "block.toml").write_text('material = { include = "stuff.toml" }\n')
    case = load_case(file)
    found = entries(case, case.origins)
    assert found["solid.block.material.c0"].origin == "preset bovine_pericardium_lee_sacks"
    assert found["solid.block.material.c2"].origin == "stuff.toml"


def test_without_a_record_only_what_is_like_the_default_is_told_from_the_rest(file):
    found = entries(load_case(file), None)
    assert found["fluid.advection"].origin == "the default, or given like it"
    assert found["grid.upper"].origin == "not recorded"


def test_every_value_of_a_case_is_told_once(file):
    from valvefsi.case.values import values_by_path

    case = load_case(file)
    told = [entry.path for entry in entries_of(case, {})]
    assert len(told) == len(set(told))
    for path in values_by_path(case):
        assert any(f"{path}.".startswith(f"{key}.") for key in told), path


def test_a_run_keeps_origins_hashes_and_every_call(file, tmp_path):
    case = load_case(file)
    write_provenance(case, tmp_path, MPI.COMM_SELF, resume=False)
    kept = read_provenance(tmp_path)
    assert kept["origins"]["solid.block.kernel"] == "block.toml"
    named = {item["file"]: item for item in kept["inputs"]}
    assert {name: item["part"] for name, item in named.items()} == {
        "case.toml": "case file",
        "block.toml": "included file",
        "stuff.toml": "included file",
    }
    assert named["block.toml"]["sha256"] == hashlib.sha256(BLOCK.encode()).hexdigest()
    (call,) = kept["calls"]
    assert call["versions"]["valvefsi"]
    assert call["machine"]["cores"] >= 1
    assert call["ranks"] == 1
    (file.parent / "block.toml").write_text(BLOCK.replace("ib4", "ib3"))
    write_provenance(load_case(file), tmp_path, MPI.COMM_SELF, resume=True)
    again = read_provenance(tmp_path)
    assert [again["origins"], again["inputs"], len(again["calls"])] == [kept["origins"], kept["inputs"], 2]
    write_provenance(load_case(file), tmp_path, MPI.COMM_SELF, resume=False)
    assert len(read_provenance(tmp_path)["calls"]) == 1
    assert read_provenance(tmp_path)["inputs"] != kept["inputs"]


def test_files_that_a_case_names_are_hashed(file):
    (file.parent / "table.csv").write_text("t_s,pressure_mmHg\n0,1\n1,2\n")
    text = CASE.replace("pressure = 2.0", 'table = "table.csv"')
    file.write_text(text)
    (table,) = (item for item in inputs_of(load_case(file)) if item["file"] == "table.csv")
    assert table["part"] == "fluid.sides.x_lower.table"
    assert table["sha256"] == hashlib.sha256((file.parent / "table.csv").read_bytes()).hexdigest()


def test_a_record_that_is_damaged_counts_as_none(tmp_path):
    (tmp_path / "provenance.json").write_text("{")
    assert read_provenance(tmp_path) == {}
    (tmp_path / "provenance.json").write_text(json.dumps([1]))
    assert read_provenance(tmp_path) == {}
