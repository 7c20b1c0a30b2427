"""Slices of a run's fluid: what was written comes back, derived fields on closed forms, pictures and movies."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI
from PIL import Image
from typer.testing import CliRunner

from valvefsi.cli import app
from valvefsi.errors import CaseError
from valvefsi.io.grid_files import GridFields, nearest_time, read_grid, times_of
from valvefsi.io.paraview import FluidSeries, SolidSeries
from valvefsi.io.solid_body import Body
from valvefsi.post.movies import draw_movie, draw_plane, find_ffmpeg
from valvefsi.post.slices import Plane, cut, field_of, outline, scale_of
from valvefsi.units import MMHG

CELLS = (7, 6, 5)
UNIFORM = [np.linspace(0.1, 0.8, 8), np.linspace(0.0, 0.6, 7), np.linspace(-0.2, 0.3, 6)]
GRADED = [np.array([0.0, 0.1, 0.25, 0.4, 0.5, 0.6, 0.65, 0.8]), UNIFORM[1] ** 1.2, UNIFORM[2] - 1.0]


def fields(edges):
    """A linear velocity and a pressure of all three coordinates."""
    x = np.meshgrid(*[0.5 * (e[1:] + e[:-1]) for e in edges], indexing="ij")
    velocity = np.stack([x[1] + 2 * x[2], -x[0] + 3 * x[2], 4 * x[0] - x[1]], axis=-1)
    return velocity, 100.0 + x[0] + 10 * x[1] + 100 * x[2]


@pytest.fixture(params=["uniform", "graded"])
def written(request, shared_tmp):
    """A series of two times in two pieces, written by one rank that stands for two."""
    edges = UNIFORM if request.param == "uniform" else GRADED
    if MPI.COMM_WORLD.rank == 0:
        box = ((0.1, 0.0, -0.2), (0.1, 0.1, 0.1)) if request.param == "uniform" else edges
        (shared_tmp / "paraview").mkdir()
        velocity, pressure = fields(edges)
        place = (shared_tmp / "paraview", "fluid", MPI.COMM_SELF, CELLS, (0, 0, 0), CELLS, box)
        series = FluidSeries(*place)
        for k, t in enumerate((0.0, 0.5)):
            series.write(t, (k + 1) * velocity, pressure)
    MPI.COMM_WORLD.barrier()
    return shared_tmp, edges


def test_what_was_written_comes_back(written):
    folder, edges = written
    when, file = nearest_time(folder / "paraview" / "fluid.pvd", 0.4)
    grid = read_grid(file, when)
    velocity, pressure = fields(edges)
    assert when == 0.5
    for mine, expected in zip(grid.edges, edges, strict=True):
        assert mine == pytest.approx(expected, abs=1e-12)
    assert grid.fields["velocity"] == pytest.approx(2 * velocity, rel=1e-6)
    assert grid.fields["pressure"] == pytest.approx(pressure, rel=1e-6)


def test_the_nearest_time_is_taken_and_the_last_unless_one_is_given(written):
    series = written[0] / "paraview" / "fluid.pvd"
    assert [nearest_time(series, t)[0] for t in (None, 0.1, 0.4, 9.0)] == [0.5, 0.0, 0.5, 0.5]


def test_a_file_that_is_still_being_written_is_left_out(written):
    series = written[0] / "paraview" / "fluid.pvd"
    if MPI.COMM_WORLD.rank == 0:
        piece = max((written[0] / "paraview" / "fluid").glob("*.vt[ir]"))
        piece.write_bytes(piece.read_bytes()[:-20])
    MPI.COMM_WORLD.barrier()
    assert [t for t, _ in times_of(series)] == [0.0]


def test_pieces_of_all_ranks_come_together(shared_tmp):
    comm = MPI.COMM_WORLD
    velocity, pressure = fields(GRADED)
    ends = np.array([CELLS[0] * r // comm.size for r in range(comm.size + 1)])
    mine = slice(ends[comm.rank], ends[comm.rank + 1])
    start, size = (int(mine.start), 0, 0), (int(mine.stop - mine.start), *CELLS[1:])
    series = FluidSeries(shared_tmp, "fluid", comm, CELLS, start, size, GRADED)
    series.write(0.0, velocity[mine], pressure[mine])
    comm.barrier()
    grid = read_grid(times_of(shared_tmp / "fluid.pvd")[0][1])
    assert grid.fields["velocity"] == pytest.approx(velocity, rel=1e-6)
    assert grid.edges[0] == pytest.approx(GRADED[0])


def test_derived_fields_of_a_linear_flow_are_exact(written):
    """u = (y + 2z, -x + 3z, 4x - y): curl (-1 - 3, 2 - 4, -1 - 1), Q = -tr(G G)/2."""
    _, edges = written
    grid = GridFields(
        t=0.0, edges=tuple(edges), fields=dict(zip(("velocity", "pressure"), fields(edges), strict=True))
    )
    curl = np.array([-4.0, -2.0, -2.0])
    for axis in range(3):
        found, unit = field_of(grid, "vorticity", axis)
        assert found == pytest.approx(curl[axis])
        assert unit == "1/s"
    assert field_of(grid, "vorticity_magnitude")[0] == pytest.approx(np.linalg.norm(curl))
    G = np.array([[0.0, 1.0, 2.0], [-1.0, 0.0, 3.0], [4.0, -1.0, 0.0]])
    assert field_of(grid, "q")[0] == pytest.approx(-0.5 * np.trace(G @ G))
    assert field_of(grid, "speed")[0] == pytest.approx(np.linalg.norm(grid.fields["velocity"], axis=-1))
    assert field_of(grid, "velocity_y")[0] == pytest.approx(grid.fields["velocity"][..., 1])


def test_a_cut_takes_the_cells_that_the_plane_goes_through():
    velocity, pressure = fields(GRADED)
    grid = GridFields(t=0.0, edges=tuple(GRADED), fields={"velocity": velocity, "pressure": pressure})
    found = cut(grid, Plane(axis=0, position=0.3), "pressure")
    assert found.axes == ("y", "z")
    np.testing.assert_allclose(found.values, pressure[2] / MMHG)
    assert found.x is grid.edges[1]
    with pytest.raises(CaseError, match=r"--slice = 'x=2 cm': the box goes from 0 to 0\.8 cm along x"):
        cut(grid, Plane(axis=0, position=2.0), "pressure")
    with pytest.raises(CaseError, match=r"--field = 'vortex': expected one of pressure, velocity_x"):
        cut(grid, Plane(axis=0, position=0.3), "vortex")


def test_a_plane_cuts_a_cube_in_a_square():
    x = np.array(
        [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)], dtype=float
    )
    body = Body(points=x, cells={12: np.arange(8)[None]})
    segments = np.array(outline(body, Plane(axis=2, position=0.25), 3))
    assert len(segments) == 4
    assert np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1) == pytest.approx(1.0)
    assert outline(body, Plane(axis=2, position=3.0), 3) == []


def test_a_plane_cuts_the_outside_of_a_body_where_it_goes_through_its_edges():
    tetrahedron = Body(points=np.vstack([np.zeros(3), np.eye(3)]), cells={10: np.arange(4)[None]})
    ends = np.array(outline(tetrahedron, Plane(axis=2, position=0.25), 3)).reshape(-1, 2)
    assert sorted(map(tuple, ends.round(12))) == sorted(2 * [(0.0, 0.0), (0.0, 0.75), (0.75, 0.0)])
    n = np.arange(12).reshape(3, 2, 2)
    corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    cells = np.array([[n[i + k, a, b] for i, a, b in corners] for k in (0, 1)])
    x = np.array(np.meshgrid([0.0, 1.0, 2.0], [0.0, 1.0], [0.0, 1.0], indexing="ij")).reshape(3, -1).T
    segments = np.array(outline(Body(points=x, cells={12: cells}), Plane(axis=2, position=0.5), 3))
    # Nothing is drawn on the face between the two cells, x = 1.
    assert np.linalg.norm(np.diff(segments, axis=1), axis=-1).sum() == pytest.approx(6.0)


def test_a_scale_is_even_about_zero_and_begins_there_where_it_can():
    assert scale_of(np.linspace(-3.0, 5.0, 2001)) == pytest.approx((-4.96, 4.96), rel=1e-2)
    assert scale_of(np.linspace(0.1, 5.0, 2001))[0] == 0.0
    assert scale_of(np.full(10, 7.0))[0] < scale_of(np.full(10, 7.0))[1]


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="pictures are drawn by one rank")
def test_pictures_and_movies_are_made(written):
    folder, _ = written
    path = draw_plane(folder, folder, plane=Plane(axis=0, position=0.3), field="vorticity")
    with Image.open(path) as image:
        assert min(image.size) > 300
    made = draw_movie(folder, folder / "m.gif", plane=Plane(axis=0, position=0.3), field="pressure")
    with Image.open(made) as image:
        assert image.n_frames == 2
    with pytest.raises(CaseError, match=r"ends in \.mp4 or \.gif"):
        draw_movie(folder, folder / "m.avi", plane=None, field="speed")
    with pytest.raises(CaseError, match="needs a plane"):
        draw_plane(folder, folder, plane=None, field="speed")


@pytest.mark.parametrize("first", [-1.0, 0.0])
def test_a_gif_has_the_colours_of_the_scale_and_of_the_text_as_nearly_as_the_eye_sees(tmp_path, first):
    """A field of a thousand values from end to end of the scale, with a zero in its middle and without."""
    place, cells = tmp_path / "paraview", (1000, 250, 1)
    place.mkdir()
    series = FluidSeries(
        place, "fluid", MPI.COMM_SELF, cells, (0, 0, 0), cells, ((0, 0, 0), (0.001, 0.001, 1))
    )
    ramp = np.broadcast_to(np.linspace(first, 1.0, 1000)[:, None, None], cells)
    for t in (0.0, 0.1):
        series.write(t, np.ones((*cells, 3)), 2e5 * ramp)
    frame = draw_plane(tmp_path, tmp_path, plane=None, field="pressure")
    draw_movie(tmp_path, tmp_path / "m.gif", plane=None, field="pressure")
    with Image.open(frame) as image:
        exact = np.asarray(image.convert("RGB")).astype(int)
    with Image.open(tmp_path / "m.gif") as image:
        assert image.n_frames == 2
        image.seek(1)
        shown = np.asarray(image.convert("RGB")).astype(int)
    apart = np.abs(exact - shown).max(axis=2)  # of 255
    assert np.percentile(apart, 99) <= 4
    row = exact.shape[0] // 2
    coloured = np.ptp(exact[row], axis=1) > 20
    assert coloured.sum() > 600
    assert np.percentile(apart[row, coloured], 99) <= 4
    assert len(np.unique(shown[row, coloured], axis=0)) > 190


def test_an_mp4_is_made_by_the_ffmpeg_of_a_package_where_the_system_has_none(tmp_path, monkeypatch):
    program = tmp_path / "ffmpeg-own"
    program.write_text('#!/bin/sh\nfor last; do :; done\n/bin/cat > "$last"\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    folder = plane_run(tmp_path / "run", body=False)
    with pytest.raises(CaseError, match=r"an \.mp4 needs ffmpeg.*\[movies\].*a \.gif does not"):
        draw_movie(folder, tmp_path / "m.mp4", plane=None, field="speed")
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", SimpleNamespace(get_ffmpeg_exe=lambda: str(program)))
    made = draw_movie(folder, tmp_path / "m.mp4", plane=None, field="speed")
    assert made.stat().st_size % 3 == 0  # the frames as they were handed over
    assert made.stat().st_size > 3 * 300 * 300

    def none():
        raise RuntimeError("no ffmpeg in the package")

    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", SimpleNamespace(get_ffmpeg_exe=none))
    assert find_ffmpeg() is None


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="a command of one rank")
def test_the_commands(written):
    folder, _ = written
    run = CliRunner().invoke
    result = run(app, ["plot", str(folder), "--slice", "x=3mm", "--field", "vorticity"])
    assert result.exit_code == 0, result.output
    assert (folder / "slice_x0.3_vorticity.png").exists()
    result = run(app, ["movie", str(folder), "--slice", "y=0.2", "--out", str(folder / "m.gif")])
    assert result.exit_code == 0, result.output
    for wrong, said in (("w=3", "an axis and a position"), ("x=3 s", "--slice")):
        result = run(app, ["plot", str(folder), "--slice", wrong])
        assert result.exit_code != 0
        assert said in str(result.exception) + result.output


def plane_run(folder, body=True):
    """What a run in two dimensions leaves: one time of the fluid, and of a solid."""
    place, cells = folder / "paraview", (4, 3, 1)
    place.mkdir(parents=True)
    series = FluidSeries(place, "fluid", MPI.COMM_SELF, cells, (0, 0, 0), cells, ((0, 0, 0), (0.1, 0.1, 1)))
    series.write(0.0, np.ones((*cells, 3)), np.ones(cells))
    if body:
        points = np.array([[0.1, 0.1, 0], [0.2, 0.1, 0], [0.2, 0.2, 0]])
        solid = SolidSeries(place, "flag", MPI.COMM_SELF)
        solid.write(0.0, points, {5: np.array([[0, 1, 2]])}, np.ones(1), 0 * points)
    return str(folder)


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="a command of one rank")
def test_in_two_dimensions_a_picture_is_made_or_one_line_says_why_not(tmp_path, monkeypatch):
    monkeypatch.setattr("valvefsi.post.plots.solid.can_render", lambda: False)
    run, folder = CliRunner().invoke, plane_run(tmp_path / "run")
    for command in ("plot", "movie"):
        for plane in ("z=0", "x=0.2"):
            result = run(app, [command, folder, "--slice", plane])
            assert "--slice = " in str(result.exception)
            assert "a run in two dimensions is drawn whole" in str(result.exception)
    result = run(app, ["plot", folder])
    assert result.exit_code == 0, result.output
    assert (tmp_path / "run" / "flag_J.png").exists()
    assert "bodies in space" not in result.output
    result = run(app, ["plot", plane_run(tmp_path / "flow", body=False)])
    assert result.exit_code == 0, result.output
    assert (tmp_path / "flow" / "slice_speed.png").exists()
    for arguments, said in (
        ([folder, "--time", "nan"], "--time = nan: expected a finite time"),
        ([f"{folder}/paraview/fluid.pvd"], "drawn from the folder of its run, with --field speed"),
        (
            [str(tmp_path / "case.toml")],
            "this is a case, nothing of it is drawn but its fibres, with --fibres",
        ),
        ([str(tmp_path), "--field", "speed"], "was the run made with output.frames"),
        ([str(tmp_path), "--field", "mean_velocity_x"], "was the run made with output.frames"),
    ):
        (tmp_path / "case.toml").write_text("")
        assert said in str(run(app, ["plot", *arguments]).exception)


def test_a_series_that_is_not_there_is_said(tmp_path):
    with pytest.raises(CaseError, match=r"no such series.*output\.frames"):
        times_of(tmp_path / "fluid.pvd")
