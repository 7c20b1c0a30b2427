"""No text of a picture is cut off at its edge."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from valvefsi.post.plots import free_edge, profile


def outside(figure):
    """Texts that reach beyond the figure."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    whole = figure.bbox.padded(1.0)
    shown = list(figure.texts)
    for axes in figure.axes:
        shown += axes.findobj(Text) if axes.axison else [axes.title, *axes.texts]
    texts = [text for text in shown if text.get_visible() and text.get_text().strip()]
    places = [(text.get_text(), text.get_window_extent(canvas.get_renderer())) for text in texts]
    inside = [
        whole.x0 <= p.x0 and p.x1 <= whole.x1 and whole.y0 <= p.y0 and p.y1 <= whole.y1 for _, p in places
    ]
    return [text for (text, _), good in zip(places, inside, strict=True) if not good]


@pytest.fixture
def drawn(monkeypatch):
    """Figures that are drawn, instead of files."""
    figures = []
    for module in (profile, free_edge):
        monkeypatch.setattr(module, "saved", lambda figure, path: figures.append(figure))
    return figures


@pytest.mark.parametrize("lines", [1, 2])
def test_profiles(drawn, lines, tmp_path):
    y = np.linspace(0.0, 1.0, 11)
    one = {"x_cm": 0 * y + 3.5, "y_cm": y, "s_cm": y, "u_x_cm_per_s": 4 * y * (1 - y), "u_y_cm_per_s": 0 * y}
    profile.draw_profiles(tmp_path / "a.png", {f"line {k}": one for k in range(lines)}, title="a channel")
    assert outside(drawn[0]) == []


def test_free_edges(drawn, tmp_path):
    t, turn = np.linspace(0.0, 0.025, 9), np.linspace(0.0, 6.2, 30)
    ends = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    pieces = np.broadcast_to(np.stack([ends[:-1], ends[1:]], axis=1), (9, 29, 2, 2))
    middles = 0.23 + np.outer(t, [1.0, 1.2, 1.4])
    edges = {"t": t, "pieces": pieces, "middles": middles, "top": 8}
    free_edge.free_edges(tmp_path / "a.png", edges, radius=1.25, title="a valve")
    assert outside(drawn[0]) == []
