"""The static benchmarks: published values, refinement, parameters, what is left behind."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.benchmarks import land, statics_compression, statics_cook, statics_torsion
from valvefsi.benchmarks.static_study import Setup, chosen_cells, extrapolated, observed_order, run_study
from valvefsi.errors import CaseError

REFERENCE = Path(__file__).parents[1] / "reference"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return Path(MPI.COMM_WORLD.bcast(str(tmp_path_factory.mktemp("statics")), root=0))


@pytest.fixture(scope="module")
def compression(folder):
    return statics_compression.run(Setup(elements=4, refine=2), out=folder / "compression")


@pytest.fixture(scope="module")
def cook(folder):
    return statics_cook.run(Setup(elements=4, refine=3), out=folder / "cook")


def column(name, key):
    table = np.genfromtxt(REFERENCE / name, delimiter=",", comments="#", skip_header=4, names=True)
    return table[key]


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_the_compressed_block_is_within_half_a_per_mille(compression, cell):
    reference = column("compression_statics.csv", "u_y_top_centre_cm")[-1]
    assert compression["quantities"][cell]["u_y_top_centre_cm"] == pytest.approx(reference, rel=5e-4)


def test_the_compressed_block_converges_with_order_above_two_on_triangles(compression):
    assert compression["quantities"]["triangle"]["u_y_top_centre_cm_order"] > 2.0


def test_cooks_membrane_lies_in_the_published_band_and_both_cells_agree(cook):
    with (REFERENCE / "cook_membrane.csv").open() as lines:
        rows = dict(line.strip().split(",") for line in lines if line.startswith("band_"))
    values = [cook["quantities"][cell]["u_y_corner_cm"] for cell in ("triangle", "quadrilateral")]
    for value in values:
        assert float(rows["band_lower"]) <= value <= float(rows["band_upper"])
    limit = cook["quantities"]["triangle"]["u_y_corner_cm_extrapolated"]
    assert limit == pytest.approx(values[1], rel=1e-3)
    assert all(line["inside"] for line in cook["table"] if "inside" in line)


def test_the_band_is_the_one_of_the_reference_table():
    with (REFERENCE / "cook_membrane.csv").open() as lines:
        rows = dict(line.strip().split(",") for line in lines if line.startswith("band_"))
    assert (float(rows["band_lower"]), float(rows["band_upper"])) == statics_cook.BAND


def test_the_torsion_benchmark_compares_with_the_reference_table():
    assert tuple(column("torsion_statics.csv", "u_y_top_centre_cm")) == statics_torsion.COMPUTED
    parts = column("torsion_statics.csv", "theta_over_pi") / 2.5
    np.testing.assert_allclose(statics_torsion.FRACTIONS, parts)


def test_a_column_twisted_on_a_coarse_mesh_rises_by_the_reference_within_three_per_cent(folder):
    result = statics_torsion.run(Setup(cell="hexahedron", elements=2), out=folder / "torsion")
    found = [result["quantities"]["hexahedron"][name] for name in statics_torsion.NAMES]
    np.testing.assert_allclose(found, column("torsion_statics.csv", "u_y_top_centre_cm"), rtol=0.03)
    assert found[-1] == pytest.approx(0.2804, rel=5e-3)


@pytest.mark.slow
def test_a_column_twisted_on_a_finer_mesh_rises_by_the_reference_at_every_angle(folder):
    result = statics_torsion.run(Setup(cell="hexahedron", elements=4), out=folder / "torsion_fine")
    found = [result["quantities"]["hexahedron"][name] for name in statics_torsion.NAMES]
    np.testing.assert_allclose(found, column("torsion_statics.csv", "u_y_top_centre_cm"), atol=6e-5)


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
    setup = Setup(cell="triangle", elements=4, overrides=["traction=10 Pa", "c1=8.0194 Pa", "width=20 cm"])
    result = statics_compression.run(setup, out=folder / "half")
    assert result["parameters"]["traction"] == pytest.approx(100.0)
    assert result["parameters"]["c1"] == pytest.approx(80.194)
    assert -2.5 < result["quantities"]["triangle"]["u_y_top_centre_cm"] < -1.5
    assert result["reference"] == {}


def test_lengths_and_moduli_scale_out(folder):
    def corner(overrides):
        result = statics_cook.run(
            Setup(cell="triangle", elements=2, overrides=overrides), out=folder / "scale"
        )
        return result["quantities"]["triangle"]["u_y_corner_cm"]

    plain = corner([])
    assert corner(["scale=2"]) == pytest.approx(2 * plain, rel=1e-9)
    assert corner(["c1=250", "traction=18.75"]) == pytest.approx(plain, rel=1e-9)


def test_cells_are_chosen_by_name():
    assert chosen_cells(statics_cook.BENCHMARK, "both") == ("triangle", "quadrilateral")
    assert chosen_cells(statics_torsion.BENCHMARK, "simplex") == ("tetrahedron",)
    with pytest.raises(CaseError, match="no such cell"):
        chosen_cells(statics_cook.BENCHMARK, "hexahedron")


def test_a_refinement_below_zero_is_refused(folder):
    with pytest.raises(CaseError, match="refine"):
        run_study(statics_cook.BENCHMARK, Setup(refine=-1), out=folder / "bad")


def test_the_observed_order_is_that_of_a_made_up_series():
    values = [3.0 + 0.7 * 2.0 ** (-2.5 * k) for k in range(4)]
    assert observed_order(values) == pytest.approx(2.5)
    assert observed_order(values, exact=3.0) == pytest.approx(2.5)
    assert extrapolated(values) == pytest.approx(3.0)
    assert observed_order(values[:2]) is None
    assert observed_order([1.0, 1.1, 1.05]) is None
    assert observed_order([1.0, 1.0, 1.0]) is None


@pytest.mark.serial
def test_the_command_prints_a_table_and_leaves_the_result(tmp_path):
    from typer.testing import CliRunner

    from valvefsi.cli.statics import statics

    options = ["--cell", "simplex", "--elements", "2", "--set", "c1=100", "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(statics, ["statics-compression", *options])
    assert done.exit_code == 0, done.output
    assert "u_y of the top centre" in done.output
    stored = json.loads((tmp_path / "out" / "result.json").read_text())
    assert stored["parameters"]["c1"] == 100.0
    assert list(stored["quantities"]) == ["triangle"]


def test_the_iterative_solver_gives_the_same_and_says_what_it_took(compression, folder):
    setup = Setup(cell="triangle", elements=16, iterative=True)
    result = statics_compression.run(setup, out=folder / "iterative")
    value = result["quantities"]["triangle"]["u_y_top_centre_cm"]
    assert value == pytest.approx(compression["quantities"]["triangle"]["u_y_top_centre_cm"], rel=1e-7)
    assert result["timing"]["peak_memory_gib"] > 0.05
    assert any(line["quantity"].startswith("wall time, triangle, 4,851") for line in result["table"])


def test_a_benchmark_without_an_iterative_solver_says_so(folder):
    with pytest.raises(CaseError, match="--iterative"):
        land.run(Setup(iterative=True), out=folder / "none", problems=(1,))
