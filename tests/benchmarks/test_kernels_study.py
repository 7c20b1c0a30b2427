"""The kernel study on grids far too coarse: kept runs, break-downs on record, rules, time left."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from valvefsi.benchmarks import cook, kernel_problems, statics_compression
from valvefsi.benchmarks.immersed import Numerics
from valvefsi.benchmarks.kernel_problems import COMPRESSION, COOK, SHELL, block_elements, run_halving
from valvefsi.benchmarks.kernel_rules import rules
from valvefsi.benchmarks.kernels import Setup, TimeLeft, line_of, run
from valvefsi.benchmarks.parameters import defaults
from valvefsi.cli.kernel_study import shown
from valvefsi.errors import CaseError

TINY = {"kernels": ("bspline3",), "ratios": (1.0,), "couplings": ("nodal",)}


def numbers(**changed):
    return defaults(COOK.parameters) | changed


@pytest.fixture
def coarse(monkeypatch):
    monkeypatch.setattr(cook, "FINE", 4)
    monkeypatch.setattr(kernel_problems, "STATIC", 4)


def test_a_study_gives_table_rules_and_picture_and_its_runs_are_not_run_again(
    shared_tmp, comm, coarse, monkeypatch
):
    setup = Setup(
        **TINY,
        grids={"compression": 24, "cook": 20, "shell": 16},
        overrides=["compression.t_end=0.3", "cook.t_end=0.2", "shell.t_end=0.05"],
    )
    seen = []
    result = run(setup, out=shared_tmp, comm=comm, progress=lambda *news: seen.append(news))
    assert [(r["problem"], r["stabilised"]) for r in result["runs"]] == [
        ("compression", True),
        ("compression", False),
        ("cook", True),
        ("cook", False),
        ("shell", False),
    ]
    assert all(r["failed"] is None and r["error_percent"] is not None for r in result["runs"])
    assert len(result["rules"]) == 2
    assert [news[:2] for news in seen] == [(k, 5) for k in range(6)]
    assert (seen[0][3], seen[-1][3]) == (None, 0.0)

    def refuse(*given):
        raise AssertionError("run again")

    monkeypatch.setattr(kernel_problems, "shell_at_rest", refuse)
    monkeypatch.setattr("valvefsi.run.simulation.Simulation.run", refuse)
    again = run(setup, out=shared_tmp, comm=comm)
    for new, old in zip(again["runs"], result["runs"], strict=True):  # the static solver rounds as it likes
        assert new | {"error_percent": 0} == old | {"error_percent": 0}
        assert new["error_percent"] == pytest.approx(old["error_percent"], rel=1e-12)
    if comm.rank == 0:
        assert json.loads((shared_tmp / "result.json").read_text())["benchmark"] == "kernels"
        with (shared_tmp / "kernels.csv").open(newline="") as file:
            table = list(csv.DictReader(file))
        assert [float(r["error_percent"]) for r in table] == [r["error_percent"] for r in again["runs"]]
        assert (shared_tmp / "kernels.png").stat().st_size > 1e4
    with pytest.raises(AssertionError, match="run again"):
        run(replace(setup, overrides=[*setup.overrides, "shell.t_end=0.06"]), out=shared_tmp, comm=comm)


def test_a_run_that_breaks_down_is_on_record_with_its_reason_and_the_study_goes_on(shared_tmp, comm, coarse):
    setup = Setup(
        **TINY,
        problems=("cook", "shell"),
        stabilised="on",
        grids={"cook": 20, "shell": 16},
        overrides=["cook.t_end=1", "cook.dt_per_h=0.4", "shell.t_end=0.05"],
    )
    broken, fine = run(setup, out=shared_tmp, comm=comm)["runs"]
    assert "Courant number" in broken["failed"]
    assert broken["step_halvings"] == kernel_problems.HALVINGS
    assert broken["error_percent"] is None
    assert fine["failed"] is None
    assert len(list((shared_tmp / "cook").glob("*/run.json"))) == kernel_problems.HALVINGS + 1


def test_only_a_run_that_its_step_breaks_is_tried_with_half_of_it(shared_tmp, comm):
    def attempts(reasons):
        tried, left = [], iter(reasons)

        def fake(numerics, values, folder, comm):
            tried.append((values["dt_per_h"], folder.name))
            return {"failed": next(left), "wall_s": 1.0}

        problem = replace(COOK, run=fake)
        record = run_halving(problem, Numerics(grid=20), numbers(dt_per_h=0.8), shared_tmp / "a", comm)
        return tried, record

    tried, record = attempts(["the Courant number is 9", None])
    assert tried == [(0.8, "a"), (0.4, "a-step2")]
    assert (record["halvings"], record["failed"], record["wall_s"]) == (1, None, 2.0)
    assert len(attempts(["a point of the solid is lost"])[0]) == 1
    assert len(attempts(["the velocity is not finite"] * 3)[0]) == 3


def line(kernel, ratio, error, **changed):
    given = {"problem": "cook", "kernel": kernel, "coupling": "nodal", "stabilised": True, "ratio": ratio}
    measured = {"error_percent": error, "change_percent": 0.1, "leaks": False, "failed": None}
    return given | measured | changed


def test_rules_hold_what_is_near_the_best_and_neither_leaks_nor_breaks_down():
    table = [
        line("a", 0.5, -0.2),  # below the floor of 1 %, which the others are compared with
        line("a", 1.0, 2.9),
        line("a", 2.0, 3.1),
        line("b", 0.5, 1.5, leaks=True),
        line("b", 1.0, -2.0),
        line("b", 2.0, None, failed="lost", change_percent=None),
        line("c", 1.0, 0.1, leaks=True),
    ]
    first, second, third = rules(table, floors={"cook": 1.0}, factor=3.0)
    assert (first.kernel, first.ratios, first.best, first.multiple) == ("a", (0.5, 1.0), 0.5, 0.2)
    assert (second.kernel, second.ratios, second.errors) == ("b", (1.0,), {"cook": 2.0})
    assert second.fits == {"cook": (1.0,)}
    assert (third.kernel, third.ratios, third.best, third.why) == ("c", (), None, "leaks: cook")


def test_a_problem_without_stabilisation_counts_for_both_kinds():
    still = {"problem": "shell", "stabilised": False}
    table = [line("a", 1.0, 2.0), line("a", 1.0, 1.0, stabilised=False), line("a", 1.0, 9.0, **still)]
    table += [line("b", 1.0, 1.0, **still)]
    found = rules(table, floors={"cook": 1.0, "shell": 1.0}, factor=3.0, free=["shell"])
    assert {(rule.stabilised, rule.multiple) for rule in found if rule.kernel == "a"} == {
        (True, 9.0),
        (False, 9.0),
    }


def test_a_change_of_area_beyond_the_limit_is_a_leak():
    q = {"u_y_corner_cm": 1.1, "change_percent": 1.5, "J_min": 0.9, "J_max": 1.3}
    record = {"quantities": q, "failed": None, "halvings": 0, "wall_s": 1.0}
    found = line_of(COOK, Numerics(grid=25), record, 1.0)
    assert found["leaks"]
    assert found["error_percent"] == pytest.approx(10.0)
    assert found["J_spread"] == pytest.approx(0.3)
    record["quantities"] = q | {"change_percent": 0.5}
    assert not line_of(COOK, Numerics(grid=25), record, 1.0)["leaks"]


def test_meshes_have_the_ratios_asked_for():
    for ratio in (0.5, 0.75, 1.0, 1.5, 2.0):
        assert COMPRESSION.ratio(Numerics(grid=48, ratio=ratio)) == pytest.approx(ratio)
        assert block_elements(Numerics(grid=48, ratio=ratio)) % 4 == 0
        assert COOK.ratio(Numerics(grid=25, ratio=ratio)) == pytest.approx(ratio, rel=0.1)
        assert SHELL.ratio(Numerics(grid=64, ratio=ratio)) == pytest.approx(ratio, rel=0.15)


def test_the_block_is_compared_with_its_converged_statics(comm, monkeypatch):
    monkeypatch.setattr(kernel_problems, "STATIC", 8)
    values = defaults(COMPRESSION.parameters)
    known = COMPRESSION.reference(values, comm)
    assert known == pytest.approx(statics_compression.CONVERGED, rel=1e-3)


def test_the_time_left_is_that_of_runs_alike():
    watch, one = TimeLeft(), Numerics(grid=20)
    other = replace(one, coupling="elemental")
    assert watch.left([(COOK, one)]) is None
    watch.add(COOK, one, 2.0)
    watch.add(COOK, other, 6.0)
    assert watch.left([(COOK, one), (COOK, other)]) == pytest.approx(8.0)
    assert watch.left([(COOK, replace(one, kernel="ib4")), (SHELL, one)]) == pytest.approx(2.0 + 4.0)
    assert watch.left([(COOK, replace(other, ratio=2.0))]) == pytest.approx(6.0)


def test_progress_says_what_is_next_and_how_long_it_may_take():
    said = []
    show = shown(SimpleNamespace(rank=0), echo=said.append, interval=0.0)
    show(0, 8, "cook N25", None)
    show(2, 8, "cook N30", 75.0)
    show(8, 8, "", 0.0)
    assert said[0].endswith("run 1 of 8, cook N25, unknown time left")
    assert said[1] == " 25.0 %  run 3 of 8, cook N30, 1 min 15 s left"
    assert said[2] == "100.0 %  8 runs"
    shown(SimpleNamespace(rank=1), echo=said.append)(0, 8, "cook N25", None)
    assert len(said) == 3


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"problems": ("cok",)}, "cook"),
        ({"kernels": ("bspline9",)}, "bspline"),
        ({"kernels": ()}, "some of"),
        ({"couplings": ("nodl",)}, "nodal"),
        ({"stabilised": "maybe"}, "both"),
        ({"ratios": (0.01,)}, "from 0.1 to 4"),
        ({"grids": {"cook": 2}}, "at least 8"),
        ({"grids": {"torsion": 20}}, "compression"),
        ({"factor": 0.5}, "1 or more"),
        ({"nu_stab": 0.5}, "below 0.5"),
    ],
)
def test_a_study_that_cannot_be_run_is_refused(changed, message):
    with pytest.raises(CaseError, match=message):
        Setup(**changed)


@pytest.mark.parametrize("text", ["t_end=1", "torsion.t_end=1", "cook.t_edn=1"])
def test_an_override_that_reaches_no_problem_is_refused(text):
    with pytest.raises(CaseError, match="--set"):
        Setup(problems=("cook",), overrides=[text]).values()


def test_the_command_takes_its_choices_from_options(monkeypatch):
    from valvefsi.benchmarks import kernels as benchmark
    from valvefsi.cli import app

    given = []
    monkeypatch.setattr(benchmark, "run", lambda setup, **more: given.append((setup, more)) or {})
    options = (
        "--kernels ib4,ib6 --ratios 1,2 --problems cook --couplings elemental --grid cook=20 --stabilised on"
    )
    answer = CliRunner().invoke(app, ["bench", "kernels", *options.split()], catch_exceptions=False)
    assert answer.exit_code == 0
    setup = given[0][0]
    assert (setup.kernels, setup.ratios, setup.couplings) == (("ib4", "ib6"), (1.0, 2.0), ("elemental",))
    assert (setup.problems, setup.grids, setup.stabilised) == (("cook",), {"cook": 20}, "on")
    assert len(setup.runs()) == 4
