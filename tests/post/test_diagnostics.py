"""Numbers read off a state, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.grid import MacGrid
from valvefsi.post import diagnostics


def linear_faces(grid):
    """u_d = 1 + d + 2 x - 3 y (+ z) on all faces."""
    faces = grid.zero_faces()
    for d in range(grid.dim):
        x, y, z = grid.points(d)
        faces[d][...] = 1 + d + 2 * x - 3 * y + (z if grid.dim == 3 else 0.0)
    return faces


@pytest.mark.parametrize("dim", [2, 3])
def test_velocity_in_cells_is_exact_for_linear_fields(dim):
    grid = MacGrid([0] * dim, [1] * dim, [12, 10, 8][:dim], [False] * dim)
    got = diagnostics.cell_velocity(grid, linear_faces(grid))
    x, y, z = grid.points()
    for d in range(dim):
        expected = 1 + d + 2 * x - 3 * y + (z if dim == 3 else 0.0)
        np.testing.assert_allclose(got[..., d], np.broadcast_to(expected, grid.shape)[grid.owned], atol=1e-13)


def test_kinetic_energy_of_a_uniform_stream():
    grid = MacGrid([0, 0, 0], [1, 2, 1.5], [8, 16, 12], [True] * 3)
    u = tuple(np.full(grid.shape, v) for v in (3.0, 0.0, -4.0))
    assert diagnostics.kinetic_energy(grid, u, 2.0) == pytest.approx(0.5 * 2.0 * 25.0 * 3.0)


def test_the_fastest_face_and_the_courant_rate_are_found_wherever_they_are():
    grid = MacGrid([0, 0], [2, 1], [20, 10], [False, False])
    u = grid.zero_faces()
    x, y, _ = grid.points(1)
    here = np.isclose(x, 1.45) & np.isclose(y, 0.3)
    u[1][np.broadcast_to(here, grid.shape)] = -7.0
    speed, place = diagnostics.fastest_place(grid, u)
    assert speed == 7.0
    np.testing.assert_allclose(place[:2], [1.45, 0.3])
    rate = grid.comm.allreduce(diagnostics.local_courant_rate(grid, u), op=MPI.MAX)
    assert rate == pytest.approx(70.0)


@pytest.mark.parametrize("bad", [np.nan, -np.nan, np.inf, -np.inf])
def test_the_courant_rate_of_a_velocity_that_is_not_finite_is_infinite(bad):
    grid = MacGrid([0, 0], [2, 1], [20, 10], [False, False], MPI.COMM_SELF)
    u = grid.zero_faces()
    u[0][...] = -3.0
    assert diagnostics.local_courant_rate(grid, u) == pytest.approx(30.0)
    u[1][6, 7, 0] = bad
    assert diagnostics.local_courant_rate(grid, u) == np.inf
    u[1][6, 7, 0], u[1][0, 0, 0] = 0.0, bad  # a ghost
    assert diagnostics.local_courant_rate(grid, u) == pytest.approx(30.0)
