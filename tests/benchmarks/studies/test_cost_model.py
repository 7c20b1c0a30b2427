"""The cost model: divisions as of the grid, counts, limits, and what it is calibrated with comes out again."""

from __future__ import annotations

import pytest
from mpi4py import MPI

from valvefsi.benchmarks.studies import cost_model
from valvefsi.benchmarks.studies.cost_model import Machine
from valvefsi.benchmarks.studies.speed import Speed
from valvefsi.grid import GHOSTS, MacGrid
from valvefsi.grid.mac import divided
from valvefsi.runtime.machine import Network, measure_network, triad_bandwidth

WORLD = MPI.COMM_WORLD
PHASES = {"advection": 40.0, "viscous solves": 30.0, "pressure solve": 10.0, "ghosts": 2.0, "all else": 18.0}


class Counting:
    """Stands for a communicator along an axis and counts what a rank sends to others."""

    def __init__(self, comm):
        self.comm, self.size, self.rank = comm, comm.size, comm.rank
        self.messages, self.bytes = 0, 0

    def Sendrecv(self, sent, to, **rest):
        self.messages += to != MPI.PROC_NULL
        self.bytes += sent.nbytes * (to != MPI.PROC_NULL)
        self.comm.Sendrecv(sent, to, **rest)


def test_ranks_are_divided_as_the_grid_divides_them():
    assert divided((16,) * 3, WORLD.size) == MacGrid([0] * 3, [1] * 3, [16] * 3, [True] * 3).process_grid
    assert divided((256,) * 3, 64) == (64, 1)
    assert divided((256,) * 3, 256) == (64, 4)
    with pytest.raises(ValueError, match="too many"):
        cost_model.work(16, 32)


def test_a_rank_alone_sends_nothing_and_messages_grow_with_the_ranks():
    alone, two, many = (cost_model.work(128, ranks) for ranks in (1, 2, 256))
    assert (alone.messages, alone.sent, alone.packed) == (0, 0.0, 0)
    assert alone.cells == 128**3
    assert two.cells == alone.cells // 2
    assert two.flops == pytest.approx(alone.flops / 2)
    assert two.bytes == pytest.approx(alone.bytes / 2)
    assert 0 < two.messages < many.messages


def test_explicit_viscosity_takes_a_quarter_of_the_transforms_and_fewer_messages():
    implicit, explicit = (cost_model.work(128, 8, solves=solves) for solves in (4, 1))
    assert explicit.levels == implicit.levels / 4
    assert explicit.packed == implicit.packed / 4
    assert explicit.messages < implicit.messages


def test_ghost_messages_are_those_that_a_rank_sends():
    """The three exchanges of a step on a periodic grid; without solves nothing else is sent."""
    grid = MacGrid([0] * 3, [1] * 3, [16] * 3, [True] * 3)
    grid.axis_comms = counters = tuple(Counting(c) for c in grid.axis_comms)
    u, p = grid.zero_faces(), grid.zeros()
    grid.exchange(u, width=1)
    grid.exchange((p, p), width=1)
    grid.exchange(u, width=GHOSTS)
    count = cost_model.work(16, WORLD.size, solves=0)
    divided = [c for c, p in zip(counters, grid.process_grid, strict=False) if p > 1]
    assert sum(c.messages for c in divided) == count.messages
    assert sum(c.bytes for c in divided) == count.sent


def test_the_phases_that_calibrate_the_model_are_predicted_by_it():
    machine = cost_model.calibrate(32, PHASES, solves=4)
    parts = cost_model.predict(cost_model.work(32, 1), machine, Network())
    assert parts["step"] == pytest.approx(0.1)
    assert parts["advection"] == pytest.approx(0.04)
    assert parts["transforms"] == pytest.approx(0.04)
    assert parts["streams"] == pytest.approx(0.02)


def test_the_time_of_messages_is_latency_and_bytes_over_bandwidth():
    count = cost_model.work(64, 4)
    idle = Machine(advection=0.0, streams=0.0, transforms=0.0, packing=0.0)
    parts = cost_model.predict(count, idle, Network(latency=1e-3, bandwidth=1e6))
    assert parts["step"] == pytest.approx(1e-3 * count.messages + 1e-6 * count.sent)


def test_the_network_is_measured_where_there_is_one():
    network = measure_network(WORLD, repeats=3)
    assert (network is None) == (WORLD.size == 1)
    assert network is None or (network.latency > 0 and network.bandwidth > 0)
    assert triad_bandwidth(WORLD, size=10**5, repeats=3) > 0


def test_the_speed_benchmark_predicts_every_size_and_compares_what_it_measured(shared_tmp):
    result = Speed(sizes=(16,), steps=1, model=True, overrides=["viscous=explicit"]).run(out=shared_tmp)
    model = result["cost_model"]
    assert len(model["predictions"]) == len(cost_model.SIZES) * len(cost_model.CORES)
    assert all(line["step_s"] > 0 for line in model["predictions"])
    compared = [line for line in result["table"] if line["source"] == "measured here"]
    assert [line["reference"] for line in compared] == [grid["step_ms"] for grid in result["grids"]]
    assert all(grid["bytes_per_step"] > 0 and grid["part_of_triad"] > 0 for grid in result["grids"])
    assert all(grid["set_up_ms"] > 0 for grid in result["grids"])
