"""Averages, profiles and thinned frames of a run, from case files, against closed forms; on any number of ranks."""

from __future__ import annotations

import csv
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI

from tests.case_text import stream, written
from valvefsi.case.build import build, run_case
from valvefsi.errors import CaseError
from valvefsi.grid import MacGrid
from valvefsi.io.grid_files import read_grid, times_of
from valvefsi.run.recording import Output, chosen_cells
from valvefsi.run.statistics import Line, Statistics

PERIOD = 0.4
CASE = f"""title = "a stream that swings"
{stream(2, (16, 8))}"""
CASE += """x_lower = {velocity_expression = ["3 + 2*sin(5*pi*t)", "0"]}
x_upper = {type = "open"}
[time]
dt = "5 ms"
t_end = "1 s"
[output]
history_every = 2
frames = 2
averages_from = "0.2 s"
checkpoint_every = 50
[[output.line]]
name = "along"
start = [0.1, 0.3]
end = [1.9, 0.3]
points = 7
[[output.section]]
name = "outflow"
axis = "x"
position = 1.5
"""


@pytest.fixture
def write(shared_tmp):
    """Return a function that writes the case and reads it, with changes."""

    def write(*overrides):
        return written(shared_tmp, CASE, overrides)

    return write


def table(path):
    with path.open(newline="") as file:
        rows = list(csv.reader(file))
    return dict(zip(rows[0], np.array(rows[1:], dtype=float).T, strict=True))


def test_mean_and_fluctuation_of_a_stream_that_swings(write, shared_tmp):
    """u = 3 + 2 sin(omega t) everywhere: mean 3, TKE = (2^2/2)/2 = 1 over two whole periods."""
    run_case(write(), out=shared_tmp / "out")
    MPI.COMM_WORLD.barrier()
    found = table(shared_tmp / "out" / "profiles" / "along.csv")
    assert found["s_cm"] == pytest.approx(np.linspace(0.0, 1.8, 7))
    # Samples every 10 ms stand for the time before them: exact for a sine over whole periods but for round-off.
    assert found["mean_u_x_cm_per_s"] == pytest.approx(3.0, abs=1e-6)
    assert found["tke_cm2_per_s2"] == pytest.approx(1.0, abs=1e-6)
    assert found["u_x_cm_per_s"] == pytest.approx(3.0 + 2.0 * np.sin(5.0 * np.pi), abs=1e-6)
    assert found["mean_u_y_cm_per_s"] == pytest.approx(0.0, abs=1e-9)
    assert (shared_tmp / "out" / "paraview" / "averages.pvd").exists()


def test_averages_go_on_after_a_stop(write, shared_tmp):
    case = write("output.frames=0")
    build(write("output.frames=0", "time.t_end='0.5 s'"), shared_tmp / "parts").run()
    build(case, shared_tmp / "parts").run(resume=True)
    build(case, shared_tmp / "whole").run()
    MPI.COMM_WORLD.barrier()
    parts, whole = (table(shared_tmp / name / "profiles" / "along.csv") for name in ("parts", "whole"))
    for name, column in whole.items():
        assert parts[name] == pytest.approx(column, rel=1e-10, abs=1e-10), name


def test_a_profile_reads_off_each_field_in_its_own_column():
    """At t the velocity is t (1 + x, 2 - y) and the pressure t (3 + 4 x + 5 y); samples at 1, 2 and 4."""
    grid = MacGrid([0, 0], [1, 1], [8, 8], [False, False])

    def state(t):
        (x, _, _), (_, y, _), (xc, yc, _) = grid.points(0), grid.points(1), grid.points()
        whole = [np.broadcast_to(t * c, grid.shape).copy() for c in (1 + x, 2 - y, 3 + 4 * xc + 5 * yc)]
        return SimpleNamespace(t=t, u=tuple(whole[:2]), p=whole[2])

    statistics = Statistics(grid, start=0.5)
    for t in (0.0, 1.0, 2.0, 4.0):
        statistics.add(state(t))
    found = statistics.profile(state(4.0), Line(start=(0.2, 0.1), end=(0.8, 0.9), points=5))
    x, y = np.linspace(0.2, 0.8, 5), np.linspace(0.1, 0.9, 5)
    mean = (1 * 2 + 2 * 4) / 3
    variance = (1 * (2 - mean) ** 2 + 2 * (4 - mean) ** 2) / 3
    # Of the fluctuation the squares are averaged in the cells and are linear between their centres: h^2/8 at most.
    expected = {
        "s_cm": np.hypot(x - 0.2, y - 0.1),
        "x_cm": x,
        "y_cm": y,
        "u_x_cm_per_s": 4 * (1 + x),
        "u_y_cm_per_s": 4 * (2 - y),
        "p_dyn_per_cm2": 4 * (3 + 4 * x + 5 * y),
        "mean_u_x_cm_per_s": mean * (1 + x),
        "mean_u_y_cm_per_s": mean * (2 - y),
        "mean_p_dyn_per_cm2": mean * (3 + 4 * x + 5 * y),
        "tke_cm2_per_s2": 0.5 * variance * ((1 + x) ** 2 + (2 - y) ** 2),
    }
    assert list(found) == list(expected)
    for name, column in expected.items():
        slack = 0.5 * variance * 2 / 8**2 if name.startswith("tke") else 1e-12
        assert found[name] == pytest.approx(column, abs=slack), name


@pytest.mark.parametrize("every", [1, 2, 3])
def test_frames_hold_every_kth_cell_of_a_part(every):
    grid = MacGrid([0.0, 0.0, 0.0], [1.6, 1.2, 0.8], (16, 12, 8), [False] * 3, MPI.COMM_WORLD)
    part = ((0.2, 0.0, 0.1), (1.4, 1.2, 0.8))
    chosen = chosen_cells(grid, Output(directory=None, every=every, part=part))
    cells, start, size, edges = chosen.cells, chosen.start, chosen.size, chosen.box
    assert cells == tuple(len(np.arange(a + every // 2, b, every)) for a, b in ((2, 14), (0, 12), (1, 8)))
    x, y, z = (np.broadcast_to(c, grid.shape)[grid.owned][chosen.own] for c in grid.points(None))
    assert x.shape == size
    for axis, values in enumerate((x, y, z)):
        e = np.asarray(edges[axis])
        assert len(e) == cells[axis] + 1
        along = np.moveaxis(values, axis, 0)
        low = e[start[axis] : start[axis] + size[axis]]
        # The cell that is taken lies in the one that is shown.
        if values.size:
            inside = along.reshape(len(low), -1)[:, 0]
            assert ((inside > low) & (inside < e[start[axis] + 1 : start[axis] + size[axis] + 1])).all()
    whole = MPI.COMM_WORLD.allreduce(x.size)
    assert whole == np.prod(cells)


def test_a_run_writes_the_cells_that_were_asked_for(write, shared_tmp):
    part = ("output.fluid_every=2", "output.fluid_lower=[0.5, 0]", "output.fluid_upper=[2, 1]")
    run_case(write("time.t_end='20 ms'"), out=shared_tmp / "whole")
    run_case(write("time.t_end='20 ms'", *part), out=shared_tmp / "out")
    MPI.COMM_WORLD.barrier()
    whole, chosen = (
        read_grid(times_of(shared_tmp / name / "paraview" / "fluid.pvd")[-1][1]).fields
        for name in ("whole", "out")
    )
    assert np.ptp(whole["pressure"]) > 0
    for name in ("velocity", "pressure"):
        np.testing.assert_array_equal(chosen[name], whole[name][5::2, 1::2])
    pieces = sorted((shared_tmp / "out" / "paraview" / "fluid").glob("*.pvtr"))
    assert len(pieces) == 3
    text = pieces[-1].read_text()
    assert 'WholeExtent="0 6 0 4 0 1"' in text


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("output.fluid_lower=[0, 0]", r"output\.fluid_upper.*two corners"),
        ("output.line.0.end=[3, 0]", r"output\.line\.along\.end|output\.line\.0\.end.*outside the box"),
        ("output.line.0.start=[0]", r"expected 2 entries"),
    ],
)
def test_what_cannot_be_written_is_said(write, override, said):
    with pytest.raises(CaseError, match=said):
        write(override)
