"""Stress and strain: closed forms, identities with the nodal forces, projection, ranks."""

from __future__ import annotations

import numpy as np
import pytest

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import ufl
from dolfinx import fem
from mpi4py import MPI

from valvefsi.errors import CaseError
from valvefsi.geometry.shapes import box, rectangle
from valvefsi.solid import statics
from valvefsi.solid.materials import MooneyRivlin, NeoHookean
from valvefsi.solid.stress import LABELS, QUANTITIES, Stress, stress_of_solution
from valvefsi.solid.structure import Discretisation, Structure
from valvefsi.solid.structure_stress import stress_of_structure

MATERIAL, KAPPA = NeoHookean(c1=50.0), 170.0
KINDS = ("triangle", "quadrilateral", "tetrahedron", "hexahedron")
TENSORS = ("pk1", "pk2", "cauchy")


def make_mesh(comm, kind):
    if kind in ("triangle", "quadrilateral"):
        return rectangle(comm, lower=(1, 2), size=(2, 1), elements=(4, 2), cell=kind)
    return box(comm, lower=(1, 2, 3), size=(1, 2, 1), elements=(2, 3, 2), cell=kind)


def displaced(comm, kind, function, degree=2):
    mesh = make_mesh(comm, kind).mesh
    u = fem.Function(fem.functionspace(mesh, ("Lagrange", degree, (mesh.geometry.dim,))))
    u.interpolate(function)
    return u


def homogeneous(comm, kind, F, **options):
    """The stress of a body under the linear map F ``(dim, dim)``."""
    H = F - np.eye(len(F))
    return Stress(displaced(comm, kind, lambda x: H @ x[: len(F)], 1), MATERIAL, kappa=KAPPA, **options)


def neo_hookean(F):
    """Cauchy stress of c1/2 (I1bar - 3) + kappa/2 (ln J)^2, from the text book, not from the energy."""
    J = np.linalg.det(F)
    b = F @ F.T * J ** (-2 / 3)
    return 50.0 / J * (b - np.trace(b) / 3 * np.eye(3)) + KAPPA * np.log(J) / J * np.eye(3)


def embedded(F):
    full = np.eye(3)
    full[: len(F), : len(F)] = F
    return full


@pytest.mark.parametrize("kind", KINDS)
def test_a_homogeneous_deformation_gives_the_closed_form_at_points_and_nodes(comm, kind):
    dim = 2 if kind in KINDS[:2] else 3
    F = np.eye(dim) + 0.3 * np.random.default_rng(3).uniform(-1, 1, (dim, dim))
    stress, full = homogeneous(comm, kind, F), embedded(F)
    sigma, J = neo_hookean(full), np.linalg.det(full)
    deviator = sigma - np.trace(sigma) / 3 * np.eye(3)
    pk1 = J * sigma @ np.linalg.inv(full).T
    expected = {
        "pk1": pk1,
        "pk2": np.linalg.inv(full) @ pk1,
        "cauchy": sigma,
        "principal_stresses": np.linalg.eigvalsh(sigma)[::-1],
        "von_mises": np.sqrt(1.5 * (deviator**2).sum()),
        "principal_stretches": np.sqrt(np.linalg.eigvalsh(full.T @ full))[::-1],
        "J": J,
    }
    points, nodes = stress.at_points(*expected), stress.at_nodes(*expected)
    for name, value in expected.items():
        np.testing.assert_allclose(
            points[name], np.broadcast_to(value, points[name].shape), rtol=1e-10, atol=1e-9
        )
        at_nodes = nodes[name].x.array.reshape(-1, np.size(value))
        np.testing.assert_allclose(
            at_nodes, np.tile(np.ravel(value), (len(at_nodes), 1)), rtol=1e-8, atol=1e-7
        )


def test_plane_strain_carries_a_stress_out_of_its_plane(comm):
    F = np.array([[1.2, 0.1], [0.0, 0.9]])
    sigma = homogeneous(comm, "triangle", F).at_points("cauchy")["cauchy"]
    assert np.all(np.abs(sigma[..., 2, 2]) > 1.0)
    np.testing.assert_allclose(sigma[..., 2, 2], neo_hookean(embedded(F))[2, 2], rtol=1e-10)


@pytest.mark.parametrize("kind", ["quadrilateral", "tetrahedron"])
def test_a_rotation_changes_no_stretch_and_no_invariant_of_the_stress(comm, kind):
    dim = 2 if kind == "quadrilateral" else 3
    F = np.eye(dim) + 0.2 * np.random.default_rng(5).uniform(-1, 1, (dim, dim))
    Q = np.eye(dim)
    Q[:2, :2] = [[0.6, -0.8], [0.8, 0.6]]
    names = ("pk2", "von_mises", "principal_stresses", "principal_stretches", "fibre_stretch", "J")
    fibre = (1.0, *[0.0] * (dim - 1))
    one, two = (homogeneous(comm, kind, G, fibre=fibre).at_points(*names) for G in (F, Q @ F))
    for name in names:
        np.testing.assert_allclose(one[name], two[name], rtol=1e-9, atol=1e-8)
    full = embedded(Q)
    sigma, turned = (homogeneous(comm, kind, G).at_points("cauchy")["cauchy"] for G in (F, Q @ F))
    np.testing.assert_allclose(full @ sigma @ full.T, turned, atol=1e-8)


def test_the_fibre_stretch_is_the_length_of_the_deformed_fibre(comm):
    F = np.array([[1.4, 0.3], [0.1, 0.8]])
    for angle in (0.0, 30.0, 90.0):
        a = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
        found = homogeneous(comm, "quadrilateral", F, fibre=angle).at_points("fibre_stretch")["fibre_stretch"]
        np.testing.assert_allclose(found, np.linalg.norm(F @ a), rtol=1e-12)


@pytest.mark.parametrize(("kind", "degree"), [("triangle", 1), ("quadrilateral", 2), ("hexahedron", 1)])
def test_the_integral_of_P_is_the_moment_of_the_nodal_forces(comm, kind, degree):
    discretisation = Discretisation(degree=degree, quadrature_degree=4)
    body = Structure(
        make_mesh(comm, kind), MooneyRivlin(c1=20.0, c2=7.0), nu_stab=0.4, discretisation=discretisation
    )
    chi = body.X.copy()
    chi[:, 0] += 0.06 * np.sin(2 * body.X[:, 1] + body.X[:, 0])
    chi[:, 1] += 0.05 * np.cos(2 * body.X[:, 0])
    force = body.force(chi, np.zeros_like(chi), 0.0)
    moment = comm.allreduce(np.einsum("ki,kj->ij", force, body.X))
    P = stress_of_structure(body, quadrature_degree=4).at_nodes("pk1")["pk1"]
    dX = ufl.dx(domain=body.mesh.mesh, degree=4)
    total = [comm.allreduce(fem.assemble_scalar(compat.compile_form(P[i] * dX))) for i in range(9)]
    total = np.array(total).reshape(3, 3)[: body.dim, : body.dim]
    np.testing.assert_allclose(-moment[: body.dim, : body.dim], total, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_projection_keeps_what_is_linear(comm, kind):
    def bend(x):
        u = np.zeros((2 if kind in KINDS[:2] else 3, x.shape[1]))
        u[0] = 0.1 * x[0] ** 2
        return u

    u = displaced(comm, kind, bend)
    J = Stress(u, MATERIAL, kappa=KAPPA).at_nodes("J")["J"]
    X = J.function_space.tabulate_dof_coordinates()
    np.testing.assert_allclose(J.x.array, 1 + 0.2 * X[:, 0], rtol=1e-9)


def test_an_incompressible_bar_pulled_along_one_axis_has_the_textbook_stress(comm):
    mesh = box(comm, elements=(2, 2, 2), cell="hexahedron")
    sides = [statics.Fixed(on=(f"{axis}_lower",), components=(axis,)) for axis in "xyz"]
    pull = statics.Fixed(
        on=("x_upper",), components=("x",), value=lambda X, s: 0.5 * s * np.eye(3)[0] + 0 * X
    )
    solution = statics.solve(mesh, MATERIAL, fixed=[*sides, pull])
    found = stress_of_solution(solution, MATERIAL).at_points(
        "cauchy", "von_mises", "J", "principal_stretches"
    )
    sigma = np.zeros((3, 3))
    sigma[0, 0] = 50.0 * (1.5**2 - 1 / 1.5)
    np.testing.assert_allclose(found["cauchy"], np.broadcast_to(sigma, found["cauchy"].shape), atol=1e-6)
    np.testing.assert_allclose(found["von_mises"], sigma[0, 0], rtol=1e-7)
    np.testing.assert_allclose(found["J"], 1.0, rtol=1e-9)
    stretches = np.broadcast_to([1.5, 1.5**-0.5, 1.5**-0.5], found["principal_stretches"].shape)
    np.testing.assert_allclose(found["principal_stretches"], stretches, rtol=1e-8)


def wave(x):
    return np.stack([0.05 * np.sin(2 * x[1]), 0.04 * x[0] * x[1]])


def test_what_is_gathered_does_not_depend_on_the_number_of_ranks(comm):
    shared = Stress(displaced(comm, "triangle", wave), MATERIAL, kappa=KAPPA).gather()
    if comm.rank != 0:
        assert shared is None
        return
    alone = Stress(displaced(MPI.COMM_SELF, "triangle", wave), MATERIAL, kappa=KAPPA).gather()
    for one, two in zip(shared, alone, strict=True):
        assert type(one) is type(two)
        pairs = ((one[k], two[k]) for k in one) if isinstance(one, dict) else ((one, two),)
        for a, b in pairs:
            np.testing.assert_allclose(a, b, atol=1e-7)
    points, cells, fields, reference = shared
    assert set(fields) == {LABELS[name] for name in QUANTITIES if name != "fibre_stretch"}
    np.testing.assert_allclose(points[:, :2] - reference[:, :2], wave(reference.T).T, atol=1e-12)
    assert cells.keys() == {69}
    assert sum(len(c) for c in cells.values()) == 16


def test_von_mises_at_nodes_is_never_negative(comm):
    u = displaced(comm, "triangle", lambda x: np.stack([0.3 * np.abs(x[1] - 2.5), 0 * x[0]]))
    nodes = Stress(u, MATERIAL, kappa=KAPPA).at_nodes("von_mises")["von_mises"]
    assert nodes.x.array.min(initial=np.inf) >= 0


def test_unknown_quantities_and_missing_fibres_are_refused(comm):
    stress = homogeneous(comm, "triangle", np.eye(2))
    with pytest.raises(CaseError, match="expected one of pk1"):
        stress.at_points("strain")
    with pytest.raises(CaseError, match="no fibres"):
        stress.at_points("fibre_stretch")
