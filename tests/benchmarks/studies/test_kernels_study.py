"""The kernel study on grids far too coarse: kept runs, break-downs on record, rules, time left."""

from __future__ import annotations

import csv
from dataclasses import asdict, replace
from types import SimpleNamespace

import pytest

from valvefsi.benchmarks.frame import Forecast, Job
from valvefsi.benchmarks.immersed import cook
from valvefsi.benchmarks.immersed.study import Numerics
from valvefsi.benchmarks.options import defaults
from valvefsi.benchmarks.statics.solids import block_displacement
from valvefsi.benchmarks.studies import kernel_problems
from valvefsi.benchmarks.studies.kernel_problems import COMPRESSION, COOK, SHELL, block_elements, run_halving
from valvefsi.benchmarks.studies.kernels import Kernels, One, rules
from valvefsi.cli.bench_progress import announced
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
    study = Kernels(
        **TINY,
        grids={"compression": 24, "cook": 20, "shell": 16},
        overrides=["compression.t_end=0.3", "cook.t_end=0.2", "shell.t_end=0.05"],
    )
    seen = []
    result = study.run(out=shared_tmp, progress=lambda *news: seen.append(news))
    assert [(r["problem"], r["stabilised"]) for r in result["runs"]] == [
        ("compression", True),
        ("compression", False),
        ("cook", True),
        ("cook", False),
        ("shell", False),
    ]
    assert all(r["failed"] is None and r["error_percent"] is not None for r in result["runs"])
    assert len(result["rules"]) == 2
    assert [news[1:3] for news in seen] == [(k, 5) for k in range(6)]
    assert (seen[0][3], seen[-1][3]) == (None, 0.0)

    def refuse(*given):
        raise AssertionError("run again")

    monkeypatch.setattr(kernel_problems.shell, "shell_at_rest", refuse)
    monkeypatch.setattr("valvefsi.run.simulation.Simulation.run", refuse)
    again = study.run(out=shared_tmp)
    for new, old in zip(again["runs"], result["runs"], strict=True):  # the static solver rounds as it likes
        assert new | {"error_percent": 0} == old | {"error_percent": 0}
        assert new["error_percent"] == pytest.approx(old["error_percent"], rel=1e-12)
    if comm.rank == 0:
        with (shared_tmp / "kernels.csv").open(newline="") as file:
            table = list(csv.DictReader(file))
        assert [float(r["error_percent"]) for r in table] == [r["error_percent"] for r in again["runs"]]
    with pytest.raises(AssertionError, match="run again"):
        replace(study, overrides=[*study.overrides, "shell.t_end=0.06"]).run(out=shared_tmp)


def test_a_run_that_breaks_down_is_on_record_with_its_reason_and_the_study_goes_on(shared_tmp, comm, coarse):
    study = Kernels(
        **TINY,
        problems=("cook", "shell"),
        stabilised="on",
        grids={"cook": 20, "shell": 16},
        overrides=["cook.t_end=1", "cook.dt_per_h=0.4", "shell.t_end=0.05"],
    )
    broken, fine = study.run(out=shared_tmp)["runs"]
    assert "Courant number" in broken["failed"]
    assert broken["step_halvings"] == kernel_problems.HALVINGS
    assert broken["error_percent"] is None
    assert fine["failed"] is None
    assert len(list((shared_tmp / "cook").glob("*/history.csv"))) == kernel_problems.HALVINGS + 1


def test_only_a_run_that_its_step_breaks_is_tried_with_half_of_it(shared_tmp, comm):
    def attempts(reasons):
        tried, left = [], iter(reasons)

        def fake(numerics, values, job):
            tried.append((values["dt_per_h"], job.folder.name))
            return {"failed": next(left)}

        problem = SimpleNamespace(run=fake)
        job = Job(folder=shared_tmp / "a", comm=comm)
        record = run_halving(problem, Numerics(grid=20), numbers(dt_per_h=0.8), job)
        return tried, record

    tried, record = attempts(["the Courant number is 9", None])
    assert tried == [(0.8, "a"), (0.4, "a-step2")]
    assert (record["halvings"], record["failed"]) == (1, None)
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
    record = {
        "problem": "cook",
        "numerics": asdict(Numerics(grid=25)),
        "failed": None,
        "halvings": 0,
        "wall_s": 1.0,
    }
    found, kept = Kernels().lines(
        [record | {"quantities": q}, record | {"quantities": q | {"change_percent": 0.5}}], {"cook": 1.0}
    )
    assert found["leaks"]
    assert found["error_percent"] == pytest.approx(10.0)
    assert found["J_spread"] == pytest.approx(0.3)
    assert not kept["leaks"]


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
    assert known == pytest.approx(block_displacement(), rel=1e-3)


def test_the_time_left_is_that_of_runs_alike():
    one = Numerics(grid=20)
    watch, other = Forecast(Kernels()), replace(one, coupling="elemental")

    def left(*runs):
        return watch.left([One(problem=name, numerics=numerics) for name, numerics in runs])

    assert left(("cook", one)) is None
    watch.add(One(problem="cook", numerics=one), 2.0)
    watch.add(One(problem="cook", numerics=other), 6.0)
    assert left(("cook", one), ("cook", other)) == pytest.approx(8.0)
    assert left(("cook", replace(one, kernel="ib4")), ("shell", one)) == pytest.approx(2.0 + 4.0)
    assert left(("cook", replace(other, ratio=2.0))) == pytest.approx(6.0)


def test_progress_says_what_is_next_and_how_long_it_may_take():
    said = []
    show = announced(SimpleNamespace(rank=0), echo=said.append, interval=0.0)
    show("cook N25", 0, 8, None)
    show("cook N30", 2, 8, 75.0)
    show("", 8, 8, 0.0)
    assert said[0].endswith("run 1 of 8, cook N25")
    assert said[1] == " 25.0 %  run 3 of 8, cook N30, 1 min 15 s left"
    assert said[2] == "100.0 %  8 runs"
    announced(SimpleNamespace(rank=1), echo=said.append)("cook N25", 0, 8, None)
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
        ({"factor": 0.5}, "of at least 1"),
        ({"nu_stab": 0.5}, "below 0.5"),
    ],
)
def test_a_study_that_cannot_be_run_is_refused(changed, message):
    with pytest.raises(CaseError, match=message):
        Kernels(**changed)


@pytest.mark.parametrize("text", ["t_end=1", "torsion.t_end=1", "cook.t_edn=1"])
def test_an_override_that_reaches_no_problem_is_refused(text):
    with pytest.raises(CaseError, match="--set"):
        Kernels(problems=("cook",), overrides=[text])
