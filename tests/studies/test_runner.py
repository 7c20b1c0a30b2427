"""The runner of a study: processes of its members, what is done again, what is refused, how it ends."""

from __future__ import annotations

import json
import os
import signal
import threading
import time

import pytest

from tests.studies.conftest import members
from valvefsi.errors import CaseError, Stopped
from valvefsi.studies import runner
from valvefsi.studies.members import Member


def most_at_once(events):
    count = most = 0
    for kind, _ in events:
        count += {"begin": 1, "end": -1}[kind]
        most = max(most, count)
    return most


@pytest.mark.parametrize("jobs", [1, 2, 3])
def test_as_many_members_run_at_once_as_were_asked_for(study, jobs):
    (study.folder / "together").write_text(str(jobs))
    running = []
    outcomes = study.run(
        members(1, 2, 3, 4), jobs=jobs, progress=lambda tally: running.append(len(tally.running))
    )
    assert max(running) == jobs
    assert most_at_once(study.events) == jobs
    assert [(o.member.name, o.state) for o in outcomes] == [(f"viscosity={k}", "done") for k in (1, 2, 3, 4)]


def test_a_member_is_a_process_of_one_thread_that_knows_of_no_launcher(study, monkeypatch):
    others = {"PMI_RANK", "PMIX_RANK", "OMPI_UNIVERSE_SIZE", "VALVEFSI_THREADS", "FORCE_COLOR"}
    for name in others:
        monkeypatch.setenv(name, "1")
    study.run(members(1, 2))
    told = [told for kind, told in study.events if kind == "begin"]
    assert len({os.getpid(), *(one["pid"] for one in told)}) == 3
    for one in told:
        assert one["env"]["OMP_NUM_THREADS"] == "1"
        assert not others & set(one["env"])


def test_what_is_done_is_not_done_again_and_what_is_new_is(study):
    study.run(members(1, 2))
    study.forget()
    outcomes = study.run(members(1, 2, 3), resume=True)
    assert study.begun() == {"viscosity=3": False}
    assert [o.state for o in outcomes] == ["kept", "kept", "done"]
    assert [o.summary["last"]["u_x_tip_cm"] for o in outcomes] == [20.0, 40.0, 60.0]


def test_a_study_that_is_there_is_gone_on_with_only_when_asked(study):
    study.run(members(1))
    with pytest.raises(
        CaseError, match=r"holds a study, 1 of 2 members are done and 0 begun; --resume goes on"
    ):
        study.run(members(1, 2))
    with pytest.raises(CaseError, match="not both"):
        study.run(members(1, 2), resume=True, overwrite=True)
    assert study.begun() == {"viscosity=1": False}


@pytest.mark.parametrize("resume", [True, False])
def test_a_member_with_other_inputs_is_refused_by_name_before_any_starts(study, resume):
    study.run(members(1, 2))
    before = (study.folder / "viscosity=2" / "summary.json").read_bytes()
    study.forget()
    changed = [*members(3, 1), Member("viscosity=2", ("fluid.viscosity=2", "fluid.density=1.1"))]
    said = r"fluid.density: member viscosity=2 was run where this was 1.0, it is 1.1; --overwrite replaces"
    with pytest.raises(CaseError, match=said):
        study.run(changed, resume=resume)
    assert study.events == []
    assert (study.folder / "viscosity=2" / "summary.json").read_bytes() == before


def test_a_case_file_that_has_changed_changes_its_members(study):
    study.run(members(1))
    study.case.write_text(study.case.read_text().replace("[1.0, 0.0]", "[2.0, 0.0]"))
    with pytest.raises(
        CaseError, match=r"sides.y_upper.velocity.0: member viscosity=1 .* was 1.0, it is 2.0"
    ):
        study.run(members(1), resume=True)


def test_overwriting_runs_all_anew_and_leaves_nothing_of_before(study):
    study.run(members(1, 2))
    leftover = study.folder / "viscosity=1" / "checkpoints"
    leftover.mkdir()
    (leftover / "step_00000005.vfc").write_bytes((study.folder / "checkpoint.vfc").read_bytes())
    study.forget()
    changed = [Member("viscosity=1", ("fluid.viscosity=3",)), Member("viscosity=2", ("fluid.viscosity=7",))]
    outcomes = study.run(changed, overwrite=True)
    assert study.begun() == {"viscosity=1": False, "viscosity=2": False}
    assert outcomes[0].summary["last"]["u_x_tip_cm"] == 60.0
    assert not list(leftover.iterdir())
    assert not (study.folder / "viscosity=2" / "summary.json").exists()
    assert study.record("viscosity=1")["inputs"]["fluid.viscosity"] == 3.0


def test_a_later_end_goes_on_from_the_checkpoint_and_an_earlier_one_is_refused(study):
    study.run(members(1))
    place = study.folder / "viscosity=1"
    (place / "checkpoints").mkdir()
    (place / "checkpoints" / "step_00000005.vfc").write_bytes((study.folder / "checkpoint.vfc").read_bytes())
    study.forget()
    with pytest.raises(
        CaseError, match=r"time.t_end: the checkpoint is of t = 0.25 s, after this end of 0.1 s"
    ):
        study.run(members(1, t_end=0.1), resume=True)
    assert (place / "summary.json").exists()
    (outcome,) = study.run(members(1, t_end=2), resume=True)
    assert study.begun() == {"viscosity=1": True}
    assert outcome.state == "done"
    assert study.record("viscosity=1")["inputs"]["time.t_end"] == 2.0


def test_a_later_end_that_was_not_reached_is_not_taken_for_done(study):
    study.run(members(1))
    (study.folder / "broken").touch()
    (outcome,) = study.run(members(1, t_end=2), resume=True)
    assert outcome.message == "it is broken"
    (study.folder / "broken").unlink()
    (outcome,) = study.run(members(1, t_end=2), resume=True)
    assert outcome.state == "done"
    assert outcome.summary["last"]["t_s"] == 2.0


def test_a_run_that_is_no_member_is_not_touched(study):
    place = study.folder / "viscosity=1"
    place.mkdir()
    (place / "history.csv").write_text("step,t_s\n")
    with pytest.raises(CaseError, match=r"a run that is no member of a study \(history.csv\)"):
        study.run(members(1), resume=True)
    assert [path.name for path in place.iterdir()] == ["history.csv"]


def test_members_that_fail_are_recorded_and_the_others_go_on(study):
    outcomes = study.run(members(7, 1, 9, 2), jobs=1)
    assert [o.state for o in outcomes] == ["failed", "done", "failed", "done"]
    assert outcomes[0].message == "ConvergenceError: it does not converge"
    assert outcomes[2].message == "ended by SIGKILL, perhaps for want of memory"
    assert "warning: about to fail\n" in outcomes[0].log.read_text()
    assert study.record("viscosity=7")["state"] == "failed"
    assert study.record("viscosity=7")["message"] == outcomes[0].message
    assert outcomes[0].summary == {}
    study.forget()
    study.run(members(7, 1, 9, 2), resume=True)
    assert set(study.begun()) == {"viscosity=7", "viscosity=9"}


def test_a_wrong_case_is_said_with_member_key_and_value_before_any_starts(study):
    with pytest.raises(
        CaseError, match=r"^member viscosity=-1: fluid.viscosity = -1.0: expected a number greater"
    ):
        study.run(members(1, -1))
    with pytest.raises(CaseError, match=r"two members have this name"):
        study.run(members(1, 1))
    with pytest.raises(CaseError, match=r"--jobs = 0: expected 1 or more"):
        study.run(members(1), jobs=0)
    study.case.write_text(study.case.read_text().replace("upper", "uper"))
    with pytest.raises(CaseError, match=r"case.toml, member viscosity=1: .*unknown key"):
        study.run(members(1))
    assert study.events == []
    assert not (study.folder / "viscosity=1").exists()


@pytest.mark.parametrize("name", ["", "..", "a/b"])
def test_a_name_that_is_no_folder_is_refused(name):
    with pytest.raises(ValueError, match="expected the name of a folder"):
        Member(name)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_stops_the_members_with_checkpoints_and_they_go_on_from_there(study, number):
    waiting = members(5, 1, 2)

    def stop(tally):
        if tally.running.get("viscosity=5") == 0.25 and not tally.stopping:
            signal.raise_signal(number)

    with pytest.raises(
        Stopped, match="stopped; 0 of 3 members are done, 1 more have a checkpoint"
    ) as stopped:
        study.run(waiting, jobs=1, progress=stop)
    assert stopped.value.signal == number
    assert [kind for kind, _ in study.events] == ["begin", "stop"]
    assert study.record("viscosity=5")["state"] == "stopped"
    (study.folder / "go").touch()
    study.forget()
    outcomes = study.run(waiting, resume=True)
    assert study.begun() == {"viscosity=5": True, "viscosity=1": False, "viscosity=2": False}
    assert [o.state for o in outcomes] == ["done"] * 3
    rows = (study.folder / "viscosity=5" / "history.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in rows[1:]] == [str(step) for step in range(1, 21)]


def test_a_fault_of_the_study_itself_leaves_no_member_behind(study):
    def fault(tally):
        if tally.running.get("viscosity=5") == 0.25:
            raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        study.run(members(5), progress=fault)
    assert [kind for kind, _ in study.events] == ["begin", "stop"]


def test_how_far_it_is_and_how_long_it_takes(study):
    """One member of two stands at a quarter: an eighth of all is done; seven eighths take seven times as long."""
    t0, seen = time.monotonic(), []

    def look(tally):
        seen.append((time.monotonic(), tally))
        if tally.running.get("viscosity=5") == 0.25 and len(seen) > 10:
            (study.folder / "go").touch()

    study.run(members(5, 1), jobs=1, progress=look)
    k = next(k for k, (_, tally) in enumerate(seen) if tally.running.get("viscosity=5") == 0.25)
    assert seen[0][1].left_s is None
    assert seen[k + 1][1].share == pytest.approx(0.125)
    assert 7 * (seen[k][0] - seen[0][0]) <= seen[k + 1][1].left_s <= 7 * (seen[k + 1][0] - t0)
    last = seen[-1][1]
    assert (last.total, last.kept, last.done, last.failed, last.running) == (2, 0, 2, 0, {})
    assert (last.share, last.left_s) == (1.0, 0.0)
    assert [o.member.name for _, tally in seen for o in tally.ended] == ["viscosity=5", "viscosity=1"]


def test_members_count_by_steps_and_cells(study):
    """Four times the cells and twice the steps: eight ninths of the work."""
    fine = Member("fine", ("fluid.viscosity=5", "grid.cells=[32, 32]", "time.dt=0.025"))
    shares = []

    def look(tally):
        if tally.running.get("fine") == 0.25 and tally.done == 1:
            shares.append(tally.share)
            (study.folder / "go").touch()

    study.run([fine, *members(1)], jobs=2, progress=look)
    assert shares[0] == pytest.approx((1 + 8 * 0.25) / 9)


def test_a_folder_takes_one_study_at_a_time(study):
    caught = []

    def other(tally):
        if tally.running.get("viscosity=5") == 0.25 and not caught:
            with pytest.raises(CaseError, match="another run or study holds this folder") as error:
                study.run(members(5))
            caught.append(error)
            (study.folder / "go").touch()

    study.run(members(5), progress=other)
    assert caught


def test_without_the_main_thread_it_runs_too(study):
    found = []
    thread = threading.Thread(target=lambda: found.extend(study.run(members(1))))
    thread.start()
    thread.join()
    assert [o.state for o in found] == ["done"]


def test_what_it_was_called_with_stands_in_the_log_and_the_record(study):
    study.run([Member("one", ("fluid.viscosity=1", "title='a b'"))])
    log = (study.folder / "one" / "run.log").read_text()
    assert log.startswith("$ ")
    assert "--set fluid.viscosity=1 --set 'title='\"'\"'a b'\"'\"''" in log
    record = study.record("one")
    assert record["overrides"] == ["fluid.viscosity=1", "title='a b'"]
    assert record["inputs"]["title"] == "a b"
    assert json.dumps(record)
    assert runner.cores() >= 1
