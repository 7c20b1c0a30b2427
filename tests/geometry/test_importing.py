"""Meshes from elsewhere: volumes and areas of bodies that are known, patches, tags, refusals."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import meshio
import numpy as np
import pytest
from mpi4py import MPI
from scipy.spatial import cKDTree
from typer.testing import CliRunner

from valvefsi.cli import app
from valvefsi.errors import CaseError
from valvefsi.geometry.importing import import_mesh
from valvefsi.geometry.leaflets import pericardial
from valvefsi.geometry.mesh import _quiet_gmsh, read_mesh
from valvefsi.geometry.tagged_files import fill_model, write_model
from valvefsi.geometry.valve import mesh_valve, volumes, write_valve
from valvefsi.runtime.dolfinx_compat import geometry_nodes
from valvefsi.solid.materials.fibres import read_vectors

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="files are written by one rank")

CORNERS = np.array([(i, j, k) for k in (0, 1) for j in (0, 1) for i in (0, 1)], dtype=float) * [
    10.0,
    20.0,
    5.0,
]
SQUARES = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
TRIANGLES = np.array([t for a, b, c, d in SQUARES for t in ((a, b, c), (a, c, d))])


def test_a_box_of_triangles_is_filled(tmp_path):
    meshio.Mesh(CORNERS, [("triangle", TRIANGLES)]).write(tmp_path / "box.stl", binary=True)
    numbers = import_mesh(tmp_path / "box.stl", tmp_path / "box.msh", scale=0.1, size=0.3)
    assert numbers["volume_cm3"] == pytest.approx(1.0 * 2.0 * 0.5, rel=1e-9)
    assert numbers["extent_cm"] == pytest.approx([1.0, 2.0, 0.5])
    assert numbers["tags"] == [*(f"surface_{k}" for k in range(1, 7)), "body"]
    sides = {tuple(np.rint(p["normal"]).astype(int)): p for p in numbers["patches"].values()}
    assert len(sides) == 6
    assert sides[1, 0, 0]["area_cm2"] == pytest.approx(2.0 * 0.5)
    assert sides[1, 0, 0]["centre_cm"] == pytest.approx([1.0, 1.0, 0.25])
    assert sides[0, 0, -1]["centre_cm"] == pytest.approx([0.5, 1.0, 0.0])
    mesh = read_mesh(tmp_path / "box.msh", MPI.COMM_SELF)
    assert mesh.dim == 3
    assert mesh.tag("surface_1")[0] == 2
    facets = meshio.read(tmp_path / "box.msh")
    areas = np.zeros(6)
    for block, tags in zip(facets.cells, facets.cell_data["gmsh:physical"], strict=True):
        if block.type == "triangle":
            a, b, c = np.moveaxis(facets.points[block.data], 1, 0)
            np.add.at(areas, tags - 1, 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))
    np.testing.assert_allclose(sorted(areas), [0.5, 0.5, 1.0, 1.0, 2.0, 2.0])


@pytest.mark.filterwarnings("error")
def test_a_surface_in_text_gives_no_warning(tmp_path):
    meshio.Mesh(CORNERS, [("triangle", TRIANGLES)]).write(tmp_path / "box.stl", binary=False)
    assert import_mesh(tmp_path / "box.stl", tmp_path / "box.msh")["cell"] == "tetrahedron"


def test_the_size_that_is_asked_for_is_that_of_the_cells(tmp_path):
    meshio.Mesh(CORNERS, [("triangle", TRIANGLES)]).write(tmp_path / "box.stl", binary=True)
    cells = {
        size: import_mesh(tmp_path / "box.stl", tmp_path / "box.msh", scale=0.1, size=size)["cells"]
        for size in (0.3, 0.1)
    }
    # Regular tetrahedra of edge a have the volume a^3/(6 sqrt 2).
    assert 0.5 < cells[0.1] * 0.1**3 / (6 * math.sqrt(2)) < 2
    assert cells[0.1] > 8 * cells[0.3]


def test_patches_part_where_the_surface_turns_by_the_angle(tmp_path):
    """A house whose roof turns by 28 degrees at the ridge, 62 at the eaves."""
    front = np.array([(0, 0, 0), (2, 0, 0), (2, 1, 0), (1, 1.25, 0), (0, 1, 0)], dtype=float)
    points = np.concatenate([front, front + [0, 0, 1.0]])
    fans = [(0, k + 1, k) for k in (1, 2, 3)] + [(5, k + 5, k + 6) for k in (1, 2, 3)]
    sides = [(k, (k + 1) % 5, (k + 1) % 5 + 5, k + 5) for k in range(5)]
    triangles = np.array(fans + [t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))])
    meshio.Mesh(points, [("triangle", triangles)]).write(tmp_path / "house.stl", binary=True)
    patches = {}
    for angle in (40.0, 20.0):
        found = import_mesh(tmp_path / "house.stl", tmp_path / "house.msh", size=0.5, angle=angle)
        assert found["volume_cm3"] == pytest.approx(2.25, rel=5e-3)  # a ridge inside a patch is rounded
        patches[angle] = len(found["tags"]) - 1
    assert patches == {40.0: 6, 20.0: 7}


def test_a_sphere_is_one_patch(tmp_path):
    n = 24
    theta, phi = np.linspace(0, math.pi, n + 1)[1:-1], 2 * math.pi * np.arange(2 * n) / (2 * n)
    ring = np.stack(
        [
            np.outer(np.sin(theta), np.cos(phi)),
            np.outer(np.sin(theta), np.sin(phi)),
            np.outer(np.cos(theta), np.ones(2 * n)),
        ],
        axis=-1,
    ).reshape(-1, 3)
    points = np.concatenate([ring, [[0, 0, 1.0]], [[0, 0, -1.0]]])
    index = np.arange(len(ring)).reshape(n - 1, 2 * n)
    following = np.roll(index, -1, axis=1)
    quads = np.stack([index[:-1], index[1:], following[1:], following[:-1]], axis=-1).reshape(-1, 4)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    top = np.stack([index[0], following[0], np.full(2 * n, len(ring))], axis=1)
    bottom = np.stack([following[-1], index[-1], np.full(2 * n, len(ring) + 1)], axis=1)
    meshio.Mesh(points, [("triangle", np.concatenate([triangles, top, bottom]))]).write(
        tmp_path / "sphere.vtu"
    )
    numbers = import_mesh(tmp_path / "sphere.vtu", tmp_path / "sphere.msh", size=0.2)
    assert numbers["volume_cm3"] == pytest.approx(4.0 / 3.0 * math.pi, rel=0.03)
    assert 0.97 * 4.0 / 3.0 * math.pi < numbers["volume_cm3"] < 4.0 / 3.0 * math.pi
    assert numbers["cell"] == "tetrahedron"


def test_a_volume_mesh_keeps_its_cells(tmp_path):
    x = np.array([(i, j, k) for k in range(2) for j in range(3) for i in range(4)], dtype=float)

    def at(i, j, k):
        return i + 4 * (j + 3 * k)

    cells = [
        [at(i, j, 0), at(i + 1, j, 0), at(i + 1, j + 1, 0), at(i, j + 1, 0)]
        + [at(i, j, 1), at(i + 1, j, 1), at(i + 1, j + 1, 1), at(i, j + 1, 1)]
        for j in range(2)
        for i in range(3)
    ]
    stray = np.append(x, [[9.0, 9.0, 9.0]], axis=0)
    meshio.Mesh(stray, [("hexahedron", cells)]).write(tmp_path / "block.vtu")
    numbers = import_mesh(tmp_path / "block.vtu", tmp_path / "block.msh")
    assert (numbers["cells"], numbers["nodes"], numbers["cell"]) == (6, 24, "hexahedron")
    assert numbers["volume_cm3"] == pytest.approx(6.0)
    mesh = read_mesh(tmp_path / "block.msh", MPI.COMM_SELF)
    facets = [len(mesh.facet_tags.find(mesh.tag(f"surface_{k}")[1])) for k in range(1, 7)]
    assert sorted(facets) == [2, 2, 3, 3, 6, 6]
    patches = numbers["patches"]
    assert sum(patch["area_cm2"] for patch in patches.values()) == pytest.approx(22.0)
    up = next(patch for patch in patches.values() if patch["normal"][2] > 0.5)
    assert (up["area_cm2"], up["centre_cm"]) == (pytest.approx(6.0), pytest.approx([1.5, 1.0, 1.0]))
    whole = import_mesh(tmp_path / "block.vtu", tmp_path / "whole.msh", angle=100.0)
    assert whole["tags"] == ["surface_1", "body"]


@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_tags_and_cell_data_of_a_volume_mesh_are_kept(tmp_path, cell):
    """A valve in mm, each leaflet in two parts of one group: each cell and facet keeps what was said of it."""
    made = mesh_valve(pericardial(), size=0.3, cell=cell)
    names, half = list(made.facets), np.arange(len(made.cells)) % 2
    parts = [np.flatnonzero((made.leaflet == k) & (half == side)) for side in (0, 1) for k in (1, 2, 3)]
    with _quiet_gmsh() as gmsh:
        pieces = {f"part_{n}": made.cells[part] for n, part in enumerate(parts)}
        fill_model(gmsh, 10.0 * made.points, made.facets, pieces)
        gmsh.model.removePhysicalGroups([(3, n) for n in range(1, 7)])
        for k in (1, 2, 3):
            gmsh.model.addPhysicalGroup(3, [k, k + 3], tag=k, name=f"leaflet_{k}")
        num_facets = sum(len(made.facets[name]) for name in names)
        write_model(
            gmsh, tmp_path / "mm.msh", num_facets, {"radial": made.fibres["radial"][np.concatenate(parts)]}
        )
    numbers = import_mesh(tmp_path / "mm.msh", tmp_path / "cm.msh", scale=0.1)
    assert set(numbers["tags"]) == {*names, "leaflet_1", "leaflet_2", "leaflet_3"}
    assert numbers["volume_cm3"] == pytest.approx(volumes(made).sum())
    mesh = read_mesh(tmp_path / "cm.msh", MPI.COMM_SELF)
    for k in (1, 2, 3):
        cells = mesh.cell_tags.find(mesh.tag(f"leaflet_{k}")[1])
        assert len(cells) == len(made.cells) // 3
        middles = mesh.mesh.geometry.x[geometry_nodes(mesh.mesh)[cells]].mean(axis=1)
        angle = np.degrees(np.arctan2(middles[:, 1], middles[:, 0])) - 120.0 * (k - 1)
        assert np.abs((angle + 180.0) % 360.0 - 180.0).max() < 62.0
    for name in names:
        assert len(mesh.facet_tags.find(mesh.tag(name)[1])) == len(made.facets[name]), name
    field = read_vectors(mesh, tmp_path / "cm.msh")["radial"]
    X, found = field.function_space.tabulate_dof_coordinates(), field.x.array.reshape(-1, 3)
    near = cKDTree(made.points[made.cells].mean(axis=1)).query(X)
    assert near[0].max() < 1e-9
    np.testing.assert_allclose(found, made.fibres["radial"][near[1]], atol=1e-12)


def test_a_mesh_without_unit_vectors_has_no_directions(tmp_path):
    made = mesh_valve(pericardial(), size=0.4)
    write_valve(tmp_path / "long.msh", replace(made, fibres={"force": 3.0 * made.fibres["radial"]}))
    with pytest.raises(
        CaseError, match=r"long\.msh has no cell data of unit vectors; its cell data are .*force"
    ):
        read_vectors(read_mesh(tmp_path / "long.msh", MPI.COMM_SELF), tmp_path / "long.msh")


def test_what_cannot_be_used_is_said(tmp_path):
    meshio.Mesh(CORNERS, [("triangle", TRIANGLES[:-1])]).write(tmp_path / "open.stl", binary=True)
    with pytest.raises(CaseError, match="not closed: 3 edges"):
        import_mesh(tmp_path / "open.stl", tmp_path / "open.msh")
    with pytest.raises(CaseError, match="no such mesh file"):
        import_mesh(tmp_path / "none.stl", tmp_path / "none.msh")
    (tmp_path / "bad.vtu").write_text("no mesh")
    with pytest.raises(CaseError, match="cannot read this file"):
        import_mesh(tmp_path / "bad.vtu", tmp_path / "bad.msh")
    with pytest.raises(CaseError, match=r"ends in \.msh"):
        import_mesh(tmp_path / "open.stl", tmp_path / "open.vtu")


def test_the_command(tmp_path):
    meshio.Mesh(CORNERS, [("triangle", TRIANGLES)]).write(tmp_path / "box.stl", binary=True)
    done = CliRunner().invoke(
        app, ["mesh", "import", str(tmp_path / "box.stl"), "--size", "4mm", "--out", str(tmp_path / "b.msh")]
    )
    assert done.exit_code == 0, done.output
    assert re.search(r"^volume  (1000|999\.\d+) mm\^3$", done.output, re.MULTILINE)


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("empty.stl", b"", "is empty"),
        ("none.stl", bytes(84), "holds no triangles"),
        ("short.stl", bytes(80) + (9).to_bytes(4, "little") + bytes(60), "does not begin with solid"),
        ("noise.stl", bytes(range(256)) * 3, "does not begin with solid"),
        ("solid.stl", b"solid nothing\nendsolid nothing\n", "cannot read|expected triangles|holds no"),
        ("nan.stl", bytes(80) + (1).to_bytes(4, "little") + b"\xff" * 50, "not finite"),
        ("entities.vtu", b'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "c">]><VTKFile/>', "cannot read"),
        ("fibres.h5m", b"", "ends in one of"),
    ],
)
def test_a_file_that_is_no_mesh_is_one_line(tmp_path, capfd, name, data, message):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(CaseError, match=message) as caught:
        import_mesh(tmp_path / name, tmp_path / "out.msh")
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")
