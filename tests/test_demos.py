"""Every demo runs, is short, and ends by asserting what it claims."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DEMOS = sorted((ROOT / "demos").glob("*.py"))
CASES = sorted((ROOT / "demos").glob("*.toml"))

LONG = {
    "pericardial_valve": "0.1 ms",
    "pericardial_valve_bovine": "0.1 ms",
    "pericardial_valve_pressures": "0.1 ms",
    "pericardial_valve_steady": "0.1 ms",
    "porcine_valve": "0.1 ms",
}
"""Ends of runs that take too long for a second of simulated time."""

pytestmark = pytest.mark.serial


TUTORIALS = {
    "01_minimal": "valvefsi.case.build",
    "02_tissue_to_material": '"biaxial"',
    "03_flow_record_to_circuit": '"windkessel"',
    "04_beating_valve": "pericardial_valve.toml",
    "05_own_structure": '"mesh", "import"',
    "06_new_material": "gent.py:Gent",
    "07_many_ranks": "MPIRUN",
    "08_own_valve": "solid.mesh.leaflets",
    "09_how_sure": '"sample"',
    "09_from_python": "valvefsi.simulate",
}
"""The tutorial of each kind of user, and what it cannot do without."""


def call(command, tmp_path):
    environment = os.environ | {"VALVEFSI_DEMO_OUT": str(tmp_path / "out"), "MPLBACKEND": "Agg"}
    return subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=300, check=False
    )


@pytest.mark.parametrize("demo", DEMOS, ids=lambda path: path.stem)
def test_demo_runs_and_its_claims_hold(demo, tmp_path):
    done = call([sys.executable, str(demo)], tmp_path)
    assert done.returncode == 0, done.stderr[-2000:]
    assert list((tmp_path / "out").glob("*.png")), "a demo makes a picture"


def test_a_notebook_runs_in_its_kernel_and_shows_progress_and_figure(tmp_path, monkeypatch):
    jupytext = pytest.importorskip("jupytext", reason="the notebook extra brings it")
    nbclient = pytest.importorskip("nbclient", reason="the notebook extra brings it")
    pytest.importorskip("ipykernel", reason="the notebook extra brings it")
    monkeypatch.setenv("VALVEFSI_DEMO_OUT", str(tmp_path))
    notebook = jupytext.read(ROOT / "demos" / "09_from_python.py")
    nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3").execute(cwd=str(ROOT))
    shown = [out.data for cell in notebook.cells for out in cell.get("outputs", []) if "data" in out]
    assert sum("100.0 %" in data.get("text/plain", "") for data in shown) == 2, "one line for each run"
    assert any("image/png" in data for data in shown)


@pytest.mark.parametrize("demo", DEMOS, ids=lambda path: path.stem)
def test_demo_is_literate_and_short(demo):
    lines = demo.read_text().splitlines()
    assert len(lines) <= 150
    assert lines[0] == "# %% [markdown]"
    assert any("Reference" in line for line in lines[:12])
    assert any("Run time" in line for line in lines[:12])
    assert any(line.startswith("assert ") for line in lines[-5:])


def test_there_is_a_tutorial_for_each_kind_of_user():
    texts = {path.stem: path.read_text() for path in DEMOS}
    assert {name: key in texts.get(name, "") for name, key in TUTORIALS.items()} == dict.fromkeys(
        TUTORIALS, True
    )


def test_the_minimal_run_has_forty_lines():
    assert len((ROOT / "demos" / "01_minimal.py").read_text().splitlines()) <= 40


@pytest.mark.parametrize("case", CASES, ids=lambda path: path.stem)
def test_case_of_the_demos_runs(case, tmp_path):
    out = tmp_path / "out"
    command = [
        sys.executable,
        "-m",
        "valvefsi",
        "run",
        str(case),
        "--out",
        str(out),
        "--set",
        f"time.t_end={LONG.get(case.stem, '1 s')}",
    ]
    done = call(command, tmp_path)
    assert done.returncode == 0, done.stderr[-2000:]
    picture = "history.csv" if case.stem in LONG else "flow.png"
    assert {"history.csv", "histories.png", picture, "summary.json", "case.toml"} <= {
        p.name for p in out.iterdir()
    }
