"""Spreading and interpolation: adjointness, conservation, exactness, rank invariance, bad positions."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.coupling.kernels import KERNELS
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import StabilityError
from valvefsi.grid import MacGrid

GRIDS = {
    "2-D, walls": ([0, 0], [2.0, 1.8], [20, 18], [False, False]),
    "2-D, periodic": ([-1, 0.5], [1.0, 2.1], [20, 16], [True, True]),
    "3-D, mixed": ([0, 0, 0], [1.8, 1.6, 1.5], [18, 16, 15], [True, False, True]),
}


def make(grid_name, comm=MPI.COMM_WORLD, count=60):
    """Return a grid, this rank's share of fixed random points, their numbers and all points."""
    lower, upper, cells, periodic = GRIDS[grid_name]
    grid = MacGrid(lower, upper, cells, periodic, comm)
    rng = np.random.default_rng(7)
    margin = 3.05 * grid.spacing * ~np.array(grid.periodic)
    points = rng.uniform(grid.lower + margin, grid.upper - margin, (count, 3))
    points[: count // 3] += (grid.upper - grid.lower) * np.array(grid.periodic) * (grid.dim == 3)
    if grid.dim == 2:
        points[:, 2] = 0.5
    mine = np.arange(comm.rank, count, comm.size)
    return grid, points[mine], mine, points


def whole_faces(grid, seed=11):
    """Faces filled from one global random field per component, ghosts exchanged."""
    rng = np.random.default_rng(seed)
    faces = grid.zero_faces()
    for d in range(grid.dim):
        values = rng.standard_normal(grid.face_shape(d))
        owned = grid.owned_faces(d)
        shape = faces[d][owned].shape
        faces[d][owned] = values[tuple(slice(s, s + n) for s, n in zip(grid.start, shape, strict=True))]
    grid.exchange(faces)
    return faces


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("name", GRIDS)
def test_spread_is_the_adjoint_of_interpolate(name, kernel):
    grid, chi, mine, points = make(name)
    F = np.random.default_rng(5).standard_normal(points.shape)[mine]
    F[:, grid.dim :] = 0
    u = whole_faces(grid)
    T = Coupling(grid, kernel).at(chi)
    f, U = T.spread(F), T.interpolate(u)
    total = MPI.COMM_WORLD.allreduce
    on_grid = total(
        sum((f[d][grid.owned_faces(d)] * u[d][grid.owned_faces(d)]).sum() for d in range(grid.dim))
    )
    on_points = total((F * U).sum())
    scale = total((np.abs(F) * np.abs(U)).sum())
    assert abs(on_grid * grid.cell_volume - on_points) < 1e-12 * scale


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("name", ["2-D, walls"])
def test_spreading_keeps_total_force_and_torque(name, kernel):
    grid, chi, mine, points = make(name)
    F = np.random.default_rng(5).standard_normal(points.shape)[mine]
    F[:, grid.dim :] = 0
    f = Coupling(grid, kernel).at(chi).spread(F)
    check_force_and_torque(grid, chi, F, f)


@pytest.mark.parametrize("kernel", KERNELS)
def test_spreading_keeps_total_force_and_torque_in_three_dimensions(kernel):
    grid = MacGrid([0] * 3, [1.6] * 3, [16] * 3, [False] * 3)
    comm = grid.comm
    rng = np.random.default_rng(1)
    points, forces = rng.uniform(0.31, 1.29, (40, 3)), rng.standard_normal((40, 3))
    mine = np.arange(comm.rank, 40, comm.size)
    f = Coupling(grid, kernel).at(points[mine]).spread(forces[mine])
    check_force_and_torque(grid, points[mine], forces[mine], f)


def check_force_and_torque(grid, chi, F, f):
    total = MPI.COMM_WORLD.allreduce
    force, torque = np.zeros(3), np.zeros(3)
    for d in range(grid.dim):
        own = f[d][grid.owned_faces(d)] * grid.cell_volume
        x = [np.broadcast_to(c, grid.shape)[grid.owned_faces(d)] if c.size > 1 else c for c in grid.points(d)]
        force[d] += own.sum()
        unit = np.eye(3)[d]
        arm = [(own * (xi if grid.dim == 3 or a < 2 else 0.0)).sum() for a, xi in enumerate(x)]
        torque += np.cross(arm, unit)
    arm = chi.copy()
    arm[:, grid.dim :] = 0
    assert np.abs(total(force) - total(F.sum(axis=0))).max() < 1e-12
    assert np.abs(total(torque) - total(np.cross(arm, F).sum(axis=0))).max() < 1e-12


@pytest.mark.parametrize("kernel", KERNELS)
def test_interpolation_is_exact_for_linear_fields(kernel):
    grid, chi, _, _ = make("2-D, walls")
    u = grid.zero_faces()
    for d in range(2):
        x, y, _ = grid.points(d)
        u[d][...] = (1 + d) + 2 * x - 3 * y
    U = Coupling(grid, kernel).at(chi).interpolate(u)
    for d in range(2):
        np.testing.assert_allclose(U[:, d], (1 + d) + 2 * chi[:, 0] - 3 * chi[:, 1], atol=1e-12)


@pytest.mark.parametrize("name", GRIDS)
def test_spread_and_interpolate_do_not_depend_on_the_number_of_ranks(name):
    grid, chi, mine, points = make(name)
    alone, all_points, _, _ = make(name, MPI.COMM_SELF)
    F = np.random.default_rng(5).standard_normal(points.shape)
    f = Coupling(grid, "ib4").at(chi).spread(F[mine])
    f_alone = Coupling(alone, "ib4").at(all_points).spread(F)
    U = Coupling(grid, "ib4").at(chi).interpolate(whole_faces(grid))
    U_alone = Coupling(alone, "ib4").at(all_points).interpolate(whole_faces(alone))
    np.testing.assert_allclose(U, U_alone[mine], atol=1e-13)
    for d in range(grid.dim):
        part = tuple(slice(s, s + n) for s, n in zip(grid.start, grid.size, strict=True))
        np.testing.assert_allclose(
            f[d][grid.owned], f_alone[d][alone.owned][part], atol=1e-12 * np.abs(f_alone[d]).max()
        )


@pytest.mark.parametrize("place", [[0.1, 0.9], [1.0, 1.75], [np.nan, 0.9], [1e9, 0.9]])
def test_a_point_near_a_wall_or_lost_is_an_error_on_every_rank(place, comm):
    grid, chi, _, _ = make("2-D, walls")
    if comm.rank == comm.size - 1:
        chi[0, :2] = place
    with pytest.raises(StabilityError, match="a point of the solid at"):
        Coupling(grid, "bspline3").at(chi)


def test_an_unknown_kernel_is_an_error_that_lists_the_known_ones():
    grid, *_ = make("2-D, walls")
    with pytest.raises(ValueError, match="piecewise_linear, bspline3"):
        Coupling(grid, "bspline2")
