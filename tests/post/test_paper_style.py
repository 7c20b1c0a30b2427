"""Figures for papers: width, type, vectors, and the numbers behind them."""

from __future__ import annotations

import csv
import itertools
import re
import zlib

import numpy as np
import pytest

from tests.valve_waves import record
from valvefsi.post.plots import base
from valvefsi.post.plots.paper import LEAST, MOST, paper
from valvefsi.post.plots.valve_waveform import valve_waveforms
from valvefsi.units import MMHG

POINT = 25.4 / 72


def drawn(folder, name="valve.png", **more):
    r = record(samples=200)
    waves = {"t": r.t, "p_lv": r.p_lv, "p_ao": r.p_ao, "q": r.q, "pdva": r.pdva, **more}
    with paper():
        return valve_waveforms(folder / name, waves, title="a title", caption="and more")


def rows(path):
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    return list(csv.DictReader(lines))


def size(path):
    """Width and height of a page [mm], and what is in its streams."""
    raw = path.read_bytes()
    box = re.search(rb"/MediaBox \[ ?([\d.]+) ([\d.]+) ([\d.]+) ([\d.]+) ?\]", raw)
    streams = [zlib.decompress(s) for s in re.findall(rb"stream\n(x.*?)\nendstream", raw, re.DOTALL)]
    return [float(box[k]) * POINT for k in (3, 4)], b"".join(streams), raw


def test_a_figure_is_one_column_of_vectors_with_its_own_type(tmp_path):
    path = drawn(tmp_path)
    assert path == tmp_path / "valve.pdf"
    assert not (tmp_path / "valve.png").exists()
    (width, height), content, raw = size(path)
    assert width == pytest.approx(85.0, abs=0.1)
    assert 60.0 < height < 160.0
    assert b"/Subtype /Image" not in raw
    sizes = {float(s) for s in re.findall(rb"/F\d+ ([\d.]+) Tf", content)}
    whole = {s for s in sizes if not any(abs(s - 0.7 * other) < 1e-3 for other in sizes)}  # 0.7 are indices
    assert LEAST <= min(whole) <= max(whole) <= MOST
    assert b"/Type3" not in raw, "journals refuse type 3 fonts"


def test_the_numbers_behind_a_figure_are_those_that_are_drawn(tmp_path):
    drawn(tmp_path)
    r = record(samples=200)
    found = rows(tmp_path / "valve_data.csv")
    pressure = [row for row in found if row["panel"] == "0" and "LV" in row["series"]]
    assert [float(row["x"]) for row in pressure] == pytest.approx(r.t, abs=1e-6)
    assert [float(row["y"]) for row in pressure] == pytest.approx(r.p_lv / MMHG, rel=1e-6, abs=1e-5)
    assert pressure[0]["axes"].endswith("pressure [mmHg]")
    head = (tmp_path / "valve_data.csv").read_text().splitlines()[:2]
    assert head == ["# a title", "# and more"]


def test_panels_side_by_side_are_two_columns_wide(tmp_path):
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 4.0))
    left, right = figure.subplots(1, 2)
    left.imshow(np.arange(6.0).reshape(2, 3), origin="lower", extent=(0, 3, 0, 2))
    right.pcolormesh([0, 1, 2], [0, 1], [[5.0, 7.0]])
    with paper():
        path = base.saved(figure, tmp_path / "two.png")
    assert size(path)[0][0] == pytest.approx(174.0, abs=0.1)
    found = rows(tmp_path / "two_data.csv")
    assert {row["series"] for row in found} == {""}, "what has no name in a legend has none here"
    pixels = [tuple(float(row[k]) for k in ("x", "y", "value")) for row in found if row["kind"] == "pixel"]
    assert (2.5, 1.5, 5.0) in pixels
    assert (0.5, 0.5, 0.0) in pixels
    cells = [tuple(float(row[k]) for k in ("x", "y", "value")) for row in found if row["kind"] == "cell"]
    assert cells == [(0.5, 0.5, 5.0), (1.5, 0.5, 7.0)]


@pytest.mark.parametrize("way", ["vertical", "horizontal"])
def test_a_colour_bar_is_of_vectors_and_closes_its_hairlines(tmp_path, way):
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.0, 4.0))
    figure.add_axes((0.1, 0.2, 0.6, 0.7)).plot([0.0, 1.0])
    place = figure.add_axes((0.85, 0.2, 0.03, 0.7) if way == "vertical" else (0.1, 0.06, 0.6, 0.03))
    bar = figure.colorbar(ScalarMappable(cmap="viridis"), cax=place, orientation=way)
    assert bar.solids.get_rasterized(), "what matplotlib does by itself"
    with paper():
        path = base.saved(figure, tmp_path / "bar.png")
    _, content, raw = size(path)
    assert b"/Subtype /Image" not in raw
    colours = {bytes(c) for c in re.findall(rb"([\d.]+ [\d.]+ [\d.]+) rg", content)}
    assert len(colours) > 200
    assert {bytes(c) for c in re.findall(rb"([\d.]+ [\d.]+ [\d.]+) RG", content)} >= set(list(colours)[5:9])


def test_nothing_of_a_figure_leaves_its_page(tmp_path, monkeypatch):
    kept = []
    monkeypatch.setattr(base, "save_for_paper", lambda figure, path: kept.append(figure) or path)
    drawn(tmp_path)
    from valvefsi.post.plots import paper as style

    style.save_for_paper(kept[0], tmp_path / "valve.png")
    box, (width, height) = kept[0].get_tightbbox(), kept[0].get_size_inches()
    assert box.x0 >= -0.02
    assert box.y0 >= -0.02
    assert box.x1 <= width + 0.02
    assert box.y1 <= height + 0.02


def test_a_legend_wider_than_its_axes_stands_above_them_and_numbers_at_ticks_stay_apart(tmp_path):
    from matplotlib.figure import Figure

    from valvefsi.post.plots import paper as style

    figure = Figure(figsize=(7.6, 3.0))
    axes = figure.subplots()
    for k in range(3):
        axes.plot([0.0, 1.0], [0.0, k], label=f"a name that is too long for one row, {k}")
    axes.legend(ncols=3, frameon=False)
    axes.xaxis.set_major_formatter("{x:.5f}")
    axes.set_xticks(np.linspace(0.0, 1.0, 21))
    style.save_for_paper(figure, tmp_path / "wide.png")
    box, frame = axes.get_legend().get_window_extent(), axes.get_window_extent()
    assert box.y0 >= frame.y1
    assert box.width <= frame.width
    assert frame.width > 0.7 * figure.bbox.width, "the axes have not given way to it"
    labels = [label.get_window_extent() for label in axes.get_xticklabels()]
    assert len(labels) > 2
    assert axes.get_xticks()[0] == 0.0
    assert all(b.x0 > a.x1 for a, b in itertools.pairwise(labels))


def test_a_legend_that_lies_below_its_axes_stays_on_the_page(tmp_path):
    from matplotlib.figure import Figure

    from valvefsi.post.plots import paper as style

    figure = Figure(figsize=(7.2, 4.9))
    for axes in figure.subplots(1, 2):
        axes.plot([0.0, 1.0], label="short")
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.25))
    style.save_for_paper(figure, tmp_path / "below.png")
    assert all(axes.get_legend().get_window_extent().y0 >= -0.5 for axes in figure.axes)


def test_outside_of_it_figures_are_as_they_were(tmp_path):
    drawn(tmp_path)
    r = record(samples=200)
    path = valve_waveforms(tmp_path / "screen.png", {"t": r.t, "p_lv": r.p_lv, "p_ao": r.p_ao, "q": r.q})
    assert path.read_bytes()[1:4] == b"PNG"
    assert not (tmp_path / "screen_data.csv").exists()


def test_lines_stay_apart_for_readers_who_see_no_green_or_no_red():
    """Colours as a reader with deuteranopia or protanopia sees them (Machado et al. 2009), 10 apart in CIE Lab."""
    kinds = (
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    )
    colours = np.array([[int(c[k : k + 2], 16) / 255 for k in (1, 3, 5)] for c in base.LINES])
    linear = np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
    for matrix in kinds:
        lab = to_lab(np.clip(linear @ np.array(matrix).T, 0, 1))
        apart = np.linalg.norm(lab[:, None] - lab[None], axis=-1) + 1e3 * np.eye(len(lab))
        assert apart.min() > 10.0


def to_lab(linear):
    """Linear sRGB as CIE Lab."""
    M = [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
    xyz = linear @ np.array(M).T / [0.95047, 1.0, 1.08883]
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=1)
