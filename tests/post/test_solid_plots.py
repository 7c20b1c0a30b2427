"""Pictures and files of solids: every kind of cell, with and without pyvista, files read back."""

from __future__ import annotations

from dataclasses import replace

import matplotlib.image
import meshio
import numpy as np
import pytest

from valvefsi.errors import CaseError
from valvefsi.io.paraview import SolidSeries
from valvefsi.io.solid_body import Body, read_body, write_body
from valvefsi.post.plots import base
from valvefsi.post.plots import solid as solid_plots
from valvefsi.post.plots.convergence import Convergence, convergence
from valvefsi.post.plots.solid import deformed, draw_folder

pytestmark = pytest.mark.serial

CUBE = np.array([[x, y, z] for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0)])
CORNERS = np.array([[0, 1, 3, 2, 4, 5, 7, 6]])
NAME = "von Mises stress [dyn/cm^2]"


def square(kind=9):
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    cells = {9: np.array([[0, 1, 2, 3]])} if kind == 9 else {5: np.array([[0, 1, 2], [0, 2, 3]])}
    return Body(points=points * 1.2, cells=cells, values={NAME: points[:, 0]}, reference=points)


def cube():
    values = {NAME: CUBE[:, 2] * 1e4, "J [-]": 1 + 0.1 * CUBE[:, 0], "stretches": CUBE}
    return Body(points=CUBE * [1, 1, 2], cells={12: CORNERS}, values=values, reference=CUBE)


def colours(path):
    """The number of distinct colours of a picture, rounded."""
    image = matplotlib.image.imread(path)[..., :3]
    return len(np.unique((image * 32).astype(int) @ [1 << 12, 1 << 6, 1]))


@pytest.mark.parametrize("body", [square(9), square(5), cube()], ids=["quad", "triangle", "hexahedron"])
def test_a_deformed_body_is_drawn_in_colour(tmp_path, body):
    path = deformed(tmp_path / "body.png", body, title="Body", caption="test")
    assert colours(path) > 40


@pytest.mark.skipif(not solid_plots.can_render(), reason="pyvista or a way to render off screen is missing")
def test_pyvista_renders_without_a_display(tmp_path, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    body = replace(cube(), reference=CUBE + [0.5, 2.0, 1.0])  # far off, it must be in the picture too
    _, values = body.scalar()
    image = solid_plots._render(body, NAME, values, solid_plots._scale(NAME, values))
    ink = (image < 250).any(axis=2)
    assert 0.05 < ink.mean() < 0.9
    for edge in (ink[0], ink[-1], ink[:, 0], ink[:, -1]):
        assert not edge.any(), "the body fits into the picture"


def test_without_pyvista_matplotlib_draws_the_body(tmp_path, monkeypatch):
    monkeypatch.setattr(solid_plots, "can_render", lambda: False)
    assert colours(deformed(tmp_path / "plain.png", cube())) > 20


def test_a_missing_library_is_noticed_before_vtk_is_started(monkeypatch):
    def no_library(name):
        raise OSError(name)

    monkeypatch.setattr(solid_plots.ctypes, "CDLL", no_library)
    assert not solid_plots.can_render()


def test_a_body_that_is_written_is_read_back(tmp_path):
    body = cube()
    found = read_body(write_body(tmp_path / "cube.vtu", body))
    np.testing.assert_allclose(found.points, body.points)
    np.testing.assert_allclose(found.reference, body.reference, atol=1e-12)
    np.testing.assert_array_equal(found.cells[12], CORNERS)
    for name, values in body.values.items():
        np.testing.assert_allclose(found.values[name], values)
    assert meshio.read(tmp_path / "cube.vtu").cells[0].type == "hexahedron"


def test_the_field_that_is_drawn_can_be_chosen():
    assert cube().scalar()[0] == NAME
    assert replace(cube(), shown="J [-]").scalar()[0] == "J [-]"
    with pytest.raises(CaseError, match="no such field"):
        replace(cube(), shown="stretches").scalar()
    bare = Body(points=CUBE * 2, cells={12: CORNERS}, reference=CUBE)
    name, values = bare.scalar()
    assert name.startswith("displacement")
    assert values.max() == pytest.approx(np.sqrt(3))


def test_a_series_is_drawn_at_the_time_asked_for(tmp_path, comm):
    series = SolidSeries(tmp_path / "paraview", "block", comm)
    for t in (0.0, 1.0, 2.0):
        series.write(t, CUBE * (1 + t), {12: CORNERS}, np.array([1.0 + t]), CUBE * t)
    made = draw_folder(tmp_path, tmp_path / "out", t=0.9)
    assert [path.name for path in made] == ["block_J.png"]
    assert solid_plots._at_time(tmp_path / "paraview" / "block.pvd", 0.9)[0] == 1.0
    assert solid_plots._at_time(tmp_path / "paraview" / "block.pvd", None)[0] == 2.0


def test_a_folder_of_a_benchmark_is_drawn_and_a_field_is_found_by_its_beginning(tmp_path):
    write_body(tmp_path / "solid_hexahedron.vtu", cube())
    made = draw_folder(tmp_path, tmp_path, field="von mises")
    assert [path.name for path in made] == ["solid_hexahedron_von_Mises_stress.png"]
    with pytest.raises(CaseError, match="there are"):
        draw_folder(tmp_path, tmp_path, field="pressure")


def test_a_folder_without_solids_is_one_clear_error(tmp_path):
    with pytest.raises(CaseError, match="no solids here"):
        draw_folder(tmp_path, tmp_path)
    (tmp_path / "broken.vtu").write_text("nothing")
    with pytest.raises(CaseError, match="cannot read"):
        draw_folder(tmp_path, tmp_path)


def test_convergence_is_drawn_with_its_references(tmp_path):
    lines = {"triangle": ([100, 400, 1600], [1.0, 1.1, 1.12]), "quad": ([100, 400, 1600], [1.2, 1.13, 1.125])}
    panel = Convergence(
        label="u [cm]", lines=lines, known=[(1.12, None, "known"), (None, (1.1, 1.15), "band")]
    )
    assert colours(convergence(tmp_path / "convergence.png", [panel], title="Answer")) > 10


def test_two_pictures_of_one_J_have_even_ticks_and_say_what_was_averaged(tmp_path, monkeypatch):
    made = []
    for module in (solid_plots, base):
        monkeypatch.setattr(module, "saved", lambda figure, path: made.append(figure) or path)
    J = np.array([0.879, 1.0, 1.1, 1.05])
    deformed(tmp_path / "a.png", replace(square(), values={"J": J}, shown="J"))
    x, still = np.linspace(0.1, 0.9, 5), np.zeros((5, 5))
    solid = base.PlaneSolid(points=square().points, cells=square().cells, J=J[:1])
    base.flow_and_solid(tmp_path / "b.png", base.PlaneFlow(x=x, y=x, u=still, v=still), [solid])
    bars = [next(axes for axes in figure.axes if "det F" in axes.get_xlabel()) for figure in made]
    labels = [axes.get_xlabel() for axes in bars]
    assert "mean of the cells at each node" in labels[0]
    assert "mean of each cell" in labels[1]
    for axes in bars:
        assert [t.get_text() for t in axes.get_xticklabels()] == ["0.84", "0.92", "1.00", "1.08", "1.16"]
