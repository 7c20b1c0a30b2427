"""Meshes from gmsh: shapes, tags, files, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import ufl
from dolfinx import fem
from dolfinx.mesh import compute_midpoints
from mpi4py import MPI

from valvefsi.errors import CaseError
from valvefsi.geometry.mesh import mesh_from_gmsh, read_mesh
from valvefsi.geometry.shapes import box, compressed_block, rectangle

MESHES = Path(__file__).parents[2] / "meshes"


def size_of(mesh, name):
    """Area or volume of a tag."""
    dim, tag = mesh.tag(name)
    cells = dim == mesh.dim
    data = mesh.cell_tags if cells else mesh.facet_tags
    measure = ufl.Measure("dx" if cells else "ds", domain=mesh.mesh, subdomain_data=data)
    one = fem.Constant(mesh.mesh, 1.0)
    return mesh.mesh.comm.allreduce(fem.assemble_scalar(compat.compile_form(one * measure(tag))))


def count_cells(mesh):
    return mesh.mesh.topology.index_map(mesh.dim).size_global


BLOCK = {"block": 200.0, "bottom": 20.0, "sides": 20.0, "top_loaded": 10.0, "top_outer": 10.0}
EDGES = ("x_lower", "x_upper", "y_lower", "y_upper", "z_lower", "z_upper")


@pytest.mark.parametrize(("cell", "per_square"), [("quadrilateral", 1), ("triangle", 2)])
def test_the_block_has_its_tags_with_their_sizes(comm, cell, per_square):
    mesh = compressed_block(comm, elements=(16, 8), cell=cell)
    assert count_cells(mesh) == 128 * per_square
    assert {name: pytest.approx(size_of(mesh, name)) for name in mesh.names} == BLOCK
    x = mesh.mesh.geometry.x
    assert comm.allreduce(x[:, 0].min(), op=MPI.MIN) == 10
    assert comm.allreduce(x[:, 1].max(), op=MPI.MAX) == 25


def test_the_block_takes_other_load_widths_that_end_on_nodes(comm):
    mesh = compressed_block(comm, elements=(20, 4), load_width=4.0)
    assert size_of(mesh, "top_loaded") == pytest.approx(4.0)
    with pytest.raises(CaseError, match=r"load_width = 4\.5"):
        compressed_block(comm, elements=(20, 4), load_width=4.5)
    with pytest.raises(CaseError, match="load_width = 20"):
        compressed_block(comm, elements=(20, 4), load_width=20.0)


@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
def test_a_rectangle_has_its_sides(comm, cell):
    mesh = rectangle(comm, lower=(1, 2), size=(3, 0.5), elements=(6, 2), cell=cell)
    sizes = {name: pytest.approx(size) for name, size in zip(EDGES, (0.5, 0.5, 3, 3), strict=False)}
    assert {name: size_of(mesh, name) for name in mesh.names} == {"body": pytest.approx(1.5), **sizes}


@pytest.mark.parametrize(("cell", "hexahedra"), [("hexahedron", True), ("tetrahedron", False)])
def test_a_box_has_its_faces_where_their_names_say(comm, cell, hexahedra):
    mesh = box(comm, lower=(1, 2, 3), size=(1, 2, 4), elements=(2, 3, 4), cell=cell)
    assert (count_cells(mesh) == 24) == hexahedra
    areas = dict(zip(EDGES, (8, 8, 4, 4, 2, 2), strict=True))
    assert {name: size_of(mesh, name) for name in mesh.names} == pytest.approx({"body": 8, **areas})
    for axis, (low, high) in enumerate(((1, 2), (2, 4), (3, 7))):
        for name, place in (("xyz"[axis] + "_lower", low), ("xyz"[axis] + "_upper", high)):
            facets = mesh.facet_tags.find(mesh.tag(name)[1])
            middles = compute_midpoints(mesh.mesh, 2, facets)
            assert np.all(np.abs(middles[:, axis] - place) < 1e-12)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"size": (1.0, -1.0)}, "positive lengths"),
        ({"size": (1.0, 1.0, 1.0)}, "expected 2 numbers"),
        ({"elements": (4, 0)}, "whole numbers"),
        ({"cell": "hexagon"}, '"quadrilateral" or "triangle"'),
    ],
)
def test_impossible_shapes_are_refused(comm, options, message):
    with pytest.raises(CaseError, match=message):
        rectangle(comm, **options)


def test_the_committed_mesh_is_the_one_the_package_makes(comm):
    read = read_mesh(MESHES / "compressed_block.msh", comm)
    assert read.dim == 2
    assert count_cells(read) == 128
    assert {name: pytest.approx(size_of(read, name)) for name in read.names} == BLOCK


def test_an_unknown_tag_lists_those_there_are(comm):
    mesh = compressed_block(comm, elements=(4, 2))
    with pytest.raises(CaseError) as caught:
        mesh.tag("botom")
    assert 'did you mean "bottom"' in str(caught.value)
    assert all(f'"{name}"' in str(caught.value) for name in BLOCK)


def write(comm, path, text):
    if comm.rank == 0:
        path.write_text(text, encoding="utf-8")
    comm.barrier()
    return path


def test_missing_and_broken_files_are_one_error_on_all_ranks(comm, shared_tmp):
    with pytest.raises(CaseError, match="no such mesh file"):
        read_mesh(shared_tmp / "missing.msh", comm)
    for name, text in (("junk.msh", "not a mesh\n"), ("empty.msh", "")):
        with pytest.raises(CaseError, match=name):
            read_mesh(write(comm, shared_tmp / name, text), comm)


HEADER = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n"


def square(nodes, elements, names=""):
    lines = [f"{k} {x} {y} {z}" for k, (x, y, z) in enumerate(nodes, start=1)]
    body = "\n".join(f"{k} {element}" for k, element in enumerate(elements, start=1))
    return (
        f"{HEADER}{names}$Nodes\n{len(nodes)}\n" + "\n".join(lines) + "\n$EndNodes\n"
        f"$Elements\n{len(elements)}\n{body}\n$EndElements\n"
    )


CORNERS = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
QUAD = "3 2 5 1 1 2 3 4"


BITE = 'SystemCall "touch {0}"; Printf("x") > "{0}";'


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("script.msh", "{bite}\n"),
        ("blank.msh", "\n\n{bite}\n"),
        ("comment.msh", "// mesh\n{bite}\n"),
        ("box.geo", "{bite}\n"),
        ("box.msh.gz", "{bite}\n"),
        ("head.msh", HEADER + "{bite}\n"),
        ("comments.msh", "$Comments\n{bite}\n$EndComments\n" + HEADER),
    ],
)
def test_a_script_is_no_mesh(tmp_path, name, text):
    mark = tmp_path / "bitten"
    path = tmp_path / name
    path.write_text(text.replace("{bite}", BITE.format(mark)), encoding="utf-8")
    with pytest.raises(CaseError) as caught:
        read_mesh(path, MPI.COMM_SELF)
    assert not mark.exists()
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


def test_options_beside_a_mesh_are_not_run(tmp_path):
    mark = tmp_path / "bitten"
    path = tmp_path / "plain.msh"
    path.write_text(square(CORNERS, [QUAD]), encoding="utf-8")
    (tmp_path / "plain.msh.opt").write_text(BITE.format(mark), encoding="utf-8")
    assert count_cells(read_mesh(path, MPI.COMM_SELF)) == 1
    assert not mark.exists()


def test_groups_without_a_name_get_one(comm, shared_tmp):
    mesh = read_mesh(write(comm, shared_tmp / "plain.msh", square(CORNERS, [QUAD, "1 2 7 1 1 2"])), comm)
    assert mesh.names == {"cells_5": (2, 5), "facets_7": (1, 7)}
    assert size_of(mesh, "facets_7") == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("nodes", "elements", "message"),
    [
        (CORNERS, ["3 2 5 1 1 2 4 3"], "inverted or flat"),
        (
            [(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0)],
            ["2 2 5 1 1 2 3", "2 2 5 1 1 2 4"],
            "1 inverted or flat",
        ),
        ([(0, 0, 0), (1, 0, 1), (1, 1, 0), (0, 1, 0)], [QUAD], "must be flat"),
        (CORNERS, ["3 2 0 1 1 2 3 4"], "physical group"),
        (CORNERS, ["1 2 7 1 1 2"], "physical group for its cells"),
        ([*CORNERS, (2, 0, 0), (2, 1, 0)], [QUAD, "3 2 0 2 2 5 6 3"], "every cell needs one"),
        ([*CORNERS, (2, 0, 0)], [QUAD, "2 2 5 1 2 5 3"], "one kind"),
    ],
)
def test_meshes_that_cannot_be_used_are_refused(comm, shared_tmp, nodes, elements, message):
    path = write(comm, shared_tmp / "bad.msh", square(nodes, elements))
    with pytest.raises(CaseError, match=message) as caught:
        read_mesh(path, comm)
    assert "bad.msh" in str(caught.value)
    assert "\n" not in str(caught.value)


TWO_TRIANGLES = """$MeshFormat
4.1 0 8
$EndMeshFormat
$Entities
0 0 1 0
1 0 0 0 1 1 0 1 1 0
$EndEntities
$Nodes
1 4 1 4
2 1 0 4
1\n2\n3\n4
0 0 0\n1 0 0\n1 1 0\n0 1 0
$EndNodes
$Elements
1 2 1 2
2 1 2 2
1 1 2 3
{} 1 3 4
$EndElements
"""


def test_two_cells_of_one_number_are_refused(comm, shared_tmp):
    read_mesh(write(comm, shared_tmp / "good.msh", TWO_TRIANGLES.format(2)), comm)
    path = write(comm, shared_tmp / "bad.msh", TWO_TRIANGLES.format(1))
    with pytest.raises(CaseError, match=r"bad\.msh: two cells have the same number"):
        read_mesh(path, comm)


def test_any_failure_of_the_build_reaches_all_ranks(comm):
    def build(gmsh):
        raise KeyError("nothing here")

    with pytest.raises(KeyError, match="nothing here"):
        mesh_from_gmsh(build, comm, source="test")


def test_gmsh_is_left_as_it_was_found(comm, capfd):
    import gmsh

    compressed_block(comm, elements=(4, 2))
    assert not gmsh.isInitialized()
    gmsh.initialize([], readConfigFiles=False)
    try:
        gmsh.model.add("mine")
        gmsh.option.setNumber("General.Terminal", 0)
        compressed_block(comm, elements=(4, 2))
        assert gmsh.isInitialized()
        assert gmsh.model.getCurrent() == "mine"
    finally:
        gmsh.finalize()
    assert capfd.readouterr().out == ""
