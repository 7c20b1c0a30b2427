"""The offset of a kernel: closed forms, and Couette flow past held points through coupling and fluid."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.bodies.rigid import RigidSurface
from valvefsi.coupling.kernels import KERNELS
from valvefsi.coupling.transfer import Coupling
from valvefsi.coupling.wall_offset import _offset, wall_offset
from valvefsi.fluid.boundary import Boundary, FreeSlip, Wall
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.grid import MacGrid

WORLD = MPI.COMM_WORLD


def test_one_plane_stands_out_by_half_the_mean_distance_of_two_places_of_its_kernel():
    """Piecewise linear: 1/2 mean of 2 s (1 - s); of a spline the sum of |k| / 2 of the one of twice its points."""
    assert wall_offset("piecewise_linear") == pytest.approx(1 / 6, rel=1e-3)
    assert wall_offset("bspline3") == pytest.approx((26 + 2 * 1) / 120, rel=1e-6)
    assert wall_offset("composite_bspline43") == pytest.approx(wall_offset("bspline3"), rel=1e-12)


@pytest.mark.parametrize("kernel", KERNELS)
def test_planes_behind_the_first_let_it_stand_out_farther(kernel):
    one, sparse, dense = (wall_offset(kernel, depths) for depths in ((0.0,), (0.0, 2.0, 4.0), range(5)))
    assert 0.0 < one < sparse < dense
    assert wall_offset(kernel, (0.0, 1e4)) == pytest.approx(one, abs=1e-3)  # a plane far behind is not felt


@pytest.mark.parametrize("depths", [(0.0,), (0.0, 1.0, 2.0)])
@pytest.mark.parametrize("place", [0.0, 0.3])
def test_couette_flow_is_at_rest_where_the_offset_says(depths, place):
    """Points on planes y = 8 + place - depth under a lid at y = 20, h = 1: the shear's line meets zero above them."""
    size = (16, 20)
    grid = MacGrid((0.0, 0.0), size, size, (True, False), WORLD, process_grid=(WORLD.size, 1))
    sides = {"y_lower": FreeSlip(), "y_upper": Wall(velocity=(1.0, 0.0))}
    fluid = NavierStokes(grid, Boundary(grid, sides), rho=1.0, mu=1.0)
    x, y = np.meshgrid(0.25 + 0.5 * np.arange(32), 8.0 + place - np.array(depths), indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.5)], axis=1)
    coupling = Coupling(grid, "bspline3")
    held = RigidSurface(points, np.full(len(points), 0.5), coupling, name="w", stiffness=0.2, damping=0.2)
    model = fsi.Model(grid=grid, fluid=fluid, bodies=(held,))
    state = fsi.initial_state(model, 1.0)
    for _ in range(700):
        state = fsi.step(model, state, 1.0)
    u = state.u[0][grid.owned_faces(0)][0, :, 0]
    rest = 19.5 - u[19] / (u[19] - u[18])
    expected = 8.0 + place + _offset(0, 3, 8.0 + place - 0.5 - np.array(depths))
    assert rest == pytest.approx(expected, abs=1e-5)
