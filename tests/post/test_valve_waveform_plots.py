"""Pictures of a valve's waveforms and of its leaflets end on."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.image import imread

from tests.valve_shapes import UP, leaflets
from tests.valve_waves import SALINE, record
from valvefsi.post.diagnostics.projected_area import end_view, projected_area
from valvefsi.post.plots import free_edge, valve_waveform
from valvefsi.post.plots.valve_waveform import valve_end_views, valve_waveforms
from valvefsi.post.valve_numbers import valve_numbers


def test_the_waveforms_are_drawn(tmp_path):
    two = record(2, samples=600)
    numbers = valve_numbers(two, SALINE)
    drawn = {name: getattr(two, name) for name in ("t", *two.signals)}
    for name, prefix in (("forward", "forward"), ("positive", "pressure")):
        drawn[name] = np.array(
            [
                [n.start + getattr(n, f"{prefix}_start"), n.start + getattr(n, f"{prefix}_end")]
                for n in numbers
            ]
        )
    rng = np.random.default_rng(0)
    drawn |= {"t_data": two.t[::6], "q_data": two.q[::6] + 5 * rng.standard_normal(len(two.t[::6]))}
    path = valve_waveforms(tmp_path / "waves.png", drawn, title="Pulse duplicator", caption="closed form")
    assert np.ptp(imread(path)[..., :3]) > 0.5
    bare = {name: drawn[name] for name in ("t", "p_lv", "p_ao", "q")}
    assert valve_waveforms(tmp_path / "bare.pdf", bare).stat().st_size > 5000


def test_the_leaflets_are_drawn_end_on(tmp_path):
    views = []
    for k, opening in enumerate((0.02, 0.25, 0.6, 1.0)):
        points, triangles, owner, edges, _ = leaflets(opening)
        area = projected_area(points, triangles, radius=1.25, rows=128, **UP).open_area
        xyz = end_view(points, UP["axis"], UP["centre"])
        views.append(
            {"xyz": xyz, "triangles": triangles, "owner": owner, "free_edges": edges}
            | {"open_area": area, "t": 0.1 + 0.02 * k}
        )
    path = valve_end_views(tmp_path / "views.png", views, radius=1.25, title="Opening", caption="end on")
    assert np.ptp(imread(path)[..., :3]) > 0.5
    assert valve_end_views(tmp_path / "one.png", views[:1], radius=1.25).exists()


def test_the_size_of_a_valve_can_be_read_off_its_end_views(tmp_path, monkeypatch):
    """The bar of 5 mm is 0.5 cm long on axes in cm, beside an orifice of 21 mm."""
    made = []
    monkeypatch.setattr(valve_waveform, "saved", lambda figure, path: made.append(figure) or path)
    monkeypatch.setattr(free_edge, "saved", lambda figure, path: made.append(figure) or path)
    view = {"xyz": np.zeros((0, 3)), "triangles": np.zeros((0, 3))}
    valve_end_views(tmp_path / "a.png", [view], radius=1.05)
    pieces, middles = np.zeros((3, 1, 2, 2)), np.outer([0.1, 0.2, 0.3], np.ones(3))
    edges = {"t": np.linspace(0, 1, 3), "pieces": pieces, "middles": middles, "top": 1}
    free_edge.free_edges(tmp_path / "b.png", edges, radius=1.05)
    for figure in made:
        assert any("21 mm across" in text.get_text() for text in figure.texts)
        axes = next(a for a in figure.axes if any(text.get_text() == "5 mm" for text in a.texts))
        assert [np.ptp(line.get_xdata()) for line in axes.lines] == [pytest.approx(0.5)]
    assert len(made) == 2
