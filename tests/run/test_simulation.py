"""The time loop: restart, rank invariance, faults, signals."""

from __future__ import annotations

import os
import signal
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from mpi4py import MPI

from tests.coupled_case import DT, STEPS, block_model, moved, simulation
from valvefsi import fsi
from valvefsi.errors import CaseError, StabilityError, Stopped
from valvefsi.io.folder import held, request_stop
from valvefsi.io.history import read_history
from valvefsi.run import simulation as loop

WORLD = MPI.COMM_WORLD


def whole_state(sim, state):
    """Global arrays of a state: faces, pressure, positions by node number."""
    grid = sim.model.grid
    out = []
    for d in range(grid.dim):
        owned = grid.owned_faces(d)
        out.append(gathered(grid, state.u[d][owned], grid.face_shape(d)))
    out.append(gathered(grid, state.p[grid.owned], grid.cells))
    for body, q in zip(sim.model.bodies, state.bodies, strict=True):
        whole = np.zeros((body.num_points, 3))
        whole[body.ids] = q["chi"]
        out.append(grid.comm.allreduce(whole))
    return out


def gathered(grid, block, shape):
    whole = np.zeros(shape)
    whole[tuple(slice(s, s + n) for s, n in zip(grid.start, block.shape, strict=True))] = block
    return grid.comm.allreduce(whole)


def largest_gap(first, second):
    return max(np.abs(a - b).max() / max(np.abs(a).max(), 1e-30) for a, b in zip(first, second, strict=True))


def entries(folder, name):
    root = ET.parse(folder / "paraview" / f"{name}.pvd").getroot()
    return [float(item.get("timestep")) for item in root.iter("DataSet")]


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    """The run to the end on all ranks: its folder and its last state."""
    folder = WORLD.bcast(tmp_path_factory.mktemp("whole"), root=0)
    sim = simulation(folder)
    outcome = sim.run()
    return folder, whole_state(sim, outcome.state)


def test_the_block_moves_and_the_velocity_is_solenoidal(shared_tmp):
    sim = simulation(shared_tmp)
    state = sim.run().state
    fluid = sim.model.fluid
    assert WORLD.allreduce(np.abs(fluid.divergence(state.u)[fluid.grid.owned]).max(), op=MPI.MAX) < 1e-12
    top = state.bodies[0]["chi"][np.isclose(sim.model.bodies[0].solid.X[:, 1], 25.0)]
    assert WORLD.allreduce((25.0 - top[:, 1]).max(initial=0.0), op=MPI.MAX) > 0.01


def test_restart_equals_the_uninterrupted_run(shared_tmp, uninterrupted):
    folder, expected = uninterrupted
    with pytest.raises(StopIteration):
        simulation(shared_tmp, checkpoint_every=15).run(progress=stop_after(18))
    sim = simulation(shared_tmp)
    outcome = sim.run(resume=True)
    assert outcome.steps == STEPS - 15
    assert largest_gap(whole_state(sim, outcome.state), expected) < 1e-12
    ours, theirs = read_history(shared_tmp / "history.csv"), read_history(folder / "history.csv")
    assert ours["step"] == theirs["step"]
    assert ours["step"] == [*range(0, STEPS + 1, 5)]
    for column, values in theirs.items():
        np.testing.assert_allclose(ours[column], values, rtol=1e-10, atol=1e-12, err_msg=column)
    for series in ("fluid", "block"):
        assert entries(shared_tmp, series) == entries(folder, series)
        assert len(entries(folder, series)) == 5


def stop_after(step):
    def progress(now, *_):
        if now == step:
            raise StopIteration

    return progress


@pytest.mark.skipif(WORLD.size == 1, reason="needs two ranks")
@pytest.mark.parametrize("first", ["one rank", "all ranks"])
def test_restart_on_another_number_of_ranks_equals_the_uninterrupted_run(first, shared_tmp, uninterrupted):
    _, expected = uninterrupted
    comms = {"one rank": MPI.COMM_SELF, "all ranks": WORLD}
    for comm, resume in ((comms.pop(first), False), (next(iter(comms.values())), True)):
        if comm is WORLD or WORLD.rank == 0:
            if resume:
                sim = simulation(shared_tmp, comm)
                sim.schedule = simulation(shared_tmp, comm).schedule
                result = whole_state(sim, sim.run(resume=True).state)
            else:
                with pytest.raises(StopIteration):
                    simulation(shared_tmp, comm, checkpoint_every=15).run(progress=stop_after(16))
        WORLD.barrier()
    if first == "one rank" or WORLD.rank == 0:
        assert largest_gap(result, expected) < 1e-10


@pytest.mark.skipif(WORLD.size == 1, reason="needs two ranks")
def test_the_coupled_run_does_not_depend_on_the_number_of_ranks(shared_tmp, uninterrupted):
    _folder, expected = uninterrupted
    if WORLD.rank == 0:
        sim = simulation(shared_tmp, MPI.COMM_SELF)
        assert largest_gap(whole_state(sim, sim.run().state), expected) < 1e-10
    WORLD.barrier()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_to_any_rank_writes_a_checkpoint_and_says_how_to_resume(number, shared_tmp, uninterrupted):
    _, expected = uninterrupted

    def progress(step, *_):
        if step == 12 and WORLD.rank == WORLD.size - 1:
            os.kill(os.getpid(), number)

    with pytest.raises(Stopped, match=r"step 13.*--resume") as caught:
        simulation(shared_tmp).run(progress=progress)
    assert caught.value.signal == number
    sim = simulation(shared_tmp)
    outcome = sim.run(resume=True)
    assert outcome.steps == STEPS - 13
    assert largest_gap(whole_state(sim, outcome.state), expected) < 1e-12


def test_a_request_in_the_folder_stops_all_ranks_as_a_signal_does(shared_tmp, uninterrupted, monkeypatch):
    _, expected = uninterrupted
    monkeypatch.setattr(loop, "LOOK_S", 0.0)

    def progress(step, *_):
        if step == 12 and WORLD.rank == 0:
            request_stop(shared_tmp)

    with held(shared_tmp, WORLD), pytest.raises(Stopped, match=r"step 13.*--resume") as caught:
        simulation(shared_tmp).run(progress=progress)
    assert caught.value.signal == signal.SIGINT
    sim = simulation(shared_tmp)
    assert largest_gap(whole_state(sim, sim.run(resume=True).state), expected) < 1e-12


def test_an_unfinished_run_is_not_overwritten_but_a_finished_one_is(shared_tmp):
    with pytest.raises(StopIteration):
        simulation(shared_tmp, checkpoint_every=5).run(progress=stop_after(7))
    with pytest.raises(CaseError, match=r"not finished \(t = 0\.1 s\); --resume"):
        simulation(shared_tmp).run()
    simulation(shared_tmp).run(resume=True)
    assert simulation(shared_tmp).run().steps == STEPS


def test_resuming_without_a_checkpoint_is_an_error(shared_tmp):
    with pytest.raises(CaseError, match="no whole checkpoint"):
        simulation(shared_tmp / "empty").run(resume=True)


def test_too_large_a_courant_number_stops_with_the_last_good_state(shared_tmp):
    with pytest.raises(
        StabilityError, match=r"Courant number .* at \(.*\) cm, t = .*try a smaller"
    ) as caught:
        simulation(shared_tmp, cfl_max=5e-3).run()
    check_last_good_state(shared_tmp, caught.value)


def test_an_unstable_tether_stops_with_the_last_good_state(shared_tmp):
    with pytest.raises(StabilityError) as caught:
        simulation(shared_tmp, model=block_model(lid=2.0, tether=1e7), cfl_max=1e9).run()
    check_last_good_state(shared_tmp, caught.value)


def test_an_inverted_element_is_named(shared_tmp):
    sim = simulation(shared_tmp)
    start = fsi.initial_state(sim.model, DT)
    chi = start.bodies[0]["chi"].copy()
    chi[:, 0] = 40.0 - chi[:, 0]
    sim.initial = moved(start, chi=chi)
    with pytest.raises(
        StabilityError, match=r"element of block is inverted, J = -.*near \(\d+.*\) cm, t = 0 s"
    ):
        sim.run()


def test_a_velocity_that_is_not_finite_is_named(shared_tmp):
    sim = simulation(shared_tmp)
    inner = sim.model.bodies[0].solid.force
    sim.model.bodies[0].solid.force = lambda chi, U, t: inner(chi, U, t) * (np.nan if t > 0.3 else 1.0)
    with pytest.raises(
        StabilityError, match=r"velocity is not finite at .*t = 0\.32 s \(step 16\)"
    ) as caught:
        sim.run()
    check_last_good_state(shared_tmp, caught.value)


def test_a_fault_does_not_remove_a_checkpoint_that_is_newer_than_the_last_row(shared_tmp):
    sim = simulation(shared_tmp, history_every=1000, frames=0, checkpoint_every=10)
    inner = sim.model.bodies[0].solid.force
    sim.model.bodies[0].solid.force = lambda chi, U, t: inner(chi, U, t) * (np.nan if t > 0.5 else 1.0)
    with pytest.raises(StabilityError, match=r"last good state, t = 0\.4 s"):
        sim.run()
    check_last_good_state(shared_tmp, StabilityError("step_00000020.vfc"))


def check_last_good_state(folder, error):
    """The checkpoint that the message names is there, and holds finite numbers."""
    names = sorted(path.name for path in (folder / "checkpoints").glob("*.vfc"))
    assert names
    assert names[-1] in str(error)
    state = simulation(folder)._first_state(resume=True)
    assert all(np.isfinite(c).all() for c in (*state.u, state.p, state.bodies[0]["chi"]))
    WORLD.barrier()


def test_an_observer_adds_its_columns_and_sees_every_row(shared_tmp):
    class Observer:
        columns = ("middle_s",)
        seen: list[int] = []

        def row(self, state):
            self.seen.append(state.step)
            return {"middle_s": state.t - 0.5 * state.dt}

    observer = Observer()
    simulation(shared_tmp, observers=(observer,), history_every=2).run()
    if WORLD.rank == 0:
        history = read_history(shared_tmp / "history.csv")
        assert set(map(int, history["step"])) <= set(observer.seen)
        np.testing.assert_allclose(history["middle_s"][1:], np.array(history["t_s"])[1:] - 0.5 * DT)
