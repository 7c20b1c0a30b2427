"""What is made of a user's facets: middle lines of edges, the stent under them, a wall's points."""

from __future__ import annotations

import math

import meshio
import numpy as np
import pytest
from mpi4py import MPI
from scipy.spatial import cKDTree

from valvefsi.errors import CaseError
from valvefsi.geometry.aortic_section import SPACING
from valvefsi.geometry.leaflets import pericardial, porcine
from valvefsi.geometry.mesh import mesh_from_gmsh
from valvefsi.geometry.ribbons import middle_lines
from valvefsi.geometry.stent import (
    STEEPEST,
    WIDEST_POST,
    FormulaEdge,
    LineEdge,
    edge_line,
    stent_wall,
    widest_seam,
)
from valvefsi.geometry.tagged import TaggedSurfaces, gather_surfaces
from valvefsi.geometry.tagged_files import fill_model
from valvefsi.geometry.valve import distribute, mesh_valve
from valvefsi.geometry.wall import radius_at, read_wall, wall_points

TAGS = {name: (name,) for name in ("attached", "free", "inflow", "outflow")}


def surfaces_of(comm, size, cell="hexahedron", layers=1):
    made = mesh_valve(pericardial(), size=size, layers=layers, cell=cell)
    return gather_surfaces(distribute(made, comm), TAGS)


@pytest.mark.parametrize(("cell", "layers"), [("hexahedron", 1), ("hexahedron", 2), ("tetrahedron", 1)])
def test_the_middle_lines_of_a_valve_are_those_it_was_made_of(comm, cell, layers):
    valve, found = pericardial(), surfaces_of(comm, 0.2, cell, layers)
    for ribbon, u in (("free", None), ("attached", None)):
        lines = middle_lines(found, ribbon)
        assert len(lines) == 3
        for k, line in enumerate(lines):
            c, s = math.cos(2 * math.pi * k / 3), math.sin(2 * math.pi * k / 3)
            x = line.at(found.points) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
            assert not line.closed
            assert (np.diff(np.arctan2(x[:, 1], x[:, 0])) > -1e-12).all(), "counter-clockwise"
            if ribbon == "free":
                u = np.linspace(-1.0, 1.0, len(x))
                np.testing.assert_allclose(x, valve.free_edge(u), atol=1e-12)
            else:
                assert np.hypot(x[:, 0], x[:, 1]) == pytest.approx(valve.radius, rel=1e-12)
                assert (x[0, 2], x[-1, 2]) == pytest.approx((valve.height, valve.height))


def test_middle_lines_do_not_depend_on_the_number_of_ranks(comm):
    alone, together = (surfaces_of(c, 0.25) for c in (MPI.COMM_SELF, comm))
    np.testing.assert_array_equal(alone.points, together.points)
    for name in TAGS:
        assert (np.sort(alone.faces[name], axis=1) == np.sort(together.faces[name], axis=1)).all()
    for one, other in zip(middle_lines(alone, "attached"), middle_lines(together, "attached"), strict=True):
        np.testing.assert_array_equal(one.at(alone.points), other.at(together.points))


def ribbon_of(inner, outer):
    """A flat ribbon of triangles between two curves, and one facet row on each of its sides."""
    n, m = len(inner), len(outer)
    points = np.concatenate([inner, outer, inner - [0, 0, 1], outer - [0, 0, 1]])
    strips = []
    i = j = 0
    while i < n - 1 or j < m - 1:
        if j == m - 1 or (i < n - 1 and i / (n - 1) <= j / (m - 1)):
            strips.append((i, i + 1, n + j))
            i += 1
        else:
            strips.append((i, n + j + 1, n + j))
            j += 1
    side = [(k, k + 1, n + m + k) for k in range(n - 1)]
    other = [(n + k, n + k + 1, 2 * n + m + k) for k in range(m - 1)]
    faces = {name: np.array(each) for name, each in (("edge", strips), ("inflow", side), ("outflow", other))}
    return TaggedSurfaces(points=points, faces=faces)


def arc(r, n, ends=(0.2, 1.4)):
    phi = np.linspace(*ends, n)
    return np.stack([r * np.cos(phi), r * np.sin(phi), 0 * phi], axis=1)


@pytest.mark.parametrize("counts", [(7, 7), (13, 8), (8, 21)])
def test_curves_with_different_numbers_of_nodes_meet_in_the_middle(counts):
    found = ribbon_of(arc(1.0, counts[0]), arc(1.2, counts[1]))
    (line,) = middle_lines(found, "edge")
    x = line.at(found.points)
    assert line.weights.sum(axis=1) == pytest.approx(1.0)
    assert np.hypot(x[:, 0], x[:, 1]) == pytest.approx(1.1, abs=1.2 * (1.2 / (min(counts) - 1)) ** 2 / 8)
    assert np.arctan2(x[:, 1], x[:, 0]) == pytest.approx(np.linspace(0.2, 1.4, counts[0]), abs=2e-3)
    moved = found.points + [0.3, -0.1, 2.0]
    np.testing.assert_allclose(line.at(moved) - x, np.tile([0.3, -0.1, 2.0], (len(x), 1)))


def test_closed_curves_whose_numbers_begin_elsewhere_meet_in_the_middle():
    """Two circles of one cone; the outer one's nodes are numbered from another azimuth on."""
    n, turn = 24, 10
    inner, outer = (ring(n=n, radius=r)[:-1] + [0.0, 0.0, z] for r, z in ((1.0, 0.0), (1.2, 0.5)))
    outer = np.roll(outer, -turn, axis=0)
    points = np.concatenate([inner, outer, inner - [0, 0, 1], outer - [0, 0, 1]])
    k = np.arange(n)
    after, beside = (k + 1) % n, n + (k - turn) % n
    faces = {
        "edge": np.stack([k, after, np.roll(beside, -1), beside], axis=1),
        "inflow": np.stack([k, after, after + 2 * n, k + 2 * n], axis=1),
        "outflow": np.stack(
            [beside, np.roll(beside, -1), np.roll(beside, -1) + 2 * n, beside + 2 * n], axis=1
        ),
    }
    (line,) = middle_lines(TaggedSurfaces(points=points, faces=faces), "edge")
    assert line.closed
    x = line.at(points)
    np.testing.assert_allclose(x[-1], x[0])
    assert np.hypot(x[:, 0], x[:, 1]) == pytest.approx(1.1)
    assert x[:, 2] == pytest.approx(1.25)
    assert np.diff(np.unwrap(np.arctan2(x[:, 1], x[:, 0]))) == pytest.approx(2 * math.pi / n)


def test_a_ribbon_of_which_a_part_has_another_tag_is_refused():
    found = ribbon_of(arc(1.0, 9), arc(1.2, 9))
    found.faces["inflow"] = np.delete(found.faces["inflow"], 3, axis=0)
    with pytest.raises(CaseError, match="edge: .*2 curves on the side of inflow and 1"):
        middle_lines(found, "edge")
    found.faces["inflow"] = found.faces["inflow"][:0]
    with pytest.raises(CaseError, match="edge: .*share no edge with those of inflow"):
        middle_lines(found, "edge")


# Stent


def test_the_stent_of_chords_converges_to_that_of_the_formula(comm):
    valve, phi = pericardial(), np.linspace(0.0, 2 * math.pi, 2001)
    exact = FormulaEdge(valve, 0.0).at(phi)
    errors = []
    for size in (0.2, 0.1, 0.05):
        found = surfaces_of(comm, size)
        edge = LineEdge([line.at(found.points) for line in middle_lines(found, "attached")])
        r, z = edge.at(phi)
        assert r == pytest.approx(valve.radius, rel=1e-12)
        assert edge.mean_radius == pytest.approx(valve.radius)
        assert edge.lowest == pytest.approx(0.0, abs=1e-12)
        errors.append(np.abs(z - exact[1]).max())
    assert errors[-1] < 5e-4
    assert math.log2(errors[1] / errors[2]) > 1.7


def test_the_stent_of_a_valve_stands_where_the_valve_does():
    edge = FormulaEdge(pericardial(), 0.7)
    _, z = edge.at(np.linspace(0.0, 2 * math.pi, 1201))
    assert (z.min(), z.max()) == pytest.approx((0.7, 0.7 + pericardial().height), abs=1e-9)
    assert edge.lowest == 0.7
    assert edge_line(edge, 1200)[:, 2].min() == pytest.approx(0.7, abs=1e-9)


@pytest.mark.parametrize("h", [0.11, 0.13, 0.17])
def test_the_stent_is_the_same_under_each_of_three_leaflets(h):
    valve = pericardial()
    x = stent_wall(FormulaEdge(valve, 0.0), -0.2, lambda phi: np.full_like(phi, valve.radius), h).points
    c, s = math.cos(2 * math.pi / 3), math.sin(2 * math.pi / 3)
    turned = x @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    assert cKDTree(x).query(turned)[0].max() < 1e-9


@pytest.mark.parametrize(("diameter", "h"), [(1.9, 0.1), (2.0, 0.0526), (2.3, 0.0526)])
def test_a_stent_narrower_than_the_housing_leaves_no_slot_at_the_attachment(diameter, h):
    """The posts too stand on the attachment's radius; on a cone of their own they miss it by up to 2 h."""
    valve = porcine(diameter=diameter)
    edge = FormulaEdge(valve, 0.0)
    x = stent_wall(edge, -0.1, lambda phi: np.full_like(phi, 1.25), h).points
    # Half the diagonal of a patch of half a spacing, and as much again for what the last column stands beside the side.
    assert widest_seam(edge, x)[0] < math.sqrt(0.5) * h
    r = np.hypot(x[:, 0], x[:, 1])
    post = np.abs((np.arctan2(x[:, 1], x[:, 0]) % (2 * math.pi / 3)) - math.pi / 3) < 1e-3 + 0.25 * h
    knee = valve.height - valve.commissure + 0.2
    assert r[post & (x[:, 2] > knee)] == pytest.approx(valve.radius, rel=1e-9)


def test_the_seam_is_the_distance_of_the_attachment_from_the_walls_where_it_is_widest():
    valve = porcine(diameter=2.0)
    edge = FormulaEdge(valve, 0.3)
    lines = edge.attached()
    expected = [valve.attachment(np.array([0.0]))[0], valve.free_edge(np.array([-1.0]))[0]]
    for x in expected:
        assert cKDTree(np.concatenate(lines)).query(x + [0.0, 0.0, 0.3])[0] < 0.01
    for line in lines:
        assert np.hypot(line[:, 0], line[:, 1]) == pytest.approx(1.0)
        assert (line[:, 2].min(), line[:, 2].max()) == pytest.approx((0.3, 0.3 + valve.height), abs=1e-4)
    everywhere = np.concatenate(lines)
    hole = np.linalg.norm(everywhere - everywhere[50], axis=1) < 0.1
    apart, place = widest_seam(edge, everywhere[~hole])
    assert apart == pytest.approx(0.1, abs=0.02)
    np.testing.assert_allclose(place, everywhere[50], atol=0.02)
    assert widest_seam(LineEdge([ring()]), ring() + [0.0, 0.0, 0.2])[0] == pytest.approx(0.2)


def test_the_knee_of_a_stent_rises_no_more_than_it_may():
    """A ring with one high place: the wall beside it is a cone that ends where the low edge does."""
    phi = np.linspace(0.0, 2.0 * math.pi, 721)
    z = np.where(np.abs(phi - math.pi) < 0.1, 2.0, 1.0)
    edge = LineEdge([np.stack([np.cos(phi), np.sin(phi), z], axis=1)])
    x = stent_wall(edge, 0.0, lambda phi: np.full_like(phi, 1.5), 0.05).points
    high = np.abs(np.arctan2(x[:, 1], -x[:, 0])) < 0.09
    r = np.hypot(x[:, 0], x[:, 1])
    knee = 1.0 + STEEPEST * (0.1 + 0.05 - np.abs(np.arctan2(x[:, 1], -x[:, 0])))
    assert (high & (x[:, 2] > knee)).sum() > 20
    assert r[high & (x[:, 2] > knee)] == pytest.approx(1.0, abs=1e-4)
    assert x[high, 2].max() == pytest.approx(2.0)


def ring(tilt=0.0, n=400, radius=1.1):
    phi = np.linspace(0.0, 2.0 * math.pi, n + 1)
    x = np.stack([radius * np.cos(phi), radius * np.sin(phi), 1.0 + tilt * np.cos(phi)], axis=1)
    x[-1] = x[0]
    return x


def test_a_stent_that_widens_is_a_cone_with_its_area_and_normals():
    edge = LineEdge([ring()])
    surface = stent_wall(edge, 0.0, lambda phi: np.full_like(phi, 0.8), 0.05)
    slant = math.hypot(1.0, 0.3)
    assert surface.areas.sum() == pytest.approx(math.pi * (0.8 + 1.1) * slant, rel=1e-3)
    r = np.hypot(surface.points[:, 0], surface.points[:, 1])
    assert r == pytest.approx(0.8 + 0.3 * surface.points[:, 2], abs=1e-4)
    outward = np.einsum("ni,ni->n", surface.normals[:, :2], surface.points[:, :2]) / r
    assert outward == pytest.approx(1.0 / slant, rel=1e-4)
    assert surface.normals[:, 2] == pytest.approx(-0.3 / slant, rel=1e-4)


def test_the_wall_of_a_cylinder_beside_the_axis_has_its_area_and_its_own_normals():
    """A unit circle about (0.3, 0): its distance from the z axis changes along the way around."""
    radius, aside = 1.0, np.array([0.3, 0.0, 0.0])
    edge = LineEdge([ring(radius=radius, n=2000) + aside])

    def foot(phi):
        return 0.3 * np.cos(phi) + np.sqrt(1.0 - 0.09 * np.sin(phi) ** 2)

    surface = stent_wall(edge, 0.0, foot, 0.05)
    assert edge.radius == pytest.approx(1.3)
    assert surface.areas.sum() == pytest.approx(2 * math.pi * radius * 1.0, rel=1e-3)
    np.testing.assert_allclose(surface.normals, (surface.points - aside) * [1.0, 1.0, 0.0], atol=5e-3)


def test_a_closed_edge_has_no_posts_and_a_tilted_one_its_heights():
    r, z = LineEdge([ring(tilt=0.2)]).at(np.array([0.0, math.pi / 2, math.pi, 7.0]))
    assert r == pytest.approx(1.1, rel=1e-4)
    assert z == pytest.approx([1.2, 1.0, 0.8, 1.0 + 0.2 * math.cos(7.0)], abs=1e-4)
    assert edge_line(LineEdge([ring()]), 12)[3] == pytest.approx([0.0, 1.1, 1.0], abs=1e-4)


def test_where_lines_lie_above_one_another_the_stent_goes_up_to_the_highest():
    steps = [
        arc(1.0, 66, (2 * math.pi * k / 3 - 1.1, 2 * math.pi * k / 3 + 1.1)) + [0.0, 0.0, z]
        for k, z in enumerate((2.0, 1.0, 3.0))
    ]
    middles, overlaps = (np.array([a, a + 2 * math.pi / 3, a - 2 * math.pi / 3]) for a in (0.0, math.pi / 3))
    assert LineEdge(steps).at(middles)[1] == pytest.approx([2.0, 1.0, 3.0])
    assert LineEdge(steps).at(overlaps)[1] == pytest.approx([2.0, 3.0, 3.0])


def test_gaps_wider_than_a_post_leave_the_stent_open():
    def arcs(gap):
        half = math.radians(120.0 - gap) / 2
        return [arc(1.0, 30, (2 * math.pi * k / 3 - half, 2 * math.pi * k / 3 + half)) for k in range(3)]

    steps = [x + [0.0, 0.0, k] for k, x in enumerate(arcs(WIDEST_POST - 0.1))]
    posts = LineEdge(steps).at(np.array([math.pi / 3, math.pi, -math.pi / 3]))[1]
    assert posts == pytest.approx([0.5, 1.5, 1.0])
    with pytest.raises(CaseError, match=r"open: nothing is attached between azimuths 165 and 195 deg"):
        LineEdge(arcs(WIDEST_POST + 0.1))
    aside = arc(0.1, 20, (0.0, 6.0)) + [1.0, 0.0, 0.0]
    with pytest.raises(CaseError, match="stent's curve is open|does not go around"):
        LineEdge([aside])


# Tags


def test_a_tag_inside_the_body_is_none_of_its_surface():
    x = np.array([(i, j, k) for k in range(3) for j in range(2) for i in range(2)], dtype=float)
    cells = np.array([[0, 1, 3, 2, 4, 5, 7, 6], [4, 5, 7, 6, 8, 9, 11, 10]])
    facets = {"inside": np.array([[4, 5, 7, 6]]), "top": np.array([[8, 9, 11, 10]])}

    def build(gmsh):
        fill_model(gmsh, x, facets, {"body": cells})

    mesh = mesh_from_gmsh(build, MPI.COMM_SELF, source="two cells")
    found = gather_surfaces(mesh, {"free": ("top",)})
    np.testing.assert_allclose(found.points[:, 2], 2.0)
    ends = found.points[found.faces["free"][0]]
    assert np.linalg.norm(ends - np.roll(ends, 1, axis=0), axis=1) == pytest.approx(1.0), "corners go around"
    with pytest.raises(CaseError, match="free = 'inside': no outer facet of two cells"):
        gather_surfaces(mesh, {"free": ("inside",)})
    with pytest.raises(CaseError, match="free = 'body': this tag of two cells is one of cells"):
        gather_surfaces(mesh, {"free": ("body",)})
    with pytest.raises(CaseError, match="free = 'topp': .*did you mean \"top\""):
        gather_surfaces(mesh, {"free": ("topp",)})


# Walls


def box_wall(path, inward=False):
    """The four sides of a square tube in mm, tagged as two facets each."""
    corners = [(-10, -8), (10, -8), (10, 8), (-10, 8)]
    points = np.array([(x, y, z) for z in (-20.0, 30.0) for x, y in corners])
    quads = np.array([(k, (k + 1) % 4, (k + 1) % 4 + 4, k + 4) for k in range(4)])
    quads = quads[:, ::-1] if inward else quads
    tags = [np.array([1, 2, 1, 2])]
    mesh = meshio.Mesh(
        points,
        [("quad", quads)],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={"short": np.array([2, 2]), "long": np.array([1, 2])},
    )
    mesh.write(path, file_format="gmsh22", binary=False)
    return path


@pytest.mark.parametrize("inward", [False, True])
def test_a_wall_of_planes_has_their_areas_and_normals_away_from_the_axis(tmp_path, inward):
    points, triangles = read_wall(box_wall(tmp_path / "box.msh", inward), scale=0.1)
    surface = wall_points(points, triangles, 0.15, (-1.5, 2.5))
    assert surface.areas.sum() == pytest.approx(2 * (2.0 + 1.6) * 4.0, rel=0.03)
    outward = (surface.normals[:, :2] * surface.points[:, :2]).sum(axis=1)
    assert np.unique(np.round(outward, 9)).tolist() == pytest.approx([0.8, 1.0])
    part = read_wall(tmp_path / "box.msh", scale=0.1, tags=("short",))
    assert np.abs(part[0][np.unique(part[1])][:, 0]) == pytest.approx(1.0)
    assert wall_points(*part, 0.15, (-1.5, 2.5)).areas.sum() == pytest.approx(2 * 1.6 * 4.0, rel=0.03)
    with pytest.raises(CaseError, match="tags = 'shorts': .*did you mean \"short\""):
        read_wall(tmp_path / "box.msh", scale=0.1, tags=("shorts",))


def test_no_place_of_a_wall_is_far_from_a_point(tmp_path):
    h = 0.15
    points, triangles = read_wall(box_wall(tmp_path / "box.msh"), scale=0.1)
    surface = wall_points(points, triangles, h, (-1.5, 2.5))
    y, z = np.random.default_rng(1).uniform((-0.8, -1.4), (0.8, 2.4), (5000, 2)).T
    there = np.stack([np.ones(5000), y, z], axis=1)
    assert cKDTree(surface.points).query(there)[0].max() < SPACING * h
    phi = np.array([0.0, math.pi / 2, math.pi])
    assert radius_at(surface, 0.0, phi) == pytest.approx([1.0, 0.8, 1.0], abs=0.01)


def test_the_radius_of_a_wall_is_that_of_its_height_and_azimuth():
    """A cone with an oval section, r = (1 + z/2) (1 + cos(2 phi)/10) for 0 <= z <= 1."""
    n, m = 240, 40
    phi, z = np.meshgrid(2 * math.pi * np.arange(n) / n, np.linspace(0.0, 1.0, m + 1))
    r = (1.0 + 0.5 * z) * (1.0 + 0.1 * np.cos(2 * phi))
    points = np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=-1).reshape(-1, 3)
    k, j = (each.ravel() for each in np.meshgrid(np.arange(n), np.arange(m)))
    corner = j * n + k, j * n + (k + 1) % n, (j + 1) * n + (k + 1) % n, (j + 1) * n + k
    triangles = np.concatenate([np.stack([corner[0], *pair], axis=1) for pair in (corner[1:3], corner[2:])])
    surface = wall_points(points, triangles, 0.1, (0.0, 1.0))
    at = np.linspace(0.0, 2 * math.pi, 13)
    for height in (0.1, 0.8):
        expected = (1.0 + 0.5 * height) * (1.0 + 0.1 * np.cos(2 * at))
        assert radius_at(surface, height, at) == pytest.approx(expected, abs=0.03)
