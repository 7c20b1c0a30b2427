"""What is shown of a mesh: facets by tag, thickness and quality, on bodies where they are known."""

from __future__ import annotations

import meshio
import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.geometry import shapes
from valvefsi.geometry.importing import import_mesh
from valvefsi.geometry.looks import Quality, facets_by_tag, plane_cells, quality_of, thickness_through
from valvefsi.geometry.mesh import read_mesh
from valvefsi.post.plots.views import area_vectors

pytestmark = pytest.mark.serial  # one rank looks at a mesh
SIZE = (2.0, 1.0, 0.1)


@pytest.fixture(params=["hexahedron", "tetrahedron"])
def plate(request):
    return shapes.box(MPI.COMM_SELF, lower=(0, 0, 0), size=SIZE, elements=(8, 4, 2), cell=request.param)


def test_facets_by_tag_are_the_whole_surface_and_point_outward(plate):
    groups = facets_by_tag(plate)
    vectors = {name: area_vectors(polygons) for name, polygons in groups.items()}
    area = sum(np.linalg.norm(each, axis=1).sum() for each in vectors.values())
    assert area == pytest.approx(2 * (2 * 1 + 2 * 0.1 + 1 * 0.1))
    flux = sum(
        np.einsum("ni,ni->", polygons.mean(axis=1), vectors[name]) for name, polygons in groups.items()
    )
    assert flux / 3 == pytest.approx(np.prod(SIZE))
    for name in groups:
        if name:
            total = np.linalg.norm(vectors[name].sum(axis=0))
            assert total == pytest.approx(np.linalg.norm(vectors[name], axis=1).sum()), name


def test_the_thickness_behind_each_facet_is_that_of_the_plate(plate):
    polygons = np.concatenate(list(facets_by_tag(plate).values()))
    normal = area_vectors(polygons)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    np.testing.assert_allclose(thickness_through(polygons), np.abs(normal) @ SIZE, rtol=1e-6)


def twisted_sheet(cells, t, twist=0.5):
    """Return faces of a sheet of one thickness along the normals of z = twist x y, and the largest angle of these."""
    x, y = np.meshgrid(*2 * [np.linspace(-1, 1, cells + 1)], indexing="ij")
    middle, normal = (
        np.stack([x, y, twist * x * y], -1),
        np.stack([-twist * y, -twist * x, np.ones_like(x)], -1),
    )
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    corners = [(slice(None, -1), slice(None, -1)), (slice(1, None), slice(None, -1))]
    corners += [(slice(1, None), slice(1, None)), (slice(None, -1), slice(1, None))]
    faces = [
        np.stack([(middle + side * 0.5 * t * normal)[k] for k in corners[::side]], axis=2).reshape(-1, 4, 3)
        for side in (1, -1)
    ]
    cosines = [np.einsum("ijc,ijc->ij", normal[a], normal[b]).min() for a in corners for b in corners]
    return np.concatenate(faces), np.arccos(min(cosines))


@pytest.mark.parametrize("cells", [8, 16])
def test_the_thickness_of_a_twisted_sheet_is_the_same_from_both_sides(cells):
    """Between t and t times the least length of the mean of four unit columns with angles of up to a."""
    t = 0.02
    faces, angle = twisted_sheet(cells, t)
    found = thickness_through(faces)
    assert found.max() <= t * (1 + 1e-9)
    assert found.min() >= t * np.sqrt((1 + 3 * np.cos(angle)) / 4)


def test_many_facets_are_sampled(monkeypatch, plate):
    monkeypatch.setattr("valvefsi.geometry.looks.RAYS", 40)
    polygons = np.concatenate(list(facets_by_tag(plate).values()))
    found = thickness_through(polygons)
    assert np.count_nonzero(np.isclose(found, 0.1)) > len(found) / 4
    assert set(np.round(found, 6)) <= {0.1, 1.0, 2.0}


def test_a_cube_is_the_best_hexahedron():
    found = quality_of(shapes.box(MPI.COMM_SELF, lower=(0, 0, 0), size=(1, 1, 1), elements=(2, 2, 2)))
    assert (found.cells, found.nodes) == (8, 27)
    assert found.scaled == pytest.approx(1.0)
    assert found.edges == pytest.approx(0.5)


def test_a_tetrahedron_is_as_good_as_its_worst_corner(tmp_path):
    """The regular one has 1; the corner of a cube 1 where its edges meet, and 1 / sqrt 2 over sqrt 2 elsewhere."""
    regular = np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)], dtype=float)
    corner = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], dtype=float) + 5.0
    points, cells = np.concatenate([regular, corner]), [("tetra", np.array([[0, 2, 1, 3], [4, 5, 6, 7]]))]
    meshio.Mesh(points, cells).write(tmp_path / "two.vtu")
    import_mesh(tmp_path / "two.vtu", tmp_path / "two.msh")
    found = quality_of(read_mesh(tmp_path / "two.msh", MPI.COMM_SELF))
    assert sorted(found.scaled) == pytest.approx([np.sqrt(2) / 2, 1.0])


@pytest.mark.parametrize(
    ("scaled", "said"),
    [([0.9, 0.31], "good"), ([0.9, 0.2], "usable; 1 cells"), ([0.9, 0.05, -0.2], "bad: 2 cells")],
)
def test_the_verdict_on_the_cells(scaled, said):
    quality = Quality(cells=len(scaled), nodes=8, scaled=np.array(scaled), edges=np.ones(3))
    assert quality.verdict().startswith(said)


def test_cells_in_the_plane_go_round():
    mesh = shapes.rectangle(MPI.COMM_SELF, lower=(0, 0), size=(2, 1), elements=(4, 2))
    x = np.array(plane_cells(mesh))
    a, b = x[:, 2] - x[:, 0], x[:, 3] - x[:, 1]
    areas = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    assert areas == pytest.approx(0.25)
    assert quality_of(mesh).scaled == pytest.approx(1.0)
    lines = facets_by_tag(mesh)
    assert sum(np.linalg.norm(a[:, 1] - a[:, 0], axis=1).sum() for a in lines.values()) == pytest.approx(6.0)
