"""The checker of figures finds each fault that it is for, and nothing in a figure without."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

from tests.figures import faults
from valvefsi.post.plots import decay, free_edge, profile


def good():
    figure = Figure(figsize=(4, 3), layout="constrained")
    axes = figure.add_subplot()
    axes.plot([0, 1, 2], [0, 1, 4], label="a")
    axes.set_title("a title")
    return figure, axes


def equal(figure, axes):
    axes.set_xticks([0, 1, 2], labels=["1", "1", "2"])


def overlapping(figure, axes):
    axes.set_xticks([0, 0.05, 2], labels=["0.000", "0.050", "2.000"])


def clipped(figure, axes):
    figure.text(0.9, 0.5, "a long remark that runs over the edge")


def empty(figure, axes):
    axes.lines[0].remove()


def headings(figure, axes):
    figure.text(0.4, 0.93, "over the title")


def legend(figure, axes):
    axes.legend(loc="lower left", handlelength=12)


FAULTS = {
    equal: "equal tick labels of x",
    overlapping: "tick labels of x overlap",
    clipped: "cut off: 'a long remark",
    empty: "empty axes at 'a title'",
    headings: "overlap: 'over the title' and 'a title'",
    legend: "legend covers",
}


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
def test_each_fault_is_found(fault, tmp_path):
    figure, axes = good()
    figure.draw_without_rendering()
    assert faults(figure) == []
    fault(figure, axes)
    figure.draw_without_rendering()
    (said,) = faults(figure)
    assert said.startswith(FAULTS[fault])


def test_every_figure_that_is_saved_is_looked_at(picture_faults, tmp_path):
    figure, axes = good()
    equal(figure, axes)
    figure.savefig(tmp_path / "a.png")
    assert picture_faults == ["a.png: equal tick labels of x: ['1', '1', '2'] at 'a title'"]
    picture_faults.clear()  # or this test would fail for it


@pytest.mark.parametrize("lines", [1, 2])
def test_profiles(lines, tmp_path):
    y = np.linspace(0.0, 1.0, 11)
    one = {"x_cm": 0 * y + 3.5, "y_cm": y, "s_cm": y, "u_x_cm_per_s": 4 * y * (1 - y), "u_y_cm_per_s": 0 * y}
    assert profile.draw_profiles(
        tmp_path / "a.png", {f"line {k}": one for k in range(lines)}, title="a channel"
    ).exists()


def test_the_published_ranges_of_forces_can_be_seen_beside_a_start(tmp_path, monkeypatch):
    """A start of 20 times the drag does not press the range to a line; the curve is there from its first moment."""
    kept = []
    monkeypatch.setattr(decay, "saved", lambda figure, path: kept.append(figure) or path)
    t = np.linspace(0.1, 60.0, 600)
    drag, lift = 1.34 + 25.0 * np.exp(-2.0 * t), 0.33 * np.sin(t)
    decay.forces(tmp_path / "a.png", (t, drag, lift), {"drag": (1.32, 1.37), "lift": (0.31, 0.34)})
    above, below = kept[0].axes
    assert 0.05 / np.ptp(above.get_ylim()) > 0.5  # of 1.32 to 1.37 and the curve at 1.34
    assert 0.03 / np.ptp(below.get_ylim()) > 0.02
    assert above.lines[0].get_xdata()[0] == t[0]


def test_a_valve_that_ends_open_has_one_view_of_its_edges_in_the_middle(tmp_path, monkeypatch):
    kept = []
    monkeypatch.setattr(free_edge, "saved", lambda figure, path: kept.append(figure) or path)
    for end in (8, 4):
        test_free_edges(tmp_path, top=end)
    still, through = ([a for a in f.axes if a.get_title() in VIEWS] for f in kept)
    assert [a.get_title() for a in still] == ["until open widest"]
    assert 0.4 < still[0].get_position().x0 + 0.5 * still[0].get_position().width < 0.6
    assert [a.get_title() for a in through] == VIEWS


VIEWS = ["until open widest", "from then on"]


def test_free_edges(tmp_path, top=8):
    t, turn = np.linspace(0.0, 0.025, 9), np.linspace(0.0, 6.2, 30)
    ends = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    pieces = np.broadcast_to(np.stack([ends[:-1], ends[1:]], axis=1), (9, 29, 2, 2))
    middles = 0.23 + np.outer(t, [1.0, 1.2, 1.4])
    edges = {"t": t, "pieces": pieces, "middles": middles, "top": top}
    assert free_edge.free_edges(tmp_path / "a.png", edges, radius=1.25, title="a valve")
