"""Long lines on a terminal and in files, and what a run with a target ends with."""

from __future__ import annotations

import shlex
import subprocess

import pytest
from mpi4py import MPI

from valvefsi.cli.closing import show_run
from valvefsi.cli.tables import folded
from valvefsi.post.columns import Units

pytestmark = pytest.mark.serial
LAST = {"t_s": 0.5, "u_x_tip_cm": 0.25}


def test_columns_says_how_wide_redirected_output_is(tmp_path, capsys, monkeypatch):
    judged = {"value": 30.0, "from": 0.0, "to": 9.0, "unit": "% of " + 90 * "x", "plausible": False}
    result = {"last": LAST, "valve": {"plausible": {"closing volume": judged}}, "finished": True}
    folder = tmp_path / "out"
    widths = {}
    for columns in ("80", "0", ""):
        monkeypatch.setenv("COLUMNS", columns)
        show_run(result, MPI.COMM_SELF, folder, Units())
        widths[columns] = capsys.readouterr().out.splitlines()
    long = [line for line in widths["80"] if len(line) > 80]
    assert all(max(map(len, line.split())) > 60 for line in long), "only a path is longer"
    assert max(map(len, widths["0"])) > 80
    assert widths["0"] == widths[""]
    assert (
        "this run is finished: nothing was computed, its summary and pictures are as they were" in widths[""]
    )


def test_long_lines_break_between_words_and_a_command_stays_one_for_a_shell():
    assert folded("short", 10) == ["short"]
    text = "this run is finished: nothing was computed, its summary and pictures are as they were"
    pieces = folded(text, 40)
    assert max(map(len, pieces)) <= 40
    assert " ".join(piece.strip() for piece in pieces) == text
    command = (
        "  valvefsi run results/a-folder/case.toml --out results/a-folder --resume --set time.t_end='1 s'"
    )
    for width in (10, 30, 40, 80, 94):
        pieces = folded(command, width)
        assert all(len(piece) <= width for piece in pieces if len(piece.split()) > 2)
        assert len(pieces) > 1
        said = subprocess.run(
            ["sh", "-c", "printf '%s;' " + "\n".join(pieces)], capture_output=True, text=True, check=True
        )
        assert said.stdout.split(";")[:-1] == shlex.split(command)


def test_a_run_with_a_target_ends_with_how_to_correct_it(tmp_path, capsys):
    line = f"valvefsi target {tmp_path}"
    for result, shown in (
        ({"target": {}, "valve": {"cycles": [{"cardiac_output_l_per_min": 4.5}]}}, True),
        ({"target": {}, "valve": {"cycles": []}}, False),
        ({"valve": {"cycles": [{"cardiac_output_l_per_min": 4.5}]}}, False),
    ):
        show_run({"last": LAST, **result}, MPI.COMM_SELF, tmp_path, Units())
        assert (line in capsys.readouterr().out) == shown
