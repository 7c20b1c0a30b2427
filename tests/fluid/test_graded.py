"""Graded axes: edges from wanted spacings, second order, what refuses them."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from tests.fluid.test_sides import Manufactured, relative_error, sample
from tests.ordering import assert_order
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import StabilityError
from valvefsi.fluid.boundary import Boundary
from valvefsi.fluid.navier_stokes import ExplicitViscosity, NavierStokes
from valvefsi.grid import MacGrid
from valvefsi.grid.grading import LARGEST_RATIO, graded_edges

WORLD = MPI.COMM_WORLD


def smooth_edges(n):
    """A smooth map of equal cells, widths from 0.6 to 1.4 of the mean."""
    s = np.arange(n + 1) / n
    return s + 0.4 / (2 * np.pi) * np.sin(2 * np.pi * s)


def graded_square(n, sides):
    edges = [smooth_edges(n)] * 2
    return MacGrid.graded(edges, [sides[axis][0] == "periodic" for axis in (0, 1)])


@pytest.mark.parametrize("advection", ["centred", "xsppm7"])
@pytest.mark.parametrize(
    "sides",
    [
        (("wall", "open"), ("slip", "wall")),
        (("periodic",) * 2, ("open", "slip")),
        (("open", "open"), ("wall", "wall")),
        (("periodic",) * 2, ("periodic",) * 2),
    ],
    ids=lambda s: "-".join((*s[0], *s[1])),
)
def test_the_order_is_two_on_a_graded_grid(sides, advection):
    problem = Manufactured(sides, mu=0.05)
    assert_order(
        lambda n: relative_error(problem, graded_square(n, sides), 0.08 / n, advection=advection),
        (12, 24, 48),
        order=1.8,
        below=1e-2,
    )


def test_explicit_viscosity_has_order_two_on_a_graded_grid():
    sides = (("wall", "open"), ("slip", "wall"))
    problem = Manufactured(sides, mu=0.02)
    assert_order(
        lambda n: relative_error(problem, graded_square(n, sides), 0.8 / n**2, cls=ExplicitViscosity),
        (12, 24, 48),
        order=1.8,
        below=1e-2,
    )


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("advection", ["centred", "xsppm7"])
def test_equal_cells_given_by_their_edges_are_a_uniform_grid(dim, advection):
    """The kernels of graded grids with equal widths do what those of uniform grids do."""
    cells = (9, 8, 7)[:dim]
    edges = [np.linspace(0.0, 1.0, n + 1) for n in cells]
    uniform = MacGrid.graded(edges, [False] * dim)
    assert all(uniform.uniform)
    slightly = [np.append(e[:-1], e[-1] * (1 + 1e-8)) for e in edges]
    graded = MacGrid.graded(slightly, [False] * dim)
    assert not any(graded.uniform[:dim])
    rng = np.random.default_rng(0)
    u = tuple(rng.standard_normal(uniform.shape) for _ in range(dim))
    p, q = rng.standard_normal(uniform.shape), rng.standard_normal(uniform.shape)
    results = []
    for grid in (uniform, graded):
        ops = NavierStokes(grid, Boundary(grid), rho=1.0, mu=0.1, advection=advection).operators
        out = [c[grid.owned] for c in ops.advection(u)] + [ops.divergence(u)[grid.owned]]
        for d in range(dim):
            out.append(ops.momentum(u[d], p, (q, p, q), (1.2, 0.3, 0.7), d)[grid.owned])
            out.append(ops.advance(u[d], p, (q, p, q), (0.4, 1.2, 0.3), d)[grid.owned])
            term = q.copy()
            ops.subtract_laplacian(term, u[d], d, 0.2)
            out.append(term[grid.owned])
        changed = tuple(c.copy() for c in u)
        ops.subtract_gradient(changed, p, 0.3)
        results.append(out + [c[grid.owned] for c in changed])
    for a, b in zip(*results, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-5 * np.abs(a).max())
        assert np.abs(a).max() > 0.1


def test_a_constant_stream_stays_one_on_a_graded_grid():
    grid = graded_square(12, (("periodic",) * 2,) * 2)
    fluid = NavierStokes(grid, Boundary(grid), rho=1.0, mu=0.1, advection="xsppm7")
    u = fluid.fill(sample(grid, lambda x, y, z, t: (1.0, -0.5, 0.0), 0.0), 0.0)
    assert max(np.abs(c[grid.owned]).max() for c in fluid.advection(u)) < 1e-12


def test_edges_reach_the_wanted_spacings_smoothly():
    edges = graded_edges([(-5.0, 0.4), (-1.5, 0.1), (1.5, 0.1), (5.0, 0.3)])
    widths = np.diff(edges)
    assert (edges[0], edges[-1]) == (-5.0, 5.0)
    assert widths[0] == pytest.approx(0.4, rel=0.1)
    assert widths[-1] == pytest.approx(0.3, rel=0.1)
    inside = (edges[:-1] > -1.5 - 1e-9) & (edges[1:] < 1.5 + 1e-9)
    np.testing.assert_allclose(widths[inside], 0.1, rtol=1e-9)
    ratios = widths[1:] / widths[:-1]
    assert np.maximum(ratios, 1 / ratios).max() <= LARGEST_RATIO


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([(0.0, 0.1)], "at least two"),
        ([(0.0, 0.1), (0.0, 0.2)], "must increase"),
        ([(0.0, 0.1), (1.0, -0.2)], "be positive"),
        ([(0.0, 0.1), (0.5, 0.4)], r"widths 0\.\d+ and 0\.\d+ cm, a ratio of 1\.\d+; at most 1\.1"),
    ],
)
def test_spacings_that_cannot_be_are_refused(points, message):
    with pytest.raises(ValueError, match=message):
        graded_edges(points)


def test_a_point_must_keep_its_kernel_where_cells_are_equal():
    edges = graded_edges([(-3.0, 0.2), (-1.0, 0.1), (1.0, 0.1), (3.0, 0.2)])
    grid = MacGrid.graded([edges, edges], [True, False])
    coupling = Coupling(grid, "ib4")
    mine = [[0.79, -0.75, 0.5]] if WORLD.rank == 0 else np.zeros((0, 3))
    force = np.ones((len(mine), 3))
    f = coupling.at(np.array(mine).reshape(-1, 3)).spread(force)
    for d in range(2):
        total = WORLD.allreduce(float((f[d] * grid.volumes(d))[grid.owned_faces(d)].sum()))
        moment = WORLD.allreduce(
            float((f[d] * grid.volumes(d) * grid.points(d)[0])[grid.owned_faces(d)].sum())
        )
        assert total == pytest.approx(1.0, rel=1e-12)
        assert moment == pytest.approx(0.79, rel=1e-12)
    for place in ([0.85, 0.0, 0.5], [0.0, -0.85, 0.5]):
        with pytest.raises(StabilityError, match="graded cells"):
            coupling.at(np.array([place] if WORLD.rank == 0 else []).reshape(-1, 3))
