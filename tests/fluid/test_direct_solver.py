"""Residuals of the direct solver for all kinds of axes, sizes and process grids."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.fluid import direct_solver
from valvefsi.fluid.direct_solver import Axis, TensorSolver
from valvefsi.grid import MacGrid

KINDS = ("periodic", "neumann", "dirichlet", "faces")


def second_difference(kind, n, h):
    """Dense second-difference matrix of an axis of n cells, written entry by entry."""
    size = n - 1 if kind == "faces" else n
    D = np.zeros((size, size))
    for i in range(size):
        for neighbour in (i - 1, i + 1):
            D[i, i] -= 1
            if 0 <= neighbour < size:
                D[i, neighbour] += 1
            elif kind == "periodic":
                D[i, neighbour % size] += 1
            elif kind == "neumann":
                D[i, i] += 1
            elif kind == "dirichlet":
                D[i, i] -= 1
    return D / h**2


@pytest.mark.parametrize("limit", [0, 1000])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("n", [4, 7, 12])
def test_transform_diagonalises_the_second_difference(kind, n, limit, monkeypatch):
    monkeypatch.setattr(direct_solver, "MATRIX_LIMIT", dict.fromkeys(KINDS, limit))
    axis = Axis(kind, n, 0.3)
    D = second_difference(kind, n, 0.3)
    V = np.stack([axis.transform(e.reshape(-1, 1, 1).copy(), 0).ravel() for e in np.eye(axis.size)])
    np.testing.assert_allclose(V.T @ V, np.eye(axis.size), atol=1e-13)
    np.testing.assert_allclose(D, V @ np.diag(axis.eigenvalues) @ V.T, atol=1e-11)


@pytest.mark.parametrize("limit", [0, 1000])
@pytest.mark.parametrize("axis_number", [0, 1, 2])
@pytest.mark.parametrize("kind", KINDS)
def test_transform_back_undoes_the_transform_along_every_axis(kind, axis_number, limit, monkeypatch):
    monkeypatch.setattr(direct_solver, "MATRIX_LIMIT", dict.fromkeys(KINDS, limit))
    axis = Axis(kind, 7, 0.3)
    shape = [5, 6, 4]
    shape[axis_number] = axis.size
    x = np.random.default_rng(0).standard_normal(shape)
    there = axis.transform(x.copy(), axis_number)
    assert np.abs(there - x).max() > 0.1
    np.testing.assert_allclose(axis.transform(there, axis_number, inverse=True), x, atol=1e-13)


def process_grids():
    size = MPI.COMM_WORLD.size
    return [(size // n, n) for n in range(1, size + 1) if size % n == 0]


@pytest.mark.parametrize("process_grid", process_grids())
@pytest.mark.parametrize("limit", [0, 1000])
@pytest.mark.parametrize("kinds", [(a, b, c) for a in KINDS for b in KINDS for c in KINDS])
def test_solve_has_a_residual_of_round_off_in_three_dimensions(kinds, limit, process_grid, monkeypatch):
    check_residual((17, 18, 9), kinds, process_grid, limit, monkeypatch)


@pytest.mark.parametrize("limit", [0, 1000])
@pytest.mark.parametrize("kinds", [(a, b, "periodic") for a in KINDS for b in KINDS])
def test_solve_has_a_residual_of_round_off_in_two_dimensions(kinds, limit, monkeypatch):
    check_residual((17, 13), kinds, (MPI.COMM_WORLD.size, 1), limit, monkeypatch)


def check_residual(cells, kinds, process_grid, limit, monkeypatch):
    monkeypatch.setattr(direct_solver, "MATRIX_LIMIT", dict.fromkeys(KINDS, limit))
    dim = len(cells)
    grid = MacGrid([0] * dim, [1.0, 0.9, 1.2][:dim], cells, [True] * dim, process_grid=process_grid)
    solver = TensorSolver(grid, kinds)
    singular = not {"dirichlet", "faces"} & set(kinds)
    a, b = (0.0, -1.0) if singular else (0.7, 0.3)
    D = [second_difference(k, n, h) for k, n, h in zip(kinds, grid.cells, grid.spacing, strict=True)]
    if dim == 2:
        D[2] = np.zeros((1, 1))
    shape = tuple(len(d) for d in D)
    r = np.random.default_rng(2).standard_normal(shape)
    r -= r.mean() if singular else 0
    mine = []
    for axis, kind in enumerate(kinds):
        shift = int(kind == "faces")
        first, last = grid.start[axis] - shift, grid.start[axis] + grid.size[axis] - shift
        mine.append(slice(max(first, 0), last))
    x = solver.solve(r[tuple(mine)].copy(), a, b)
    whole = np.zeros(shape)
    whole[tuple(mine)] = x
    grid.comm.Allreduce(MPI.IN_PLACE, whole)
    applied = a * whole - b * (
        np.einsum("ai,ijk->ajk", D[0], whole)
        + np.einsum("bj,ijk->ibk", D[1], whole)
        + np.einsum("ck,ijk->ijc", D[2], whole)
    )
    assert np.linalg.norm(applied - r) < 1e-11 * np.linalg.norm(r)
