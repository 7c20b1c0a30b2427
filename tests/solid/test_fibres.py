"""Fibre fields: rules, data, their checks, and what a body with fibres does."""

from __future__ import annotations

import math

import numpy as np
import pytest

from valvefsi.runtime import dolfinx_compat  # noqa: F401

# isort: split
from dolfinx import fem

from valvefsi.errors import CaseError
from valvefsi.geometry.shapes import box, rectangle
from valvefsi.solid import statics
from valvefsi.solid.loads import DeadLoad
from valvefsi.solid.materials import fibres
from valvefsi.solid.materials.fibre_reinforced import HGO, FibreFamily, Fung, HolzapfelOgden
from valvefsi.solid.structure import Discretisation, Structure


def values(field):
    """Vectors and their places, of this rank's own cells."""
    space = field.function_space
    n, dim = space.dofmap.index_map.size_local, space.dofmap.index_map_bs
    return field.x.array[: n * dim].reshape(n, dim), space.tabulate_dof_coordinates()[:n]


def hgo(fibre, **family):
    return HGO(c10=100.0, c01=1.0, families=[FibreFamily(k1=500.0, k2=1.0, fibre=fibre, **family)])


def test_a_constant_field_is_made_unit(comm):
    for mesh, given in (
        (rectangle(comm), (3.0, 4.0)),
        (box(comm, elements=(2, 2, 2)), (0.0, -2.0, 0.0)),
    ):
        vectors, _ = values(fibres.constant(mesh, given))
        np.testing.assert_allclose(vectors, np.broadcast_to(given, vectors.shape) / math.hypot(*given))
    with pytest.raises(CaseError, match="expected 3 components"):
        fibres.constant(mesh, (1.0, 0.0))
    for given in ((0.0, 0.0, 0.0), (1.0, math.nan, 0.0)):
        with pytest.raises(CaseError, match="fibres are zero or not finite"):
            fibres.constant(mesh, given)


@pytest.mark.parametrize("degree", [0, 1])
@pytest.mark.parametrize("angle", [0.0, 45.0, -45.0])
def test_circumferential_fibres_make_their_angle_with_the_circle(comm, angle, degree):
    mesh = box(comm, lower=(1, 2, 3), elements=(3, 2, 2), cell="tetrahedron")
    axis, through = np.array([1.0, 2.0, 2.0]) / 3, np.array([-1.0, 0.5, 0.0])
    vectors, X = values(
        fibres.circumferential(mesh, axis=3 * axis, through=through, angle=angle, degree=degree)
    )
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(vectors @ axis, math.sin(math.radians(angle)), atol=1e-12)
    radius = X - through
    radius -= np.outer(radius @ axis, axis)
    np.testing.assert_allclose(np.einsum("ij,ij->i", vectors, radius), 0.0, atol=1e-12)
    circle = np.cross(axis, radius)
    assert np.all(np.einsum("ij,ij->i", vectors, circle) > 0)


def test_in_the_plane_the_angle_turns_from_the_circle_to_the_radius(comm):
    mesh = rectangle(comm, lower=(1, 1))
    vectors, X = values(fibres.circumferential(mesh, angle=30.0))
    radius = X[:, :2] / np.linalg.norm(X[:, :2], axis=1, keepdims=True)
    np.testing.assert_allclose(np.einsum("ij,ij->i", vectors, radius), 0.5, rtol=1e-12)


def test_a_fibre_on_the_axis_is_refused(comm):
    mesh = rectangle(comm, elements=(3, 3))
    with pytest.raises(CaseError, match="1 fibres are zero or not finite"):
        fibres.circumferential(mesh, through=(0.5, 0.5))
    with pytest.raises(CaseError, match="axis"):
        fibres.circumferential(box(comm, elements=(2, 2, 2)), axis=(0, 0, 0))


def test_a_blend_turns_evenly_through_a_flat_wall(comm):
    mesh = box(comm, size=(2.0, 1.0, 1.0), elements=(8, 2, 2))
    vectors, X = values(fibres.blend(mesh, {"x_lower": 60.0, "x_upper": -60.0}, axis=(0.0, 0.0, 1.0)))
    alpha = np.radians(60 - 60 * X[:, 0])
    # The normal is x, the circumferential direction z x x = y, and x x y = z.
    expected = np.stack([0 * alpha, np.cos(alpha), np.sin(alpha)], axis=1)
    np.testing.assert_allclose(vectors, expected, atol=1e-9)


@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
def test_a_blend_in_the_plane_follows_a_curved_wall(comm, cell):
    mesh = rectangle(comm, lower=(1.0, 0.0), size=(1.0, 1.5), elements=(12, 16), cell=cell)
    x = mesh.mesh.geometry.x
    r, theta = x[:, 0].copy(), x[:, 1].copy()
    x[:, 0], x[:, 1] = r * np.cos(theta), r * np.sin(theta)
    vectors, X = values(fibres.blend(mesh, {"x_lower": 0.0, "x_upper": 90.0}))
    r, theta = np.hypot(X[:, 0], X[:, 1]), np.arctan2(X[:, 1], X[:, 0])
    alpha = np.pi / 2 * np.log(r) / np.log(2.0)  # the solution of Laplace's equation between two circles
    around, out = np.stack([-np.sin(theta), np.cos(theta)], 1), np.stack([np.cos(theta), np.sin(theta)], 1)
    expected = np.cos(alpha)[:, None] * around + np.sin(alpha)[:, None] * out
    assert np.abs(vectors - expected).max(initial=0.0) < 0.03


def test_a_blend_that_cannot_be_is_refused(comm):
    mesh = box(comm, elements=(2, 2, 2))
    for angles, message in (
        ({"x_lower": 0.0}, "two facet tags"),
        ({"x_lower": 0.0, "x_uper": 1.0}, 'did you mean "x_upper"'),
        ({"x_lower": 0.0, "body": 1.0}, "no facet carries this tag"),
    ):
        with pytest.raises(CaseError, match=message):
            fibres.blend(mesh, angles)
    with pytest.raises(CaseError, match="zero or not finite"):
        fibres.blend(mesh, {"x_lower": 0.0, "x_upper": 1.0}, axis=(1.0, 0.0, 0.0))


def middles(n, size):
    """Middles of the cells of a box of n^3 cubes, not in the mesh's order, and a smooth unit field there."""
    points = (np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij"), -1).reshape(-1, 3) + 0.5) * size / n
    vectors = np.stack([np.cos(points[:, 1]), np.sin(points[:, 1]), 0 * points[:, 0]], 1)
    return points[::-1], vectors[::-1]


def test_data_find_their_cells_in_any_order(comm):
    mesh = box(comm, elements=(3, 3, 3))
    vectors, X = values(fibres.from_cells(mesh, *middles(3, 1.0)))
    np.testing.assert_allclose(vectors[:, 0], np.cos(X[:, 1]), rtol=1e-12)
    points, given = middles(3, 1.0)
    with pytest.raises(CaseError, match="1 fibres are zero"):
        fibres.from_cells(mesh, points[1:], given[1:])
    with pytest.raises(CaseError, match="2 of 27 fibres are not unit vectors"):
        fibres.from_cells(mesh, points, np.where(np.arange(27)[:, None] < 2, 2.0, 1.0) * given)
    with pytest.raises(CaseError, match="cells without data: 27"):
        fibres.from_cells(mesh, np.zeros((0, 3)), np.zeros((0, 3)))


@pytest.mark.parametrize("at", ["cells", "points"])
def test_fibres_are_read_from_a_file(comm, shared_tmp, at):
    import meshio

    path = shared_tmp / "fibres.vtu"
    if comm.rank == 0:
        corners = [(x, y, z) for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
        up = np.array([[0.6, 0.8, 0.0]])
        signs = np.array([1, -1, 1, 1, -1, 1, 1, -1])[:, None]
        data = {"cell_data": {"f": [up]}} if at == "cells" else {"point_data": {"f": signs * up}}
        meshio.Mesh(np.array(corners, dtype=float), [("hexahedron", [list(range(8))])], **data).write(path)
    comm.barrier()
    mesh = box(comm, elements=(1, 1, 1))
    vectors, _ = values(fibres.read_fibres(mesh, path, "f"))
    np.testing.assert_allclose(vectors, np.broadcast_to([0.6, 0.8, 0.0], vectors.shape), rtol=1e-12)
    with pytest.raises(CaseError, match=r"no such cell or point data; the file has f"):
        fibres.read_fibres(mesh, path, "fibre")
    with pytest.raises(CaseError, match="cells without data"):
        fibres.read_fibres(box(comm, elements=(2, 1, 1)), path, "f")
    with pytest.raises(CaseError, match="no such mesh file"):
        fibres.read_fibres(mesh, shared_tmp / "missing.vtu", "f")
    if comm.rank == 0:
        (shared_tmp / "junk.vtu").write_text("nothing", encoding="utf-8")
    comm.barrier()
    with pytest.raises(CaseError, match=r"junk\.vtu: cannot read"):
        fibres.read_fibres(mesh, shared_tmp / "junk.vtu", "f")


def test_a_material_gets_only_fibres_it_can_use(comm):
    mesh = box(comm, elements=(2, 2, 2))
    long = fem.Function(fem.functionspace(mesh.mesh, ("DG", 0, (3,))))
    long.x.array[:] = 1.0
    along, across = fibres.constant(mesh, (1, 0, 0)), fibres.constant(mesh, (0, 1, 0))
    oblique = fibres.constant(mesh, (1, 1, 0))
    known = mesh.with_fibres(along=along, across=across, oblique=oblique, long=long)
    Structure(known, hgo("along"))
    two = {"a": 1.0, "b": 1.0, "a_f": 1.0, "fibre": "along"}
    Structure(known, HolzapfelOgden(**two, sheet="across"))
    for material, message in (
        (hgo("alon"), 'no such fibre field .did you mean "along"'),
        (hgo("long"), "fibre = 'long': 8 fibres are not unit vectors"),
        (HolzapfelOgden(**two, sheet="oblique"), "right angles, the cosine between them reaches 0.707"),
        (Fung(c=1, a1=1, a2=1, a4=1, fibre=0.0, sheet=60.0), "right angles"),
    ):
        with pytest.raises(CaseError, match=message):
            Structure(known, material)
    with pytest.raises(CaseError, match="no such fibre field; the mesh has none"):
        statics.solve(mesh, hgo("along"), fixed=[statics.Fixed(on=("x_lower",))])


@pytest.mark.parametrize("degree", [0, 1])
def test_forces_and_statics_see_the_fibres_of_the_mesh(comm, degree):
    mesh = box(comm, elements=(2, 2, 2))
    field = fibres.from_function(mesh, lambda X: np.broadcast_to([0.6, 0.8, 0.0], X.shape), degree=degree)
    by_field = Structure(mesh.with_fibres(fibre=field), hgo("fibre"))
    by_vector = Structure(mesh, hgo((0.6, 0.8, 0.0)))
    chi = by_field.X * [1.2, 1.1, 0.8] + 0.02 * np.sin(by_field.X[:, [1, 2, 0]])
    expected = by_vector.elasticity.force(chi).copy()
    scale = comm.allreduce(np.abs(expected).max(initial=0.0))
    np.testing.assert_allclose(by_field.elasticity.force(chi), expected, atol=1e-12 * scale)

    def pulled(solid):
        load = DeadLoad(on=("x_upper",), traction=(60.0, 0.0, 0.0))
        fixed = [statics.Fixed(on=("x_lower",))]
        return statics.solve(solid.mesh, solid.material, fixed=fixed, loads=[load]).displacement_at((1, 1, 1))

    np.testing.assert_allclose(pulled(by_field), pulled(by_vector), atol=1e-9)


def test_statics_of_dispersed_fibres_converges_with_a_rounded_corner(comm):
    mesh = box(comm, elements=(2, 2, 2))
    load = DeadLoad(on=("x_upper",), traction=(60.0, 0.0, 0.0))

    def pulled(width):
        family = FibreFamily(k1=500.0, k2=1.0, kappa=0.1, fibre=(0.6, 0.8, 0.0))
        material = HGO(c10=100.0, c01=1.0, families=[family], width=width)
        fixed = [statics.Fixed(on=("x_lower",))]
        return statics.solve(mesh, material, fixed=fixed, loads=[load]).displacement_at((1, 1, 1))

    coarse, fine = pulled(0.02), pulled(0.005)
    assert np.abs(coarse - fine).max() < 0.03 * np.abs(fine).max()


def test_a_field_is_gathered_for_pictures_in_an_order_of_its_own(comm):
    mesh = box(comm, elements=(2, 3, 2))
    mesh = mesh.with_fibres(around=fibres.circumferential(mesh, through=(2, 2, 0)))
    found = fibres.on_root(mesh, "around")
    if comm.rank != 0:
        assert found is None
        return
    points, vectors = found
    assert points.shape == vectors.shape == (12, 3)
    np.testing.assert_allclose(points[:2], [[0.25, 1 / 6, 0.25], [0.25, 1 / 6, 0.75]])
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1.0)


def test_the_volumetric_energy_of_a_structure_can_be_chosen(comm):
    mesh = rectangle(comm, elements=(2, 2))
    material = hgo(0.0)
    chi = Structure(mesh, material).X * [1.3, 1.3, 1.0]
    energies = {}
    for form in ("log", "quadratic", "simo_taylor"):
        solid = Structure(mesh, material, discretisation=Discretisation(volumetric=form, kappa=1e6))
        assert solid.kappa == 1e6
        energies[form] = solid.energy(chi)
    J = 1.69
    expected = {
        "log": math.log(J) ** 2,
        "quadratic": (J - 1) ** 2,
        "simo_taylor": (J**2 - 1) / 2 - math.log(J),
    }
    least = min(energies, key=energies.get)
    assert least == "log"
    for form in ("quadratic", "simo_taylor"):
        difference = 5e5 * (expected[form] - expected["log"])
        assert energies[form] - energies["log"] == pytest.approx(difference, rel=1e-9)


@pytest.mark.serial
@pytest.mark.parametrize("dim", [2, 3])
def test_a_field_is_drawn(tmp_path, dim):
    from mpi4py import MPI

    from valvefsi.post.plots.fibre import fibre_picture

    make = box if dim == 3 else rectangle
    mesh = make(MPI.COMM_SELF, elements=(4,) * dim)
    mesh = mesh.with_fibres(around=fibres.circumferential(mesh, through=(2.0, 2.0, 0.0)))
    path = fibre_picture(tmp_path / "fibres.png", *fibres.on_root(mesh, "around"))
    assert path.read_bytes()[:4] == b"\x89PNG"
    assert path.stat().st_size > 10_000
