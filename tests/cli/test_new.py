"""What `valvefsi new` writes: each kind is short, is commented, is a valid case, and its data are the records."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import typer.testing

from valvefsi import cli
from valvefsi.case import load_case
from valvefsi.case.build import build
from valvefsi.cli.new import NEXT
from valvefsi.geometry.importing import import_mesh

ROOT = Path(__file__).parents[2]
RUNNER = typer.testing.CliRunner()
CASES = sorted(what for what, commands in NEXT.items() if any("valvefsi run" in line for line in commands))
DATA = {
    "valve/pump.csv": "demos/pericardial_valve_pump.csv",
    "leaflet-fit/biaxial.csv": "calibration/porcine_leaflet.csv",
    "loop-fit/loop.csv": "calibration/porcine_loop.csv",
}

pytestmark = pytest.mark.serial


def new(what, folder, *options):
    return RUNNER.invoke(cli.app, ["new", what, str(folder), *options])


def test_there_is_a_case_or_a_fit_of_each_kind():
    assert sorted(CASES + ["leaflet-fit", "loop-fit"]) == sorted(NEXT)


@pytest.mark.parametrize("what", NEXT)
def test_a_start_is_short_commented_and_says_what_is_next(what, tmp_path):
    answer = new(what, tmp_path / "a" / "b")
    assert answer.exit_code == 0
    written = [line.removeprefix("written: ") for line in answer.stdout.splitlines() if "written" in line]
    assert sorted(written) == sorted(map(str, (tmp_path / "a" / "b").iterdir()))
    main = next(Path(path) for path in written if path.endswith((".toml", ".sh")))
    lines = main.read_text().splitlines()
    assert 20 <= len(lines) <= 60
    assert sum("#" in line for line in lines) >= 6
    assert max(map(len, lines)) <= 125
    last = answer.stdout.splitlines()[-1].split()
    assert last[:2] in (["sh", main.name], ["valvefsi", "run"], ["valvefsi", "plot"])


@pytest.mark.parametrize("what", CASES)
def test_a_start_is_a_valid_case(what, tmp_path):
    new(what, tmp_path)
    if what == "own-mesh":
        patches = import_mesh(tmp_path / "flap.stl", tmp_path / "flap.msh", scale=0.1, size=0.12)["patches"]
        case = load_case(tmp_path / "own-mesh.toml")
        foot = patches[case.solid[0].tether[0].on[0]]  # what is held stands on the floor
        assert foot["centre_cm"] == pytest.approx([0.75, 0.5, 0.0], abs=1e-6)
        assert foot["normal"] == pytest.approx([0.0, 0.0, -1.0], abs=1e-6)
        assert foot["area_cm2"] == pytest.approx(0.15 * 0.5)
    assert load_case(tmp_path / f"{what}.toml").title


@pytest.mark.parametrize("name", DATA)
def test_the_data_of_a_start_are_the_record(name):
    assert (ROOT / "valvefsi/cli/starts" / name).read_bytes() == (ROOT / DATA[name]).read_bytes()


def test_files_that_are_there_are_kept(tmp_path):
    new("beam", tmp_path)
    (tmp_path / "beam.toml").write_text("mine")
    assert "--overwrite replaces it" in str(new("beam", tmp_path).exception)
    assert (tmp_path / "beam.toml").read_text() == "mine"
    assert new("beam", tmp_path, "--overwrite").exit_code == 0
    assert load_case(tmp_path / "beam.toml").solid[0].name == "beam"


def test_an_unknown_start_names_the_nearest():
    assert "did you mean 'channel'?" in str(new("chanel", "x").exception)
    assert "this is a file, expected a folder" in str(new("channel", ROOT / "README.md").exception)


@pytest.mark.slow
@pytest.mark.parametrize("what", NEXT)
def test_the_next_commands_run(what, tmp_path):
    """From the start to pictures, with the commands that it names itself."""
    new(what, tmp_path)
    program = tmp_path / "bin" / "valvefsi"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m valvefsi "$@"\n')
    program.chmod(0o755)
    path = {"PATH": f"{program.parent}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    for command in NEXT[what]:
        done = subprocess.run(
            command.format(what),
            shell=True,
            cwd=tmp_path,
            env=os.environ | path,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr[-2000:]
    assert len(list(tmp_path.rglob("*.png"))) >= 2


@pytest.mark.slow
def test_the_valve_that_is_written_warns_of_nothing_about_itself(tmp_path):
    """Its nodes lie close enough, and its leaflets are thick enough for its grid."""
    case = load_case(ROOT / "valvefsi/cli/starts/valve/valve.toml")
    model = build(case, tmp_path).model
    said = [entry for body in model.bodies for entry in body.size(model.grid)]
    assert [entry.note for entry in said if entry.quantity.startswith("warning")] == []
    (leaflets,) = [body for body in model.bodies if body.solid is not None]
    assert leaflets.gap({"chi": leaflets.X}) < 1.15 * case.grid.spacing, "leaflets stretch by a tenth"
