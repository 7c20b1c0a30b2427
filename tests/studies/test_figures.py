"""The supplement's figures from made-up runs: what is drawn of which frame, and what a folder may lack."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from typer.testing import CliRunner

from tests.studies.fake_runs import SPEED, beating, opening, steady
from tests.valve_waves import EJECTION, LARGEST_AREA, OPEN, PERIOD
from valvefsi.cli import app
from valvefsi.errors import CaseError
from valvefsi.io.grid_files import GridFields
from valvefsi.post.plots import supplement as plots
from valvefsi.studies.figure_runs import instants, near, opening_and_closing, read_runs
from valvefsi.studies.figures import draw_figure, field_difference

pytestmark = pytest.mark.serial
RECORD = str(Path(__file__).parents[2] / "calibration" / "valve_beat.csv")
TIMES = np.arange(0.0, PERIOD, 0.0125)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A beat, the same beat of another fluid on frames of its own, and a part of one, in folders of a study."""
    study = tmp_path_factory.mktemp("figures") / "study"
    study.mkdir()
    return {
        "study": study,
        "beat": beating(study / "beat", TIMES),
        "other": beating(study / "other", TIMES + 0.004, overrides=("fluid.viscosity='1 cP'",)),
        "part": beating(study / "part", np.arange(0.08, 0.18, 0.01), cycles=0.2, stress=False),
    }


def drawn(monkeypatch, name):
    """What a function of the pictures is called with, which draws nothing."""
    calls = []
    monkeypatch.setattr(plots, name, lambda path, *args, **options: calls.append((args, options)) or path)
    return calls


@pytest.mark.parametrize("figure", ["S6", "S7", "S8", "S14", "S16", "S19"])
def test_every_figure_of_a_beat_is_drawn_by_its_command(figure, runs, tmp_path):
    folders = [str(runs[name]) for name in ("beat", "other")]
    done = CliRunner().invoke(app, ["plot", "--figure", figure, *folders, "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output + repr(done.exception)
    picture = imread(tmp_path / f"figure_{figure}.png")[..., :3]
    assert np.ptp(picture) > 0.5
    assert (picture.min(axis=2) < 0.95).mean() > 0.02


@pytest.mark.parametrize("figure", ["S10", "S13"])
def test_every_figure_of_averages_is_drawn_by_its_command(figure, tmp_path):
    folders = [str(steady(tmp_path / name, size=size)) for name, size in (("a", 1.0), ("b", 1.2))]
    for some in (folders[:1], folders):
        done = CliRunner().invoke(app, ["plot", "--figure", figure, *some, "--out", str(tmp_path)])
        assert done.exit_code == 0, done.output + repr(done.exception)
        assert np.ptp(imread(tmp_path / f"figure_{figure}.png")[..., :3]) > 0.5


def test_the_valve_opens_and_closes_where_its_area_says(runs):
    beat, part = read_runs([runs["beat"], runs["part"]])
    assert opening_and_closing(beat) == pytest.approx(
        (OPEN + 0.004, OPEN + EJECTION - 0.042), abs=PERIOD / 500
    )
    found = opening_and_closing(part)
    assert found[0] == pytest.approx(OPEN + 0.004, abs=PERIOD / 500)
    assert found[1] is None, "it ends while the valve is open"


def test_instants_are_as_close_as_frames_and_each_is_once():
    times = np.arange(0.0, 0.2, 0.02)
    assert list(instants(times, 0.031, 0.002, 4)) == [2, 3, 4, 5]
    assert list(instants(times, 0.0, 0.002, 8)) == list(range(8))
    assert list(instants(times, 0.0, 0.06, 8)) == [0, 3, 6, 9]
    assert list(instants(times, 0.145, 0.02, 8)) == [7, 8, 9]
    assert near(times, 0.061) == 3
    assert near(times, 0.21) is None


def test_planes_are_of_the_same_instants_of_all_runs(runs, monkeypatch, tmp_path):
    calls = drawn(monkeypatch, "plane_rows")
    draw_figure("S18", [runs["beat"], runs["other"]], tmp_path)
    (rows,), options = calls[0]
    assert len(rows) == 2
    first, second = rows.values()
    assert len(first) == 6
    for a, b in zip(first, second, strict=True):
        assert abs(a.t - b.t) <= 0.0085, "the other run's frames are 4 ms later"
    for panel in first:
        jet = SPEED * float(opening(panel.t)) * np.exp(-(0.125**2))
        assert panel.found.values.max() == pytest.approx(jet, rel=0.05, abs=1e-3)
    assert first[0].t == pytest.approx(OPEN, abs=0.0126)
    assert first[1].t - first[0].t == pytest.approx(57.6e-3, abs=0.0126)
    assert [name.split("\n")[1].split(",")[0] for name in rows] == ["3.5 cP", "1 cP"]
    re = 4 * 400.0 / (np.pi * 2.5 * 0.01)
    assert f"Re {re:.0f}" in list(rows)[1]
    assert "besides the fluid" not in options["caption"]


def test_of_a_part_of_a_beat_the_common_instants_are_drawn(runs, monkeypatch, tmp_path):
    calls = drawn(monkeypatch, "plane_rows")
    draw_figure("S9", [runs["beat"], runs["part"]], tmp_path)
    (rows,), _ = calls[0]
    for row in rows.values():
        assert len(row) >= 4
        for panel in row:
            assert 0.08 <= panel.t <= 0.175


def test_leaflets_are_drawn_while_they_open_and_close(runs, monkeypatch, tmp_path):
    calls = drawn(monkeypatch, "leaflet_rows")
    draw_figure("S15", [runs["beat"], runs["part"]], tmp_path)
    (rows,), options = calls[0]
    assert list(rows) == ["beat\nopening", "part\nopening", "beat\nclosing"]
    opens, partly, closes = ([view["t"] for view in row if view is not None] for row in rows.values())
    assert opens[0] == pytest.approx(OPEN, abs=0.0126)
    assert np.diff(opens) == pytest.approx(0.0125), "frames are farther apart than 3.84 ms"
    assert closes[0] == pytest.approx(OPEN + EJECTION - 0.042, abs=0.0126)
    assert max(partly) < 0.18
    assert "frames are 12.5 ms apart" in options["caption"]
    reach = [np.abs(view["xyz"][:, :2]).max() for view in rows["beat\nopening"]]
    assert reach[-1] > 1.1 * reach[0], "leaflets go outwards as they open"


def test_the_stress_of_a_leaflet_is_that_of_its_frame(runs, monkeypatch, tmp_path):
    calls = drawn(monkeypatch, "leaflet_rows")
    draw_figure("S17", [runs["beat"]], tmp_path)
    (rows,), options = calls[0]
    for row in rows.values():
        for view in row:
            shut = 1.0 - float(opening(view["t"]))
            # 1e6 dyn/cm^2 is 100 kPa, times the height of the node.
            height = np.asarray(view["xyz"])[:, 2][view["triangles"]].mean(axis=1)
            assert view["values"] == pytest.approx(100.0 * shut * height, abs=0.01 + 0.01 * shut * 100)
    assert options["scale"][2] == "von Mises [kPa]"


def test_waveforms_hold_the_differences_of_runs_and_of_records(runs, monkeypatch, tmp_path):
    calls = drawn(monkeypatch, "waves_figure")
    draw_figure("S6", [runs["beat"], runs["other"], RECORD], tmp_path)
    (waves, quantities), options = calls[0]
    assert [wave.measured for wave in waves] == [True, False, False]
    assert tuple(quantities) == ("p_lv", "p_ao", "q_ao", "pdva")
    assert waves[1].values["pdva"].max() == pytest.approx(LARGEST_AREA)
    assert "beat less other in L2: P_LV 0 %" in options["caption"]
    assert "beat less valve_beat in L2: P_LV" in options["caption"]
    assert "two standard deviations" in options["caption"]


def test_a_record_begins_where_it_is_told_to(runs, monkeypatch, tmp_path):
    calls = drawn(monkeypatch, "waves_figure")
    draw_figure("S6", [runs["beat"], RECORD], tmp_path)
    done = CliRunner().invoke(
        app,
        ["plot", "--figure", "S6", str(runs["beat"]), RECORD, "--start", "85.7 ms", "--out", str(tmp_path)],
    )
    assert done.exit_code == 0, done.output
    plain, moved = (call[0][0][0] for call in calls)
    assert plain.t[np.argmax(plain.values["q_ao"])] - moved.t[
        np.argmax(moved.values["q_ao"])
    ] == pytest.approx(85.7e-3, abs=5e-3)
    assert moved.deviations["q_ao"].shape == moved.t.shape


def test_a_study_is_drawn_by_its_folder_from_the_coarsest_grid_on(runs, tmp_path):
    study = tmp_path / "study"
    for name, spacing in (("fine", "1 mm"), ("coarse", "2 mm")):
        shutil.copytree(runs["beat"], study / "runs" / name)
        text = (study / "runs" / name / "case.toml").read_text()
        assert 'h = "0.2 cm"' in text
        (study / "runs" / name / "case.toml").write_text(text.replace('h = "0.2 cm"', f'h = "{spacing}"'))
    assert [run.name for run in read_runs([study])] == ["coarse", "fine"]


def test_the_difference_of_two_grids_is_that_of_their_fields():
    def fields(n, size):
        edges = tuple(np.linspace(-1.0, 1.0, n + 1) for _ in range(3))
        x, y, z = np.meshgrid(*[0.5 * (e[1:] + e[:-1]) for e in edges], indexing="ij")
        return GridFields(t=0.0, edges=edges, fields={"q": size * (2.0 + x + 0.5 * y - z)})

    l2, peak = field_difference(fields(10, 1.1), fields(20, 1.0), "q")
    assert l2 == pytest.approx(0.1, rel=1e-9), "linear fields are interpolated exactly"
    # The coarse grid's corner cell is half a cell of its own further in.
    assert peak == pytest.approx(1.1 * (2 + 2.5 * 0.9) / (2 + 2.5 * 0.95) - 1.0, rel=1e-9)


@pytest.mark.parametrize(
    ("figure", "folders", "message"),
    [
        ("S5", ["beat"], "expected one of S6, S7"),
        ("S18", ["beat"], "figure S18 sets 2 runs side by side, found 1"),
        ("S19", ["beat", "part"], "compares two fluids, all of these have 3.5 cP"),
        ("S6", ["part"], "no whole cycle of the run, it covers 171.4 ms of one"),
        ("S10", ["beat"], "no averages: give output.averages_from"),
        ("S17", ["part"], "no stress in the frames: give output.stress"),
        ("S8", ["nothing"], "no run here: expected the folder of a run, or of a study"),
        ("S8", ["bare"], "no such series; was the run made with output.frames?"),
        ("S14", ["bare"], "no such series; was the run made with output.frames?"),
        ("S8", [RECORD], "figure S8 is of runs, this is a file"),
        ("S6", [RECORD], "figure S6 sets 1 run side by side, found 0"),
    ],
)
def test_a_folder_that_lacks_what_a_figure_needs_is_refused(figure, folders, message, runs, tmp_path):
    (tmp_path / "nothing").mkdir()
    (tmp_path / "bare").mkdir()
    for name in ("case.toml", "history.csv"):
        shutil.copy(runs["beat"] / name, tmp_path / "bare")
    known = runs | {"nothing": tmp_path / "nothing", "bare": tmp_path / "bare"}
    with pytest.raises(CaseError, match=message.replace("?", r"\?")) as error:
        draw_figure(figure, [known.get(name, name) for name in folders], tmp_path)
    assert "\n" not in str(error.value)


def test_averages_without_profiles_are_refused(tmp_path):
    with pytest.raises(CaseError, match="no profiles: give"):
        draw_figure("S12", [steady(tmp_path / "bare", lines=False)], tmp_path)


def test_several_folders_go_with_a_figure_only(runs):
    done = CliRunner().invoke(app, ["plot", str(runs["beat"]), str(runs["other"])])
    assert "several folders go with --figure" in str(done.exception)
