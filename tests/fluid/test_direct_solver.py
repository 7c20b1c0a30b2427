"""Residuals of the direct solver for all kinds of axes, sizes and process grids."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.fluid import axes
from valvefsi.fluid.axes import KINDS, Axis
from valvefsi.fluid.direct_solver import TensorSolver
from valvefsi.fluid.line_solver import LineSolver
from valvefsi.grid import MacGrid
from valvefsi.runtime import threads

SAMPLE = ("periodic", "cells NN", "cells DN", "faces DD", "faces ND")


def second_difference(kind, widths):
    """Dense second-difference matrix of an axis, applied to one unit vector after the other with its ghosts."""
    n = len(widths)
    if kind == "periodic":
        w = np.pad(widths, 1, mode="wrap")
        gaps = 0.5 * (w[1:] + w[:-1])
        D = np.zeros((n, n))
        for i in range(n):
            D[i, (i + 1) % n] += 1 / (gaps[i + 1] * widths[i])
            D[i, (i - 1) % n] += 1 / (gaps[i] * widths[i])
            D[i, i] -= (1 / gaps[i] + 1 / gaps[i + 1]) / widths[i]
        return D
    where, ends = kind.split()
    w = np.pad(widths, 1, mode="symmetric")
    gaps = 0.5 * (w[1:] + w[:-1])
    columns = []
    if where == "cells":
        for unit in np.eye(n):
            sign = {"D": -1.0, "N": 1.0}
            q = np.concatenate([[sign[ends[0]] * unit[0]], unit, [sign[ends[1]] * unit[-1]]])
            columns.append(np.diff(np.diff(q) / gaps) / widths)
        return np.array(columns).T
    first, last = int(ends[0] == "D"), n + 1 - int(ends[1] == "D")
    for unit in np.eye(n + 1)[first:last]:
        q = np.concatenate([[unit[1]], unit, [unit[-2]]])
        columns.append((np.diff(np.diff(q) / w) / gaps)[first:last])
    return np.array(columns).T


def some_widths(n, *, graded):
    return 0.3 + (0.2 * np.random.default_rng(n).random(n) if graded else np.zeros(n))


@pytest.mark.parametrize("graded", [False, True])
@pytest.mark.parametrize("limit", [0, 1000])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("n", [4, 7, 12])
def test_transform_diagonalises_the_second_difference(kind, n, limit, graded, monkeypatch):
    monkeypatch.setattr(axes, "MATRIX_LIMIT", dict.fromkeys(KINDS, limit))
    widths = some_widths(n, graded=graded)
    axis, D = Axis(kind, widths), second_difference(kind, widths)
    forward, back = axis.dense(), axis.dense(inverse=True)
    np.testing.assert_allclose(forward @ back, np.eye(axis.size), atol=1e-13)
    np.testing.assert_allclose(back @ np.diag(axis.eigenvalues) @ forward, D, atol=2e-12)
    np.testing.assert_allclose(axis.second_difference(), D, atol=1e-12)
    np.testing.assert_allclose(axis.row(axis.size - 1), forward[:, -1], atol=1e-14)
    np.testing.assert_allclose(axis.row(0, inverse=True), back[0], atol=1e-14)


@pytest.mark.parametrize("graded", [False, True])
@pytest.mark.parametrize("limit", [0, 1000])
@pytest.mark.parametrize("axis_number", [0, 1, 2])
@pytest.mark.parametrize("kind", KINDS)
def test_transform_back_undoes_the_transform_along_every_axis(kind, axis_number, limit, graded, monkeypatch):
    monkeypatch.setattr(axes, "MATRIX_LIMIT", dict.fromkeys(KINDS, limit))
    axis = Axis(kind, some_widths(7, graded=graded))
    shape = [5, 6, 4]
    shape[axis_number] = axis.size
    x = np.random.default_rng(0).standard_normal(shape)
    there = axis.transform(x.copy(), axis_number)
    assert np.abs(there - x).max() > 0.1
    np.testing.assert_allclose(axis.transform(there, axis_number, inverse=True), x, atol=1e-13)


def test_an_unknown_kind_of_axis_is_refused():
    with pytest.raises(ValueError, match="unknown kind of axis 'cells XX', one of periodic, cells NN"):
        Axis("cells XX", np.ones(4))


def process_grids():
    size = MPI.COMM_WORLD.size
    return [(size // n, n) for n in range(1, size + 1) if size % n == 0]


@pytest.mark.parametrize("process_grid", process_grids())
@pytest.mark.parametrize("limit", [0, 1000])
@pytest.mark.parametrize("kinds", [(a, b, c) for a in SAMPLE for b in SAMPLE for c in SAMPLE])
def test_solve_has_a_residual_of_round_off_in_three_dimensions(kinds, limit, process_grid, monkeypatch):
    check_residual((17, 19, 11), kinds, process_grid, limit, monkeypatch)


@pytest.mark.parametrize("process_grid", process_grids())
@pytest.mark.parametrize(
    "kinds", [(a, b, c) for a in SAMPLE for b in SAMPLE for c in ("periodic", "cells NN")]
)
def test_solve_has_a_residual_of_round_off_on_graded_axes(kinds, process_grid, monkeypatch):
    check_residual((17, 19, 11), kinds, process_grid, 0, monkeypatch, graded=True)


@pytest.mark.parametrize("limit", [0, 1000])
@pytest.mark.parametrize("kinds", [(a, b, "periodic") for a in KINDS for b in KINDS])
def test_solve_has_a_residual_of_round_off_in_two_dimensions(kinds, limit, monkeypatch):
    check_residual((17, 13), kinds, (MPI.COMM_WORLD.size, 1), limit, monkeypatch)


@pytest.mark.parametrize("graded", [False, True])
@pytest.mark.parametrize("kinds", [(a, b, "cells NN") for a in KINDS for b in SAMPLE])
def test_solve_by_modes_has_a_residual_of_round_off(kinds, graded, monkeypatch):
    called = []
    process_grid = process_grids()[0]
    check_residual((17, 19, 11), kinds, process_grid, 0, monkeypatch, graded=graded, correct=called.append)
    assert len(called) == 1


@pytest.mark.parametrize("graded", [False, True])
@pytest.mark.parametrize(
    "kinds", [("cells NN", "cells NN", "periodic"), ("faces NN", "cells NN", "faces NN")]
)
def test_lines_and_modes_drop_the_same_part_of_a_singular_right_side(kinds, graded):
    edges = [np.cumsum(np.append(0.0, some_widths(n, graded=graded))) for n in (17, 19, 11)]
    grid = MacGrid.graded(edges, [False] * 3)
    solver = TensorSolver(grid, kinds)
    shape = [grid.size[d] + (grid.is_last[d] and kinds[d].startswith("faces")) for d in range(3)]
    r = 1.0 + np.random.default_rng(grid.comm.rank).random(shape)
    by_lines = solver.solve(r.copy(), 0.0, -1.0)
    by_modes = solver.solve(r.copy(), 0.0, -1.0, lambda x: None)
    np.testing.assert_allclose(by_lines, by_modes, atol=1e-12 * np.abs(by_modes).max())


@pytest.mark.parametrize("n", [2, 3, 40])
@pytest.mark.parametrize("lines", [1, 63, 64, 200])
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "periodic"])
def test_elimination_solves_every_line(kind, lines, n, monkeypatch):
    monkeypatch.setattr(threads, "LEAST", 1)
    monkeypatch.setattr(threads, "count", lambda: 2)
    widths, rng = some_widths(n, graded=True), np.random.default_rng(lines)
    axis, D = Axis(kind, widths), second_difference(kind, widths)
    shift, r = 0.1 + rng.random(lines), rng.standard_normal((axis.size, lines, 1))
    x = LineSolver(axis).solve(r.copy(), shift[:, None], 0.3)
    expected = [
        np.linalg.solve(s * np.eye(axis.size) - 0.3 * D, b) for s, b in zip(shift, r[..., 0].T, strict=True)
    ]
    np.testing.assert_allclose(x[..., 0].T, expected, rtol=1e-11, atol=1e-12)


def test_lines_of_a_periodic_axis_are_refused():
    with pytest.raises(ValueError, match="a periodic axis has no tridiagonal second difference"):
        LineSolver(Axis("periodic", np.ones(4)))


def check_residual(cells, kinds, process_grid, limit, monkeypatch, *, graded=False, correct=None):
    monkeypatch.setattr(axes, "MATRIX_LIMIT", dict.fromkeys(KINDS, limit))
    dim = len(cells)
    edges = [np.cumsum(np.append(0.0, some_widths(n, graded=graded))) for n in cells]
    # Nothing is periodic for the grid: faces n have to have an owner.
    grid = MacGrid.graded(edges, [False] * dim, process_grid=process_grid)
    solver = TensorSolver(grid, kinds)
    singular = all(kind == "periodic" or kind.endswith("NN") for kind in kinds)
    assert solver.singular == singular
    a, b = (0.0, -1.0) if singular else (0.7, 0.3)
    D = [second_difference(kind, w) for kind, w in zip(kinds, grid.cell_widths, strict=True)]
    if dim == 2:
        D[2] = np.zeros((1, 1))
    shape = tuple(len(d) for d in D)
    r = np.random.default_rng(2).standard_normal(shape)
    if singular:
        volumes = [axis.volumes for axis in solver.axes]
        r -= np.einsum("ijk,i,j,k", r, *volumes) / np.prod([v.sum() for v in volumes])
    mine = []
    for axis, kind in enumerate(kinds):
        shift = int(kind.startswith("faces D"))
        first, last = grid.start[axis] - shift, grid.start[axis] + grid.size[axis] - shift
        mine.append(slice(max(first, 0), shape[axis] if grid.is_last[axis] else last))
    x = solver.solve(r[tuple(mine)].copy(), a, b, correct)
    whole = np.zeros(shape)
    whole[tuple(mine)] = x
    grid.comm.Allreduce(MPI.IN_PLACE, whole)
    applied = a * whole - b * (
        np.einsum("ai,ijk->ajk", D[0], whole)
        + np.einsum("bj,ijk->ibk", D[1], whole)
        + np.einsum("ck,ijk->ijc", D[2], whole)
    )
    assert np.linalg.norm(applied - r) < 1e-11 * np.linalg.norm(r)
