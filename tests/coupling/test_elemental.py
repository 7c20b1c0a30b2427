"""Elemental coupling: the same identities as for nodes, and points that follow the elements."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from scipy.spatial import cKDTree

from tests.coupling.test_transfer import check_force_and_torque, whole_faces
from valvefsi.coupling.elemental import ElementalCoupling
from valvefsi.coupling.kernels import KERNELS
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import CaseError, StabilityError
from valvefsi.geometry.shapes import box, rectangle
from valvefsi.grid import MacGrid
from valvefsi.solid.elements.element_points import ElementPoints
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.structure import Discretisation, Structure

KINDS = [
    ("quadrilateral", 1),
    ("quadrilateral", 2),
    ("triangle", 1),
    ("triangle", 2),
    ("hexahedron", 1),
    ("tetrahedron", 1),
]


def make(kind, degree=1, comm=MPI.COMM_WORLD):
    """Return a solid in the middle of a box of walls, its positions after a twist, and the grid."""
    dim = 2 if kind in ("quadrilateral", "triangle") else 3
    shape, size = (rectangle, (4, 3)) if dim == 2 else (box, (3, 2, 2))
    mesh = shape(comm, lower=(0.5,) * dim, size=(0.9, 0.6, 0.6)[:dim], elements=size, cell=kind)
    solid = Structure(mesh, NeoHookean(c1=1.0), discretisation=Discretisation(degree=degree))
    grid = MacGrid([0] * dim, [1.8] * dim, [18] * dim, [False] * dim, comm)
    chi = solid.X.copy()
    chi[:, 0] += 0.06 * np.sin(4 * solid.X[:, 1])
    chi[:, 1] += 0.05 * np.sin(3 * solid.X[:, 0])
    return solid, chi, grid


def nodal(solid, seed=5):
    values = np.random.default_rng(seed).standard_normal((solid.num_nodes, 3))[solid.ids]
    values[:, solid.dim :] = 0
    return values


def products(grid, f, u, F, U):
    total = grid.comm.allreduce
    on_grid = sum((f[d][grid.owned_faces(d)] * u[d][grid.owned_faces(d)]).sum() for d in range(grid.dim))
    return total(on_grid * grid.cell_volume), total((F * U).sum()), total((np.abs(F) * np.abs(U)).sum())


@pytest.mark.parametrize(
    ("kind", "degree", "mass"),
    [
        (*of, mass)
        for of in KINDS
        for mass in ("consistent", "lumped")
        if (*of, mass) != ("triangle", 2, "lumped")
    ],
)
def test_spread_is_the_adjoint_of_interpolate(kind, degree, mass):
    solid, chi, grid = make(kind, degree)
    T = ElementalCoupling(grid, "ib4", ElementPoints(solid, mass)).at(chi)
    F, u = nodal(solid), whole_faces(grid)
    on_grid, on_nodes, scale = products(grid, T.spread(F), u, F, T.interpolate(u))
    assert abs(on_grid - on_nodes) < 1e-12 * scale


@pytest.mark.parametrize("kernel", KERNELS)
def test_the_adjoint_holds_for_every_kernel(kernel):
    solid, chi, grid = make("quadrilateral")
    T = ElementalCoupling(grid, kernel, ElementPoints(solid)).at(chi)
    F, u = nodal(solid), whole_faces(grid)
    on_grid, on_nodes, scale = products(grid, T.spread(F), u, F, T.interpolate(u))
    assert abs(on_grid - on_nodes) < 1e-12 * scale


@pytest.mark.parametrize("kernel", ["bspline3", "ib6", "composite_bspline43"])
@pytest.mark.parametrize(("kind", "degree"), KINDS)
def test_spreading_keeps_total_force_and_torque(kind, degree, kernel):
    solid, chi, grid = make(kind, degree)
    F = nodal(solid)
    f = ElementalCoupling(grid, kernel, ElementPoints(solid)).at(chi).spread(F)
    check_force_and_torque(grid, chi, F, f)


@pytest.mark.parametrize(("kind", "degree"), KINDS)
def test_interpolation_is_exact_for_linear_fields_of_the_position(kind, degree):
    solid, chi, grid = make(kind, degree)
    u = grid.zero_faces()
    for d in range(grid.dim):
        x, y, _ = grid.points(d)
        u[d][...] = (1 + d) + 2 * x - 3 * y
    U = ElementalCoupling(grid, "ib4", ElementPoints(solid)).at(chi).interpolate(u)
    for d in range(grid.dim):
        np.testing.assert_allclose(U[:, d], (1 + d) + 2 * chi[:, 0] - 3 * chi[:, 1], atol=1e-11)


def test_results_do_not_depend_on_the_number_of_ranks():
    for kind in ("triangle", "hexahedron"):
        (solid, chi, grid), (alone, chi_alone, grid_alone) = make(kind), make(kind, comm=MPI.COMM_SELF)
        T = ElementalCoupling(grid, "ib4", ElementPoints(solid)).at(chi)
        T_alone = ElementalCoupling(grid_alone, "ib4", ElementPoints(alone)).at(chi_alone)
        U, U_alone = T.interpolate(whole_faces(grid)), T_alone.interpolate(whole_faces(grid_alone))
        expected = np.empty_like(U_alone)
        expected[alone.ids] = U_alone
        np.testing.assert_allclose(U, expected[solid.ids], atol=1e-11)
        f, f_alone = T.spread(nodal(solid)), T_alone.spread(nodal(alone))
        part = tuple(slice(s, s + n) for s, n in zip(grid.start, grid.size, strict=True))
        for d in range(grid.dim):
            np.testing.assert_allclose(
                f[d][grid.owned],
                f_alone[d][grid_alone.owned][part],
                atol=1e-11 * np.abs(f_alone[d]).max(),
            )


@pytest.mark.parametrize("kind", ["quadrilateral", "triangle", "hexahedron", "tetrahedron"])
@pytest.mark.parametrize("gap", [0.1, 0.06])
def test_no_point_is_further_than_the_gap_from_its_nearest_neighbour(kind, gap):
    solid, chi, _ = make(kind)
    points = ElementPoints(solid)
    chi[:, 0] = 0.5 + 1.3 * (solid.X[:, 0] - 0.5 + 1e-9) ** 1.5  # elements stretch, each by its own factor
    rule = points.refined(chi, gap)
    start = 0
    for group in rule.groups:
        count, n = group.weights.shape
        x = rule.x[start : start + count * n].reshape(count, n, 3)
        start += count * n
        for cell in x[:3]:
            assert cKDTree(cell[:, : solid.dim]).query(cell[:, : solid.dim], 2)[0][:, 1].max() <= gap * (
                1 + 1e-12
            )


def stretched(kind):
    """Positions of a solid whose elements stretch along x, each by its own factor."""
    solid, chi, _ = make(kind)
    chi[:, 0] = 0.5 + 1.6 * (solid.X[:, 0] - 0.5 + 1e-9) ** 1.5
    return solid, chi


@pytest.mark.parametrize("kind", ["quadrilateral", "hexahedron"])
@pytest.mark.parametrize("gap", [0.1, 0.07])
def test_no_gap_on_a_line_through_elements_is_larger_than_asked_for_also_across_faces(kind, gap):
    solid, chi = stretched(kind)
    rule, start, kinds = ElementPoints(solid).refined(chi, gap), 0, set()
    for group in rule.groups:
        count, shape = len(group.cells), group.points
        part = rule.x[start : start + group.weights.size].reshape(count, *shape, 3)
        start += group.weights.size
        kinds.add(shape)
        for axis, n in enumerate(shape):
            assert n > 1
            apart = np.linalg.norm(np.diff(part, axis=1 + axis), axis=-1)
            x = 0.5 + 0.5 * np.polynomial.legendre.leggauss(n)[0]
            to_face = (
                apart.take(0, axis=1 + axis) * x[0] / (x[1] - x[0])
            )  # lines are straight in linear elements
            assert apart.max() <= gap * (1 + 1e-12)
            assert to_face.max() <= 0.5 * gap * (1 + 1e-12)
    assert solid.comm.size > 1 or len(kinds) > 1


@pytest.mark.parametrize("kind", ["quadrilateral", "hexahedron"])
def test_long_elements_get_more_points_along_their_length_only(kind):
    solid, chi = stretched(kind)
    groups = ElementPoints(solid).refined(chi, 0.2).groups
    assert all(n == 2 for group in groups for n in group.points[1:])
    assert solid.comm.allreduce(max((group.points[0] for group in groups), default=0), op=MPI.MAX) > 2


def test_elements_that_stretch_get_more_points_and_others_do_not():
    solid, _, _ = make("quadrilateral", comm=MPI.COMM_SELF)
    points = ElementPoints(solid)
    before = len(points.refined(solid.X, 0.1).x)
    chi = solid.X.copy()
    chi[:, 0] = np.where(chi[:, 0] > 1.3, chi[:, 0] + 0.4, chi[:, 0])
    stretched = points.refined(chi, 0.1)
    assert len(stretched.x) > before
    assert {len(g.phi) for g in stretched.groups} >= {len(g.phi) for g in points.refined(solid.X, 0.1).groups}
    assert len(points.refined(solid.X, 0.1).x) == before


def test_an_element_beyond_all_rules_is_an_error_on_every_rank(comm):
    solid, chi, grid = make("quadrilateral")
    chi[solid.ids == solid.num_nodes - 1] += [90.0, 0.0, 0.0]
    with pytest.raises(StabilityError, match="torn apart"):
        ElementalCoupling(grid, "ib4", ElementPoints(solid)).at(chi)


def test_lumped_masses_need_positive_shares(comm):
    solid, _, grid = make("triangle", 2)
    with pytest.raises(CaseError, match="lumped"):
        ElementPoints(solid, "lumped")
    with pytest.raises(CaseError, match="lumpd"):
        ElementPoints(solid, "lumpd")
    with pytest.raises(ValueError, match="gap"):
        ElementalCoupling(grid, "ib4", ElementPoints(solid), gap=0.0)


def linear_faces(grid):
    """A solenoidal velocity on the faces, from a random stream function on edges."""
    psi = np.random.default_rng(3).standard_normal(tuple(n + 1 for n in grid.shape[:2]))
    u, h = grid.zero_faces(), grid.spacing[0]
    u[0][..., 0] = (psi[:-1, 1:] - psi[:-1, :-1]) / h
    u[1][..., 0] = -(psi[1:, :-1] - psi[:-1, :-1]) / h
    return u


@pytest.mark.parametrize("kernel", [k for k in KERNELS if k.startswith("composite")])
def test_composite_kernels_interpolate_a_solenoidal_velocity(kernel):
    grid = MacGrid([0, 0], [1, 1], [20, 20], [False, False], MPI.COMM_SELF)
    u, x = linear_faces(grid), np.random.default_rng(1).uniform(0.3, 0.7, (50, 3))

    def divergence(name, step=1e-5):
        total = 0.0
        for d in range(2):
            e = step * np.eye(3)[d]
            c = Coupling(grid, name)
            total = total + (c.at(x + e).interpolate(u) - c.at(x - e).interpolate(u))[:, d] / (2 * step)
        return np.abs(total).max()

    smooth = 1e-3 if kernel == "composite_bspline32" else 1e-5  # differences across a kink see half of it
    assert divergence(kernel) < smooth * divergence("bspline4")
