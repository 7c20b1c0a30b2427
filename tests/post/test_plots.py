"""Pictures: what is drawn is where it should be and has the colour it should have."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from valvefsi.post.plots.base import (
    PlaneFlow,
    PlaneSolid,
    Series,
    can_be_seen,
    flow_and_solid,
    histories,
    phase_bars,
    typeset,
)
from valvefsi.post.plots.fit import ProfilePanel, _between
from valvefsi.post.plots.ticks import tick_texts
from valvefsi.post.plots.waveform import headings_at

X = np.arange(16) + 0.5


def flow(pressure=False):
    x, y = np.meshgrid(X, X, indexing="ij")
    return PlaneFlow(x=X, y=X, u=y - 8, v=8 - x, pressure=(x - 8) if pressure else None)


def block(J):
    points = np.array([[4, 4, 0.5], [8, 4, 0.5], [12, 4, 0.5], [4, 12, 0.5], [8, 12, 0.5], [12, 12, 0.5]])
    cells = {9: np.array([[0, 1, 4, 3], [1, 2, 5, 4]])}
    return PlaneSolid(points=points, cells=cells, J=np.array(J), outline=points[[0, 2, 5, 3, 0], :2])


@pytest.mark.parametrize("pressure", [False, True])
def test_compressed_cells_are_red_and_dilated_ones_blue(tmp_path, pressure):
    picture = imread(flow_and_solid(tmp_path / "a" / "flow.png", flow(pressure), [block([0.9, 1.1])]))
    # The left quarter of the picture's block and the right one, in the middle of its height.
    height, width = picture.shape[:2]
    left, right = (picture[int(0.46 * height), int(f * width), :3] for f in (0.44, 0.59))
    assert left[0] > left[2] + 0.3
    assert right[2] > right[0] + 0.3


def test_a_solid_at_rest_in_a_fluid_at_rest_is_drawn(tmp_path):
    rest = PlaneFlow(x=X, y=X, u=np.zeros((16, 16)), v=np.zeros((16, 16)))
    for solids in ([block([1.0, 1.0])], []):
        assert flow_and_solid(tmp_path / "flow.png", rest, solids, title="rest").stat().st_size > 5000


def test_triangles_and_second_order_cells_are_drawn_by_their_corners():
    nodes = np.arange(9)[None]
    solid = PlaneSolid(
        points=np.random.default_rng(0).random((9, 3)), cells={70: nodes, 69: nodes[:, :6]}, J=np.ones(2)
    )
    assert [polygons.shape for polygons in solid.polygons] == [(1, 4, 2), (1, 3, 2)]


def test_a_history_shows_its_reference(tmp_path):
    t = np.linspace(0, 1, 50)
    panels = [
        Series(label="u [cm]", lines={"a": t, "b": t**2}, reference=0.8),
        Series(label="v [cm]", lines={"a": t}),
    ]
    with_reference = imread(histories(tmp_path / "a.png", t, panels, title="t", caption="c"))
    panels[0] = Series(label="u [cm]", lines=panels[0].lines)
    without = imread(histories(tmp_path / "b.png", t, panels, title="t", caption="c"))
    assert with_reference.shape == without.shape
    assert (with_reference != without).any(axis=-1).sum() > 500


def test_the_phases_of_a_step_are_drawn(tmp_path):
    steps = {"64^3": {"a": 1.0, "b": 3.0}, "128^3": {"a": 10.0, "c": 10.0}}
    picture = imread(phase_bars(tmp_path / "speed.png", steps))
    blue = (np.abs(picture[..., :3] - np.array([0x56, 0xB4, 0xE9]) / 255) < 0.02).all(axis=-1).sum(axis=1)
    bars = np.split(blue, np.flatnonzero(np.diff((blue > 100).astype(int))) + 1)
    first, second = (bar.max() for bar in bars if bar.min() > 100)
    assert second == pytest.approx(2 * first, rel=0.05)


@pytest.mark.parametrize(
    ("ticks", "texts"),
    [
        ([0.0, 2500.0, 5000.0], ["0", "2500", "5000"]),
        ([0.9999999, 1.0, 1.0000001], ["0.9999999", "1.0000000", "1.0000001"]),
        ([1.895e4, 1.897e4], ["18950", "18970"]),
        ([0.0, 2e6, 4e6], ["0", r"$2 \cdot 10^{6}$", r"$4 \cdot 10^{6}$"]),
        ([0.0, 1.25, 2.5, 3.75], ["0.00", "1.25", "2.50", "3.75"]),
        ([-1.5, 0.0, 1.5], ["-1.5", "0.0", "1.5"]),
        ([3.0, 3.0], ["3", "3"]),
    ],
)
def test_even_ticks_have_texts_that_differ(ticks, texts):
    assert tick_texts(ticks) == texts


def test_powers_are_set():
    assert typeset("64^3 cells, 1/s^2, s^-1, P_Ao") == "64\u00b3 cells, 1/s\u00b2, s\u207b\u00b9, P_Ao"


def test_a_band_is_seen_that_is_wider_than_a_line():
    """A line has 1.2 % of the axis: bands of 2 % and 1 % about a level line, and 2 % about one with slope 10."""
    level, whole = np.full(50, 40.0), np.ones(50)
    assert can_be_seen(whole, level, frame=(1.0, 100.0))
    assert not can_be_seen(0.5 * whole, level, frame=(1.0, 100.0))
    steep, x = np.linspace(0.0, 100.0, 50), np.linspace(0.0, 0.1, 50)
    assert not can_be_seen(whole, steep, x=x, frame=(1.0, 100.0))


def test_a_band_that_is_wide_at_one_end_alone_is_not_seen():
    band = np.zeros(50)
    band[-2:] = 30.0
    assert not can_be_seen(band, np.full(50, 40.0), frame=(1.0, 100.0))


def test_a_long_caption_ends_with_a_sentence(tmp_path):
    figure = Figure(figsize=(4, 3))
    headings_at(figure, 0.1, "title", "a short part; " + "a part that is far too long for the line " * 2)
    assert figure.texts[1].get_text() == "a short part"


@pytest.mark.parametrize("log", [False, True])
def test_a_profile_between_its_points_is_the_parabola_they_are_of(log):
    """Where the cost is quadratic in the parameter (or its logarithm), five points give all of it."""
    x = np.array([-1.0, -0.4, 0.0, 0.7, 1.2])
    panel = ProfilePanel(
        name="a",
        unit="-",
        values=np.exp(x) if log else x,
        costs=1 + 0.3 * x**2,
        threshold=1.2,
        best=1.0 if log else 0.0,
        interval=(0.0, 1.0),
        verdict="",
        log=log,
    )
    values, costs = _between(panel)
    fine = np.log(values) if log else values
    np.testing.assert_allclose(costs, 1 + 0.3 * fine**2, atol=1e-12)
    assert len(values) > 150


def test_the_legend_of_curves_that_fill_their_panel_lies_above_them(tmp_path):
    """Posts that swing from edge to edge all the time leave no place between them; what is saved is looked at."""
    t = np.linspace(0.0, 1.0, 400)
    posts = {f"leaflets post {k} inward": 0.3 * np.sin(20.0 * t + 0.4 * k) for k in range(3)}
    assert histories(tmp_path / "a.png", t, [Series(label="posts [mm]", lines=posts)]).exists()
