"""Adaptive steps, recoveries, checkpoints by the clock, a run that is killed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI

from tests.coupled_case import DT, STEPS, block_model, simulation
from tests.ordering import assert_order
from tests.run.test_simulation import largest_gap, stop_after, whole_state
from valvefsi import fsi
from valvefsi.case import load_case
from valvefsi.case.build import build
from valvefsi.errors import CaseError, StabilityError
from valvefsi.fluid.boundary import Boundary
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.grid import MacGrid
from valvefsi.io.history import read_history
from valvefsi.run.schedule import AdaptiveSchedule, Schedule, check_end
from valvefsi.run.stable_step import measured_limit

WORLD = MPI.COMM_WORLD
T_END = STEPS * DT


def adaptive(folder, comm=WORLD, *, lid=300.0, **options):
    """The block under a fast lid, with steps that follow the Courant number."""
    output = {key: options.pop(key) for key in list(options) if key.startswith(("checkpoint", "history"))}
    sim = simulation(folder, comm, model=block_model(comm, lid=lid), **output)
    sim.schedule = AdaptiveSchedule(**{"dt": DT, "t_end": T_END, "cfl": 0.1, **options})
    return sim


def state(*, t=0.0, step=0, dt=1.0, dt_stable=np.inf):
    return SimpleNamespace(t=t, step=step, dt=dt, dt_stable=dt_stable)


def test_the_next_step_is_the_smallest_of_its_limits():
    schedule = AdaptiveSchedule(dt=1.0, t_end=100.0, cfl=0.2, growth=1.1)
    assert schedule.next_dt(state(), 0.0) == 1.0
    assert schedule.next_dt(state(step=1, dt=0.5), 0.0) == pytest.approx(0.55)
    assert schedule.next_dt(state(step=1, dt=0.5), 4.0) == pytest.approx(0.05)
    assert schedule.next_dt(state(step=1, dt_stable=0.4), 0.0) == pytest.approx(0.8 * 0.4)
    assert schedule.next_dt(state(t=98.5, step=1), 0.0) == pytest.approx(0.75)
    assert schedule.next_dt(state(t=99.25, step=1), 0.0) == pytest.approx(0.75)
    assert schedule.finished(state(t=99.25 + 0.75))


def test_impossible_limits_are_refused():
    with pytest.raises(ValueError, match="cfl <= cfl_max"):
        AdaptiveSchedule(dt=1.0, t_end=1.0, cfl=0.6, cfl_max=0.5)


def test_steps_follow_the_courant_number_and_end_at_the_end(shared_tmp):
    sim = adaptive(shared_tmp, history_every=1)
    final = sim.run().state
    assert final.t == pytest.approx(T_END, rel=1e-12)
    rows = read_history(shared_tmp / "history.csv")
    courant, steps = np.array(rows["courant"]), np.diff(rows["t_s"])
    assert steps.max() <= DT * (1 + 1e-12)
    assert (steps[1:] / steps[:-1]).max() < 1.1 + 1e-9
    # One step late at most: the lid at rest at first, then 300 cm/s on cells of 40/24 cm.
    late = courant[len(courant) // 2 : -2]
    assert late.min() > 0.08
    assert courant.max() < 0.15
    assert np.ptp(steps) > 0.1 * DT


def test_unequal_steps_keep_the_second_order():
    """A travelling Taylor-Green vortex; steps alternate by a factor of two."""

    def error(steps):
        grid = MacGrid([0, 0], [1, 1], [8, 8], [True, True])
        fluid = NavierStokes(grid, Boundary(grid), rho=1.0, mu=0.02)
        model = fsi.Model(grid=grid, fluid=fluid)
        u = grid.zero_faces()
        for d, sign in ((0, 1.0), (1, -1.0)):
            x, y, _ = grid.points(d)
            a, b = 2 * np.pi * x, 2 * np.pi * y
            u[d][...] = 1.0 + sign * (np.sin(a) * np.cos(b) if d == 0 else np.cos(a) * np.sin(b))
        dt = 0.2 / steps
        s = fsi.initial_state(model, dt, u)
        for k in range(steps):
            s = fsi.step(model, s, dt * (4 / 3 if k % 2 else 2 / 3))
        return [c[grid.owned].copy() for c in s.u]

    exact = error(1280)

    def distance(steps):
        gap = sum(float(np.square(a - b).sum()) for a, b in zip(error(steps), exact, strict=True))
        return float(np.sqrt(WORLD.allreduce(gap) / 64))

    assert_order(distance, (40, 80, 160), order=2, below=1e-3)


def test_an_adaptive_run_restarts_with_the_same_steps(shared_tmp):
    whole = adaptive(shared_tmp / "whole")
    expected = whole_state(whole, whole.run().state)
    with pytest.raises(StopIteration):
        adaptive(shared_tmp, checkpoint_every=15).run(progress=stop_after(18))
    sim = adaptive(shared_tmp)
    assert largest_gap(whole_state(sim, sim.run(resume=True).state), expected) < 1e-12


def stiff(folder, **options):
    """The block under its load, with steps three times as long as it stays stable with."""
    model = block_model(lid=2.0, tether=2e4)
    sim = simulation(folder, model=model, checkpoint_every=options.pop("checkpoint_every", 0))
    limit = measured_limit(model, 1e-2, 0)
    given = {"dt": 3.0 * limit, "t_end": 120 * limit, "cfl": 0.4, "max_recoveries": 0, "measure_every": 10}
    sim.schedule = AdaptiveSchedule(**given | options)
    return sim, limit


def test_steps_keep_below_the_stable_one_as_it_is_measured(shared_tmp):
    with pytest.raises(StabilityError):
        stiff(shared_tmp / "blind", measure_every=0)[0].run()
    sim, limit = stiff(shared_tmp / "seeing")
    outcome = sim.run()
    assert not outcome.recoveries
    assert "stable step" in outcome.phases
    steps = np.diff(read_history(shared_tmp / "seeing" / "history.csv")["t_s"]) / 5
    assert 0.4 * limit < np.median(steps) < 1.2 * limit


def test_the_measured_step_is_restored_with_the_state(shared_tmp):
    expected = stiff(shared_tmp / "whole")[0].run().state
    with pytest.raises(StopIteration):
        stiff(shared_tmp / "cut", checkpoint_every=15)[0].run(progress=stop_after(18))
    final = stiff(shared_tmp / "cut")[0].run(resume=True).state
    assert final.step == expected.step
    assert final.measure_at == expected.measure_at
    assert final.dt_stable == pytest.approx(expected.dt_stable, rel=1e-9)
    assert np.abs(final.bodies[0]["chi"] - expected.bodies[0]["chi"]).max(initial=0.0) < 1e-12


def test_the_stable_step_is_measured_anew_when_a_run_goes_back(shared_tmp, monkeypatch):
    sim, faults, measuring, measured = adaptive(shared_tmp, lid=2.0, measure_every=10), [True], [], []
    inner, measure = sim.model.bodies[0].solid.force, sim._measured

    def force(chi, U, t):
        fault = t > 0.3 and not measuring and bool(faults) and faults.pop()
        return inner(chi, U, t) * (np.nan if fault else 1.0)

    def noted(state):
        measured.append(state.step)
        measuring.append(True)
        new = measure(state)
        measuring.clear()
        return new

    monkeypatch.setattr(sim, "_measured", noted)
    sim.model.bodies[0].solid.force = force
    (back,) = sim.run().recoveries
    assert back["step"] > 0
    assert back["step"] in measured


def test_a_fault_that_shorter_steps_avoid_is_recovered_from_and_told(shared_tmp):
    sim = adaptive(shared_tmp, lid=2.0, measure_every=0)
    inner, calls = sim.model.bodies[0].solid.force, []

    def force(chi, U, t):
        calls.append(t)
        fault = 0.3 < t < 0.5 and len(calls) < 19
        return inner(chi, U, t) * (np.nan if fault else 1.0)

    sim.model.bodies[0].solid.force = force
    outcome = sim.run()
    assert outcome.state.t == pytest.approx(T_END, rel=1e-12)
    assert len(outcome.recoveries) == 3
    first, second = outcome.recoveries[:2]
    assert first["t_s"] == second["t_s"] == pytest.approx(0.3)
    assert second["dt_s"] == pytest.approx(0.5 * first["dt_s"])
    assert "not finite" in first["reason"]
    rows = read_history(shared_tmp / "history.csv")
    assert rows["step"] == sorted(set(rows["step"]))
    assert np.all(np.isfinite(rows["kinetic_energy_erg"]))


def test_a_fault_that_stays_ends_the_run_after_the_allowed_recoveries(shared_tmp):
    sim = adaptive(shared_tmp, lid=2.0, max_recoveries=3)
    inner = sim.model.bodies[0].solid.force
    sim.model.bodies[0].solid.force = lambda chi, U, t: inner(chi, U, t) * (np.nan if t > 0.3 else 1.0)
    with pytest.raises(StabilityError, match="last good state"):
        sim.run()
    assert len(sim.memory.recoveries) == 3
    again = adaptive(shared_tmp, lid=2.0, max_recoveries=3)
    outcome = again.run(
        resume=True
    )  # the fault is gone: it may recover as often again, and tells of the old ones
    assert [one["t_s"] for one in outcome.recoveries] == [one["t_s"] for one in sim.memory.recoveries]


def test_checkpoints_by_the_clock_keep_the_newest(shared_tmp):
    sim = simulation(shared_tmp, checkpoint_wall_s=1e-9, keep_checkpoints=3)
    with pytest.raises(StopIteration):
        sim.run(progress=stop_after(12))
    names = sorted(path.name for path in (shared_tmp / "checkpoints").glob("*.vfc"))
    assert names == [f"step_{k:08d}.vfc" for k in (9, 10, 11)]


KILLED = """
import os, signal
from pathlib import Path
from mpi4py import MPI
from tests.run.test_schedule import adaptive

def progress(step, *_):
    if step == 23 and MPI.COMM_WORLD.rank == MPI.COMM_WORLD.size - 1:
        os.kill(os.getpid(), signal.SIGKILL)

adaptive(Path({folder!r}), checkpoint_every=5).run(progress=progress)
"""


@pytest.mark.serial
@pytest.mark.skipif(WORLD.size > 1, reason="starts a process of its own")
@pytest.mark.parametrize("ranks", [1, 2])
def test_a_run_killed_outright_goes_on_to_the_same_answer(ranks, tmp_path):
    """One rank gets SIGKILL in mid-run; what is left on disk is enough, also for another number of ranks."""
    whole = adaptive(tmp_path / "whole")
    outcome = whole.run()
    folder = tmp_path / "killed"
    command = [sys.executable, "-c", KILLED.format(folder=str(folder))]
    if ranks > 1:
        command = ["mpirun", "-n", str(ranks), *command]
    child = subprocess.run(command, capture_output=True, check=False, timeout=100)
    assert child.returncode != 0
    sim = adaptive(folder)
    resumed = sim.run(resume=True)
    assert 0 < resumed.steps < outcome.steps - 15
    assert largest_gap(whole_state(sim, resumed.state), whole_state(whole, outcome.state)) < 1e-10


def test_a_case_file_chooses_its_steps():
    demo = Path(__file__).parents[2] / "demos" / "compressed_block.toml"
    for overrides, kind in (([], Schedule), (["time.control=adaptive", "time.cfl=0.2"], AdaptiveSchedule)):
        schedule = build(load_case(demo, overrides), Path()).schedule
        assert type(schedule) is kind
    assert (schedule.cfl, schedule.max_recoveries) == (0.2, 5)
    with pytest.raises(CaseError, match=r"time\.cfl = 0\.6: expected at most cfl_max"):
        load_case(demo, ["time.control=adaptive", "time.cfl=0.6"])


@pytest.mark.parametrize(("t_end", "passed"), [(0.9, True), (0.949, True), (0.951, False), (1.2, False)])
def test_an_end_counts_as_passed_by_more_than_half_a_step(t_end, passed):
    if not passed:
        check_end(1.0, 0.1, t_end)
        return
    with pytest.raises(CaseError, match="the checkpoint is of t = 1 s, after this end"):
        check_end(1.0, 0.1, t_end)
