"""``valvefsi fit biaxial``: files it leaves, what it prints, what it says when something is wrong."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import tomllib

import numpy as np
import pytest
from biaxial_synthetic import records_of as synthetic
from typer.testing import CliRunner

from valvefsi.cli.fit import fit as commands
from valvefsi.errors import CaseError
from valvefsi.fitting.biaxial import fit_biaxial
from valvefsi.fitting.biaxial_records import read_biaxial
from valvefsi.fitting.planar import LeeSacks
from valvefsi.fitting.planar_hgo import HGO

pytestmark = pytest.mark.serial  # nothing in it runs in parallel

HGO_TRUTH = [1.5, 5.0, 0.12, 0.0, 20.0, 8.0]
PNG = b"\x89PNG"


def csv_of(data, path):
    rows = ["protocol,F11,F12,F21,F22,P11_kPa,P22_kPa"]
    for k, (F, P) in enumerate(zip(data.F, data.stress, strict=True)):
        rows.append(",".join(repr(float(x)) for x in (data.protocol[k] + 1, *F.ravel(), *P)))
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    data = synthetic(HGO(), HGO_TRUTH, noise=0.005, seed=3)
    return csv_of(data, tmp_path_factory.mktemp("biaxial") / "leaflet.csv")


def run(*words):
    return CliRunner().invoke(commands, ["biaxial", *map(str, words)])


def test_the_command_leaves_json_material_and_pictures(record, tmp_path):
    out = tmp_path / "out"
    words = ["--fibre-angle", "0", "--starts", "8", "--protocols", "1,2,3,4", "--compare", "lee-sacks"]
    done = run(record, *words, "--out", out)
    assert done.exit_code == 0, done.output
    assert "identified" in done.output
    assert "protocol 5, predicted" in done.output
    written = json.loads((out / "fit.json").read_text())
    for key in ("parameters", "r_squared", "cost", "nrmse", "relative_l2", "relative_linf", "correlation"):
        assert key in written
    for key in (
        "starts",
        "n_points",
        "data",
        "versions",
        "singular_values",
        "held_out",
        "comparison",
        "stability",
    ):
        assert key in written
    held = 0
    for name, value in zip(("c10", "c01", "kappa", "angle", "k1", "k2"), HGO_TRUTH, strict=True):
        entry = written["parameters"][name]
        assert entry["unit"] == {"c10": "kPa", "k1": "kPa", "angle": "deg"}.get(name, "-")
        if name != "angle":
            assert entry["ci95"][0] <= entry["value"] <= entry["ci95"][1]
            held += entry["ci95"][0] <= value <= entry["ci95"][1]
    assert held >= 4
    assert written["parameters"]["angle"]["verdict"] == "held"
    assert set(written["prediction"]) == {"5"}
    assert set(written["comparison"]) == {"hgo", "lee_sacks"}
    for name in ("fit.png", "profiles.png"):
        assert (out / name).read_bytes()[:4] == PNG


def test_pictures_of_a_fit_for_papers_are_vectors_with_their_numbers(record, tmp_path):
    done = run(record, "--model", "neo-hookean", "--starts", "1", "--style", "paper", "--out", tmp_path)
    assert done.exit_code == 0, done.output
    assert sorted(path.name for path in tmp_path.iterdir() if path.suffix not in (".json", ".toml")) == [
        "fit.pdf",
        "fit_data.csv",
        "profiles.pdf",
        "profiles_data.csv",
    ]
    lines = (tmp_path / "fit_data.csv").read_text().splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    assert {row["series"] for row in rows if "protocol 2" in row["axes"]} >= {
        "component 11",
        "component 22, data",
    }
    held = [
        float(row["y"])
        for row in rows
        if row["axes"].startswith("protocol 2") and row["series"] == "component 11, data"
    ]
    table = np.genfromtxt(record, delimiter=",", names=True)
    assert set(held) <= {float(f"{p:.7g}") for p in table["P11_kPa"][table["protocol"] == 2]}
    assert len(held) > 5
    parts = (tmp_path / "profiles_data.csv").read_text()
    assert all(word in parts for word in (",profile,", ",computed,", ",best,", ",95 % threshold,"))


def test_a_case_file_takes_the_material_as_it_is(record, tmp_path):
    pytest.importorskip("dolfinx")
    from valvefsi.case.includes import resolve_includes
    from valvefsi.case.materials import read_material

    found = fit_biaxial(record, "hgo", families="2", fibre_angle=0.0, starts=4, profiles=False, draws=0)
    found.write(tmp_path)
    table = resolve_includes({"include": "material.toml"}, tmp_path / "case.toml")
    material = read_material(table)
    values = found.parameters
    assert material["c10"] == pytest.approx(1e4 * values["c10"], rel=1e-12)  # kPa to dyn/cm^2
    families = material["families"]
    assert len(families) == 2
    other = families[1] if isinstance(families[1], dict) else vars(families[1])
    assert other["k1"] == pytest.approx(1e4 * values["k1_2"], rel=1e-12)
    assert other["fibre"] == "90.0 deg from circumferential"
    flat = fit_biaxial(
        record, "hgo", families="2", fibre_angle=0.0, axis1="x", starts=1, profiles=False, draws=0
    )
    assert read_material(tomllib.loads(flat.material_toml()))["families"][1]["fibre"] == 90.0


def test_the_summary_is_one_call_and_says_the_same_as_the_file(record):
    found = fit_biaxial(read_biaxial(record), "lee-sacks", starts=4)
    said = found.summary()
    assert said.startswith("biaxial fit, lee_sacks")
    for name in ("c0", "c1", "c2"):
        assert f"\n{name} " in said
    written = found.report.as_dict()
    assert written["parameters"]["c0"]["value"] == found.parameters["c0"]
    assert f"{written['r_squared']:.5f}" in said


def test_fixed_and_bounded_parameters_stay_where_they_are_put(record):
    options = {"fix": {"c01": 5.0}, "bounds": {"k2": (1.0, 6.0)}, "fibre_angle": 0.0}
    found = fit_biaxial(record, "hgo", starts=4, draws=0, **options)
    assert found.parameters["c01"] == 5.0
    assert found.parameters["k2"] == pytest.approx(6.0, rel=1e-6)
    assert found.report.parameters()["k2"]["verdict"] == "at bound (upper)"


def test_offsets_of_the_stretch_are_found():
    data = synthetic(LeeSacks(), [5.0, 3.0, 6.0])
    truth = np.random.default_rng(0).uniform(-0.02, 0.02, (5, 2))
    data.F[:, 0, 0] -= truth[data.protocol, 0]
    data.F[:, 1, 1] -= truth[data.protocol, 1]
    found = fit_biaxial(data, "lee_sacks", offsets=True, starts=4, profiles=False, draws=0)
    values = [found.parameters[f"offset{axis}_{k}"] for k in range(1, 6) for axis in (1, 2)]
    np.testing.assert_allclose(values, truth.ravel(), atol=1e-7)
    plain = fit_biaxial(data, "lee_sacks", starts=4, profiles=False, draws=0)
    assert plain.fit.cost > 1e3 * found.fit.cost


def test_balanced_weights_give_each_protocol_the_same_say(record):
    found = fit_biaxial(record, "hgo", weights="balanced", fibre_angle=0.0, starts=2, profiles=False, draws=0)
    problem = found.fit.problem
    sums = [
        np.sum((problem.w * problem.data)[(problem.block_of == k) & (np.arange(len(problem.data)) < 75)] ** 2)
        for k in range(5)
    ]
    np.testing.assert_allclose(sums, sums[0], rtol=1e-9)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--model", "ogden"], "no such planar material"),
        (["--families", "7"], "expected one of 1, 2, 2-kappas, symmetric"),
        (["--fix", "k9=1"], "no such parameter of hgo"),
        (["--protocols", "12"], "no such protocol"),
        (["--thickness", "3 kg"], "expected a quantity in cm"),
        (["--column", "stretch1=lx"], "no such column"),
    ],
)
def test_an_option_that_cannot_be_used_is_said_in_one_line(record, words, said):
    done = run(record, *words)
    assert isinstance(done.exception, CaseError)
    assert said in str(done.exception)
    assert "\n" not in str(done.exception)


@pytest.mark.parametrize("words", [["--fix", "k1"], ["--bounds", "k1=3"], ["--fibre-angle", "flat"]])
def test_an_option_that_cannot_be_read_is_an_error_of_usage(record, words):
    assert run(record, *words).exit_code == 2


def test_fits_work_without_mpi_and_dolfinx(record, tmp_path):
    program = f"""
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {{"mpi4py", "dolfinx", "dolfinx_solver", "petsc4py", "ufl", "basix", "gmsh", "numba"}}:
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, Missing())
from valvefsi.cli.fit import fit
fit(["biaxial", {str(record)!r}, "--fibre-angle", "0", "--starts", "2", "--out", {str(tmp_path / "out")!r}])
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "material.toml").exists()


def test_where_the_angle_is_free_the_profiles_are_printed_and_what_the_covariances_are_is_said():
    data = synthetic(HGO(), [1.5, 5.0, 0.12, 25.0, 20.0, 8.0], noise=0.02, seed=1)
    found = fit_biaxial(data, "hgo", starts=6, draws=0)
    entries = found.report.parameters()
    assert all(entry["ci95_method"] == "profile likelihood" for entry in entries.values())
    (line,) = [line for line in found.lines() if "profile likelihoods" in line]
    said = dict(part.split() for part in line.rsplit(": ", 1)[1].split(", "))
    assert {"angle", "k1"} <= set(said)
    for name, ratio in said.items():
        expected = np.ptp(entries[name]["ci95"]) / np.ptp(entries[name]["ci95_covariance"])
        assert float(ratio) == pytest.approx(expected, rel=0.06)
        assert not 0.8 < expected < 1.25
