"""Pictures of the fibre fields of a case file."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from valvefsi.case import fibre_pictures, load_case
from valvefsi.case.fibre_pictures import draw_fibres
from valvefsi.cli import app
from valvefsi.errors import CaseError

CASE = """
[grid]
lower = [0, 0]
upper = [4, 4]
cells = [16, 16]
[time]
dt = 0.01
t_end = 1.0
[[solid]]
name = "leaflet"
material = { model = "neo_hookean", c1 = "1 kPa" }
mesh = { shape = "rectangle", lower = [1, 1], size = [2, 2], elements = [6, 6] }
"""
FIBRES = """
[[solid.fibre]]
name = "round"
rule = "circumferential"
through = [2, 0.5]
[[solid.fibre]]
name = "along"
rule = "constant"
direction = [1, 1]
"""


def test_every_fibre_field_of_a_case_is_drawn(shared_tmp, comm):
    if comm.rank == 0:
        (shared_tmp / "case.toml").write_text(CASE + FIBRES)
    comm.barrier()
    made = draw_fibres(load_case(shared_tmp / "case.toml"), shared_tmp / "pictures", comm)
    if comm.rank == 0:
        assert [path.name for path in made] == ["fibres_leaflet_round.png", "fibres_leaflet_along.png"]
        assert all(path.stat().st_size > 5000 for path in made)
    else:
        assert made == []


def test_a_case_without_fibres_says_so(shared_tmp, comm):
    if comm.rank == 0:
        (shared_tmp / "case.toml").write_text(CASE)
    comm.barrier()
    with pytest.raises(CaseError, match=r"solid\.fibre: no solid of this case"):
        draw_fibres(load_case(shared_tmp / "case.toml"), shared_tmp, comm)


@pytest.mark.serial
def test_a_picture_counts_the_lines_that_it_draws_and_names_a_family(tmp_path, monkeypatch):
    """Of the elements, with a line each, three at most are drawn."""
    monkeypatch.setattr(fibre_pictures, "MOST", 3)
    drawn = []
    monkeypatch.setattr(
        fibre_pictures,
        "fibre_picture",
        lambda path, points, vectors, **texts: drawn.append((len(points), texts["caption"])) or path,
    )
    (tmp_path / "case.toml").write_text(CASE + FIBRES)
    draw_fibres(load_case(tmp_path / "case.toml"), tmp_path)
    assert all(0 < count <= 3 and said.startswith(f"{count} lines along") for count, said in drawn)
    assert [fibre_pictures.heading(name) for name in ("fibre", "fibre_1", "sheet")] == [
        "fibres",
        "fibres 1",
        "sheet fibres",
    ]


@pytest.mark.serial
def test_the_command_draws_them(tmp_path):
    (tmp_path / "case.toml").write_text(CASE + FIBRES)
    done = CliRunner().invoke(app, ["plot", "--fibres", str(tmp_path / "case.toml"), "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert (tmp_path / "fibres_leaflet_round.png").exists()
