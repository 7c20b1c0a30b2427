"""Sweeps: what is varied, what members are called, their table, their picture."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from tests.studies.conftest import CASE
from valvefsi.case import load_case
from valvefsi.errors import CaseError
from valvefsi.post.plots import sweep as plots
from valvefsi.post.plots.base import typeset
from valvefsi.studies.members import Outcome
from valvefsi.studies.planning import time_of_all
from valvefsi.studies.sweep import make_sweep, scalars, sweep_rows, write_tables
from valvefsi.studies.sweep_picture import draw_sweep, headlines, moment, varying

DIAMETER = "solid.leaflets.mesh.valve.diameter"


def test_all_combinations_are_members_the_last_key_fastest():
    sweep = make_sweep([f"{DIAMETER}=21mm,25mm", "fluid.viscosity=1 cP, 2 cP"], ["time.t_end=2"])
    assert [member.name for member in sweep.members] == [
        "diameter=21mm,viscosity=1cP",
        "diameter=21mm,viscosity=2cP",
        "diameter=25mm,viscosity=1cP",
        "diameter=25mm,viscosity=2cP",
    ]
    assert sweep.members[1].overrides == ("time.t_end=2", f"{DIAMETER}=21mm", "fluid.viscosity=2 cP")
    assert sweep.values(2) == {"diameter_mm": 25.0, "viscosity_cP": 1.0}


@pytest.mark.parametrize(
    ("text", "column", "shown"),
    [
        ("a.d=21mm,2.5 cm, '29 mm'", "d_mm", [21.0, 25.0, 29.0]),
        ("a.d=1,2.5,-3e-2", "d", [1.0, 2.5, -0.03]),
        ("a.c1=50 kPa,0.1 MPa", "c1_kPa", [50.0, 100.0]),
        ("a.c1=5 dyn/cm^2,1 Pa", "c1_dyn_per_cm2", [5.0, 10.0]),
        ("a.kernel=ib3,ib4", "kernel", ["ib3", "ib4"]),
        ("a.nu=0.4,off", "nu", ["0.4", "off"]),
        ("a.d=21mm,2 s", "d", ["21mm", "2 s"]),
        ("a.on=true,false", "on", ["true", "false"]),
        ("a.u=[1, 0],[2, 0]", "u", ["[1, 0]", "[2, 0]"]),
        ("a.t='a, b',c", "t", ["'a, b'", "c"]),
        ("a.m={model = 'x', c = [1, 2]},{model = 'y'}", "m", ["{model = 'x', c = [1, 2]}", "{model = 'y'}"]),
    ],
)
def test_values_are_read_as_overrides_are(text, column, shown):
    (parameter,) = make_sweep([text]).parameters
    assert parameter.column == column
    assert [parameter.shown(k) for k in range(len(parameter.values))] == pytest.approx(shown)


@pytest.mark.parametrize(
    ("over", "names"),
    [
        (["a.x.d=1,2", "a.y.d=3"], ["x.d=1,y.d=3", "x.d=2,y.d=3"]),
        (["grid.cells.0=8", "grid.cells.1=8"], ["cells.0=8,cells.1=8"]),
        (["a.c1=5 dyn/cm^2"], ["c1=5dyn_per_cm^2"]),
        (["a.file=../b c.csv"], ["file=.._per_bc.csv"]),
        (["d=1"], ["d=1"]),
    ],
)
def test_a_member_is_called_by_the_ends_of_keys_that_tell_them_apart(over, names):
    assert [member.name for member in make_sweep(over).members] == names


def test_names_that_would_be_one_get_a_mark_and_long_ones_are_cut():
    first, second = (member.name for member in make_sweep(["a.u=[1],(1)"]).members)
    assert first != second
    assert first.startswith("u=_1_-")
    (member,) = make_sweep([f"a.u={'x' * 300}"]).members
    assert len(member.name) < 60


@pytest.mark.parametrize(
    ("over", "said"),
    [
        (["diameter"], "--over: diameter: expected key=value,value"),
        (["a..b=1"], "expected key=value,value"),
        (["a.d=1,,2"], "expected key=value,value"),
        (["a.d="], "expected key=value,value"),
        (["a.d=25mm,25 mm"], "a.d = '25 mm': this value stands twice"),
        (["a.d=1", "a.d=2"], "a.d: this key stands twice"),
        (["a.t=1"], "a.t: this key is in --set, too"),
    ],
)
def test_what_is_no_sweep_is_refused(over, said):
    with pytest.raises(CaseError, match=f"^--over.*{said.removeprefix('--over: ')}"):
        make_sweep(over, ["a.t=3"])


def outcomes_of(sweep, folder, summaries):
    """Outcomes of members with these summaries; None for one that failed."""
    made = []
    for member, summary in zip(sweep.members, summaries, strict=True):
        place = folder / member.name
        place.mkdir()
        state = "failed" if summary is None else "done"
        if summary is not None:
            (place / "summary.json").write_text(json.dumps(summary))
        made.append(Outcome(member=member, folder=place, state=state, message="" if summary else "why"))
    return made


SUMMARIES = [
    {"last": {"t_s": 1.0, "u_x_tip_cm": 0.1}, "note": "same", "warnings": [], "which": "a"},
    None,
    {
        "last": {"t_s": 1.0, "u_x_tip_cm": 0.3},
        "note": "same",
        "warnings": [{"t_s": 0.5}],
        "which": "b",
        "on": True,
    },
]


def test_a_row_holds_the_values_and_every_number_of_the_summary_and_what_else_differs(tmp_path):
    sweep = make_sweep([f"{DIAMETER}=21mm,25mm,29mm"])
    outcomes = outcomes_of(sweep, tmp_path, SUMMARIES)
    rows = sweep_rows(sweep, outcomes)
    assert list(rows[0]) == [
        *(
            "member",
            "state",
            "diameter_mm",
            "last.t_s",
            "last.u_x_tip_cm",
            "note",
            "which",
            "warnings.0.t_s",
            "on",
        ),
    ]
    assert [row["state"] for row in rows] == ["done", "failed", "done"]
    assert [row["diameter_mm"] for row in rows] == [21.0, 25.0, 29.0]
    for row, summary in zip(rows, SUMMARIES, strict=True):
        flat = scalars(summary or {})
        assert {name: row[name] for name in flat} == flat
        assert all(row[name] is None for name in list(row)[3:] if name not in flat)
    alike = sweep_rows(sweep, [outcomes[0], outcomes[0], outcomes[0]])
    assert "note" not in alike[0]
    assert "which" not in alike[0]
    assert "last.t_s" in alike[0]


def test_the_tables_hold_the_rows_and_how_the_members_ended(tmp_path):
    sweep = make_sweep([f"{DIAMETER}=21mm,25mm,29mm"])
    outcomes = outcomes_of(sweep, tmp_path, SUMMARIES)
    write_tables(tmp_path / "case.toml", sweep, outcomes, tmp_path)
    with (tmp_path / "sweep.csv").open() as file:
        table = list(csv.DictReader(file))
    for row, expected in zip(table, sweep_rows(sweep, outcomes), strict=True):
        assert row == {name: "" if value is None else str(value) for name, value in expected.items()}
    result = json.loads((tmp_path / "sweep.json").read_text())
    assert result["over"] == {DIAMETER: {"values": ["21mm", "25mm", "29mm"], "column": "diameter_mm"}}
    assert [(m["state"], m["message"]) for m in result["members"]] == [
        ("done", ""),
        ("failed", "why"),
        ("done", ""),
    ]
    assert result["members"][1]["log"].endswith("diameter=25mm/run.log")


def test_a_valve_is_told_by_its_last_whole_cycle_and_other_runs_by_their_ends():
    cycle = {"mean_pressure_difference_mmHg": 5.0, "peak_pdva_cm2": 3.0, "times_from": "pdva"}
    valve = {"valve": {"cycles": [{**cycle, "peak_pdva_cm2": 9.0}, cycle, {"cycle": 2}]}, "last": {"a": 1.0}}
    assert headlines(valve) == {"mean_pressure_difference_mmHg": 5.0, "peak_pdva_cm2": 3.0}
    last = {
        "step": 3.0,
        "t_s": 1.0,
        "courant": 0.1,
        "energy_x_erg": 1.0,
        "block_J_min": 0.9,
        "u_x_tip_cm": 2.0,
    }
    assert list(headlines({"last": last}).items()) == [("u_x_tip_cm", 2.0), ("block_J_min", 0.9)]
    assert headlines({}) == {}


def test_only_numbers_that_change_are_drawn():
    found = varying([{"last": {"a": 1.0, "b": 2.0, "c": 1.0}}, {}, {"last": {"a": 1.0, "b": 3.0}}])
    assert list(found) == ["b"]
    assert found["b"] == pytest.approx([2.0, np.nan, 3.0], nan_ok=True)


@pytest.fixture
def figures(monkeypatch):
    """Collect the figures that are written."""
    made, write = [], plots.saved
    monkeypatch.setattr(plots, "saved", lambda figure, path: made.append(figure) or write(figure, path))
    return made


def drawn(tmp_path, over, values):
    """Draw a sweep whose members end with these displacements, None for one that failed."""
    (tmp_path / "case.toml").write_text(CASE)
    sweep = make_sweep(over)
    found = [None if value is None else {"last": {"u_x_tip_cm": value, "J": 1 + value}} for value in values]
    outcomes = outcomes_of(sweep, tmp_path, found)
    cases = dict.fromkeys((member.name for member in sweep.members), load_case(tmp_path / "case.toml"))
    return draw_sweep(sweep, cases, outcomes, tmp_path / "sweep.png")


def curves(axes):
    named = [(line.get_label().removeprefix("_child0"), line) for line in axes.get_lines()]
    return [(name, line.get_xdata().tolist(), line.get_ydata().tolist()) for name, line in named]


def texts_are_whole_and_apart(figure):
    """Whether all texts lie in the figure, no two on one another, and none on the panel of another axes."""
    figure.canvas.draw()
    page, boxes = figure.bbox, [(None, text.get_window_extent()) for text in figure.texts]
    for axes in figure.axes:
        low, high = axes.get_ylim()
        texts = [axes.title, axes._left_title, axes.xaxis.label, axes.yaxis.label, *axes.get_xticklabels()]
        texts += [text for text in axes.get_yticklabels() if low <= text.get_position()[1] <= high]
        texts += axes.get_legend().get_texts() if axes.get_legend() else []
        boxes += [
            (axes, text.get_window_extent()) for text in texts if text.get_text() and text.get_visible()
        ]
    whole = all(page.x0 <= b.x0 and b.x1 <= page.x1 and page.y0 <= b.y0 and b.y1 <= page.y1 for _, b in boxes)
    apart = not any(a.overlaps(b) for k, (_, a) in enumerate(boxes) for _, b in boxes[:k])
    return (
        whole
        and apart
        and not any(b.overlaps(axes.bbox) for own, b in boxes for axes in figure.axes if axes != own)
    )


MEMBERS = "2 of 3 members over diameter; numbers: last values of each history"


def test_what_the_numbers_of_members_are_of_is_said():
    ended, valve = (
        {"last": {"pdva_cm2": 1.0}},
        {"valve": {"cycles": [{"mean_pressure_difference_mmHg": 5.0}]}},
    )
    assert moment([ended, {}]) == "last values of each history"
    assert moment([valve, {}]) == "last whole cycle"
    assert moment([valve, ended]) == "last whole cycle, without one the last values of each history"


def test_powers_of_units_are_set_as_powers(tmp_path, figures):
    drawn(tmp_path, ["a.c1=1 kPa,2 kPa", "a.density=1 g/cm^3,2 g/cm^3"], [1.0, 2.0, 3.0, 4.0])
    assert all("g/cm\N{SUPERSCRIPT THREE}" in name for name, *_ in curves(figures[0].axes[0]))
    assert "g/cm\N{SUPERSCRIPT THREE}" in figures[0].axes[0].get_legend().get_texts()[0].get_text()
    assert typeset("a [g/cm**3]") == "a [g/cm\N{SUPERSCRIPT THREE}]"


def test_the_picture_shows_numbers_against_what_is_varied(tmp_path, figures):
    assert drawn(tmp_path, [f"{DIAMETER}=29mm,21mm,25mm"], [0.3, 0.1, None]).exists()
    (figure,) = figures
    assert curves(figure.axes[0]) == [("", [21.0, 29.0], [1.0, pytest.approx(3.0)])]
    assert figure.axes[0].get_title(loc="left") == "$u_x$ tip [mm]"
    assert figure.axes[0].get_xlabel() == "diameter [mm]"
    assert [text.get_text() for text in figure.texts] == ["driven box", MEMBERS]
    assert texts_are_whole_and_apart(figure)


def test_a_second_parameter_makes_curves_and_words_make_places(tmp_path, figures):
    drawn(tmp_path, ["a.c1=1 kPa,2 kPa", "a.kernel=ib3,ib4"], [1.0, 2.0, 3.0, 4.0])
    assert [(name.split(" ")[1], x, y) for name, x, y in curves(figures[0].axes[0])] == [
        ("ib3", [1.0, 2.0], [10.0, 30.0]),
        ("ib4", [1.0, 2.0], [20.0, 40.0]),
    ]
    assert texts_are_whole_and_apart(figures[0])
    (tmp_path / "words").mkdir()
    drawn(tmp_path / "words", ["a.kernel=ib3,composite_bspline54,ib6"], [1.0, 2.0, 3.0])
    ticks = [text.get_text() for text in figures[1].axes[0].get_xticklabels()]
    assert ticks == ["ib3", "composit\N{HORIZONTAL ELLIPSIS}", "ib6"]
    assert texts_are_whole_and_apart(figures[1])


def test_nothing_to_draw_is_no_picture(tmp_path):
    assert drawn(tmp_path, [f"{DIAMETER}=21mm,25mm"], [None, None]) is None


def test_waveforms_of_members_lie_over_one_another(tmp_path, figures):
    t = np.linspace(0.0, 1.0, 50)
    waves = [
        {"t": t, "p_lv": k * 13332.0 * t, "p_ao": 13332.0 + 0 * t, "q": 100 * t, "pdva": t} for k in (1, 2)
    ]
    picture = plots.SweepPicture(
        label="diameter [mm]",
        x=[21.0, 25.0, 29.0],
        names=["", "", ""],
        numbers={"peak_pdva_cm2": np.array([1.0, 2.0, np.nan])},
        waves=[*waves, {}],
        members=["21 mm", "25 mm", "29 mm"],
    )
    plots.sweep_picture(tmp_path / "waves.png", picture)
    pressure, flow, area = figures[0].axes[1:]
    assert [max(line.get_ydata()) for line in pressure.get_lines()] == pytest.approx(
        [10, 10, 20, 10], rel=1e-4
    )
    assert [text.get_text() for text in pressure.get_legend().get_texts()] == [
        *("21 mm", "25 mm", "upstream", "downstream"),
    ]
    assert pressure.get_ylabel() == "pressure [mmHg]"
    assert area.get_xlabel() == "t [s]"
    assert [max(line.get_ydata()) for line in (*flow.get_lines(), *area.get_lines())] == [100, 100, 1, 1]
    assert texts_are_whole_and_apart(figures[0])
    brief = [{**one, "t": 1e-3 * t} for one in waves]
    plots.sweep_picture(tmp_path / "brief.png", replace(picture, waves=[*brief, {}]))
    assert figures[1].axes[-1].get_xlabel() == "t [ms]"
    assert max(figures[1].axes[-1].get_lines()[0].get_xdata()) == pytest.approx(1.0)
    assert texts_are_whole_and_apart(figures[1])


@pytest.mark.parametrize(("jobs", "time"), [(1, 10.0), (2, 7.0), (3, 5.0), (9, 4.0)])
def test_the_time_of_all_is_that_of_the_core_that_ends_last(jobs, time):
    assert time_of_all([1.0, 3.0, 2.0, 4.0], jobs) == time
