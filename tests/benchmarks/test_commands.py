"""Every benchmark as a command: its options, all quantities of its result, what it leaves behind, earlier names.

`commands.json` lists the options of each command and the entries of its ``result.json`` as they were before there was
one frame for all; it only grows.
"""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import pytest
import typer
from mpi4py import MPI
from typer.testing import CliRunner

from tests.benchmarks.tiny import KINDS, TINY, tiny
from valvefsi.benchmarks.registry import ENTRIES, markdown
from valvefsi.cli import app
from valvefsi.cli.bench_command import command_of

WORLD = MPI.COMM_WORLD
LONG = {"bending", "bulk-modulus", "strips"}
"""Commands whose smallest run takes minutes."""
GRID = re.compile(r"\d+|N\d+-.*")
LISTED = json.loads((Path(__file__).parent / "commands.json").read_text())


def entries(value, at=""):
    """Where the entries of a result are; numbers of grids count as one."""
    if isinstance(value, dict):
        parts = [("#" if GRID.fullmatch(key) else key, part) for key, part in value.items()]
        return {place for key, part in parts for place in (f"{at}{key}", *entries(part, f"{at}{key}/"))}
    if isinstance(value, list):
        return {place for part in value for place in entries(part, f"{at}*/")}
    return set()


def numbers(value):
    """All numbers of a result."""
    if isinstance(value, dict):
        return [number for part in value.values() for number in numbers(part)]
    if isinstance(value, list):
        return [number for part in value for number in numbers(part)]
    return [value] if isinstance(value, float) else []


def test_there_is_a_tiny_run_and_a_list_for_every_command():
    assert set(LISTED) == set(TINY) == {*KINDS, "compression-series"} - LONG


@pytest.mark.parametrize("name", list(LISTED))
def test_a_result_holds_all_that_it_held_and_finite_numbers(name, shared_tmp):
    seen = []
    tiny(name).run(out=shared_tmp, progress=lambda *news: seen.append(news))
    if WORLD.rank == 0:
        result = json.loads((shared_tmp / "result.json").read_text())
        assert set(LISTED[name]["keys"]) - entries(result) == set()
        assert all(row["quantity"] is not None and "computed" in row for row in result["table"])
        assert list(shared_tmp.rglob("*.png")), "pictures"
        q = [
            x for x in numbers(result["quantities"]) if not math.isnan(x)
        ]  # no frequency of what did not swing
        assert all(map(math.isfinite, q))
        assert q or name == "kernels"
    assert seen[-1][1] == seen[-1][2], "all runs are done in the end"


@pytest.mark.parametrize("name", sorted({*KINDS} - LONG))
def test_a_command_has_all_options_that_it_had(name):
    alone = typer.Typer()
    alone.command()(command_of(KINDS[name].load()))
    flags = {text for option in typer.main.get_command(alone).params for text in option.opts}
    assert set(LISTED[name]["options"]) <= flags


def test_help_lists_every_command_by_group_without_loading_it():
    answer = CliRunner().invoke(app, ["bench", "--help"])
    assert answer.exit_code == 0
    assert all(f" {entry.name} " in answer.output and entry.group in answer.output for entry in ENTRIES)
    assert " plug " not in answer.output
    assert all(f"| `{entry.name}` | {entry.help} |" in markdown() for entry in ENTRIES)


def test_options_of_every_kind_reach_the_benchmark(shared_tmp):
    options = [
        "--grid",
        "24",
        "--refine",
        "0",
        "--kernels",
        "ib4,bspline3",
        "--set",
        "t_end=0.02",
        "--set",
        "mu=2",
        "--style",
        "paper",
    ]
    out = shared_tmp / "out"
    done = CliRunner().invoke(app, ["bench", "shell", *options, "--out", str(out)], catch_exceptions=False)
    assert done.exit_code == 0
    if WORLD.rank == 0:
        result = json.loads((out / "result.json").read_text())
        assert result["parameters"]["grids"] == [24]
        assert (result["parameters"]["t_end"], result["parameters"]["mu"]) == (0.02, 2.0)
        assert [name for name in result["quantities"] if "shell" in name] == [
            "shell, ib4, nodal",
            "shell, bspline3, nodal",
        ]
        assert sorted(path.name for path in out.iterdir() if path.name.startswith("shell")) == [
            "shell.pdf",
            "shell_data.csv",
        ]


def test_an_earlier_name_works_and_warns(shared_tmp):
    text = ["h=2 mm", "dt=0.1 ms", "t_end=1 ms"]
    options = [word for one in text for word in ("--set", one)] + ["--out", str(shared_tmp)]
    with pytest.warns(UserWarning, match="bench plug is now called bench leakage"):
        done = CliRunner().invoke(app, ["bench", "plug", *options], catch_exceptions=False)
    assert done.exit_code == 0
    assert "leak, mean of the last quarter" in done.output or WORLD.rank


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["compression", "--refine", "1", "--plan"], "a plan is of one run"),
        (["compression", "--nu-stab", "maybe"], "--nu-stab = 'maybe': expected a number"),
        (["shell", "--kernels", "bspline9"], "--kernels = 'bspline9': expected one of"),
        (["kernels", "--grid", "cook"], "--grid = 'cook': expected NAME=N"),
        (["kernels", "--ratios", "1,x"], "--ratios = 'x': expected a number"),
        (["speed", "--sizes", "3"], "--sizes = 3: expected a number of at least 4"),
        (["turek-fsi", "--case", "fsi4"], "--case = 'fsi4': expected one of fsi1, fsi2, fsi3"),
        (["valve-2d", "--t-end", "0"], "--t-end = 0.0: expected a number above 0"),
        (["land", "--problem", "4"], "--problem = 4: expected one of 1, 2, 3"),
        (["cook", "--refine", "9"], "--refine = 9: expected at most 3 finer grids"),
    ],
)
def test_what_cannot_be_used_is_one_clear_line(arguments, text):
    done = CliRunner().invoke(app, ["bench", *arguments])
    assert done.exit_code != 0
    assert text in str(done.exception)
    assert "\n" not in str(done.exception)
