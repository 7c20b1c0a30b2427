"""The parametric valve: shape, symmetry, gap, volume, files, fibres, and what is refused."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from typer.testing import CliRunner

from valvefsi.errors import CaseError
from valvefsi.geometry import valve as parts
from valvefsi.geometry.leaflets import TYPES, ValveGeometry, pericardial, porcine
from valvefsi.geometry.mesh import read_mesh
from valvefsi.geometry.valve import jacobians, mesh_valve, surface_volume, volumes, write_valve
from valvefsi.geometry.valve_quality import coaptation_length, gap, quality

CELLS = ("hexahedron", "tetrahedron")


@pytest.mark.parametrize("kind", TYPES)
@pytest.mark.parametrize("cell", CELLS)
def test_the_volume_converges_to_the_quadrature_of_the_formulas_at_second_order(kind, cell):
    geometry = TYPES[kind]()
    exact = surface_volume(geometry)
    coarse, fine = (
        abs(volumes(mesh_valve(geometry, size=size, cell=cell)).sum() / 3 - exact) for size in (0.1, 0.05)
    )
    assert math.log2(coarse / fine) > 1.7
    assert fine < 2e-3 * exact


def test_the_quadrature_gives_the_closed_form_of_a_bent_strip(monkeypatch):
    R, length, t = 1.3, 0.7, 0.2

    def cylinder(self, u, v):
        return np.stack([R * np.cos(u), R * np.sin(u), length * v], axis=1)

    monkeypatch.setattr(ValveGeometry, "surface", cylinder)
    geometry = ValveGeometry(thickness=t, nose=0.2)
    assert surface_volume(geometry) == pytest.approx(2 * R * length * t, rel=1e-8)


@pytest.mark.parametrize("kind", TYPES)
@pytest.mark.parametrize("cell", CELLS)
def test_no_cell_is_flat_or_inverted_on_any_grid(kind, cell):
    smallest = []
    for size in (0.1, 0.05):
        table = quality(TYPES[kind](), mesh_valve(TYPES[kind](), size=size, cell=cell, layers=2))
        smallest.append(table["smallest_scaled_jacobian"])
        assert table["smallest_jacobian_cm3"] > 0
    if cell == "hexahedron":
        assert min(smallest) > 0.35


@pytest.mark.parametrize("kind", TYPES)
def test_a_turn_by_120_degrees_maps_each_leaflet_on_the_next(kind):
    one, two, three = mesh_valve(TYPES[kind](), size=0.1).points.reshape(3, -1, 3)
    c, s = -0.5, math.sqrt(0.75)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    for here, there in ((one, two), (two, three), (three, one)):
        assert np.abs(here @ turn.T - there).max() < 1e-14


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("wanted", [0.01, 0.04, 0.12])
def test_leaflets_keep_their_gap(cell, wanted):
    geometry = ValveGeometry(gap=wanted)
    mesh = mesh_valve(geometry, size=0.04, cell=cell)
    assert gap(mesh) >= wanted
    x = mesh.points.reshape(3, -1, 3)[0]
    to_plane = (math.sqrt(3) * x[:, 0] - np.abs(x[:, 1])) / 2
    assert to_plane.min() >= wanted / 2 - 1e-12
    assert to_plane.min() < wanted / 2 + 0.003


def test_each_leaflet_is_its_own_mirror_image():
    around, up, _ = mesh_valve(pericardial(), size=0.1).elements
    points, _ = parts._leaflet_nodes(pericardial(), (around, up, 1))
    grid = points.reshape(around + 1, up + 1, 2, 3)
    mirrored = grid[::-1] * [1, -1, 1]
    assert np.abs(grid - mirrored).max() < 1e-9


def test_the_ends_of_the_leaflets_stand_on_the_stent():
    geometry = pericardial()
    v = np.linspace(0, 1, 9)
    for u in (-1.0, 1.0):
        x = geometry.surface(np.full(9, u), v)
        assert np.hypot(x[:, 0], x[:, 1]) == pytest.approx(geometry.radius, abs=1e-9)
    u = np.linspace(-1, 1, 9)
    x = geometry.surface(u, np.zeros(9))
    assert np.hypot(x[:, 0], x[:, 1]) == pytest.approx(geometry.radius, abs=1e-12)
    assert x[4, 2] == 0
    assert geometry.surface(np.ones(1), np.ones(1))[0, 2] == pytest.approx(geometry.height)


def test_the_measured_thickness_is_the_one_asked_for():
    geometry = porcine()
    around, up, _ = mesh_valve(geometry, size=0.1).elements
    points, _ = parts._leaflet_nodes(geometry, (around, up, 1))
    grid = points.reshape(around + 1, up + 1, 2, 3)
    thick = np.linalg.norm(grid[:, :, 1] - grid[:, :, 0], axis=2)
    assert thick[0] == pytest.approx(0.044)
    assert thick[around // 2].min() == pytest.approx(0.03, abs=1e-4)


def test_fibres_are_unit_tangents_at_the_angles_asked_for():
    mesh = mesh_valve(ValveGeometry(fibre_angles=(0.0, 45.0, -45.0)), size=0.1)
    around, plus, minus = (mesh.fibres[f"fibre_{k}"] for k in (1, 2, 3))
    corners = mesh.points[mesh.cells]
    through = corners[:, 4:].mean(axis=1) - corners[:, :4].mean(axis=1)
    through /= np.linalg.norm(through, axis=1, keepdims=True)
    for a in (around, plus, minus):
        assert np.linalg.norm(a, axis=1) == pytest.approx(1, abs=1e-12)
        assert np.abs(np.einsum("ci,ci->c", a, through)).max() < 0.05
    assert np.einsum("ci,ci->c", around, plus) == pytest.approx(math.sqrt(0.5))
    assert np.einsum("ci,ci->c", plus, minus) == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("cell", CELLS)
def test_the_file_gives_cells_tags_and_fibres_back(comm, tmp_path, cell):
    from valvefsi.solid.materials.fibres import read_fibres

    path = comm.bcast(tmp_path) / "valve.msh"
    made = mesh_valve(pericardial(), size=0.4, cell=cell)
    if comm.rank == 0:
        write_valve(path, made)
    comm.barrier()
    mesh = read_mesh(path, comm)
    assert mesh.mesh.topology.index_map(3).size_global == len(made.cells)
    groups = {"leaflet_1", "leaflet_2", "leaflet_3", "inflow", "outflow", "attached", "free"}
    assert set(mesh.names) == groups
    for name, faces in made.facets.items():
        found = mesh.facet_tags.find(mesh.tag(name)[1])
        own = found[found < mesh.mesh.topology.index_map(2).size_local]
        assert comm.allreduce(len(own)) == len(faces)
    field = read_fibres(mesh, path, "fibre_2")
    middles = made.points[made.cells].mean(axis=1)
    X = field.function_space.tabulate_dof_coordinates()
    gaps = np.linalg.norm(X[:, None] - middles[None], axis=2)
    assert gaps.min(axis=1).max() < 1e-9
    expected = made.fibres["fibre_2"][gaps.argmin(axis=1)]
    assert np.abs(field.x.array.reshape(-1, 3) - expected).max() < 1e-7


def test_coaptation_grows_with_a_lower_belly():
    high, low = (coaptation_length(ValveGeometry(belly=belly)) for belly in (0.4, 0.0))
    assert low > high > 0


@pytest.mark.parametrize(
    "wrong",
    [
        {"gap": 0.0},
        {"commissure": 2.0},
        {"belly_thickness": 0.1},
        {"nose": 0.001},
        {"gap": 1.0},
        {"drop": 1.5},
    ],
)
def test_shapes_that_cannot_be_are_refused(wrong):
    with pytest.raises(CaseError, match=next(iter(wrong))):
        ValveGeometry(**wrong)


def test_meshes_that_cannot_be_are_refused():
    with pytest.raises(CaseError, match="cell"):
        mesh_valve(pericardial(), size=0.1, cell="prism")
    with pytest.raises(CaseError, match="size"):
        mesh_valve(pericardial(), size=0.0)


@pytest.mark.serial
def test_the_command_writes_mesh_table_and_picture(tmp_path):
    from valvefsi.cli import app

    out = tmp_path / "valve.msh"
    arguments = ["mesh", "valve", "--type", "porcine", "--diameter", "25mm", "--h", "2mm", "--out", str(out)]
    result = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert result.exit_code == 0
    table = json.loads(out.with_suffix(".json").read_text())
    assert table["gap_cm"] >= 0.04
    assert "coaptation_length_cm" in result.output
    assert jacobians(mesh_valve(porcine(), size=0.1)).shape == (table["cells"], 8)
    assert out.with_suffix(".png").stat().st_size > 10_000
    with pytest.raises(CaseError, match="--diameter"):
        CliRunner().invoke(app, [*arguments[:4], "--diameter", "25 kg"], catch_exceptions=False)
