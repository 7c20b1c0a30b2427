"""Statics of a solid at samples: a block against its closed form, a leaflet in its sector, what is kept."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import typer.testing
from scipy.optimize import brentq

from valvefsi import cli
from valvefsi.case import load_case
from valvefsi.case.sample_tables import load_samples
from valvefsi.case.statics import solve_solid
from valvefsi.case.statics_tables import StaticsModel
from valvefsi.errors import CaseError
from valvefsi.studies import static_samples as module
from valvefsi.studies.sampling import analyse, make_sampling
from valvefsi.studies.static_samples import run_statics, static_samples

ROOT = Path(__file__).parents[2]
PORCINE = ROOT / "demos" / "porcine_valve.toml"
CASE = """
[grid]
lower = [-1, -1, -1]
upper = [2, 2, 2]
cells = [8, 8, 8]
[fluid]
viscosity = 0.1
[time]
dt = "1 ms"
t_end = "1 ms"
[[solid]]
name = "block"
mesh = { shape = "box", lower = [0, 0, 0], size = [1, 1, 1], elements = [1, 1, 1] }
material = { model = "neo_hookean", c1 = "50 dyn/cm^2" }
"""
STUDY = """
case = "case.toml"
target = "statics"
design = { size = 8, degree = 2 }
[statics]
solid = "block"
pressure = "-30 dyn/cm^2"
on = ["y_upper"]
[[statics.held]]
on = ["x_lower"]
components = ["x"]
[[statics.held]]
on = ["y_lower"]
components = ["y"]
[[statics.held]]
on = ["z_lower"]
components = ["z"]
[[input]]
name = "pull"
key = "statics.pressure"
distribution = "uniform"
low = "-40 dyn/cm^2"
high = "-20 dyn/cm^2"
"""


@pytest.fixture
def study(tmp_path):
    """Return a study of a block that is pulled."""
    (tmp_path / "case.toml").write_text(CASE)
    (tmp_path / "study.toml").write_text(STUDY)
    return tmp_path / "study.toml"


def strain(pull):
    """Of an incompressible block under the Cauchy stress -pull: c1 (s^2 - 1/s) = -pull (W = c1/2 (I1 - 3)), Green's."""
    s = brentq(lambda s: 50 * (s**2 - 1 / s) + pull, 0.5, 3.0)
    return (s**2 - 1) / 2


def test_a_block_that_is_pulled_does_at_all_samples_what_the_closed_form_says(study):
    sampling = make_sampling(load_samples(study))
    found = run_statics(static_samples(sampling), study.parent / "out")
    pull = sampling.values[:, 0]
    E = np.array([strain(p) for p in pull])
    s = np.sqrt(2 * E + 1)
    expected = {
        "largest_displacement_mm": 10
        * np.sqrt((s - 1) ** 2 + 2 * (1 - 1 / np.sqrt(s)) ** 2),  # of the corner
        "largest_principal_strain_p99": E,
        "largest_principal_strain_max": E,
        "largest_principal_stress_p99_kPa": -pull * 1e-4,
    }
    assert not found.failures
    for name, values in expected.items():
        assert found.outputs[name] == pytest.approx(values, rel=1e-6), name
    (row,) = analyse(sampling, {"strain": found.outputs["largest_principal_strain_p99"]}, {})["outputs"]
    dense = np.array([strain(p) for p in np.linspace(-40, -20, 2001)])
    assert row["mean"] == pytest.approx(dense.mean(), rel=1e-3)
    assert row["std"] == pytest.approx(dense.std(), rel=1e-2)
    assert row["surrogate_relative_error"] < 1e-3
    assert [row["low"], row["high"]] == pytest.approx(np.percentile(dense, [2.5, 97.5]), rel=0.01)


def test_keys_of_the_case_and_of_the_table_reach_the_sample(study):
    more = ["design.size=6", "changes=['solid.block.material.c1=70']"]
    sample = static_samples(make_sampling(load_samples(study, more)))[5]
    values = make_sampling(load_samples(study, more)).values[5]
    assert sample.model.pressure == pytest.approx(values[0])
    assert sample.case.solid[0].material.parameters["c1"] == 70
    assert sample.mark != static_samples(make_sampling(load_samples(study, more[:1])))[5].mark


def test_a_sample_without_equilibrium_has_failed_and_the_others_count(study):
    wild = STUDY.replace('low = "-40 dyn/cm^2"', 'low = "-1 dyn/cm^2"').replace(
        'high = "-20 dyn/cm^2"', 'high = "5e7 dyn/cm^2"'
    )
    study.write_text(wild)
    sampling = make_sampling(load_samples(study))
    samples = [static_samples(sampling)[k] for k in (0, 1)]
    found = run_statics([with_number(samples[0], 0), with_number(slack(samples[1]), 1)], study.parent / "out")
    assert list(found.failures) == [0]
    assert "no equilibrium beyond" in found.failures[0]
    assert np.isnan(found.outputs["largest_displacement_mm"][0])
    assert found.outputs["largest_displacement_mm"][1] > 0


def with_number(sample, number):
    return module.StaticSample(number=number, case=sample.case, model=sample.model)


def slack(sample):
    model = StaticsModel.model_validate({**sample.model.model_dump(), "pressure": -10.0})
    return module.StaticSample(number=sample.number, case=sample.case, model=model)


def test_what_has_answered_is_not_solved_again(study, monkeypatch):
    sampling, folder, solved = make_sampling(load_samples(study)), study.parent / "out", []

    def answer(sample):
        solved.append(sample.number)
        return {"outputs": {"u_mm": float(sample.number)}, "failed": ""}

    monkeypatch.setattr(module, "answer", answer)
    samples = static_samples(sampling)
    run_statics(samples[:3], folder)
    (folder / "answers.jsonl").open("a").write('{"mark": "cut')
    with pytest.raises(CaseError, match="--resume goes on"):
        run_statics(samples, folder)
    found = run_statics(samples, folder, resume=True)
    assert solved == list(range(8))
    assert found.outputs["u_mm"] == pytest.approx(np.arange(8.0))
    changed = static_samples(make_sampling(load_samples(study, ["statics.on=['y_lower']"])))
    run_statics(changed[:1], folder, resume=True)
    run_statics(samples[:1], folder, overwrite=True)
    assert solved[8:] == [0, 0], "another model, and a new beginning"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("statics.solid='blok'", "the case has no such solid; it has block"),
        ("statics.contact=['y_lower']", "statics.contact|above 0 where leaflets meet"),
        ("statics.on=['top']", "statics"),
        ("statics.presure='1 kPa'", "did you mean 'pressure'"),
        ("target='case'", "this table is needed with statics"),
    ],
)
def test_a_study_that_cannot_be_is_refused(study, change, said):
    with pytest.raises(CaseError, match=said):
        solve_first(study, change)


def solve_first(study, change):
    sample = static_samples(make_sampling(load_samples(study, [change])))[0]
    return solve_solid(sample.case, sample.model)


def test_a_leaflet_meets_its_neighbours_where_it_may_not_pass():
    """Without the planes at 60 degrees it is pushed through its neighbours; with them it touches them."""
    case = load_case(PORCINE, ["grid.h=2.5mm", "solid.leaflets.mesh.valve.ratio=2"])
    past = {}
    for contact in ((), ("inflow",)):
        leaflet = solve_solid(case, StaticsModel(pressure="20 mmHg", contact=contact, contact_depth="0.1 mm"))
        x = leaflet.mesh.mesh.geometry.x + leaflet.solution.displacement.x.array.reshape(-1, 3)
        beyond = np.abs(x[:, 1]) * np.cos(np.pi / 3) - x[:, 0] * np.sin(np.pi / 3)
        past[contact] = beyond.max()
        assert ("contact_area_cm2" in leaflet.numbers()) == bool(contact)
    assert past[()] > 0.08
    assert past["inflow",] < 0.025, "its free edge bears more than the pressure"
    assert leaflet.numbers()["contact_area_cm2"] > 0.3


def test_the_command_solves_and_draws(study):
    folder = study.parent / "out"
    call = typer.testing.CliRunner().invoke
    words = ["sample", str(study), "--out", str(folder), "--jobs", "1"]
    answer = call(cli.app, words)
    assert answer.exit_code == 0, answer.output
    assert "8 of 8 samples done" in answer.stdout
    assert (folder / "sample.png").stat().st_size > 20_000
    result = json.loads((folder / "sample.json").read_text())
    assert result["target"] == "statics"
    assert {row["output"] for row in result["outputs"]} >= {"largest_principal_strain_p99"}
    assert isinstance(call(cli.app, words).exception, CaseError)
    assert call(cli.app, [*words, "--resume"]).exit_code == 0
    assert "statics take minutes" in str(call(cli.app, [*words, "--array"]).exception)
