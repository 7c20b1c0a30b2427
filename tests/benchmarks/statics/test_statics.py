"""The static benchmarks: published values, refinement, parameters, what is left behind."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.benchmarks import references
from valvefsi.benchmarks.statics.solids import (
    NAMES,
    StaticCompression,
    StaticCook,
    StaticTorsion,
    column_rises,
    cook_band,
)
from valvefsi.errors import CaseError


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return Path(MPI.COMM_WORLD.bcast(str(tmp_path_factory.mktemp("statics")), root=0))


@pytest.fixture(scope="module")
def compression(folder):
    return StaticCompression(elements=4, refine=2).run(out=folder / "compression")


@pytest.fixture(scope="module")
def cook(folder):
    return StaticCook(elements=4, refine=3).run(out=folder / "cook")


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_the_compressed_block_is_within_half_a_per_mille(compression, cell):
    reference = references.read("compression_statics").column("u_y_top_centre_cm")[-1]
    assert compression["quantities"][cell]["u_y_top_centre_cm"] == pytest.approx(reference, rel=5e-4)


def test_the_compressed_block_converges_with_order_above_two_on_triangles(compression):
    assert compression["quantities"]["triangle"]["u_y_top_centre_cm_order"] > 2.0


def test_cooks_membrane_lies_in_the_published_band_and_both_cells_agree(cook):
    values = [cook["quantities"][cell]["u_y_corner_cm"] for cell in ("triangle", "quadrilateral")]
    for value in values:
        assert cook_band()[0] <= value <= cook_band()[1]
    limit = cook["quantities"]["triangle"]["u_y_corner_cm_extrapolated"]
    assert limit == pytest.approx(values[1], rel=1e-3)
    assert all(line["inside"] for line in cook["table"] if "inside" in line)


def test_a_column_twisted_on_a_coarse_mesh_rises_by_the_reference_within_three_per_cent(folder):
    result = StaticTorsion(cell="hexahedron", elements=2).run(out=folder / "torsion")
    found = [result["quantities"]["hexahedron"][name] for name in NAMES]
    np.testing.assert_allclose(found, list(column_rises().values()), rtol=0.03)
    assert found[-1] == pytest.approx(0.2804, rel=5e-3)


@pytest.mark.slow
def test_a_column_twisted_on_a_finer_mesh_rises_by_the_reference_at_every_angle(folder):
    result = StaticTorsion(cell="hexahedron", elements=4).run(out=folder / "torsion_fine")
    found = [result["quantities"]["hexahedron"][name] for name in NAMES]
    np.testing.assert_allclose(found, list(column_rises().values()), atol=6e-5)


def test_result_json_and_pictures_are_left_behind(compression, folder):
    stored = json.loads((folder / "compression" / "result.json").read_text())
    assert {"benchmark", "parameters", "quantities", "reference", "levels", "table", "timing"} <= set(stored)
    assert stored["quantities"] == compression["quantities"]
    assert len(stored["levels"]) == 6
    assert [level["elements"] for level in stored["levels"]] == [4, 8, 16] * 2
    for name in (
        "deformed_triangle.png",
        "deformed_quadrilateral.png",
        "convergence.png",
        "solid_triangle.vtu",
    ):
        assert (folder / "compression" / name).stat().st_size > 1000


def test_every_line_of_a_table_names_its_source(compression, cook):
    for line in [*compression["table"], *cook["table"]]:
        assert line["source"]


def test_parameters_with_units_change_the_answer_and_take_the_reference_away(folder):
    overrides = ["traction=10 Pa", "c1=8.0194 Pa", "width=20 cm"]
    result = StaticCompression(cell="triangle", elements=4, overrides=overrides).run(out=folder / "half")
    assert result["parameters"]["traction"] == pytest.approx(100.0)
    assert result["parameters"]["c1"] == pytest.approx(80.194)
    assert -2.5 < result["quantities"]["triangle"]["u_y_top_centre_cm"] < -1.5
    assert result["reference"] == {}


def test_lengths_and_moduli_scale_out(folder):
    def corner(overrides):
        result = StaticCook(cell="triangle", elements=2, overrides=overrides).run(out=folder / "scale")
        return result["quantities"]["triangle"]["u_y_corner_cm"]

    plain = corner([])
    assert corner(["scale=2"]) == pytest.approx(2 * plain, rel=1e-9)
    assert corner(["c1=250", "traction=18.75"]) == pytest.approx(plain, rel=1e-9)


def test_cells_are_chosen_by_name():
    assert StaticCook().kinds() == ("triangle", "quadrilateral")
    assert StaticTorsion(cell="simplex").kinds() == ("tetrahedron",)
    with pytest.raises(CaseError, match="no such cell"):
        StaticCook(cell="hexahedron")
    with pytest.raises(CaseError, match="refine"):
        StaticCook(refine=-1)


def test_the_iterative_solver_gives_the_same_and_says_what_it_took(compression, folder):
    result = StaticCompression(cell="triangle", elements=16, iterative=True).run(out=folder / "iterative")
    value = result["quantities"]["triangle"]["u_y_top_centre_cm"]
    assert value == pytest.approx(compression["quantities"]["triangle"]["u_y_top_centre_cm"], rel=1e-7)
    assert result["timing"]["peak_memory_gib"] > 0.05
    assert any(line["quantity"].startswith("wall time, triangle, 4,851") for line in result["table"])
