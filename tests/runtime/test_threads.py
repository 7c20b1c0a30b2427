"""Threads inside a rank: parts cover a range once, and a step does not depend on their number."""

from __future__ import annotations

import os
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.fluid.boundary import Boundary
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.grid import MacGrid
from valvefsi.runtime import threads


@pytest.mark.parametrize(("number", "first", "last", "step"), [(1, 0, 10, 1), (3, 5, 5003, 7), (4, 2, 4, 1)])
def test_parts_cover_the_range_once_and_begin_at_whole_steps(
    monkeypatch: pytest.MonkeyPatch, number: int, first: int, last: int, step: int
) -> None:
    monkeypatch.setattr(threads, "count", lambda: number)
    seen, starts = np.zeros(last, int), []

    def loop(a: int, b: int) -> None:
        seen[a:b] += 1
        starts.append(a)

    threads.divide(loop, first, last, step, least=1)
    assert (seen[first:] == 1).all()
    assert not seen[:first].any()
    assert all((a - first) % step == 0 or a == last for a in starts)


def test_a_failure_in_another_thread_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "count", lambda: 2)

    def loop(a: int, b: int) -> None:
        if a > 0:
            raise ValueError("second part")

    with pytest.raises(ValueError, match="second part"):
        threads.divide(loop, 0, 10, least=1)


@pytest.mark.parametrize(
    ("given", "ranks", "expected"), [("3", 1, 3), ("0", 2, 4), ("many", 2, 4), ("", 8, 1), ("", 20, 1)]
)
def test_a_rank_has_the_threads_that_are_given_or_its_share_of_the_cores(
    monkeypatch: pytest.MonkeyPatch, given: str, ranks: int, expected: int
) -> None:
    monkeypatch.setenv("VALVEFSI_THREADS", given)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)))
    monkeypatch.setattr(threads, "MPI", SimpleNamespace(COMM_WORLD=SimpleNamespace(size=ranks)))
    assert threads.count.__wrapped__() == expected


def test_only_loops_over_many_entries_are_shared(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "count", lambda: 4)
    assert [threads.share(n) for n in (1, threads.LEAST, threads.LEAST + 1)] == [1, 1, 4]


@pytest.mark.parametrize("advection", ["centred", "xsppm7"])
def test_a_step_does_not_depend_on_the_number_of_threads(
    monkeypatch: pytest.MonkeyPatch, advection: str
) -> None:
    results = []
    for number in (1, 3):
        monkeypatch.setattr(threads, "count", lambda number=number: number)
        monkeypatch.setattr(threads, "LEAST", 100)
        grid = MacGrid([0.0] * 3, [1.0] * 3, (18, 15, 20), [False, True, False], MPI.COMM_SELF)
        fluid = NavierStokes(grid, Boundary(grid, {}), rho=1.0, mu=0.01, advection=advection)
        u = grid.zero_faces()
        for d in range(3):
            x, y, z = grid.points(d)
            u[d][...] = np.sin(5 * x + d) * np.cos(2 * np.pi * y) * np.exp(z)
        u = fluid.fill(u, 0.0)
        N = fluid.advection(u)
        u, p = fluid.step(u, grid.zeros(), (N, N, 1.0), grid.zero_faces(), 0.0, 1e-3)
        results.append([*(c[grid.owned] for c in u), p[grid.owned]])
    for one, three in zip(*results, strict=True):
        np.testing.assert_allclose(three, one, rtol=0.0, atol=1e-12 * np.abs(one).max())
