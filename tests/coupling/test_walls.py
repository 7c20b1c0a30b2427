"""Kernels near sides: what reaches beyond a side whose velocity is given is the mirror image of what is inside."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from tests.coupling.test_elemental import make, nodal, products
from tests.coupling.test_transfer import whole_faces
from valvefsi.coupling.elemental import ElementalCoupling
from valvefsi.coupling.kernels import KERNELS
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import StabilityError
from valvefsi.fluid.boundary import Boundary, FreeSlip, Open, Wall
from valvefsi.grid import MacGrid
from valvefsi.grid.grading import graded_edges
from valvefsi.solid.elements.element_points import ElementPoints

H = 0.1
GRIDS = {
    "2-D": ([10, 9], {"x_upper": FreeSlip()}, []),
    "3-D": ([9, 10, 8], {"y_lower": FreeSlip()}, []),
    "3-D, periodic": ([9, 8, 10], {}, [0]),
}


def box(name, comm=MPI.COMM_WORLD):
    """Return a grid of spacing H from 0 on with walls, and its sides."""
    cells, sides, periodic = GRIDS[name]
    ends = [H * n for n in cells]
    grid = MacGrid([0] * len(cells), ends, cells, [a in periodic for a in range(len(cells))], comm)
    return grid, Boundary(grid, sides)


def points_near_sides(grid, count=80):
    """Random points, each drawn to 0, 0.05, 0.5 or 1.2 h from one side or to an edge or corner of the box."""
    rng = np.random.default_rng(3)
    points = rng.uniform(grid.lower, grid.upper, (count, 3))
    for q in range(count):
        for axis in rng.choice(grid.dim, 1 + q % grid.dim, replace=False):
            gap = H * (0.0, 0.05, 0.5, 1.2)[q % 4]
            points[q, axis] = grid.lower[axis] + gap if rng.random() < 0.5 else grid.upper[axis] - gap
    points[:, grid.dim :] = 0.5
    return points


def share(grid, values):
    return values[grid.comm.rank :: grid.comm.size]


def homogeneous(grid, sides):
    """A random velocity that is zero on the sides, ghosts filled."""
    u = whole_faces(grid)
    resting = Boundary(
        grid, {p.name: p.side if isinstance(p.side, FreeSlip) else Wall() for p in sides.places}
    )
    resting.set_faces(u, 0.0)
    grid.exchange(u)
    resting.fill(u, 0.0)
    return u


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("name", GRIDS)
def test_power_is_conserved_near_sides_with_every_kernel(name, kernel):
    grid, sides = box(name)
    chi = share(grid, points_near_sides(grid))
    F = share(grid, np.random.default_rng(5).standard_normal((80, 3)))
    F[:, grid.dim :] = 0
    u = homogeneous(grid, sides)
    T = Coupling(grid, kernel, sides.signs).at(chi)
    on_grid, on_points, scale = products(grid, T.spread(F), u, F, T.interpolate(u))
    assert abs(on_grid - on_points) < 1e-12 * scale


@pytest.mark.parametrize("name", GRIDS)
def test_nothing_stays_beyond_the_sides(name):
    grid, sides = box(name)
    f = (
        Coupling(grid, "ib6", sides.signs)
        .at(share(grid, points_near_sides(grid)))
        .spread(np.ones((len(share(grid, np.empty(80))), 3)))
    )
    for d in range(grid.dim):
        rest = f[d].copy()
        rest[grid.owned_faces(d)] = 0.0
        assert np.abs(rest).max() == 0.0


@pytest.mark.parametrize("kernel", KERNELS)
def test_points_near_moving_walls_move_with_a_constant_velocity(kernel):
    grid, _ = box("3-D")
    velocity = (0.3, -0.2, 0.7)
    names = [f"{axis}_{end}" for axis in "xyz" for end in ("lower", "upper")]
    sides = Boundary(grid, {name: Wall(velocity=velocity) for name in names})
    u = grid.zero_faces()
    for d, component in enumerate(u):
        component[grid.owned_faces(d)] = velocity[d]
    sides.set_faces(u, 0.0)
    grid.exchange(u)
    sides.fill(u, 0.0)
    chi = share(grid, points_near_sides(grid))
    U = Coupling(grid, kernel, sides.signs).at(chi).interpolate(u)
    np.testing.assert_allclose(U, np.tile(velocity, (len(chi), 1)), atol=1e-13)


@pytest.mark.parametrize("kernel", KERNELS)
def test_shear_between_a_wall_at_rest_and_a_moving_one_is_reproduced(kernel):
    grid = MacGrid([0, 0], [1.0, 0.8], [10, 8], [True, False])
    sides = Boundary(grid, {"y_upper": Wall(velocity=(1.6, 0.0))})
    u = grid.zero_faces()
    u[0][...] = 2.0 * grid.points(0)[1]
    u[0][:, : grid.owned[1].start], u[0][:, grid.owned[1].stop :] = np.nan, np.nan
    grid.exchange(u)
    sides.fill(u, 0.0)
    rng = np.random.default_rng(1)
    chi = np.stack([rng.uniform(0, 1, 50), np.linspace(0, 0.8, 50), np.full(50, 0.5)], axis=1)
    U = Coupling(grid, kernel, sides.signs).at(share(grid, chi)).interpolate(u)
    np.testing.assert_allclose(U[:, 0], 2.0 * share(grid, chi)[:, 1], atol=1e-13)


@pytest.mark.parametrize("kernel", ["bspline3", "ib4", "bspline6"])
def test_the_side_bears_what_does_not_reach_the_fluid(kernel):
    """A free-slip side bears no force along it; a wall bears all of a force on it, of any direction."""
    grid, sides = box("2-D")
    at = np.array([[0.95, 0.45, 0.5], [0.4, 0.0, 0.5]])
    for place, F, expected in (
        (at[0], (0.0, 1.0), 1.0),
        (at[1], (1.0, 0.0), 0.0),
        (at[1], (0.0, 1.0), 0.0),
    ):
        mine = share(grid, np.array([place]))
        f = Coupling(grid, kernel, sides.signs).at(mine).spread(np.tile((*F, 0.0), (len(mine), 1)))
        d = F.index(1.0)
        inside = [f[d][grid.unknown_faces(d)].sum() * grid.cell_volume]
        assert abs(grid.comm.allreduce(inside[0]) - expected) < 1e-12


@pytest.mark.parametrize("name", GRIDS)
def test_the_answer_near_sides_does_not_depend_on_the_number_of_ranks(name):
    grid, sides = box(name)
    alone, sides_alone = box(name, MPI.COMM_SELF)
    points, F = points_near_sides(grid), np.random.default_rng(5).standard_normal((80, 3))
    T = Coupling(grid, "ib6", sides.signs).at(share(grid, points))
    T_alone = Coupling(alone, "ib6", sides_alone.signs).at(points)
    U = T.interpolate(homogeneous(grid, sides))
    np.testing.assert_allclose(
        U, share(grid, T_alone.interpolate(homogeneous(alone, sides_alone))), atol=1e-13
    )
    f, f_alone = T.spread(share(grid, F)), T_alone.spread(F)
    for d in range(grid.dim):
        part = tuple(slice(s, s + n) for s, n in zip(grid.start, grid.size, strict=True))
        np.testing.assert_allclose(
            f[d][grid.owned], f_alone[d][alone.owned][part], atol=1e-12 * np.abs(f_alone[d]).max()
        )


@pytest.mark.parametrize("mass", ["consistent", "lumped"])
@pytest.mark.parametrize("kind", ["quadrilateral", "hexahedron"])
def test_elemental_coupling_conserves_power_near_walls(kind, mass):
    solid, chi, grid = make(kind)
    sides = Boundary(grid)
    for axis in range(2):
        chi[:, axis] -= grid.comm.allreduce(chi[:, axis].min(), op=MPI.MIN) - 0.05 * H
    F, u = nodal(solid), homogeneous(grid, sides)
    T = ElementalCoupling(grid, "ib4", ElementPoints(solid, mass), signs=sides.signs).at(chi)
    on_grid, on_points, scale = products(grid, T.spread(F), u, F, T.interpolate(u))
    assert abs(on_grid - on_points) < 1e-12 * scale


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ([0.15, 0.45], "within 2 spacings of an open side"),
        ([0.5, 0.9 + 1e-6], "is lost, outside the box"),
        ([1.001, 0.5], "is lost, outside the box"),
        ([np.nan, 0.5], "is lost, outside the box"),
    ],
)
def test_open_sides_and_points_beyond_walls_are_refused_on_every_rank(place, message):
    grid = MacGrid([0, 0], [1.0, 0.9], [10, 9], [False, False])
    sides = Boundary(grid, {"x_lower": Open()})
    chi = np.array([[*place, 0.5]]) if grid.comm.rank == 0 else np.empty((0, 3))
    with pytest.raises(StabilityError, match=message):
        Coupling(grid, "ib4", sides.signs).at(chi)


def test_walls_beside_graded_cells_are_refused_and_beside_fine_cells_are_not():
    edges = [graded_edges([(0.0, 0.1), (1.0, 0.1), (2.0, 0.2)]), np.linspace(0, 1, 11)]
    grid = MacGrid.graded(edges, [False, False])
    coupling = Coupling(grid, "bspline3", Boundary(grid).signs)
    mine = grid.comm.rank == 0
    coupling.at(np.array([[0.01, 0.01, 0.5]])[:mine])
    with pytest.raises(StabilityError, match="graded cells"):
        coupling.at(np.array([[1.99, 0.5, 0.5]])[:mine])
