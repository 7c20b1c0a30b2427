"""circuit.toml, the derived pump pressure, the command, and the studies of the flow loops."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from valvefsi.case.circuit_tables import read_circuit
from valvefsi.cli.fit_windkessel import windkessel
from valvefsi.errors import CaseError
from valvefsi.fitting.waveforms import Waveforms, read_waveforms, write_waveforms
from valvefsi.fitting.windkessel import Settings, circuit_text, fit_windkessel
from valvefsi.fitting.windkessel_models import CIRCUITS
from valvefsi.fitting.windkessel_pump import derive_pump
from valvefsi.units import MMHG

pytestmark = pytest.mark.serial  # nothing in it runs in parallel
CALIBRATION = Path(__file__).parents[2] / "calibration"
QUICK = Settings(profiles=False, draws=0, starts=2)
VALUES = {"R_1": 0.1, "R_2": 0.04, "C_VIA": 0.3}


def beat(n=121, noise=0.0):
    """Return one beat of made-up flows and pressures."""
    t = np.linspace(0, 0.8, n)
    phase = 2 * np.pi * t / 0.8
    q = 400 * np.maximum(np.sin(phase), 0) ** 1.4
    rng = np.random.default_rng(1)
    p_lv = 70 - 60 * np.cos(phase - 0.8) + noise * rng.standard_normal(n)
    p_ao = 90 + 20 * np.sin(phase - 0.6)
    return Waveforms(t=t, values={"q_lv": q, "q_ao": q, "p_lv": p_lv * MMHG, "p_ao": p_ao * MMHG})


def run(*arguments):
    app = typer.Typer()
    app.command()(windkessel)
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_a_fitted_circuit_reads_back_exactly(tmp_path):
    report = fit_windkessel(beat(), "downstream", QUICK)
    report.write(tmp_path)
    stored = read_circuit(tmp_path / "circuit.toml")
    assert stored.model == "downstream"
    for name in ("R_c", "R_p", "C"):
        assert getattr(stored.circuit, name) == pytest.approx(getattr(report.circuit, name), rel=1e-14)
    system = stored.circuit.system()
    state = system.start([stored.start[name] for name in system.states], [0.0])
    assert system.observe(state) / MMHG == pytest.approx(report.fit.curve[0], rel=1e-12)
    entry = json.loads((tmp_path / "fit.json").read_text())
    assert set(entry["parameters"]["C"]) >= {"value", "unit", "std", "ci95", "verdict"}
    assert (tmp_path / "fit.png").stat().st_size > 10_000


@pytest.mark.parametrize("name", CIRCUITS)
def test_every_circuit_is_written_so_that_it_reads_back(tmp_path, name):
    values = {key: 0.1 + 0.07 * k for k, key in enumerate(CIRCUITS[name].parameters)}
    path = tmp_path / "circuit.toml"
    path.write_text(circuit_text(name, values, {}, {"data": 'a "quoted" name'}), encoding="utf-8")
    stored = read_circuit(path)
    for key, unit in CIRCUITS[name].parameters.items():
        size = {"mmHg*s/ml": MMHG, "ml/mmHg": 1 / MMHG, "mmHg*s^2/ml": MMHG}[unit]
        assert getattr(stored.circuit, key) == pytest.approx(values[key] * size, rel=2e-15)
    assert stored.provenance["data"] == 'a "quoted" name'


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ('model = "two-element"', 'loop = "two-element"', "expected one of downstream"),
        ("[start]", "[pump]\nfile = 3\n[start]", "pump.file"),
        ("[start]\n", "start = 3\n[other]\n", "other"),
        ("[start]\n", "[start.more]\n", "no such state, expected p_wk"),
        ('"two-element"', '"three"', "expected one of downstream"),
        ('"two-element"', "[1]", "expected one of downstream"),
        ("R_p =", "R_q =", "unknown parameter"),
        ("R_p =", "#", "required, a quantity in dyn*s/cm^5"),
        ("mmHg*s/ml", "mmHg", "expected a quantity in dyn*s/cm^5"),
        ("1.0 ml/mmHg", "one ml/mmHg", "C = 'one"),
        ("1.0 ml/mmHg", "1-0 ml/mmHg", "expected a quantity"),
        ("1.1 mmHg", "-1.1 mmHg", "R_p = "),
        ('p_wk = "80', 'p_via = "80', "no such state, expected p_wk"),
        ("[start]", "[start", "circuit.toml"),
    ],
)
def test_a_circuit_file_that_is_wrong_is_refused(tmp_path, old, new, reason):
    text = circuit_text("two-element", {"R_p": 1.1, "C": 1.0}, {"p_wk": 80.0}, {})
    path = tmp_path / "circuit.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(CaseError) as caught:
        read_circuit(path)
    assert reason in str(caught.value)
    assert "circuit.toml" in str(caught.value)


def test_units_of_a_circuit_file_may_be_cgs_or_si(tmp_path):
    path = tmp_path / "circuit.toml"
    path.write_text('model = "two-element"\nR_p = "1.4e8 Pa*s/m^3"\nC = "1e-3 cm^5/dyn"\n')
    stored = read_circuit(path)
    assert stored.circuit.R_p == pytest.approx(1400.0)
    assert stored.circuit.C == 1e-3


@pytest.mark.parametrize("cutoff", [0.0, 0.05])
@pytest.mark.parametrize("C_VIA", [0.3, 0.0])
def test_the_forward_run_gives_the_ventricle_back(tmp_path, cutoff, C_VIA):
    waves = beat(noise=1.0)
    report = derive_pump(waves, {**VALUES, "C_VIA": C_VIA}, cutoff=cutoff)
    assert report.roundtrip < 1e-9
    assert any("smoothed" in note for note in report.notes)
    if not cutoff:
        assert report.misfit["relative_linf"] < 1e-11
    report.write(tmp_path)
    # from the files alone: circuit.toml and pump.csv, as a simulation has them
    stored = read_circuit(tmp_path / "circuit.toml")
    record = read_waveforms(stored.pump)
    system = stored.circuit.system()
    u = np.stack([record["p_pump"], record["q_lv"]], axis=1)
    state = system.start([stored.start[name] for name in system.states], u[0], record.t[0])
    back = [system.observe(state)]
    for n in range(1, len(record.t)):
        state = system.advance(state, u[n], record.t[n] - record.t[n - 1])
        back.append(system.observe(state))
    assert np.abs(np.array(back) - report.used["p_lv"]).max() < 1e-5 * MMHG


def test_the_pump_needs_its_circuit():
    with pytest.raises(CaseError, match=r"--fix C_VIA="):
        derive_pump(beat(), {"R_1": 0.1, "R_2": 0.04})
    with pytest.raises(CaseError, match="R_3"):
        derive_pump(beat(), {**VALUES, "R_3": 1.0})
    with pytest.raises(CaseError, match="smooth"):
        derive_pump(beat(), VALUES, cutoff=5.0)
    with pytest.raises(CaseError, match="missing is q_lv"):
        derive_pump(replace(beat(), values={"p_lv": beat()["p_lv"]}), VALUES)


def test_a_jagged_pump_pressure_is_said_to_be_one():
    assert any("jagged" in note for note in derive_pump(beat(noise=3.0), VALUES).notes)
    assert not any("jagged" in note for note in derive_pump(beat(noise=3.0), VALUES, cutoff=0.2).notes)


def test_the_command_fits_and_writes(tmp_path):
    path = write_waveforms(beat(), tmp_path / "beat.csv")
    done = run(
        path, "--starts", 2, "--compare", "two-element", "--fix", "R_c=0.05", "--out", tmp_path / "out"
    )
    assert done.exit_code == 0, done.output
    assert "windkessel fit, downstream" in done.output
    assert "comparison" in done.output
    for name in (
        "fit.json",
        "circuit.toml",
        "fit.png",
        "profiles.png",
        "comparison.json",
        "two-element/fit.json",
    ):
        assert (tmp_path / "out" / name).exists(), name
    entry = json.loads((tmp_path / "out" / "fit.json").read_text())
    assert entry["parameters"]["R_c"] == {
        "value": 0.05,
        "unit": "mmHg*s/ml",
        "std": None,
        "ci95": None,
        "verdict": "held",
    }
    assert entry["data"][0]["file"] == "beat.csv"


def test_the_command_lists_outliers_and_replaces_them_only_when_asked(tmp_path):
    waves = beat()
    p = waves["p_ao"].copy()
    p[[20, 77]] *= 10
    path = write_waveforms(waves.with_values({"p_ao": p}), tmp_path / "beat.csv")
    before = path.read_text()
    left = run(path, "--starts", 1, "--out", tmp_path / "left")
    assert "row 22, column p_ao_mmHg" in left.output
    assert "row 79, column p_ao_mmHg" in left.output
    assert "2 outliers, left as they are" in left.output
    paper = ("--style", "paper", "--out", tmp_path / "mended")
    mended = run(path, "--starts", 1, "--repair", "outliers", *paper)
    assert "2 outliers replaced" in mended.output
    assert path.read_text() == before
    repaired = read_waveforms(tmp_path / "mended" / "repaired.csv")
    assert np.allclose(repaired["p_ao"], waves["p_ao"], rtol=1e-9)
    costs = [json.loads((tmp_path / name / "fit.json").read_text())["cost"] for name in ("left", "mended")]
    assert costs[1] < 1e-2 * costs[0]
    left, mended = ({path.name for path in (tmp_path / name).iterdir()} for name in ("left", "mended"))
    assert {"fit.png", "profiles.png"} <= left
    assert left.isdisjoint({"fit.pdf", "fit_data.csv"})
    assert {"fit.pdf", "fit_data.csv", "profiles.pdf", "profiles_data.csv"} <= mended
    assert mended.isdisjoint({"fit.png", "profiles.png"})


def test_the_command_derives_the_pump(tmp_path):
    path = write_waveforms(beat(), tmp_path / "beat.csv")
    fixed = [part for name, value in VALUES.items() for part in ("--fix", f"{name}={value}")]
    done = run(path, "--circuit", "upstream-porcine", "--smooth", 0.02, *fixed, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert "P_LV back to" in done.output
    assert (tmp_path / "out" / "pump.csv").exists()


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--circuit", "upstream-bovine"], "missing is q_pump"),
        (["--circuit", "downstrem"], "unknown circuit"),
        (["--repair", "everything"], "expected outliers"),
        (["--compare", "upstream-bovine"], "compared only"),
        (["--smooth", "0.02"], "takes the record as it is"),
        (["--flip", "p_ao"], "expected a flow"),
        (["--column", "q_ao=Flow:ml/s"], "no such column"),
        (["--period", "-2"], "period"),
    ],
)
def test_options_that_cannot_be_used_are_refused(tmp_path, arguments, reason):
    path = write_waveforms(beat(n=41), tmp_path / "beat.csv")
    done = run(path, *arguments, "--out", tmp_path / "out")
    assert isinstance(done.exception, CaseError), done.output
    assert reason in str(done.exception)
    assert "\n" not in str(done.exception)


@pytest.mark.parametrize("name", ["porcine_loop", "bovine_loop"])
def test_a_study_gives_its_committed_results_again(tmp_path, name, capsys):
    spec = importlib.util.spec_from_file_location(name, CALIBRATION / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    made, kept = read_waveforms(module.make_record(tmp_path / "record.csv")), read_waveforms(module.RECORD)
    assert all(np.abs(made[quantity] - kept[quantity]).max() < 2e-3 * MMHG for quantity in kept.values)
    found = module.study(tmp_path)
    committed = json.loads((module.RESULTS / "result.json").read_text())
    check_alike(json.loads(json.dumps(found)), committed)
    assert all(
        row["inside"] or name == "bovine_loop"
        for part in found.values()
        for row in part.get("parameters", {}).values()
    )
    for path in module.RESULTS.rglob("*.toml"):
        assert read_circuit(path).circuit.system().states


def check_alike(found, committed, place=""):
    """Compare nested results: numbers to the accuracy of the solver, text exactly."""
    if isinstance(committed, dict):
        assert set(found) == set(committed), place
        for key in committed:
            if key != "pump_roundtrip_mmHg":  # round-off
                check_alike(found[key], committed[key], f"{place}/{key}")
    elif isinstance(committed, list):
        for one, other in zip(found, committed, strict=True):
            check_alike(one, other, place)
    elif isinstance(committed, float):
        assert found == pytest.approx(committed, rel=2e-3 if "ci95" in place else 1e-4), place
    else:
        assert found == committed, place


def test_circuits_are_fitted_and_read_without_mpi_and_dolfinx(tmp_path):
    record = write_waveforms(beat(), tmp_path / "record.csv")
    program = f"""
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {{"mpi4py", "dolfinx", "dolfinx_solver", "petsc4py", "ufl", "basix", "gmsh", "numba"}}:
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, Missing())
from valvefsi.fitting.windkessel import fit_windkessel
print(fit_windkessel({str(record)!r}).summary())
from valvefsi.cli.fit import fit
fit(["windkessel", {str(record)!r}, "--out", {str(tmp_path / "out")!r}], standalone_mode=False)
from valvefsi.case.circuit_tables import read_circuit
assert read_circuit({str(tmp_path / "out" / "circuit.toml")!r}).circuit.system().states == ("p_wk",)
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "norms over time (S24)" in done.stdout
