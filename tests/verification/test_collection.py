"""Results gathered into one table: what is read, in which order, and what is refused."""

from __future__ import annotations

import json

import pytest
import typer.testing

from valvefsi import cli
from valvefsi.benchmarks.results import row
from valvefsi.errors import CaseError
from valvefsi.verification.collection import COLUMNS, collect, markdown


def write(folder, name, *, date="2026-11-20T10:00:00+0000", **more):
    result = {
        "benchmark": name,
        "parameters": {"cells": 20, "grid": [210, 162]},
        "table": [
            row("drag", 1.4, 1.25, "someone", unit="N"),
            row("time of a step", 3.0, unit="ms"),
            row("area", 0.1, 0.0),
        ],
        "timing": {"wall_s": 150.0},
        "environment": {"ranks": 2, "date": date},
    }
    folder.mkdir(parents=True)
    (folder / "result.json").write_text(json.dumps(result | more))


def test_what_is_compared_comes_ordered_and_once(tmp_path):
    write(tmp_path / "c" / "late", "beta", date="2026-11-21T01:00:00+0000")
    write(tmp_path / "c" / "early", "beta")
    write(
        tmp_path / "d",
        "alpha",
        runs=[{"numerics": {"grid": 25}}, {"numerics": {"grid": 50}}, {"numerics": {"grid": 25}}],
    )
    lines = collect([tmp_path, tmp_path / "c"])
    assert [(line.benchmark, line.date, line.quantity) for line in lines[::2]] == [
        ("alpha", "2026-11-20", "drag"),
        ("beta", "2026-11-20", "drag"),
        ("beta", "2026-11-21", "drag"),
    ]
    assert [line.quantity for line in lines[1::2]] == ["area"] * 3
    assert lines[0].difference_percent == pytest.approx(12.0)
    assert lines[1].difference_percent is None
    assert (lines[0].grid, lines[2].grid) == ("25, 50", "210 x 162")
    assert lines[2].label() == "drag (210 x 162)"
    assert lines[0].label() == "drag"
    assert lines[2].cells() == (
        "beta", "drag", "1.4 N", "1.25", "+12.00 %", "someone", "210 x 162", "2", "2026-11-20", "2 min",
    )  # fmt: skip
    assert len(collect([tmp_path], everything=True)) == 9


def test_a_row_without_a_name_belongs_to_the_one_above(tmp_path):
    write(tmp_path / "a", "alpha", table=[row("  drag", 1.4, 1.25, "one"), row("", 1.4, 1.3, "another")])
    assert [line.quantity for line in collect([tmp_path])] == ["drag", "drag"]


def test_bars_in_a_text_do_not_break_the_table(tmp_path):
    write(tmp_path / "a", "alpha", table=[row("|J - 1|", 0.1, 0.2, "x | y")])
    rows = markdown(collect([tmp_path])).splitlines()
    assert len(rows) == 3
    assert rows[2].replace("\\|", "").count("|") == len(COLUMNS) + 1


@pytest.mark.parametrize("broken", ["missing", "empty", "torn"])
def test_what_cannot_be_read_is_named(tmp_path, broken):
    folder = tmp_path / "results"
    if broken != "missing":
        folder.mkdir()
    if broken == "torn":
        (folder / "result.json").write_text('{"table": [')
    with pytest.raises(CaseError, match="results") as error:
        collect([folder])
    assert {"missing": "does not exist", "empty": "no result", "torn": "no whole result"}[broken] in str(
        error.value
    )


@pytest.mark.parametrize("relative", [True, False])
def test_the_command_writes_table_and_picture(tmp_path, relative):
    write(tmp_path / "r" / "a", "alpha", table=[row("drag", 1.4, 1.25, relative=relative)])
    out = tmp_path / "made" / "table.md"
    done = typer.testing.CliRunner().invoke(
        cli.app, ["bench", "table", str(tmp_path / "r"), "--out", str(out)]
    )
    assert done.exit_code == 0, done.output
    assert "1.25" in done.output
    assert "drag" in out.read_text()
    assert out.with_suffix(".png").stat().st_size > 5000
