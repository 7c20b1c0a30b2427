"""The solid-shell element: identities, zero-energy modes, patches, bending against incompressible elements."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.runtime import dolfinx_compat  # noqa: F401  (before ufl)

# isort: split
import ufl

from valvefsi.bodies.elastic import Elastic
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import CaseError
from valvefsi.geometry.shapes import box, rectangle
from valvefsi.grid import MacGrid
from valvefsi.solid import statics
from valvefsi.solid.elements.shell_kinematics import (
    Metric,
    ShellKinematics,
    StressFreeKinematics,
    assumed_shear,
    assumed_thickness,
    base_vectors,
)
from valvefsi.solid.elements.shell_layers import thickness_axes
from valvefsi.solid.loads import Pressure
from valvefsi.solid.materials import LeeSacks, NeoHookean, SaintVenantKirchhoff, fibres
from valvefsi.solid.materials.fibre_reinforced import HGO, FibreFamily
from valvefsi.solid.statics import Fixed, SolidShell, TaylorHood
from valvefsi.solid.structure import Discretisation, Structure
from valvefsi.solid.structure_stress import stress_of_structure

SHELL = {"element": "solid_shell", "kappa": 400.0}
SOFT = NeoHookean(c1=3.0)
PERICARDIUM = LeeSacks(c0=676080.0, c1=132848.0, c2=38.1878)
PORCINE = HGO(c10=1.21e4, c01=7.99, families=(FibreFamily(k1=2.426e5, k2=57.62, fibre="fibre"),))
ELASTIC = SaintVenantKirchhoff(mu=3.0, lam=4.0)
SHEARED = np.array([[1.05, 0.03, 0.0], [0.01, 0.97, 0.0], [0.0, 0.0, 1.0]])


def strip(comm, *, size=(1.0, 0.5, 0.04), elements=(4, 3, 1), warp=0.0, radius=None, angle=None):
    """A strip in the plane z = 0 that has been warped in its plane and rolled around the y axis."""
    mesh = box(comm, lower=(0.0, 0.0, -size[2] / 2), size=size, elements=elements)
    X = mesh.mesh.geometry.x
    bump = warp * np.sin(math.pi * X[:, 0] / size[0]) * np.sin(math.pi * X[:, 1] / size[1])
    X[:, 0] += bump
    X[:, 1] -= 0.6 * bump
    if radius:
        turn, r = X[:, 0] / radius, radius + X[:, 2]
        X[:, 0], X[:, 2] = r * np.sin(turn), r * np.cos(turn) - radius
    if angle is None:
        return mesh

    def along(x):
        turn = np.arctan2(x[:, 0], x[:, 2] + radius) if radius else np.zeros(len(x))
        c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
        return np.stack([c * np.cos(turn), s + 0 * turn, -c * np.sin(turn)], axis=1)

    return mesh.with_fibres(fibre=fibres.from_function(mesh, along))


def shell(mesh, material=SOFT, **options):
    return Structure(mesh, material, discretisation=Discretisation(**SHELL | options))


def own_bulk(material):
    """The option of an element whose material holds its thickness by itself."""
    return {"kappa": None} if material is ELASTIC else {}


def moved(X):
    """A deformation that bends, twists, shears and thickens, the same on any number of ranks."""
    x, y, z = X.T
    u = np.stack([0.1 * y * z - 0.05 * x**2, 0.08 * x * y, 0.2 * x**2 + 0.1 * x * y + 0.02 * z], axis=1)
    return X + u


def elastic(solid, chi):
    return solid.elasticity.force(chi).copy()


@pytest.mark.parametrize("material", [SOFT, PORCINE, ELASTIC], ids=["isotropic", "fibres", "compressible"])
def test_forces_are_minus_the_gradient_of_the_energy(comm, material):
    solid = shell(strip(comm, warp=0.05, radius=1.2, angle=30.0), material, **own_bulk(material))
    chi, step = moved(solid.X), 1e-6
    d = np.sin(7.0 * solid.X + np.arange(3))
    slope = (solid.energy(chi + step * d) - solid.energy(chi - step * d)) / (2 * step)
    work = comm.allreduce(float(np.vdot(elastic(solid, chi), d)))
    assert -work == pytest.approx(slope, rel=1e-7)


def test_a_rotation_turns_the_forces_and_keeps_the_energy(comm):
    solid = shell(strip(comm, warp=0.05, radius=1.2, angle=30.0), PORCINE)
    chi = moved(solid.X)
    Q, _ = np.linalg.qr(np.array([[1.0, 2.0, 0.5], [-1.0, 1.0, 2.0], [0.3, -2.0, 1.0]]))
    Q *= np.linalg.det(Q)
    F = elastic(solid, chi)
    scale = comm.allreduce(float(np.abs(F).max(initial=0.0)), op=MPI.MAX)
    np.testing.assert_allclose(elastic(solid, chi @ Q.T + 1.0), F @ Q.T, atol=1e-9 * scale)
    assert solid.energy(chi @ Q.T) == pytest.approx(solid.energy(chi), rel=1e-10)
    assert comm.allreduce(float(np.abs(elastic(solid, solid.X)).max(initial=0.0)), op=MPI.MAX) < 1e-9 * scale


@pytest.mark.parametrize("material", [SOFT, ELASTIC], ids=["incompressible", "compressible"])
def test_there_are_six_modes_without_energy_and_no_more(material):
    # one element, warped, wedge-shaped: stiffness by differences of the forces
    solid = shell(strip(MPI.COMM_SELF, size=(0.1, 0.1, 0.03), elements=(1, 1, 1), radius=0.3))
    chi = solid.X + 0.004 * np.sin(50 * solid.X[:, [1, 2, 0]])
    solid = shell(_placed(chi), material, **own_bulk(material))
    step, n = 1e-7, chi.size
    K = np.empty((n, n))
    for k, d in enumerate(np.eye(n).reshape(n, -1, 3)):
        K[:, k] = -(elastic(solid, solid.X + step * d) - elastic(solid, solid.X - step * d)).ravel() / (
            2 * step
        )
    values = np.linalg.eigvalsh(0.5 * (K + K.T)) / (material.shear_modulus * 0.1)
    assert np.abs(values[:6]).max() < 1e-6
    assert values[6] > 1e-3


def _placed(X):
    """A mesh of one element with these corners, in the order of its nodes."""
    mesh = strip(MPI.COMM_SELF, size=(0.1, 0.1, 0.03), elements=(1, 1, 1), radius=0.3)
    solid = shell(mesh)
    for x in mesh.mesh.geometry.x:
        x[:] = X[np.argmin(np.linalg.norm(solid.X - x, axis=1))]
    return mesh


def test_the_stiffness_of_a_brick_at_rest_is_that_of_its_strains():
    """Linear strains by shape functions: layers as a plane sheet without volume change, shear of the edges, volume."""
    size = (0.1, 0.08, 0.03)
    solid = shell(box(MPI.COMM_SELF, size=size, elements=(1, 1, 1)))
    corners = np.where(solid.X > 1e-9, 1, -1)
    d, step = np.random.default_rng(4).standard_normal(solid.X.shape), 1e-6
    found = (elastic(solid, solid.X - step * d) - elastic(solid, solid.X + step * d)) / (2 * step)

    def strain(at):  # symmetric gradient of the displacement d
        one = 1 + corners * at
        slopes = [corners[:, i] * np.delete(one, i, axis=1).prod(axis=1) / 8 @ d for i in range(3)]
        gradient = np.stack(slopes, axis=1) * 2 / size
        return 0.5 * (gradient + gradient.T)

    g, volume = 1 / math.sqrt(3), math.prod(size)
    places = [(i * g, j * g) for i in (-1, 1) for j in (-1, 1)]
    energy = 0.0
    for (x, y), (z, weight) in itertools.product(places, ((-math.sqrt(0.6), 5), (0, 8), (math.sqrt(0.6), 5))):
        e = strain((x, y, z))
        e[2, 2] = -e[0, 0] - e[1, 1]
        for i, middles in ((0, ((0, -1), (0, 1))), (1, ((-1, 0), (1, 0)))):
            ends = [strain((*middle, 0))[i, 2] for middle in middles]
            share = (1 + (y, x)[i]) / 2
            e[i, 2] = e[2, i] = (1 - share) * ends[0] + share * ends[1]
        energy += SOFT.c1 * np.sum(e**2) * volume / 4 * weight / 18
    growth = [np.trace(strain((x, y, 0))) for x, y in places]
    columns = 2 / 3 * SOFT.c1  # bulk modulus of nu = 0
    energy += columns / 2 * np.mean(np.square(growth)) * volume
    energy += (SHELL["kappa"] - columns) / 2 * np.mean(growth) ** 2 * volume
    assert 0.5 * np.vdot(found, d) == pytest.approx(energy, rel=1e-6)


@pytest.mark.parametrize("layers", [1, 2])
def test_a_patch_of_warped_elements_keeps_a_constant_strain(comm, layers):
    # stretched and sheared in its plane, thinned to the same volume: no stress on its faces, so none on inner nodes
    solid = shell(strip(comm, elements=(4, 3, layers), warp=0.06))
    A = SHEARED.copy()
    A[2, 2] = 1 / np.linalg.det(SHEARED)
    F = elastic(solid, solid.X @ A.T)
    x, y, _ = solid.X.T
    inner = (x > 1e-9) & (x < 1 - 1e-9) & (y > 1e-9) & (y < 0.5 - 1e-9)
    scale = comm.allreduce(float(np.abs(F).max(initial=0.0)), op=MPI.MAX)
    assert comm.allreduce(int(inner.sum())) == 6 * (layers + 1)
    assert np.abs(F[inner]).max(initial=0.0) < 1e-10 * scale
    expected = SOFT.c1 / 2 * (np.sum(A**2) - 3) * 0.02
    assert solid.energy(solid.X @ A.T) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("layers", [1, 2])
def test_a_patch_of_compressible_elements_has_the_energy_and_stress_of_its_strain(comm, layers):
    # stretched, sheared and swollen: all of E, that along the normal included, is what W takes it for
    solid = shell(strip(comm, elements=(4, 3, layers), warp=0.06), ELASTIC, kappa=None)
    A = SHEARED.copy()
    A[2, 2] = 1.01
    E = (A.T @ A - np.eye(3)) / 2
    expected = (ELASTIC.lam / 2 * np.trace(E) ** 2 + ELASTIC.mu * np.sum(E**2)) * 0.02
    assert solid.energy(solid.X @ A.T) == pytest.approx(expected, rel=1e-10)
    F = elastic(solid, solid.X @ A.T)
    x, y, _ = solid.X.T
    inner = (x > 1e-9) & (x < 1 - 1e-9) & (y > 1e-9) & (y < 0.5 - 1e-9) & (abs(solid.X[:, 2]) < 0.019)
    scale = comm.allreduce(float(np.abs(F).max(initial=0.0)), op=MPI.MAX)
    assert np.abs(F[inner]).max(initial=0.0) < 1e-10 * scale
    found = stress_of_structure(solid).at_points("pk2")["pk2"]
    S = ELASTIC.lam * np.trace(E) * np.eye(3) + 2 * ELASTIC.mu * E
    np.testing.assert_allclose(found, np.broadcast_to(S, found.shape), atol=1e-9 * abs(S).max())


def test_the_stress_of_a_flat_strip_is_that_of_plane_stress(comm):
    mesh = strip(comm, warp=0.06, angle=30.0)
    solid = shell(mesh, PORCINE)
    A = SHEARED.copy()
    A[2, 2] = 1 / np.linalg.det(SHEARED)
    solid.jacobian(solid.X @ A.T)
    found = stress_of_structure(solid, fibres=mesh.fibres, fibre="fibre")
    values = found.at_points("cauchy", "principal_stretches", "fibre_stretch", "J")
    B, a = A @ A.T, A @ np.array([math.cos(math.radians(30)), 0.5, 0.0])
    family, excess = PORCINE.families[0], np.trace(B) - 3
    stretch = max(a @ a, 1.0) - 1
    sigma = 2 * PORCINE.c10 * PORCINE.c01 * math.exp(PORCINE.c01 * excess) * B
    sigma = sigma + 2 * family.k1 * stretch * math.exp(family.k2 * stretch**2) * np.outer(a, a)
    sigma = sigma - sigma[2, 2] * np.eye(3)
    np.testing.assert_allclose(
        values["cauchy"], np.broadcast_to(sigma, values["cauchy"].shape), atol=1e-9 * sigma.max()
    )
    stretches = np.broadcast_to(np.linalg.svd(A, compute_uv=False), values["principal_stretches"].shape)
    np.testing.assert_allclose(values["principal_stretches"], stretches, rtol=1e-12)
    np.testing.assert_allclose(values["fibre_stretch"], np.linalg.norm(a), rtol=1e-12)
    np.testing.assert_allclose(values["J"], 1.0, rtol=1e-12)


def test_swelling_is_held_by_the_bulk_modulus_alone(comm):
    solid = shell(strip(comm), volumetric="quadratic")
    chi = solid.X * np.array([1.0, 1.0, 1.02])
    assert solid.energy(chi) == pytest.approx(0.5 * 400.0 * 0.02**2 * 0.02, rel=1e-10)
    assert solid.volume(chi) == pytest.approx(1.02 * 0.02, rel=1e-12)
    np.testing.assert_allclose(solid.jacobian(chi), 1.02, rtol=1e-12)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_thickness_is_found_along_any_axis_even_where_it_is_the_longest_edge(comm, axis):
    counts, size = np.roll([8, 6, 2], axis - 2), np.roll([0.8, 0.6, 0.4], axis - 2)  # edges of 1, 1 and 2 mm
    mesh = box(comm, size=tuple(map(float, size)), elements=tuple(map(int, counts)))
    assert set(thickness_axes(mesh)) <= {axis}


@pytest.mark.parametrize("elements", [(12, 1, 2), (12, 2, 3), (12, 2, 5), (1, 1, 1), (12, 4, 4)])
def test_a_narrow_strip_of_several_layers_is_thin_where_it_is(comm, elements):
    """More layers than elements across: the sheet's own thickness counts, not the number of its elements."""
    mesh = box(comm, size=(0.9, 0.3, 0.03), elements=elements)
    assert set(thickness_axes(mesh)) <= {2}


@pytest.mark.parametrize("angle", [0.0, 14.0, 27.0])
def test_the_slant_of_the_thickness_is_measured_and_warned_of(comm, angle):
    mesh = strip(comm)
    mesh.mesh.geometry.x[:, 0] += math.tan(math.radians(angle)) * mesh.mesh.geometry.x[:, 2]
    solid = shell(mesh)
    assert solid.elasticity.slant == pytest.approx(angle, abs=1e-9)
    grid = MacGrid([-1, -1, -1], [2, 2, 2], [12, 12, 12], [True] * 3, comm)
    notes = [entry.note for entry in Elastic(solid, Coupling(grid, "bspline3")).size(grid)]
    assert sum(f"slant by up to {angle:.0f} degrees" in note for note in notes) == (angle > 0.0)


def test_the_slant_is_the_largest_of_all_ranks(comm):
    mesh = strip(comm, size=(2.0, 0.2, 0.04), elements=(16, 2, 1))
    x, _, z = mesh.mesh.geometry.x.T
    x += math.tan(math.radians(20.0)) * z * np.clip(8.0 * (x - 1.5), 0.0, 1.0)
    assert shell(mesh).elasticity.slant == pytest.approx(20.0, abs=1e-9)


def test_forces_do_not_depend_on_the_number_of_ranks(comm):
    alone, together = (
        shell(strip(c, elements=(6, 4, 2), warp=0.05, radius=1.2, angle=30.0), PORCINE)
        for c in (MPI.COMM_SELF, comm)
    )
    expected, F = elastic(alone, moved(alone.X)), elastic(together, moved(together.X))
    order = np.empty_like(alone.ids)
    order[alone.ids] = np.arange(len(alone.ids))
    np.testing.assert_allclose(F, expected[order[together.ids]], atol=1e-10 * np.abs(expected).max())
    for quantity in ("energy", "volume"):
        values = [getattr(solid, quantity)(moved(solid.X)) for solid in (alone, together)]
        assert values[1] == pytest.approx(values[0], rel=1e-12)


@pytest.mark.parametrize(
    ("layers", "radius", "angle", "material"),
    [
        (1, None, None, PERICARDIUM),
        (2, 1.2, None, PERICARDIUM),
        (1, 1.2, 0.0, PORCINE),
        (1, None, 45.0, PORCINE),
    ],
)
def test_strips_bend_as_incompressible_elements_do(comm, layers, radius, angle, material):
    """A cantilever of 10 x 5 x 0.4 mm with elements of 1 mm under pressure, kappa as large as the demos'."""
    load = Pressure(on=("z_lower",), value=0.12 * 4 * material.shear_modulus * 0.04**3 / 12)
    tips = []
    for elements, formulation in (((8, 4, 2), TaylorHood()), ((10, 4, layers), SolidShell(kappa=1e8))):
        mesh = strip(comm, elements=elements, radius=radius, angle=angle)
        options = statics.SolverOptions(quadrature_degree=7, first_increment=1.0)
        held = [Fixed(on=("x_lower",))]
        solution = statics.solve(
            mesh, material, fixed=held, loads=[load], formulation=formulation, options=options
        )
        tips.append(np.linalg.norm(solution.displacement_at(_end(radius))))
    assert tips[1] == pytest.approx(tips[0], rel=0.05)


def _end(radius):
    """The middle of the strip's end."""
    if radius is None:
        return 1.0, 0.25, 0.0
    turn = 1.0 / radius
    return (radius * math.sin(turn) - 1e-9, 0.25, radius * math.cos(turn) - radius)


def test_what_the_element_cannot_be_is_refused(comm):
    with pytest.raises(CaseError, match=r"element.*expected one of lagrange, solid_shell"):
        Discretisation(element="shell")
    with pytest.raises(CaseError, match="degree.*solid-shell elements are of degree 1"):
        Discretisation(element="solid_shell", degree=2)
    with pytest.raises(CaseError, match="solid-shell elements are hexahedra"):
        shell(rectangle(comm))
    with pytest.raises(CaseError, match="kappa.*give nu_stab or kappa"):
        Structure(strip(comm), SOFT, nu_stab=None, discretisation=Discretisation(element="solid_shell"))
    with pytest.raises(CaseError, match="kappa.*a volumetric part of its own"):
        shell(strip(comm), ELASTIC)


def test_the_elements_of_a_mesh_that_is_seen_in_a_mirror_have_the_same_energy(comm):
    meshes = [strip(comm, warp=0.05, radius=1.2) for _ in range(2)]
    meshes[1].mesh.geometry.x[:, 1] *= -1
    energies = [
        solid.energy(moved(solid.X * flip) * flip)
        for solid, flip in zip(map(shell, meshes), MIRRORS, strict=True)
    ]
    assert energies[1] == pytest.approx(energies[0], rel=1e-10)
    assert energies[0] > 0


MIRRORS = (np.ones(3), np.array([1.0, -1.0, 1.0]))


def test_shear_and_thickness_are_those_of_the_trilinear_map_at_the_middles_of_the_edges():
    """Base vectors and sampled shear from the corners by shape functions, of any position; the sampling is linear."""
    corners = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)])
    x = np.random.default_rng(8).standard_normal((8, 3))

    def bases(xi, eta, zeta):
        one = 1 + corners * (xi, eta, zeta)
        slopes = [corners[:, i] * np.delete(one, i, axis=1).prod(axis=1) / 8 for i in range(3)]
        return [slope @ x for slope in slopes]

    powers = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 0, 1), (0, 1, 1), (1, 1, 1)]
    m = np.array([(corners ** np.array(p)).prod(axis=1) @ x / 8 for p in powers])
    at = (0.3, -0.6, 0.4)
    monomials = ufl.as_matrix(m.tolist())
    for own, vector in zip(base_vectors(monomials, at), bases(*at), strict=True):
        np.testing.assert_allclose([float(own[d](())) for d in range(3)], vector, atol=1e-13)
    (g1, _, g3), (h1, _, h3) = bases(0, -1, 0), bases(0, 1, 0)
    expected_13 = 0.5 * ((1 - at[1]) * (g1 @ g3) + (1 + at[1]) * (h1 @ h3))
    (_, g2, g3), (_, h2, h3) = bases(-1, 0, 0), bases(1, 0, 0)
    expected_23 = 0.5 * ((1 - at[0]) * (g2 @ g3) + (1 + at[0]) * (h2 @ h3))
    found = [float(part(())) for part in assumed_shear(monomials, at)]
    np.testing.assert_allclose(found, [expected_13, expected_23], rtol=1e-12)
    edges = [(i, j, bases(i, j, 0)[2]) for i in (-1, 1) for j in (-1, 1)]
    expected_33 = sum((1 + i * at[0]) * (1 + j * at[1]) / 4 * (g3 @ g3) for i, j, g3 in edges)
    assert float(assumed_thickness(monomials, at)(())) == pytest.approx(expected_33, rel=1e-12)


def test_the_kinematics_of_an_incompressible_deformation_are_those_of_its_gradient():
    """C, its invariants and F^T F from the metric but for c_33, against the same from F with det F = 1."""
    rng = np.random.default_rng(9)
    F, frame = np.eye(3) + 0.3 * rng.standard_normal((3, 3)), np.eye(3) + 0.2 * rng.standard_normal((3, 3))
    F /= np.cbrt(np.linalg.det(F))
    C, (f, s) = F.T @ F, np.linalg.qr(rng.standard_normal((3, 2)))[0].T
    s = (f + s) / np.sqrt(2)  # unit vectors, not at right angles
    c = frame @ C @ frame.T  # rows of the frame are G_i
    kinematics = ShellKinematics(
        Metric(c11=c[0, 0], c22=c[1, 1], c12=c[0, 1], c13=c[0, 2], c23=c[1, 2]),
        tuple(ufl.as_vector(G.tolist()) for G in frame),
        {"f": ufl.as_vector(f.tolist()), "s": ufl.as_vector(s.tolist())},
    )
    found_F = np.array([[float(kinematics.F[i, j](())) for j in range(3)] for i in range(3)])
    np.testing.assert_allclose(found_F.T @ found_F, C, rtol=1e-10, atol=1e-12)
    found_C = [[float(kinematics.C[i, j](())) for j in range(3)] for i in range(3)]
    np.testing.assert_allclose(found_C, C, rtol=1e-10, atol=1e-12)
    expected = [np.trace(C), 0.5 * (np.trace(C) ** 2 - np.trace(C @ C)), f @ C @ s]
    invariants = [kinematics.I1, kinematics.I2, kinematics.I8("f", "s")]
    np.testing.assert_allclose([float(part(())) for part in invariants], expected, rtol=1e-10)


def test_a_compressible_material_thins_so_that_no_stress_acts_along_the_normal_of_any_frame():
    rng = np.random.default_rng(10)
    frame = np.eye(3) + 0.3 * rng.standard_normal((3, 3))  # rows are G_i, not at right angles
    F = np.eye(3) + 0.2 * rng.standard_normal((3, 3))
    c = frame @ F.T @ F @ frame.T
    kinematics = StressFreeKinematics(
        Metric(c11=c[0, 0], c22=c[1, 1], c12=c[0, 1], c13=c[0, 2], c23=c[1, 2]),
        tuple(ufl.as_vector(G.tolist()) for G in frame),
        None,
        ELASTIC.thinning,
    )
    C = np.array([[float(kinematics.C[i, j](())) for j in range(3)] for i in range(3)])
    found = frame @ C @ frame.T
    found[2, 2] = c[2, 2]
    np.testing.assert_allclose(found, c, atol=1e-12)
    E, normal = (C - np.eye(3)) / 2, np.cross(frame[0], frame[1])
    S = ELASTIC.lam * np.trace(E) * np.eye(3) + 2 * ELASTIC.mu * E
    assert abs(normal @ S @ normal) < 1e-10 * abs(S).max() * (normal @ normal)
    J = math.sqrt(np.linalg.det(C))
    assert float(kinematics.J(())) == pytest.approx(J, rel=1e-12)
    I1, I2 = np.trace(C), 0.5 * (np.trace(C) ** 2 - np.trace(C @ C))
    assert float(kinematics.I1_bar(())) == pytest.approx(J ** (-2 / 3) * I1, rel=1e-12)
    assert float(kinematics.I2_bar(())) == pytest.approx(J ** (-4 / 3) * I2, rel=1e-12)
