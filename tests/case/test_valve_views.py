"""Leaflets end on and their free edges, from the frames of a run."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from matplotlib.image import imread
from typer.testing import CliRunner

from tests.case.test_case_valve import coarse
from valvefsi.case.build import run_case
from valvefsi.case.valve_views import draw_leaflets, moments, read_leaflets
from valvefsi.cli import app
from valvefsi.errors import CaseError
from valvefsi.io.history import read_history
from valvefsi.post.plots.free_edge import free_edges

pytestmark = pytest.mark.serial
FRAMES = "output.frames=3"


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    folder = tmp_path_factory.mktemp("views") / "run"
    run_case(coarse(6, FRAMES), out=folder)
    return folder


def test_a_run_leaves_its_leaflets_as_they_are_in_the_frames(ran):
    found, history = read_leaflets(coarse(6, FRAMES), ran), read_history(ran / "history.csv")
    assert found.t == pytest.approx([0.0, 80e-6, 160e-6, 240e-6])
    assert found.area == pytest.approx(np.interp(found.t, history["t_s"], history["pdva_cm2"]), rel=1e-5)
    # Each leaflet is in its own third: the middle of one is at 0, 120 or 240 degrees.
    angle = np.degrees(np.arctan2(*found.points[0][found.triangles].mean(axis=1)[:, 1::-1].T))
    for number in range(3):
        off = (angle[found.owner == number] - 120.0 * number + 180.0) % 360.0 - 180.0
        assert np.abs(off).max() < 63.0
        assert off.mean() == pytest.approx(0.0, abs=2.0)
    at_rest = found.edges(0)
    assert at_rest[..., 2].min() > 0.5 * found.points[0][:, 2].max(), "free edges are at the downstream end"
    middles = found.middles()
    assert middles.shape == (4, 3)
    assert np.ptp(middles[0]) < 1e-6, "three leaflets, turned by 120 degrees"
    assert (middles[0] > 0.0).all()


def test_a_window_keeps_its_frames_only(ran):
    found = read_leaflets(coarse(6, FRAMES), ran, (70e-6, 170e-6))
    assert found.t == pytest.approx([80e-6, 160e-6])
    assert draw_leaflets(coarse(6, FRAMES), ran, ran / "none", (1.0, 2.0)) == []


def test_frames_of_another_valve_are_refused(ran):
    with pytest.raises(CaseError, match="not of the case's valve"):
        read_leaflets(coarse(6, FRAMES, "solid.leaflets.mesh.valve.base='1 mm'"), ran)


def test_the_pictures_are_drawn_by_the_run_and_by_plot(ran, tmp_path):
    for name in ("leaflets.png", "free_edges.png", "valve.png"):
        assert np.ptp(imread(ran / name)[..., :3]) > 0.5
    done = CliRunner().invoke(app, ["plot", str(ran), "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    for name in ("leaflets.png", "free_edges.png", "valve.png"):
        assert (tmp_path / name).stat().st_size > 5000
    (tmp_path / "no history").mkdir()
    shutil.copy(ran / "case.toml", tmp_path / "no history")
    shutil.copytree(ran / "paraview", tmp_path / "no history" / "paraview")
    done = CliRunner().invoke(app, ["plot", str(tmp_path / "no history")])
    assert "free_edges" in done.output
    assert "valve.png" not in done.output
    bare = tmp_path / "bare"
    shutil.copytree(ran / "paraview", bare / "paraview")
    assert "free_edges" not in CliRunner().invoke(app, ["plot", str(bare)]).output


def test_moments_are_where_the_area_changes():
    t = np.linspace(0.0, 1.0, 101)
    area = np.interp(t, [0.1, 0.15, 0.4, 0.5], [0.0, 3.0, 3.0, 0.0])
    chosen = t[moments(t, area)]
    assert len(chosen) == 8
    assert (np.diff(chosen) > 0).all()
    assert (chosen[0], chosen[-1]) == (0.0, 1.0)
    moving = ((chosen > 0.1) & (chosen < 0.15)) | ((chosen > 0.4) & (chosen < 0.5))
    assert moving.sum() >= 4
    assert list(moments(t[:5], area[:5])) == [0, 1, 2, 3, 4]
    still = moments(t, 0.0 * t)
    assert np.diff(t[still]) == pytest.approx(1.0 / 7.0, abs=0.011)


def test_many_moments_are_thinned_along_the_way(tmp_path):
    t = np.linspace(0.0, 1.0, 60)
    swing = 1.0 - np.cos(2 * np.pi * t)
    circle = np.exp(2j * np.pi * np.arange(13) / 12)
    ends = np.stack([circle[:-1], circle[1:]], axis=1)
    pieces = np.stack([ends.real, ends.imag], axis=-1) * (0.1 + 0.5 * swing)[:, None, None, None]
    edges = {"t": t, "pieces": pieces, "middles": np.repeat(0.1 + 0.5 * swing[:, None], 3, 1), "top": 30}
    path = free_edges(tmp_path / "edges.png", edges, radius=1.25, title="A circle", caption="breathes")
    assert np.ptp(imread(path)[..., :3]) > 0.5
