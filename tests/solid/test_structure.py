"""Nodal forces, loads, supports and node numbers of a solid, on any number of ranks."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.errors import CaseError
from valvefsi.geometry.shapes import box, compressed_block, rectangle
from valvefsi.solid.elements.numbering import number_nodes
from valvefsi.solid.loads import DeadLoad, Ramp, Tether
from valvefsi.solid.materials import MooneyRivlin, NeoHookean
from valvefsi.solid.structure import Discretisation, Structure

MATERIAL = NeoHookean(c1=80.194)
TOP = ("top_loaded", "top_outer")


def make(comm, kind="quadrilateral", degree=1, **options):
    if kind in ("quadrilateral", "triangle"):
        mesh = rectangle(comm, lower=(1, 2), size=(2, 1), elements=(6, 3), cell=kind)
    else:
        mesh = box(comm, lower=(1, 2, 3), size=(1, 2, 1), elements=(2, 4, 2), cell=kind)
    return Structure(mesh, MATERIAL, discretisation=Discretisation(degree=degree), **options)


def deformed(solid, amount=0.05):
    """A deformation that is neither homogeneous nor isochoric, the same on any number of ranks."""
    chi, X = solid.X.copy(), solid.X
    chi[:, 0] += amount * np.sin(2 * X[:, 1] + X[:, 0])
    chi[:, 1] += amount * np.cos(3 * X[:, 0] - X[:, 1])
    if solid.dim == 3:
        chi[:, 2] += amount * np.sin(X[:, 0] * X[:, 2])
    return chi


def by_id(solid, values):
    """All ranks' rows in order of the node numbers, on every rank."""
    rows = solid.comm.allgather((solid.ids, np.asarray(values)))
    result = np.full((solid.num_nodes, values.shape[1]), np.nan)
    for ids, part in rows:
        result[ids] = part
    return result


KINDS = [
    ("quadrilateral", 1),
    ("quadrilateral", 2),
    ("triangle", 1),
    ("triangle", 2),
    ("hexahedron", 1),
    ("tetrahedron", 2),
]


@pytest.mark.parametrize(("kind", "degree"), KINDS)
def test_elastic_forces_are_minus_the_gradient_of_the_energy_and_balance(comm, kind, degree):
    solid = make(comm, kind, degree)
    chi = deformed(solid)
    F = solid.force(chi, np.zeros_like(chi), 0.0)
    direction = np.zeros_like(chi)
    direction[:, : solid.dim] = np.stack([np.sin(5 * chi[:, 1] + a) for a in range(solid.dim)], axis=1)
    step = 1e-5
    slope = (solid.energy(chi + step * direction) - solid.energy(chi - step * direction)) / (2 * step)
    work = comm.allreduce(float((F * direction).sum()))
    assert -work == pytest.approx(slope, rel=1e-7)
    size = comm.allreduce(float(np.abs(F).sum()))
    assert np.abs(comm.allreduce(F.sum(axis=0))).max() < 1e-12 * size
    arm = chi - np.array([1.0, 2.0, 0.5])
    assert np.abs(comm.allreduce(np.cross(arm, F).sum(axis=0))).max() < 1e-12 * size
    assert np.all(F[:, solid.dim :] == 0)


@pytest.mark.parametrize(("kind", "degree"), KINDS)
def test_a_homogeneous_deformation_loads_the_surface_only(comm, kind, degree):
    solid = make(comm, kind, degree)
    gradient = np.eye(3)
    gradient[: solid.dim, : solid.dim] += 0.2 * np.random.default_rng(1).uniform(
        -1, 1, (solid.dim, solid.dim)
    )
    chi = solid.X @ gradient.T
    F = by_id(solid, solid.force(chi, np.zeros_like(chi), 0.0))
    X = by_id(solid, solid.X)[:, : solid.dim]
    inside = np.all((X.min(axis=0) + 1e-9 < X) & (X.max(axis=0) - 1e-9 > X), axis=1)
    assert inside.any()
    assert np.abs(F[inside]).max() < 1e-12 * np.abs(F).max()
    assert solid.jacobian(chi) == pytest.approx(np.linalg.det(gradient), rel=1e-12)
    expected = np.linalg.det(gradient) * solid.reference_volume
    assert solid.volume(chi) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("kind", "degree"), KINDS)
def test_a_rigid_motion_gives_no_force(comm, kind, degree):
    solid = make(comm, kind, degree)
    c, s = np.cos(2.0), np.sin(2.0)
    chi = solid.X @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + [4.0, -1.0, 0.0]
    assert np.abs(solid.force(chi, np.zeros_like(chi), 0.0)).max(initial=0.0) < 1e-11


def test_the_volume_of_a_trilinear_deformation_is_exact(comm):
    solid = make(comm, "hexahedron")
    (x, y, z), (a, b, c) = solid.X.T, (0.05, -0.04, 0.03)
    chi = np.stack([x + a * y * z, y + b * x * z, z + c * x * y], axis=1)
    # det F integrated over (1, 2) x (2, 4) x (3, 4)
    squares = b * c * 2 * 7 / 3 + a * c * 56 / 3 + a * b * 2 * 37 / 3
    expected = 2 - squares + 2 * a * b * c * 1.5 * 6 * 3.5
    assert solid.volume(chi) == pytest.approx(expected, rel=1e-10)


def test_a_dead_load_adds_up_to_traction_times_area_and_follows_its_ramp(comm):
    load = DeadLoad(on=("top_loaded",), traction=(3.0, -200.0), ramp=Ramp(duration=20.0, shape="smooth"))
    for degree, cell in ((1, "quadrilateral"), (2, "triangle")):
        mesh = compressed_block(comm, elements=(8, 4), cell=cell)
        solid = Structure(mesh, MATERIAL, discretisation=Discretisation(degree=degree), loads=[load])
        for t, factor in ((0.0, 0.0), (10.0, 0.5), (5.0, 0.15625), (20.0, 1.0), (99.0, 1.0)):
            total = comm.allreduce(solid.force(solid.X, 0 * solid.X, t).sum(axis=0))
            np.testing.assert_allclose(total, [30.0 * factor, -2000.0 * factor, 0.0], atol=1e-9)
        report = solid.load_report()[0]
        assert report.measure == pytest.approx(10.0, rel=1e-12)
        assert report.value == (3.0, -200.0)


@pytest.mark.parametrize(("degree", "cell"), [(1, "quadrilateral"), (2, "quadrilateral"), (2, "triangle")])
def test_tethers_pull_back_and_damp_with_their_whole_area(comm, degree, cell):
    tethers = [
        Tether(on=TOP, components=("x",), stiffness=1e3, damping=7.0),
        Tether(on=("bottom",), components=("y",), stiffness=2e3),
        Tether(stiffness=5.0),
    ]
    mesh = compressed_block(comm, elements=(8, 4), cell=cell)
    solid = Structure(
        mesh, MATERIAL, discretisation=Discretisation(degree=degree), damping=4.0, tethers=tethers
    )
    shift, U = np.array([0.3, -0.2, 0.0]), np.array([0.5, 2.0, 0.0])
    F = solid.force(solid.X + shift, np.broadcast_to(U, solid.X.shape), 0.0)
    surface = -np.array([1e3 * 20 * shift[0], 2e3 * 20 * shift[1], 0.0])
    body = -5.0 * 200 * shift - 4.0 * 200 * U - np.array([7.0 * 20 * U[0], 0.0, 0.0])
    np.testing.assert_allclose(comm.allreduce(F.sum(axis=0)), surface + body, rtol=1e-12)
    assert [report.measure for report in solid.tether_report()] == pytest.approx([20.0, 20.0, 200.0])
    assert [report.value for report in solid.tether_report()] == [1e3, 2e3, 5.0]
    assert comm.allreduce(float(solid.weights.min(initial=1.0)), op=MPI.MIN) > 1e-3


@pytest.mark.parametrize(("kind", "degree"), KINDS)
def test_node_numbers_and_forces_do_not_depend_on_the_number_of_ranks(comm, kind, degree):
    tethers = [Tether(on=("x_lower",), stiffness=1e3)]
    loads = [DeadLoad(on=("y_upper",), traction=(0.0, -5.0))]
    shared = make(comm, kind, degree, damping=2.0, tethers=tethers, loads=loads)
    alone = make(MPI.COMM_SELF, kind, degree, damping=2.0, tethers=tethers, loads=loads)
    assert sorted(np.concatenate(comm.allgather(shared.ids)).tolist()) == list(range(alone.num_nodes))
    X = by_id(shared, shared.X)
    np.testing.assert_allclose(X, by_id(alone, alone.X), atol=1e-13)
    rows = np.round(X, 9).tolist()
    assert rows == sorted(rows)
    forces = [by_id(s, s.force(deformed(s), 0.1 * s.X, 1.0)) for s in (shared, alone)]
    np.testing.assert_allclose(*forces, atol=1e-12 * np.abs(forces[1]).max())
    assert shared.volume(deformed(shared)) == pytest.approx(alone.volume(deformed(alone)), rel=1e-13)
    assert shared.stiffness() == pytest.approx(alone.stiffness(), rel=1e-12)
    pictures = shared.cells_on_root(deformed(shared)), alone.cells_on_root(deformed(alone))
    assert (pictures[0] is None) == (comm.rank != 0)
    if comm.rank == 0:
        (points, cells, J), (points_1, cells_1, J_1) = pictures
        np.testing.assert_allclose(points, points_1, atol=1e-13)
        (shape, nodes), (shape_1, nodes_1) = *cells.items(), *cells_1.items()
        assert shape == shape_1
        np.testing.assert_array_equal(np.sort(nodes, axis=1), np.sort(nodes_1, axis=1))
        np.testing.assert_allclose(J, J_1, rtol=1e-12)


def test_picture_cells_go_round_in_order(comm):
    solid = make(comm)
    gathered = solid.cells_on_root(solid.X)
    if comm.rank == 0:
        points, cells, J = gathered
        x, y, _ = points[cells[9]].transpose(2, 1, 0)
        area = 0.5 * np.abs(sum(x[k] * y[(k + 1) % 4] - x[(k + 1) % 4] * y[k] for k in range(4)))
        np.testing.assert_allclose(area, 1 / 9, rtol=1e-10)
        np.testing.assert_allclose(J, 1.0, rtol=1e-12)


def test_nodes_within_round_off_get_the_numbers_of_their_exact_places(comm):
    i, j = np.meshgrid(np.arange(7), np.arange(5), indexing="ij")
    X = np.stack([i.ravel() * 0.1, j.ravel() / 3, np.full(35, 0.5)], axis=1)
    noise = np.random.default_rng(comm.size).uniform(-1, 1, X.shape) * 1e-15
    mine = np.arange(comm.rank, 35, comm.size)[::-1]
    np.testing.assert_array_equal(number_nodes((X + noise)[mine], comm), mine)


def test_two_nodes_at_one_place_are_refused_on_all_ranks(comm):
    X = np.array([[float(comm.rank), 0.0, 0.0], [float(comm.rank), 1e-14, 0.0], [float(comm.rank), 1.0, 0.0]])
    with pytest.raises(CaseError, match="same place"):
        number_nodes(X, comm)


def test_a_node_is_found_by_its_place_and_followed(comm):
    solid = make(comm)
    node = solid.node_at((2.0, 3.01))
    np.testing.assert_allclose(solid.position_of(node, solid.X), [2.0, 3.0, 0.5], atol=1e-12)
    chi = deformed(solid)
    expected = by_id(solid, chi)[node]
    np.testing.assert_array_equal(solid.position_of(node, chi), expected)
    assert solid.node_at((1.0, 2.0)) == 0


def test_an_inverted_cell_shows_as_nan_and_as_a_negative_volume_ratio(comm):
    solid = make(comm)
    chi = solid.X.copy()
    chi[solid.ids == solid.node_at((2.0, 3.0)), 1] -= 1.0
    F = solid.force(chi, np.zeros_like(chi), 0.0)
    assert comm.allreduce(int(np.isnan(F).sum())) > 0
    assert comm.allreduce(solid.jacobian(chi).min(initial=9.0), op=MPI.MIN) < 0


def test_forces_are_new_arrays_and_the_stabilisation_can_be_switched_off(comm):
    solid = make(comm)
    chi = deformed(solid)
    first = solid.force(chi, 0 * chi, 0.0)
    kept = first.copy()
    solid.force(solid.X, 0 * chi, 0.0)
    np.testing.assert_array_equal(first, kept)
    np.testing.assert_array_equal(solid.force(chi, 0 * chi, 0.0), kept)
    off = make(comm, nu_stab=None)
    assert off.kappa == 0
    assert off.energy(chi) < solid.energy(chi)
    swollen = off.X * [1.1, 1.1, 1.0]
    assert np.isfinite(off.force(swollen, 0 * chi, 0.0)).all()


def test_what_limits_the_step_is_reported(comm):
    mesh = compressed_block(comm, elements=(8, 4))
    tether = Tether(on=("bottom",), components=("y",), stiffness=1e5)
    solid = Structure(mesh, MooneyRivlin(c1=9000, c2=9000), damping=4.0, tethers=[tether])
    found = solid.stiffness()
    assert found.shear_modulus == 36000
    assert found.kappa == pytest.approx(168000)
    assert found.smallest_edge == pytest.approx(2.5)
    assert found.tether == pytest.approx(1e5 * 2.5)
    assert found.damping == pytest.approx(4.0 * 2.5**2)


@pytest.mark.parametrize(
    ("make_options", "message"),
    [
        (lambda: {"damping": -1.0}, "damping = -1.0"),
        (lambda: {"nu_stab": 0.5}, "nu_stab = 0.5"),
        (lambda: {"discretisation": Discretisation(degree=3)}, "degree = 3"),
        (lambda: {"discretisation": Discretisation(quadrature_degree=0)}, "quadrature_degree = 0"),
        (lambda: {"tethers": [Tether(on=("botom",), stiffness=1.0)]}, 'did you mean "bottom"'),
        (lambda: {"tethers": [Tether(on=(), stiffness=1.0)]}, "at least one tag"),
        (lambda: {"tethers": [Tether(on=("bottom", "block"), stiffness=1.0)]}, "only cells or only facets"),
        (lambda: {"tethers": [Tether(stiffness=-1.0)]}, "stiffness = -1.0"),
        (lambda: {"tethers": [Tether(stiffness=1.0, components=("u",))]}, "components"),
        (lambda: {"loads": [DeadLoad(on=("block",), traction=(0.0, 1.0))]}, "needs facets"),
        (lambda: {"loads": [DeadLoad(on=("bottom",), traction=(0.0, 1.0, 2.0))]}, "no z component"),
        (lambda: {"loads": [DeadLoad(on=("bottom",), traction=(1.0,))]}, "2 or 3 finite"),
        (lambda: {"loads": [DeadLoad(on="x", traction=(0.0, 1.0), ramp=Ramp(duration=-1.0))]}, "ramp = -1.0"),
    ],
)
def test_bad_input_is_one_clear_line(comm, make_options, message):
    mesh = compressed_block(comm, elements=(8, 4))
    with pytest.raises(CaseError) as caught:
        Structure(mesh, MATERIAL, **make_options())
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
