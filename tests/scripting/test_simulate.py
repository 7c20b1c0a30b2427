"""Runs from Python: what they do is what the command does, and what they return is what the folder holds."""

from __future__ import annotations

import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from rich.console import Console

import valvefsi
from valvefsi.case import load_case
from valvefsi.case.build import run_case
from valvefsi.cli import progress as progress_module
from valvefsi.errors import CaseError, SurroundingsError
from valvefsi.io.grid_files import nearest_time, read_grid
from valvefsi.io.history import read_history
from valvefsi.io.solid_body import read_body
from valvefsi.scripting import simulate as entry

CASE = """title = "a soft block under a lid"
[grid]
lower = [0, 0]
upper = [1, 1]
cells = [16, 16]
[fluid]
viscosity = "10 cP"
sides = {y_upper = {velocity = [1, 0]}}
[time]
dt = "4 ms"
t_end = "40 ms"
[output]
history_every = 2
frames = 2
[[solid]]
name = "block"
mesh = {shape = "rectangle", lower = [0.375, 0.375], size = [0.25, 0.25], elements = [4, 4]}
material = {model = "neo_hookean", c1 = "1 Pa"}
probe = [{name = "corner", at = [0.625, 0.625]}]
"""


@pytest.fixture
def file(shared_tmp, comm):
    """The case file, the same on all ranks."""
    if comm.rank == 0:
        (shared_tmp / "case.toml").write_text(CASE)
    comm.barrier()
    return shared_tmp / "case.toml"


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A run, its folder the same on all ranks."""
    folder = Path(MPI.COMM_WORLD.bcast(tmp_path_factory.mktemp("run")))
    if MPI.COMM_WORLD.rank == 0:
        (folder / "case.toml").write_text(CASE)
    MPI.COMM_WORLD.barrier()
    return valvefsi.simulate(folder / "case.toml", out=folder / "out", progress=False)


def test_a_run_from_python_is_that_of_the_command(file, shared_tmp, comm):
    changes = {"solid.block.material.c1": "2 Pa", "output.frames": 0}
    result = valvefsi.simulate(file, changes, out=shared_tmp / "a", fluid__viscosity="20 cP", progress=False)
    texts = ["solid.block.material.c1='2 Pa'", "output.frames=0", "fluid.viscosity='20 cP'"]
    run_case(load_case(file, texts), out=shared_tmp / "b")
    comm.barrier()
    expected = read_history(shared_tmp / "b" / "history.csv")
    assert list(result.history) == list(expected)
    for name, values in expected.items():
        np.testing.assert_array_equal(result.history[name], values)
    written = load_case(shared_tmp / "a" / "case.toml")
    assert (written.fluid.viscosity, written.solid[0].material.parameters["c1"]) == (0.2, 20.0)
    assert result.summary["last"]["t_s"] == pytest.approx(0.04)
    assert result.folder == shared_tmp / "a"


def test_a_run_goes_on_and_is_replaced_as_on_the_command_line(file, shared_tmp):
    options = {"out": shared_tmp / "out", "output__frames": 0, "progress": False}
    assert valvefsi.simulate(file, **options).history["t_s"][-1] == pytest.approx(0.04)
    with pytest.raises(valvefsi.ValvefsiError, match="--overwrite"):
        valvefsi.simulate(file, **options)
    longer = valvefsi.simulate(file, time__t_end=0.056, resume=True, **options)
    assert longer.history["t_s"][-1] == pytest.approx(0.056)
    again = valvefsi.simulate(file, overwrite=True, **options)
    assert again.history["t_s"][-1] == pytest.approx(0.04)


WRONG = [
    ({"fluid__viscosty": 1}, r"--set: fluid\.viscosty = 1: unknown key; did you mean 'viscosity'\?"),
    ({"fluid__viscosity": "2 cm"}, r"--set: fluid\.viscosity = '2 cm': expected a quantity"),
    ({"overwite": True}, r"overwite = True: no such option or key; did you mean 'overwrite'\?"),
    ({"solid__blok__kappa": 1}, "no such item; did you mean 'block'"),
    ({"resume": True, "overwrite": True}, "go on with the run or replace it, not both"),
]


@pytest.mark.parametrize(("keys", "message"), WRONG, ids=[next(iter(keys)) for keys, _ in WRONG])
def test_what_is_wrong_is_one_error_with_the_message_of_the_command(keys, message, file, shared_tmp):
    with pytest.raises(valvefsi.ValvefsiError, match=message):
        valvefsi.simulate(file, out=shared_tmp / "out", **keys)


def test_a_case_of_tables_needs_a_folder_and_a_file_that_is_missing_is_named(file, shared_tmp):
    with pytest.raises(valvefsi.ValvefsiError, match="out: a case without a file needs a folder"):
        valvefsi.simulate({"title": "x"})
    with pytest.raises(valvefsi.ValvefsiError, match="no such case file; did you mean 'case.toml'"):
        valvefsi.simulate(shared_tmp / "cas.toml", out=shared_tmp / "out")


def test_a_full_disk_on_one_rank_is_the_same_error_on_all(file, shared_tmp, comm, monkeypatch):
    def run(*_, **__):
        if comm.rank == 0:
            raise OSError(28, "No space left on device", "history.csv")

    monkeypatch.setattr(entry, "run_case", run)
    with pytest.raises(SurroundingsError, match=r"^history.csv: No space left on device$"):
        valvefsi.simulate(file, out=shared_tmp / "out")


def test_the_history_has_units_and_names_the_nearest_column(done):
    units = done.history.units
    assert {units[name] for name in done.history} >= {"s", "cm", "erg", ""}
    assert (units["t_s"], units["u_x_corner_cm"], units["step"]) == ("s", "cm", "")
    assert len(done.history["t_s"]) == 6
    with pytest.raises(KeyError, match="did you mean 'u_x_corner_cm'"):
        done.history["u_x_corner"]
    assert "t_s" in done.history
    assert done.history.get("nothing") is None


def test_a_history_becomes_a_table_of_pandas(done):
    pytest.importorskip("pandas", reason="the notebook extra brings it")
    frame = done.history.to_pandas()
    assert list(frame.columns) == list(done.history)
    assert frame.attrs["units"]["t_s"] == "s"


def test_what_is_not_installed_is_said(done, monkeypatch):
    for name in ("pandas", "pyvista"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(valvefsi.ValvefsiError, match=r"pip install pandas$"):
        done.history.to_pandas()
    with pytest.raises(valvefsi.ValvefsiError, match=r"pip install .*\[plot\]"):
        done.fields(0.0)


def test_columns_with_one_unit_share_a_panel(done):
    figure = done.plot("u_x_corner_cm", "u_y_corner_cm", "courant")
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels == ["[mm]", "Courant number [-]"]
    assert [line.get_label() for line in figure.axes[0].lines] == ["u x corner", "u y corner"]
    drawn = figure.axes[0].lines[0].get_ydata()
    np.testing.assert_array_equal(drawn, 10.0 * done.history["u_x_corner_cm"])
    assert figure._repr_png_().startswith(b"\x89PNG"), "a notebook shows it"
    assert len(done.plot().axes) >= 2
    with pytest.raises(CaseError, match=r"columns = 'corant': no such column; did you mean 'courant'"):
        done.plot("corant")


def test_fields_are_those_of_the_nearest_frame(done):
    pytest.importorskip("pyvista", reason="the plot extra brings it")
    series = done.folder / "paraview"
    mesh = done.fields(0.021)
    t, path = nearest_time(series / "fluid.pvd", 0.021)
    expected = read_grid(path).fields
    assert mesh.field_data["t_s"][0] == t == pytest.approx(0.02)
    u = mesh.cell_data["velocity"].reshape(1, 16, 16, 3).transpose(2, 1, 0, 3)
    np.testing.assert_array_equal(u, expected["velocity"])
    assert np.ptp(u) > 0.1
    solid = done.fields(of="block")
    body = read_body(nearest_time(series / "block.pvd", None)[1])
    np.testing.assert_allclose(solid.points, body.points, atol=1e-7)
    assert done.series == ["block", "fluid"]


def test_fields_that_are_not_there_are_named(done):
    with pytest.raises(CaseError, match=r"of = 'blok': no such fields; did you mean 'block'"):
        done.fields(0.0, of="blok")


def test_a_folder_without_a_run_is_refused(tmp_path):
    with pytest.raises(valvefsi.ValvefsiError, match="there is no run here, history.csv is missing"):
        valvefsi.open(tmp_path)
    with pytest.raises(valvefsi.ValvefsiError, match="no such folder"):
        valvefsi.open(tmp_path / "nowhere")


def test_a_run_that_was_opened_is_the_run(done):
    result = valvefsi.open(done.folder)
    np.testing.assert_array_equal(result.history["t_s"], done.history["t_s"])
    assert "6 rows to t = 0.04 s" in repr(result)
    assert result.summary == done.summary


def test_the_package_has_no_other_name():
    with pytest.raises(AttributeError, match="no attribute 'simulat'"):
        _ = valvefsi.simulat


def test_in_a_notebook_one_line_is_written_over(monkeypatch):
    shown = []

    class Handle:
        def update(self, data, *, raw):
            shown.append(("update", data["text/plain"]))

    def display(data, *, raw, display_id):
        shown.append(("display", data["text/plain"]))
        return Handle()

    notebook = types.ModuleType("IPython.display")
    notebook.display = display
    monkeypatch.setitem(sys.modules, "IPython", types.ModuleType("IPython"))
    monkeypatch.setitem(sys.modules, "IPython.display", notebook)
    clock = iter(range(10000))
    monkeypatch.setattr(progress_module.time, "perf_counter", lambda: float(next(clock)))
    one = type("Comm", (), {"rank": 0, "size": 1})()
    with progress_module.Progress(one, "block", Console(force_jupyter=True)) as progress:
        for step in (1, 2, 3):
            progress(step, 0.1 * step, 0.3)
    assert [kind for kind, _ in shown] == ["display", "update"]
    assert shown[-1][1].startswith("block: 100.0 %  t = 0.3 of 0.3 s, step 3")


def test_all_public_names_are_listed_before_they_are_loaded():
    script = "import valvefsi; assert {*valvefsi.__all__, '__version__'} <= set(dir(valvefsi))"
    subprocess.run([sys.executable, "-c", script], check=True)
