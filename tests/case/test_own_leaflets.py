"""Leaflets from a file get what meshed ones get: the demo's valve against its own mesh, read back with its tags."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from tests.case.own_leaflets import STENTLESS, demo_leaflets, own, tube, write_stl, written
from tests.case.test_case_valve import coarse
from valvefsi.case.build import build, build_solid, run_case
from valvefsi.case.meshes import solid_mesh
from valvefsi.case.valve import check_leaflets
from valvefsi.case.walls import build_rigid
from valvefsi.errors import CaseError
from valvefsi.geometry.mesh import _quiet_gmsh
from valvefsi.geometry.tagged_files import fill_model, write_model
from valvefsi.io.history import read_history
from valvefsi.io.solid_body import read_body

FRAMES = "output.frames=2"
HGO = (
    "solid.leaflets.material={ model = 'hgo', c10 = '10 kPa', c01 = 8.0, "
    "families = [{ k1 = '20 kPa', k2 = 50.0, fibre = '30 deg from circumferential' }] }"
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """One folder for all ranks and the whole file."""
    path = tmp_path_factory.mktemp("own") if MPI.COMM_WORLD.rank == 0 else None
    return MPI.COMM_WORLD.bcast(path)


@pytest.fixture(scope="module")
def leaflets(folder):
    return written(folder)


@pytest.fixture(scope="module")
def both(folder, leaflets):
    """The demo without a stent, whose edge is of the formula or of the mesh, with the leaflets' own directions."""
    more = (FRAMES, STENTLESS, HGO)
    run_case(coarse(6, *more), out=folder / "made")
    run_case(own(leaflets, *more), out=folder / "read")
    return folder / "made", folder / "read"


def test_positions_open_area_and_waveforms_are_those_of_the_meshed_valve(both):
    made, read = (read_history(path / "history.csv") for path in both)
    assert set(made) == set(read)
    assert made["pdva_cm2"][0] > 0.1
    assert max(made["kinetic_energy_erg"]) > 0.0
    for name, expected in made.items():
        # Stored energies are round-off of modulus times volume, 1e5 dyn/cm^2 and 0.5 cm^3, at such small strains.
        least = 1e-10 if name.startswith("energy") else 1e-13
        assert np.abs(np.subtract(read[name], expected)).max() <= 1e-9 * np.abs(expected).max() + least, name
    bodies = [sorted((path / "paraview" / "leaflets").glob("*.vtu"))[-1] for path in both]
    made, read = (read_body(path) for path in bodies)
    assert np.abs(made.points - made.reference).max() > 1e-9
    np.testing.assert_allclose(read.points, made.points, rtol=0, atol=1e-13)


def test_peaks_numbers_and_pictures_are_those_of_the_meshed_valve(both):
    made, read = (read_history(path / "leaflets.csv") for path in both)
    assert "leaflet_2_von_mises_p99_kPa" in made
    for name, expected in made.items():
        assert read[name] == pytest.approx(expected, rel=1e-7, abs=1e-10), name
    if MPI.COMM_WORLD.rank == 0:
        told = [json.loads((path / "summary.json").read_text())["valve"] for path in both]
        numbers = [(each["cycles"][0]["missing"], set(each["plausible"])) for each in told]
        assert numbers[0] == numbers[1]
        area = [each["plausible"]["largest open area"]["value"] for each in told]
        assert area[1] == pytest.approx(area[0], rel=1e-9)
        for name in ("leaflets.png", "free_edges.png", "valve.png"):
            assert (both[1] / name).stat().st_size > 5000


def test_one_rank_gives_the_same_as_several(both, leaflets, folder):
    alone = folder / f"alone-{MPI.COMM_WORLD.rank}"
    run_case(own(leaflets, STENTLESS, HGO), out=alone, comm=MPI.COMM_SELF)
    mine, expected = (read_history(path / "history.csv") for path in (both[1], alone))
    for name in mine:
        scale = np.abs(expected[name]).max() + 1e-12
        assert mine[name] == pytest.approx(expected[name], rel=1e-6, abs=1e-8 * scale + 1e-11), name


def tops(points):
    """The highest point of each column of a stent, by azimuth."""
    phi = np.round(np.arctan2(points[:, 1], points[:, 0]), 6)
    return np.array([points[phi == each, 2].max() for each in np.unique(phi)])


def test_the_stent_is_that_of_the_meshed_valve_but_for_the_chords_of_the_edge(leaflets, folder):
    """Where the formula's edge bends, the mesh has chords: between its nodes they lie off by at most c s^2/8."""
    case, other = coarse(2), own(leaflets, steps=2)
    shape = case.solid[0].mesh.valve.geometry()
    u = np.linspace(-1.0, 1.0, 20001)
    curvature = np.gradient(np.gradient(shape.attachment(u)[:, 2], u), u)
    cut = np.abs(curvature).max() * (2.0 / demo_leaflets().elements[0]) ** 2 / 8.0
    made, read = (build(each, folder).model.bodies[1].points for each in (case, other))
    section = len(case.housing.section().housing(0.2, (-1.9, 5.9)).points)
    np.testing.assert_array_equal(read[:section], made[:section])
    made, read = made[section:], read[section:]
    radius = np.hypot(made[:, 0], made[:, 1])
    assert (np.hypot(read[:, 0], read[:, 1]).min(), np.hypot(read[:, 0], read[:, 1]).max()) == pytest.approx(
        (radius.min(), radius.max()), rel=1e-9
    )
    away = np.abs(tops(read) - tops(made))
    assert 0.0 < away.max() < cut
    assert tops(read).max() == pytest.approx(shape.height, abs=1e-12), "the posts are as high"


def test_fibres_and_thickness_follow_from_tags(leaflets, folder, comm):
    """The leaflets' directions from tags are those that the mesh was made with, but near the posts."""
    case = own(leaflets, HGO, leaflets="diameter = '25 mm'")
    found = {}
    for directions in ("tags", "data"):
        case = own(leaflets, HGO, leaflets=f"diameter = '25 mm', directions = '{directions}'")
        solid = build_solid(case, 0, comm)
        assert solid.discretisation.faces == (("inflow",), ("outflow",))
        field = solid.mesh.fibres["30.0 deg from circumferential"]
        found[directions] = np.concatenate(comm.allgather(field.x.array[: _own(field)].reshape(-1, 3)))
    cosine = np.einsum("ni,ni->n", found["tags"], found["data"])
    turn = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    assert np.median(turn) < 5.0
    assert np.quantile(turn, 0.9) < 30.0
    assert turn.max() < 60.0


def _own(field):
    return 3 * field.function_space.dofmap.index_map.size_local


@pytest.mark.parametrize(
    ("leaflets_of", "more", "said"),
    [
        (
            "attached = ['atached']",
            (),
            r"pericardial_valve\.toml: solid\.leaflets\.mesh\.leaflets\.attached = 'atached': .*mean \"attached\"",
        ),
        (
            "free = ['leaflet_1']",
            (),
            r"mesh\.leaflets\.free = 'leaflet_1': .*one of cells, expected one of facets",
        ),
        (
            "attached = ['free'], free = ['attached']",
            (),
            r"mesh\.leaflets\.diameter = 2\.5: the attached edge is on average 0\.\d+ cm from the z axis",
        ),
        ("inflow = ['free']", (), r"mesh\.leaflets\.inflow = 'free': this tag is one of free, too"),
        ("diameter = '25 cm'", (), r"mesh\.leaflets\.diameter = 25\.0: .*is the mesh in cm"),
        ("free = []", (), r"mesh\.leaflets\.free.*at least 1"),
        ("directions = 'file'", (), r"directions = 'file': expected one of tags, data"),
        ("", ("housing.annulus='1 cm'",), r"housing\.annulus = 1\.0: .*begins below"),
        ("", ("housing.stent=valve",), r"housing\.stent = 'valve'.*'leaflets'"),
        (
            "",
            ("solid.leaflets.element=lagrange", "solid.leaflets.faces=['inflow', 'outflow']"),
            r"faces.*solid_shell",
        ),
        ("", ("solid.leaflets.faces=['inflow', 'out']",), r"leaflets\.faces = 'out': .*no such tag"),
        ("", ("solid.leaflets.faces=['inflow', 'free']", HGO), r"leaflets\.faces.*do not lie in one row"),
        ("", ("solid.leaflets.tether.0.on=['atached']",), r"tether\.0\.on = 'atached': .*no such tag"),
        (
            "",
            (HGO.replace("30 deg from circumferential", "45 deg"),),
            r"families\.0\.fibre = 45\.0: one direction",
        ),
    ],
)
def test_what_does_not_fit_is_one_line_with_file_key_and_value(leaflets, folder, leaflets_of, more, said):
    with pytest.raises(CaseError, match=said) as caught:
        build(own(leaflets, *more, leaflets=leaflets_of), folder)
    assert "\n" not in str(caught.value)


def test_leaflets_of_tags_need_a_file_and_three_dimensions(folder):
    with pytest.raises(CaseError, match=r"mesh\.leaflets.*says what the tags of a file are"):
        coarse(2, "solid.leaflets.mesh.leaflets={ diameter = '25 mm' }")


def test_a_stent_whose_curve_is_open_is_refused_with_the_angles(folder, comm):
    """One leaflet of three: nothing is attached on two thirds of the way around."""
    path = folder / "one.msh"
    if comm.rank == 0:
        made = demo_leaflets()
        one = len(made.points) // 3
        kept = {name: faces[(faces < one).all(axis=1)] for name, faces in made.facets.items()}
        first = made.leaflet == 1
        fibres = {name: vectors[first] for name, vectors in made.fibres.items()}
        single = replace(
            made, points=made.points[:one], cells=made.cells[first], leaflet=np.ones(first.sum()), facets=kept
        )
        with _quiet_gmsh() as gmsh:
            fill_model(gmsh, single.points, kept, {"leaflet_1": single.cells})
            write_model(gmsh, path, sum(map(len, kept.values())), fibres)
    comm.barrier()
    with pytest.raises(
        CaseError, match=r"leaflets\.attached = 'attached': .*open: .*azimuths 5\d\.?\d* and 30\d\.?\d* deg"
    ):
        build(own(path), folder)


# A housing of one's own


def test_a_tube_from_a_file_is_the_housing(leaflets, folder):
    """A tube in mm, longer than the box: its points lie outside by the kernel's offset, with the tube's area."""
    path = write_stl(folder / "tube.stl", *tube(12.5, (-30.0, 70.0), around=96))
    housing = f"housing={{ file = '{path}', file_unit = '1 mm', annulus = '-1 mm', stent = 'leaflets' }}"
    case = own(leaflets, housing, steps=2)
    rigid, filling = build_rigid(
        case, build(case, folder).model.grid, check_leaflets(case, {0: solid_mesh(case, 0, MPI.COMM_WORLD)})
    )
    bare = own(leaflets, housing.replace(", stent = 'leaflets'", ""), steps=2)
    for d in range(3):
        faces = filling.X[filling.transfer.volumes[:, d] > 0.0] - 0.1 * (np.arange(3) == d)
        assert np.hypot(faces[:, 0], faces[:, 1]).min(initial=np.inf) > 1.25 * np.cos(np.pi / 96) + 0.099
    (alone,) = build_rigid(bare, build(bare, folder).model.grid)
    r, z = np.hypot(alone.points[:, 0], alone.points[:, 1]), alone.points[:, 2]
    flat = 1.25 * np.cos(np.pi / 96)  # the middle of a facet
    assert flat + 0.9 * 0.2 / 6.0 < r.min() < r.max() < 1.25 + 0.3 * 0.2
    assert z.min() >= -1.9 - 1e-9
    assert z.max() <= 5.9 + 1e-9
    facets = 96 * 2.0 * 1.25 * np.sin(np.pi / 96)
    total = alone.comm.allreduce(float(alone.weights.sum()))
    assert total == pytest.approx(facets * 7.8, rel=0.02)
    assert rigid.num_points > alone.num_points
    stent = rigid.points[alone.num_points :]
    assert np.hypot(stent[:, 0], stent[:, 1]).max() < 1.25 + 0.3 * 0.2
    assert stent[:, 2].min() == pytest.approx(-0.1, abs=1e-3)


def test_the_stent_stands_on_the_wall_of_a_file_where_the_annulus_is(leaflets, folder):
    """A cone, r = 1.25 + 0.3 z up to z = 0: at z = -5 mm the stent begins at r = 1.1 and not at 1.25."""
    points, triangles = tube(1.25, (-2.0, 6.0), around=96, along=160)
    points[:, :2] *= 1.0 + 0.3 / 1.25 * np.minimum(points[:, 2:], 0.0)
    path = write_stl(folder / "cone.stl", points, triangles)
    case = own(leaflets, f"housing={{ file = '{path}', annulus = '-5 mm', stent = 'leaflets' }}", steps=2)
    grid = build(case, folder).model.grid
    section, stent = (
        build_rigid(each, grid, check_leaflets(case, {0: solid_mesh(case, 0, MPI.COMM_WORLD)}))[0].points
        for each in (
            case.model_copy(update={"housing": case.housing.model_copy(update={"stent": None})}),
            case,
        )
    )
    foot = stent[len(section) :]
    foot = foot[foot[:, 2] < -0.45]
    assert np.hypot(foot[:, 0], foot[:, 1]) == pytest.approx(1.1, abs=0.3 * 0.2)


def test_a_run_in_a_housing_from_a_file(leaflets, folder, picture_faults):
    path = write_stl(folder / "tube.stl", *tube(1.25, (-2.0, 6.0)))
    housing = f"housing={{ file = '{path}', annulus = '-1 mm', stent = 'leaflets' }}"
    run_case(own(leaflets, housing, steps=4), out=folder / "tube")
    picture_faults.clear()  # the axis of time has labels like 0.00016 s
    history = read_history(folder / "tube" / "history.csv")
    assert np.isfinite([history[name] for name in history]).all()
    assert history["pdva_cm2"][0] > 0.1


def _turned(points, triangles):
    return points, np.where((np.arange(len(triangles)) == 700)[:, None], triangles[:, ::-1], triangles)


@pytest.mark.parametrize(
    ("wall", "more", "said"),
    [
        (tube(1.25, (-2.0, 5.0)), "", r"housing\.file = .*spans z = -2 \.\.\. 5 cm and must reach both"),
        (
            tube(1.25, (-2.0, 6.0)),
            ", tags = ['wall']",
            r"housing\.tags = 'wall': no facets of wall.stl have this tag",
        ),
        (tube(1.25, (-2.0, 6.0)), ", sinus_depth = '3 mm'", r"housing\.sinus_depth.*is that of the file"),
        (tube(12.5, (-20.0, 60.0)), "", r"housing\.file = .*wider than the box: .*file_unit"),
        (_turned(*tube(1.25, (-2.0, 6.0))), "", r"housing\.file = .*not oriented alike: 3 edges"),
    ],
)
def test_a_wall_that_cannot_be_used_is_one_line(leaflets, folder, wall, more, said):
    path = write_stl(folder / "wall.stl", *wall)
    with pytest.raises(CaseError, match=said):
        build(own(leaflets, f"housing={{ file = '{path}', annulus = '-1 mm'{more} }}"), folder)


def test_keys_of_a_file_need_one():
    with pytest.raises(CaseError, match=r"housing\.tags.*needs a file"):
        coarse(2, "housing.tags=['wall']")
    with pytest.raises(CaseError, match=r"housing\.file = 'none\.stl': no such file"):
        coarse(2, "housing.file=none.stl")
