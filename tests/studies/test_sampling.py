"""Samples through runs and through the circuit alone: what is found, what fails, what is written."""

from __future__ import annotations

import csv
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.studies.conftest import CASE
from valvefsi.case import load_case
from valvefsi.case.circulation import build_circulation
from valvefsi.case.sample_tables import OrificeModel, load_samples
from valvefsi.circulation.orifice import Orifice, OrificeLoop
from valvefsi.errors import CaseError
from valvefsi.post.plots import sensitivity
from valvefsi.studies import runner
from valvefsi.studies.circuit_samples import run_circuits
from valvefsi.studies.members import collected
from valvefsi.studies.runner import run_member, run_members
from valvefsi.studies.sample_report import draw_samples, write_samples
from valvefsi.studies.sample_runs import outputs_of_runs, sample_members, write_job_array
from valvefsi.studies.sampling import analyse, chosen_outputs, make_sampling
from valvefsi.units import MMHG

ROOT = Path(__file__).parents[2]
PROGRAM = (sys.executable, str(Path(__file__).with_name("fake_sample.py")))
STUDY = """
case = "case.toml"
design = { size = 8, degree = 2 }
[[input]]
name = "mu"
key = "fluid.viscosity"
distribution = "uniform"
low = "10 cP"
high = "30 cP"
[[input]]
name = "rho"
key = "fluid.density"
distribution = "normal"
mean = 1
std = 0.5
"""
SBATCH = """#!/bin/sh
# Stands in for sbatch: runs every task of the array that a script asks for, one after the other.
script=$1
range=$(sed -n 's/^#SBATCH --array=\\([0-9-]*\\).*/\\1/p' "$script")
for task in $(seq "${range%-*}" "${range#*-}"); do
    SLURM_ARRAY_TASK_ID=$task sh "$script" >"$(dirname "$script")/array-$task.log" 2>&1 || echo "task $task: $?"
done
"""


@pytest.fixture
def study(tmp_path, monkeypatch):
    """Return a study whose runs are stand-ins."""
    monkeypatch.setattr(runner, "PROGRAM", PROGRAM)
    monkeypatch.setattr(runner, "POLL", 0.02)
    (tmp_path / "case.toml").write_text(CASE)
    (tmp_path / "study.toml").write_text(STUDY)
    return tmp_path / "study.toml"


def exact(sampling):
    """What the stand-in answers at the samples; 30 cP are 0.3 P."""
    mu, rho = sampling.values.T
    return 100 * (0.01 * mu) ** 2 + rho


def test_a_sample_is_what_set_takes(study):
    sampling = make_sampling(load_samples(study))
    first = sample_members(sampling)[0]
    assert first.name == "s0000"
    mu, rho = sampling.values[0]
    assert first.overrides == (f"fluid.viscosity={float(mu)!r} cP", f"fluid.density={float(rho)!r}")
    case = load_case(study.parent / "case.toml", first.overrides)
    assert (case.fluid.viscosity, case.fluid.density) == (pytest.approx(0.01 * mu), pytest.approx(rho))
    again = make_sampling(load_samples(study))
    assert (again.values == sampling.values).all()
    assert (make_sampling(load_samples(study, ["design.seed=1"])).values != sampling.values).any()


def test_a_chaos_of_runs_has_the_moments_and_indices_of_the_closed_form(study):
    """y = 100 mu^2 + rho, mu = 0.2 + 0.1 x, x uniform: mean 13/3 + 1, variance of 4 x + x^2 (16/3 + 4/45) plus 1/4."""
    sampling = make_sampling(load_samples(study, ["design.size=16"]))
    result = analyse(sampling, {"u_cm": exact(sampling), "still_cm": np.full(16, 2.0)}, {})
    (row,) = result["outputs"]
    variance = 16 / 3 + 4 / 45 + 0.25
    assert (row["mean"], row["std"]) == (pytest.approx(16 / 3), pytest.approx(np.sqrt(variance)))
    assert row["surrogate_relative_error"] < 1e-20
    assert [one["group"] for one in row["indices"]] == ["mu", "rho"]
    assert [one["first"] for one in row["indices"]] == pytest.approx([1 - 0.25 / variance, 0.25 / variance])
    draws = np.random.default_rng(9)
    sample = 100 * (0.1 + 0.2 * draws.random(400_000)) ** 2 + 1 + 0.5 * draws.standard_normal(400_000)
    found = [row[name] for name in ("low", "median", "high")]
    assert found == pytest.approx(np.percentile(sample, [2.5, 50, 97.5]), rel=0.03)


def test_samples_without_a_value_are_counted_and_have_a_reason(study, tmp_path):
    sampling = make_sampling(load_samples(study, ["design.size=24"]))
    values = exact(sampling)
    values[[2, 5, 7]] = np.nan
    result = analyse(sampling, {"u_cm": values}, {7: "it broke"})
    said = "NO VALUE of u_cm in 2 of 23 samples that have not failed: its statistics hold for the others only"
    assert said in result["notes"]
    write_samples(sampling, {"u_cm": values}, {7: "it broke"}, result, tmp_path)
    assert said in (tmp_path / "sample.md").read_text()
    with (tmp_path / "samples.csv").open() as file:
        reasons = [row["reason"] for row in csv.DictReader(file)]
    expected = {2: "no value of u_cm", 5: "no value of u_cm", 7: "it broke"}
    assert reasons == [expected.get(k, "") for k in range(24)]
    assert json.loads((tmp_path / "sample.json").read_text())["members"]["reason"] == reasons


def test_inputs_of_a_fit_say_its_file_and_what_is_taken(study, tmp_path):
    (tmp_path / "draws.csv").write_text("R,C\n" + "".join(f"{1 + k / 9},{2 + k / 9}\n" for k in range(9)))
    fit = "[[fit]]\nname='outlet'\nfile='draws.csv'\ntake='samples'\nkeys={R='a.R',C='a.C'}\n"
    study.write_text(STUDY.replace("size = 8, degree = 2", 'method = "sobol", size = 8') + fit)
    sampling = make_sampling(load_samples(study))
    y = {"u_cm": exact_of_two(sampling)}
    write_samples(sampling, y, {}, analyse(sampling, y, {}), tmp_path)
    inputs = json.loads((tmp_path / "sample.json").read_text())["inputs"]
    origins = {one["name"]: one["from"] for one in inputs}
    assert origins["outlet.R"] == origins["outlet.C"]
    assert re.fullmatch(r"samples of .*draws\.csv", origins["outlet.R"])


def exact_of_two(sampling):
    """What the stand-in answers where there are more inputs than its two."""
    mu, rho = sampling.values.T[:2]
    return 100 * (0.01 * mu) ** 2 + rho


def test_an_output_that_no_sample_has_is_not_said_to_be_constant(study):
    sampling = make_sampling(load_samples(study, ['outputs=["u_cm"]']))
    (row,) = analyse(sampling, {"u_cm": np.full(8, np.nan)}, {})["outputs"]
    assert row["text"] == "no sample has a value"


def test_a_surrogate_that_misses_says_so(study):
    sampling = make_sampling(load_samples(study, ["design.size=24"]))
    noise = np.random.default_rng(0).standard_normal(24)
    (row,) = analyse(sampling, {"noise": noise}, {})["outputs"]
    assert row["surrogate_relative_error"] > 0.5
    assert "DO NOT TRUST" in row["text"]


def test_saltellis_design_gives_the_same_and_drops_whole_blocks(study):
    pytest.importorskip("SALib", reason="make setup installs it")
    sampling = make_sampling(load_samples(study, ["design.method=sobol", "design.size=512"]))
    assert len(sampling.u) == 512 * 4
    values = exact(sampling)
    values[5] = np.nan
    result = analyse(sampling, {"u_cm": values}, {5: "too thick"})
    (row,) = result["outputs"]
    variance = 16 / 3 + 4 / 45 + 0.25
    assert "indices of 2044 runs in 511 blocks" in row["text"]
    assert row["count"] == 2 * 512, (
        "mean, deviation and interval are of the independent ones, sample 5 is none"
    )
    assert row["std"] == pytest.approx(np.sqrt(variance), rel=0.05)
    assert [one["total"] for one in row["indices"]] == pytest.approx(
        [1 - 0.25 / variance, 0.25 / variance], abs=0.03
    )
    assert "1 of 2048 samples FAILED" in " ".join(result["notes"])
    few = analyse(sampling, {"u_cm": np.where(np.arange(2048) % 4 == 0, np.nan, values)}, {})["outputs"][0]
    assert (few["indices"], few["text"]) == ([], "0 whole blocks of runs are too few for indices")


def test_outputs_are_found_by_their_ends_and_what_is_missing_is_named():
    outputs = {"last.u_cm": np.arange(3.0), "valve.cycles.0.u": np.arange(3.0), "still": np.ones(3)}
    assert chosen_outputs((), outputs) == (["last.u_cm", "valve.cycles.0.u"], [])
    assert chosen_outputs(("u_cm",), outputs) == (["last.u_cm"], [])
    chosen, missing = chosen_outputs(("u_cn", "still"), {**outputs, "u_cm": np.ones(3)})
    assert (chosen, missing) == (["still"], ["u_cn; did you mean 'u_cm'?"])


def test_a_design_that_does_not_go_with_its_inputs_is_refused(study):
    with pytest.raises(CaseError, match=r"design.size = 4: 2 variates need 5 runs"):
        make_sampling(load_samples(study, ["design.size=4"]))


@pytest.mark.serial
def test_runs_that_fail_are_recorded_and_said_and_gone_on_with(study):
    sampling, folder = make_sampling(load_samples(study)), study.parent / "out"
    members, case = sample_members(sampling), study.parent / "case.toml"
    folder.mkdir()
    (folder / "limit").write_text("28")
    outcomes = run_members(case, members, folder, jobs=2)
    found = outputs_of_runs(outcomes)
    thick = {k for k, mu in enumerate(sampling.values[:, 0]) if mu > 28}
    assert set(found.failures) == thick
    assert thick
    result = analyse(sampling, found.outputs, found.failures)
    assert result["failed"] == {str(k): "StabilityError: too thick" for k in sorted(thick)}
    assert result["outputs"][0]["count"] == 8 - len(thick)
    write_samples(sampling, found.outputs, found.failures, result, folder)
    with (folder / "samples.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["state"] for row in rows] == ["failed" if k in thick else "done" for k in range(8)]
    assert {row["reason"] for row in rows} == {"", "StabilityError: too thick"}
    assert [float(row["mu [cP]"]) for row in rows] == pytest.approx(sampling.values[:, 0])
    assert all(row["u_cm"] == "" for k, row in enumerate(rows) if k in thick)
    assert f"FAILED: sample {min(thick)}: StabilityError" in (folder / "sample.md").read_text()
    check_members(folder, sampling, found.outputs["u_cm"], thick)
    (folder / "limit").unlink()
    found = outputs_of_runs(run_members(case, members, folder, resume=True, jobs=2))
    assert not found.failures
    assert found.outputs["u_cm"] == pytest.approx(exact_in_cgs(sampling))
    assert len((folder / "events").read_text().split()) == 8 + len(thick)
    result = analyse(sampling, found.outputs, {})
    assert draw_samples(sampling, found.outputs, result, folder / "sample.png").stat().st_size > 20_000


def test_a_picture_has_its_outputs_in_the_unit_at_their_axis(monkeypatch, study, tmp_path):
    made = []
    monkeypatch.setattr(sensitivity, "saved", lambda figure, path: made.append(figure))
    sampling = make_sampling(load_samples(study))
    y = sampling.values[:, 0].copy()
    y[1] = np.nan
    ends = [0.8, 1.0]
    group = sampling.inputs.names[0]
    index = {"group": group, "first": 0.9, "first_interval": ends, "total": 0.9, "total_interval": ends}
    row = {
        "output": "last.u_x_tip_cm",
        "indices": [index],
        "low": 0.1,
        "median": 0.2,
        "high": 0.3,
        "text": "",
    }
    result = {"outputs": [row], "failed": {}, "samples": len(y)}
    draw_samples(sampling, {"last.u_x_tip_cm": y}, result, tmp_path / "sample.png")
    bars, samples = made[0].axes[:2]
    assert bars.get_title(loc="left") == "$u_x$ tip [mm]"
    assert samples.collections[-1].get_offsets()[:, 1].compressed() == pytest.approx(10.0 * np.delete(y, 1))
    assert samples.get_title(loc="left").startswith("2 (1 to 3)")


def check_members(folder, sampling, u, thick):
    """The result holds the samples themselves: inputs of all, outputs of those that were done."""
    result = json.loads((folder / "sample.json").read_text())
    members = result["members"]
    assert members["inputs"]["mu"] == pytest.approx(sampling.values[:, 0])
    assert {k for k, value in enumerate(members["outputs"]["u_cm"]) if value is None} == thick
    assert all(v == pytest.approx(u[k]) for k, v in enumerate(members["outputs"]["u_cm"]) if k not in thick)
    assert [k for k, state in enumerate(members["state"]) if state == "failed"] == sorted(thick)
    assert {members["reason"][k] for k in thick} == {"StabilityError: too thick"}
    assert [one["from"] for one in result["inputs"]] == [
        "uniform: low 10 cP, high 30 cP",
        "normal: mean 1.0, std 0.5",
    ]


def exact_in_cgs(sampling):
    """What the stand-in makes of the numbers as they are written, in cP."""
    mu, rho = sampling.values.T
    return 100 * mu**2 + rho


@pytest.mark.serial
def test_members_alone_are_runs_of_the_study_and_what_was_not_run_is_no_answer(study):
    sampling, folder = make_sampling(load_samples(study)), study.parent / "out"
    members, case = sample_members(sampling), study.parent / "case.toml"
    assert run_member(case, members[3], folder).state == "done"
    assert run_member(case, members[3], folder).state == "kept"
    (folder / "limit").write_text("0")
    assert run_member(case, members[5], folder).state == "failed"
    outcomes = collected(case, members, folder)
    assert [o.state for o in outcomes] == ["kept" if k == 3 else "failed" for k in range(8)]
    assert (outcomes[5].message, outcomes[0].message) == ("StabilityError: too thick", "it has not been run")
    assert outputs_of_runs(outcomes).outputs["u_cm"][3] == pytest.approx(exact_in_cgs(sampling)[3])
    record = json.loads((folder / "s0003" / "member.json").read_text())
    (folder / "s0004").mkdir()
    (folder / "s0004" / "member.json").write_text(json.dumps({**record, "state": "running"}))
    assert collected(case, members, folder)[4].message == "it has not ended"


@pytest.mark.serial
def test_the_array_of_jobs_runs_every_sample_under_sbatch(study, tmp_path):
    folder = tmp_path / "with a space"
    tasks = tmp_path / "tasks"
    stub, program = tmp_path / "sbatch", tmp_path / "valvefsi.sh"
    stub.write_text(SBATCH)
    program.write_text(
        f'#!/bin/sh\nprintf "%s\\n" "$*" >>"{tasks}"\ncase "$*" in *"--member 2") exit 3;; esac\n'
    )
    script = write_job_array(study, folder, 4, 2, ["--set", "design.size=4 "])
    text = script.read_text()
    assert "#SBATCH --array=0-3%2\n" in text
    script.write_text(text.replace(f"exec {sys.executable}", f"exec sh {program}"))
    stub.chmod(0o755)
    done = subprocess.run([str(stub), str(script)], capture_output=True, text=True, check=True)
    assert done.stdout == "task 2: 3\n"
    lines = tasks.read_text().splitlines()
    assert lines == [
        f"-m valvefsi sample {study} --out {folder} --set design.size=4  --member {k}" for k in range(4)
    ]
    assert (
        "%" not in write_job_array(study, folder, 4, None, []).read_text().split("--array=")[1].split("\n")[0]
    )


@pytest.mark.slow
@pytest.mark.serial
def test_an_array_of_real_runs_is_collected(tmp_path):
    case = CASE.replace('dt = "50 ms"', 'dt = "5 ms"').replace('t_end = "1 s"', 't_end = "10 ms"')
    (tmp_path / "case.toml").write_text(case)
    (tmp_path / "study.toml").write_text(
        STUDY.replace("size = 8", "size = 5").replace("std = 0.5", "std = 0.1")
    )
    stub = tmp_path / "sbatch"
    stub.write_text(SBATCH)
    command = [
        sys.executable,
        "-m",
        "valvefsi",
        "sample",
        str(tmp_path / "study.toml"),
        "--out",
        str(tmp_path / "out"),
    ]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    for words in (
        [*command, "--array"],
        ["sh", str(stub), str(tmp_path / "out" / "members.sh")],
        [*command, "--collect"],
    ):
        done = subprocess.run(words, capture_output=True, text=True, check=False, env=environment)
        assert done.returncode == 0, done.stderr
    assert "0 of 5" not in done.stdout
    result = json.loads((tmp_path / "out" / "sample.json").read_text())
    assert result["failed"] == {}
    assert result["outputs"]


# The circuit alone


def test_the_circuit_alone_gives_what_the_loop_of_each_sample_gives():
    path = ROOT / "demos" / "pericardial_valve.toml"
    case, model = load_case(path), OrificeModel(area="2.4 cm^2", inertance="0.001 mmHg*s^2/ml", steps=100)
    values = np.array([[1.0, 2.2], [1.3, 2.6], [1.14, -1.0]])
    found = run_circuits(case, model, ("circuit.aorta.R_p", "orifice.area"), ("mmHg*s/ml", "cm^2"), values)
    assert found.failures == {2: "orifice.area = -1: expected a number above 0"}
    assert np.isnan(found.outputs["peak_flow_ml_per_s"][2])
    for k, (R_p, area) in enumerate(values[:2]):
        at = {
            c.side: c
            for c in build_circulation(
                load_case(path, [f"circuit.aorta.R_p={float(R_p)!r} mmHg*s/ml"])
            ).connections
        }
        valve = Orifice(area=float(area), inertance=model.inertance, rho=case.fluid.density)
        loop = OrificeLoop(valve, at["z_lower"], at["z_upper"])
        state = loop.begin()
        for _ in range(30):
            waves, state = loop.run(state, 100, 0.857 / 100)
        assert found.outputs["peak_flow_ml_per_s"][k] == pytest.approx(waves["q_ao"].max(), rel=1e-4)
        p_ao = waves["p_ao"] / MMHG
        assert found.outputs["systolic_aortic_pressure_mmHg"][k] == pytest.approx(p_ao.max(), rel=1e-4)
        assert found.outputs["mean_aortic_pressure_mmHg"][k] == pytest.approx(p_ao[:-1].mean(), rel=1e-3)


def test_a_sample_that_does_not_become_periodic_has_failed():
    case = load_case(ROOT / "demos" / "pericardial_valve.toml")
    model = OrificeModel(
        area="2.4 cm^2", inertance="0.001 mmHg*s^2/ml", steps=100, max_beats=2, tolerance=1e-9
    )
    found = run_circuits(case, model, ("orifice.area",), ("cm^2",), np.array([[2.0], [2.5]]))
    assert set(found.failures) == {0, 1}
    assert "not periodic after 2 beats" in found.failures[0]


@pytest.mark.parametrize(
    ("key", "unit", "said"),
    [
        ("circuit.aorta.R_q", "mmHg*s/ml", "no such input; did you mean 'circuit.aorta.R_"),
        ("orifice.area", "cm", "measures something else"),
    ],
)
def test_an_input_that_the_circuit_does_not_have_is_refused(key, unit, said):
    case = load_case(ROOT / "demos" / "pericardial_valve.toml")
    model = OrificeModel(area=2.4, inertance=1.3)
    with pytest.raises(CaseError, match=said):
        run_circuits(case, model, (key,), (unit,), np.ones((1, 1)))


def test_the_circuit_alone_needs_a_case_with_circuits(study):
    with pytest.raises(CaseError, match="needs a case with circuits at z_lower and z_upper"):
        run_circuits(
            load_case(study.parent / "case.toml"),
            OrificeModel(area=2.4, inertance=1.3),
            ("orifice.area",),
            ("cm^2",),
            np.ones((1, 1)),
        )
