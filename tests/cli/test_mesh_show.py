"""``valvefsi mesh show`` and what ``mesh import`` shows: pictures that are there, tables that say what is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from typer.testing import CliRunner

from valvefsi.cli import app
from valvefsi.cli.mesh_pictures import edges_say

pytestmark = pytest.mark.serial
ROOT = Path(__file__).parents[2]
STARTS = ROOT / "valvefsi" / "cli" / "starts"


def called(*words):
    done = CliRunner().invoke(app, ["mesh", *map(str, words)])
    assert done.exit_code == 0, done.output + str(done.exception)
    return done.output


def colours(path):
    """Number of strong colours in a picture."""
    rgb = np.rint(imread(path)[..., :3] * 7).reshape(-1, 3)
    strong = rgb[np.ptp(rgb, axis=1) > 2]
    return len(np.unique(strong, axis=0))


def test_an_import_draws_tags_and_says_which_is_where(tmp_path):
    said = called("import", STARTS / "own-mesh" / "flap.stl", "--out", tmp_path / "flap.msh")
    assert "surface_3" in said
    assert "7.5, 2.5, 3   0.00, -1.00, 0.00   flat" in said
    assert "scaled Jacobian" in said
    assert "area [mm^2]" in said  # a heading's unit is no markup
    assert "extent  1.5 x 5 x 6 mm" in said
    assert colours(tmp_path / "flap_tags.png") >= 6
    assert (tmp_path / "flap_thickness.png").exists()


@pytest.mark.parametrize(
    ("edges", "verdict"),
    [
        ([0.8, 1.2, 1.9], "even"),
        ([0.35, 0.87, 1.98], "5.7 to 1"),
        ([0.1, 0.87, 1.98], "20 to 1: the smallest edge limits the time step"),
    ],
)
def test_edges_are_even_where_they_are(edges, verdict):
    assert edges_say(np.array(edges)) == verdict


def test_a_mesh_in_the_plane_is_shown(tmp_path):
    said = called("show", ROOT / "meshes" / "compressed_block.msh", "--out", tmp_path)
    assert "quadrilateral" in said or "triangle" in said
    assert [path.name for path in tmp_path.glob("*.png")] == ["compressed_block_tags.png"]


def test_a_valve_of_a_case_is_shown_with_its_fibres(tmp_path):
    said = called("show", STARTS / "valve" / "valve.toml", "--out", tmp_path)
    assert "leaflet_1, leaflet_2, leaflet_3" in said
    names = {path.name for path in tmp_path.glob("*.png")}
    assert {"leaflets_tags.png", "leaflets_thickness.png", "leaflets_fibres_circumferential.png"} <= names


def test_what_is_no_mesh_is_refused():
    done = CliRunner().invoke(app, ["mesh", "show", str(STARTS / "own-mesh" / "flap.stl")])
    assert "mesh import makes a .msh" in str(done.exception)
