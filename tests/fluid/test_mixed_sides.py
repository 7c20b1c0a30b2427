"""Sides that are open on a part: against an iterative solver of the assembled operator, mass balance, ranks."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse
import scipy.sparse.linalg
from mpi4py import MPI

from tests.fluid.test_direct_solver import second_difference, some_widths
from tests.fluid.test_sides import march
from valvefsi.fluid.boundary import Boundary, Disk, FreeSlip, Mixed, Open, Wall
from valvefsi.fluid.navier_stokes import ExplicitViscosity, NavierStokes
from valvefsi.grid import MacGrid

WORLD = MPI.COMM_WORLD


def make_grid(dim, *, graded=False, comm=WORLD, process_grid=None):
    cells = (13, 11, 10)[:dim]
    edges = [np.cumsum(np.append(0.0, some_widths(n, graded=graded) / 3)) for n in cells]
    return MacGrid.graded(edges, [False] * dim, comm, process_grid)


def patch(grid, axis, *, shift=0.0):
    """A disk (in the plane a stretch) off the middle of a side."""
    centre = 0.5 * (grid.lower + grid.upper) + shift
    return Mixed(open=Open(pressure=2.0), where=Disk(centre=tuple(centre), radius=0.25))


def sides_of(grid, setting, axis):
    name = "xyz"[axis]
    lower, upper = patch(grid, axis), patch(grid, axis, shift=0.13)
    return {
        "one": {f"{name}_lower": lower},
        "two": {f"{name}_lower": lower, f"{name}_upper": upper},
        "beside an open one": {f"{name}_upper": upper, f"{name}_lower": Open()},
        "across an open one": {f"{name}_upper": upper, f"{'yx'[axis % 2]}_lower": Open()},
    }[setting]


def gathered(grid, local, start, shape):
    whole = np.zeros(shape)
    whole[tuple(slice(s, s + n) for s, n in zip(start, local.shape, strict=True))] = local
    grid.comm.Allreduce(MPI.IN_PLACE, whole)
    return whole


def kronecker(parts):
    """Sparse sum of one-dimensional operators."""
    eyes = [scipy.sparse.identity(len(p)) for p in parts]
    out = 0
    for axis, part in enumerate(parts):
        factors = [scipy.sparse.csr_matrix(part) if a == axis else eye for a, eye in enumerate(eyes)]
        out = out + scipy.sparse.kron(scipy.sparse.kron(factors[0], factors[1]), factors[2])
    return out.tocsr()


def assembled_poisson(grid, boundary):
    """The pressure's operator, entry by entry: the wall's, less what the open cells lose."""
    parts = [second_difference(kind, w) for kind, w in zip(boundary.kinds(), grid.cell_widths, strict=True)]
    if grid.dim == 2:
        parts[2] = np.zeros((1, 1))
    lost = np.zeros(grid.cells)
    for place in boundary.mixed:
        end = -1 if place.upper else 0
        width = grid.cell_widths[place.axis][end]
        np.moveaxis(lost, place.axis, 0)[end] += np.where(place.mask, 2.0 / width**2, 0.0)
    return kronecker(parts) - scipy.sparse.diags(lost.ravel())


def iterative(A, r):
    """GMRES with an incomplete factorisation; the tolerance is that of the comparison."""
    factors = scipy.sparse.linalg.spilu(A.tocsc(), drop_tol=1e-5, fill_factor=30)
    M = scipy.sparse.linalg.LinearOperator(A.shape, factors.solve)
    x, info = scipy.sparse.linalg.gmres(A, r, M=M, rtol=1e-13, atol=0.0, maxiter=200)
    assert info == 0
    return x


SETTINGS = ("one", "two", "beside an open one", "across an open one")


@pytest.mark.parametrize("graded", [False, True])
@pytest.mark.parametrize("setting", SETTINGS)
@pytest.mark.parametrize(("dim", "axis"), [(2, 0), (2, 1), (3, 0), (3, 1), (3, 2)])
def test_the_pressure_is_that_of_an_iterative_solver(dim, axis, setting, graded):
    grid = make_grid(dim, graded=graded)
    boundary = Boundary(grid, sides_of(grid, setting, axis))
    fluid = NavierStokes(grid, boundary, rho=1.0, mu=0.1)
    r = np.random.default_rng(1).standard_normal(grid.cells)
    mine = tuple(slice(s, s + n) for s, n in zip(grid.start, grid.size, strict=True))
    x = gathered(grid, fluid.mixed_pressure.solve(r[mine].copy()), grid.start, grid.cells)
    A = assembled_poisson(grid, boundary)
    assert np.linalg.norm(A @ x.ravel() - r.ravel()) < 1e-11 * np.linalg.norm(r)
    expected = iterative(A, r.ravel())
    np.testing.assert_allclose(x.ravel(), expected, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("graded", [False, True])
@pytest.mark.parametrize("setting", SETTINGS)
@pytest.mark.parametrize(("dim", "axis"), [(2, 0), (2, 1), (3, 0), (3, 1), (3, 2)])
def test_the_viscous_solve_of_the_normal_velocity_fits_the_assembled_operator(dim, axis, setting, graded):
    grid = make_grid(dim, graded=graded)
    boundary = Boundary(grid, sides_of(grid, setting, axis))
    fluid = NavierStokes(grid, boundary, rho=1.0, mu=0.3)
    dt, shape = 0.02, grid.face_shape(axis)
    rhs = np.random.default_rng(2).standard_normal(shape)
    local, out = grid.zeros(), grid.zeros()
    owned = grid.owned_faces(axis)
    size = [s.stop - s.start for s in owned]
    local[owned] = rhs[tuple(slice(s, s + n) for s, n in zip(grid.start, size, strict=True))]
    fluid._add_increment(out, grid.zeros(), local, axis, dt)
    x = gathered(grid, out[owned], grid.start, shape)
    # All faces with their ghosts mirrored, of which those on walls are then held at zero.
    kinds = ["faces NN" if a == axis else kind for a, kind in enumerate(boundary.kinds(axis))]
    parts = [second_difference(kind, w) for kind, w in zip(kinds, grid.cell_widths, strict=True)]
    if dim == 2:
        parts[2] = np.zeros((1, 1))
    A = scipy.sparse.identity(x.size) / dt - 0.15 * kronecker(parts)
    free = np.ones(shape, dtype=bool)
    for end, name in ((0, "lower"), (-1, "upper")):
        place = boundary.place(f"{'xyz'[axis]}_{name}")
        plane = np.moveaxis(free, axis, 0)
        if isinstance(place.side, Mixed):
            plane[end] = place.mask
        elif not isinstance(place.side, Open):
            plane[end] = False
    free = free.ravel()
    assert np.all(x.ravel()[~free] == 0.0)
    residual = (A @ x.ravel() - rhs.ravel())[free]
    assert np.linalg.norm(residual) < 1e-11 * np.linalg.norm(rhs)


@pytest.mark.parametrize("cls", [NavierStokes, ExplicitViscosity])
@pytest.mark.parametrize("graded", [False, True])
@pytest.mark.parametrize(("dim", "axis"), [(2, 1), (3, 0), (3, 2)])
def test_what_goes_in_through_one_disk_comes_out_of_the_other(dim, axis, graded, cls):
    grid = make_grid(dim, graded=graded)
    sides = sides_of(grid, "two", axis)
    sides[f"{'yx'[axis % 2]}_upper"] = FreeSlip()
    sides[f"{'yx'[axis % 2]}_lower"] = Wall()
    fluid = cls(grid, Boundary(grid, sides), rho=1.0, mu=0.05)
    lower, upper = (f"{'xyz'[axis]}_{end}" for end in ("lower", "upper"))
    u, _ = march(
        fluid,
        grid.zero_faces(),
        grid.zeros(),
        lambda _: grid.zero_faces(),
        0.005,
        20,
        pressures={lower: 30.0, upper: 0.0},
    )
    into, out = -fluid.boundary.outflow(u, lower), fluid.boundary.outflow(u, upper)
    assert into > 1e-3
    assert out == pytest.approx(into, rel=1e-11)
    assert WORLD.allreduce(np.abs(fluid.divergence(u)[grid.owned]).max(), op=MPI.MAX) < 1e-11


@pytest.mark.skipif(WORLD.size == 1, reason="needs two ranks")
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_mixed_side_does_not_see_the_number_of_ranks(axis):
    runs = []
    for comm in (WORLD, MPI.COMM_SELF):
        grid = make_grid(3, comm=comm)
        fluid = NavierStokes(grid, Boundary(grid, sides_of(grid, "two", axis)), rho=1.0, mu=0.05)
        name = f"{'xyz'[axis]}_lower"
        u, p = march(
            fluid,
            grid.zero_faces(),
            grid.zeros(),
            lambda _, g=grid: g.zero_faces(),
            0.005,
            5,
            pressures={name: 30.0},
        )
        parts = [gathered(grid, c[grid.owned], grid.start, grid.cells) for c in (*u, p)]
        runs.append(parts)
    for ours, alone in zip(*runs, strict=True):
        np.testing.assert_allclose(ours, alone, atol=1e-10 * np.abs(alone).max())


def test_mixed_sides_in_a_corner_are_refused():
    grid = make_grid(3)
    with pytest.raises(ValueError, match=r"face each other.*x_lower, y_upper"):
        Boundary(grid, {"x_lower": patch(grid, 0), "y_upper": patch(grid, 1)})


@pytest.mark.parametrize("cls", [NavierStokes, ExplicitViscosity])
def test_a_force_that_is_not_finite_is_left_to_the_health_check(cls):
    """The run looks at the velocity after each step, goes back and halves the step."""
    grid = make_grid(3)
    fluid = cls(grid, Boundary(grid, sides_of(grid, "two", 2)), rho=1.0, mu=0.05)
    f = tuple(np.full(grid.shape, np.nan) for _ in range(3))
    with np.errstate(invalid="ignore"):
        u, _ = march(fluid, grid.zero_faces(), grid.zeros(), lambda _: f, 0.005, 1)
    assert np.isnan(u[2][grid.unknown_faces(2)]).all()
