"""Pages as files: structure, numbers, what is missing, what is escaped, size."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import json
import re
import subprocess
import sys

import numpy as np
import pytest
from mpi4py import MPI

from tests.case.test_valve_runs import run_folder
from tests.cli.test_cli import RUNNER
from tests.report.folders import (
    FRAMES,
    Parsed,
    benchmark_folder,
    fit_folder,
    grids_folder,
    sample_folder,
    sweep_folder,
    validation_folder,
    valve_folder,
)
from tests.valve_waves import PERIOD
from valvefsi import cli
from valvefsi.errors import CaseError, SurroundingsError
from valvefsi.io.paraview import FluidSeries
from valvefsi.io.solid_body import Body, write_body
from valvefsi.post.valve_numbers import CycleNumbers
from valvefsi.report import scenes, writing
from valvefsi.report.blocks import Chapter, Note, Page, Section, Table, packed
from valvefsi.report.folders import report
from valvefsi.report.geometry import the_geometry
from valvefsi.report.runs import open_run
from valvefsi.report.words import defined, definitions
from valvefsi.report.writing import LARGEST, html, write_page

EVIL = "</script><script>window.hacked=1</script><img src=x onerror='window.hacked=1'>\"'&amp;"
SCRIPTS = {"figures": "application/json", "library": "text/plain", "program": None}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The folder of a run of a valve."""
    return valve_folder(tmp_path_factory.mktemp("report") / "run")


@pytest.fixture(scope="module")
def page(run):
    """Its page, parsed."""
    return Parsed(html(report([run])))


@pytest.fixture(scope="module")
def pair(run, tmp_path_factory):
    """The page of two runs, parsed."""
    other = valve_folder(tmp_path_factory.mktemp("report") / "other", overrides=["fluid.viscosity='2 cP'"])
    return Parsed(html(report([run, other])))


def of_kind(kind, folder):
    makers = {
        "fit": fit_folder,
        "benchmark": benchmark_folder,
        "sweep": sweep_folder,
        "validation": validation_folder,
        "grids": grids_folder,
        "sample": sample_folder,
        "circuit": functools.partial(sample_folder, runs=False),
    }
    return Parsed(html(report([makers[kind](folder / kind)])))


def check_structure(page):
    """Every table names itself and its headings, every picture says what is seen, nothing comes from elsewhere."""
    for table in page.tables:
        assert table["caption"].strip()
        head, *rows = table["rows"]
        assert {cell["tag"] for cell in head} == {"th"}
        assert all(cell["text"].strip() for cell in head)
        assert {len(row) for row in table["rows"]} == {len(head)}, table["caption"]
        assert [row[0]["tag"] for row in rows] == ["th"] * len(rows)
        assert set(table["scopes"]) <= {"col", "row"}
    ids = [named["id"] for _, named in page.tags if "id" in named]
    assert len(ids) == len(set(ids))
    for tag, named in page.tags:
        assert tag not in ("link", "iframe", "object", "embed", "base")
        for key in ("src", "href", "data", "srcset", "action"):
            assert named.get(key, "#").startswith(("#", "data:image/png;base64,")), (tag, named)
        assert not any(key.startswith("on") for key in named)
        assert tag != "img" or len(named["alt"]) > 10
        assert "drawing" not in named.get("class", "") or len(named["aria-label"]) > 10
    levels = [int(tag[1]) for tag, _ in page.tags if re.fullmatch(r"h\d", tag)]
    assert levels[0] == 1
    assert all(b - a <= 1 for a, b in itertools.pairwise(levels))
    assert {named.get("type") for tag, named in page.tags if tag == "script"} <= set(SCRIPTS.values())


def test_the_page_of_a_run_has_its_parts_and_every_table_names_itself(page):
    check_structure(page)
    for heading in (
        "What was run",
        "Scene",
        "Curves",
        "Numbers",
        "Warnings and recoveries",
        "Evidence",
        "The case",
    ):
        assert heading in page.words
    kinds = [named["data-kind"] for tag, named in page.tags if tag == "figure" and "data-kind" in named]
    assert kinds == ["scene", "chart"]


@pytest.mark.parametrize("kind", ["fit", "benchmark", "sweep", "validation", "grids", "sample", "circuit"])
def test_other_folders_have_pages_of_the_same_structure(kind, tmp_path):
    found = of_kind(kind, tmp_path)
    check_structure(found)
    expected = {
        "fit": ("1.25", "identified", "held", "few starts <b>reached</b> the best", "ab12"),
        "benchmark": ("drag", "3.3333", "Versions and machine are not recorded."),
        "sweep": ("kappa=2 failed: it <broke> down", "porcine.toml"),
        "validation": ("raise max_beats", "run-1mm - record, p_lv", "no"),
        "grids": ("h=0.4mm failed and is in no number: it <broke> down", "NOT VARIED: --steps does"),
        "sample": ("1 of 3 samples failed", "DO NOT TRUST", "Waveforms of the samples over one another"),
        "circuit": ("uniform: low 1 cP, high 3 cP", "The folder holds no pictures."),
    }
    for text in expected[kind]:
        assert text in found.words


def test_the_numbers_of_a_page_are_those_of_the_summary(page, run):
    summary = json.loads((run / "summary.json").read_text())
    known = definitions()
    for number, cycle in enumerate(summary["valve"]["cycles"]):
        column = page.column("Hydrodynamic", f"cycle {number}")
        for name, value in cycle.items():
            if isinstance(value, float):
                cell = column[defined(name, known)[0]]
                assert cell["value"] == value
                assert float(cell["text"]) == pytest.approx(value, rel=1e-4)
    plausible = page.column("Plausibility", "value")
    for name, judged in summary["valve"]["plausible"].items():
        assert plausible[name]["value"] == judged["value"]
    assert page.column("Balance of energy", "value")["residual percent"]["value"] == -0.75
    assert page.column("Balance of energy", "value")["kinetic"]["value"] == pytest.approx(0.12345)
    assert page.column("The run", "value")["wall-clock time [s]"]["value"] == 12.5


def test_every_number_of_a_valve_has_a_definition_and_its_unit():
    names = CycleNumbers(cycle=0, start=0.0).in_lab_units()
    known = definitions()
    for name in names:
        words, unit, meaning = defined(name, known)
        assert meaning, name
        assert "``" not in meaning
        assert not words.endswith(("mmHg", "percent", "per s", " ml"))
        assert unit in ("", "s", "ms", "ml", "ml/s", "l/min", "mmHg", "cm²", "%", "mJ")
    assert defined("cardiac_output_l_per_min", known)[:2] == ("cardiac output", "l/min")
    assert defined("opening_duration_ms", known)[2] == "From opening start to opening end"


def test_warnings_and_recoveries_are_told(page):
    assert "fluid may leak through <leaflets>" in page.words
    assert page.column("Recoveries", "reason")["1"]["text"] == "the Courant number is 1.5 > 0.5"


def test_every_value_of_the_case_is_there_with_unit_and_meaning(page):
    row = {r[0]["text"]: r for r in page.table("Values that were given")["rows"]}["solid.leaflets.kappa"]
    assert [cell["text"] for cell in row[1:4]] == ["1e+07", "dyn/cm²", "not recorded"]
    assert "bulk modulus" in row[4]["text"]
    rest = page.column("Values left at their defaults", "origin")
    assert {cell["text"] for cell in rest.values()} == {"the default, or given like it"}
    assert "fluid.sides.x_lower.backflow" in rest


def test_what_is_missing_is_said_and_no_cell_is_blank_or_not_a_number(tmp_path):
    found = Parsed(html(report([run_folder(tmp_path / "bare")])))
    check_structure(found)
    for text in (
        "There is no summary.json: the run has not ended",
        "This run did not record versions and machine.",
        "This run did not record hashes of the files that went in.",
        "The run has no frames",
        "There is no summary.json to take numbers from",
        "warnings and recoveries of the run are not known",
        "The balance of energy was not recorded",
        "The folder holds no pictures.",
    ):
        assert text in found.words
    values = [row[1]["text"].strip() for table in found.tables for row in table["rows"]]
    assert all(values)
    assert not {"nan", "None", "inf"} & set(values)


def test_a_run_without_solids_is_not_said_to_have_no_frames(tmp_path):
    folder = run_folder(tmp_path / "bare")
    case = open_run(folder).case
    output = case.output.model_copy(update={"frames": 20})
    case = case.model_copy(update={"solid": [], "output": output})
    run = dataclasses.replace(open_run(folder), case=case)
    said = [block.text for block in the_geometry(run).blocks if isinstance(block, Note)]
    assert said == ["The case has no solids: there are no meshes but the grid."]


def test_a_case_that_cannot_be_read_is_said_and_the_rest_stands(tmp_path):
    folder = run_folder(tmp_path / "run")
    text = (folder / "case.toml").read_text()
    (folder / "case.toml").write_text(text.replace("[grid]", "[grud]"))
    found = Parsed(html(report([folder])))
    check_structure(found)
    assert "The case cannot be read: " in found.words
    assert "grud" in found.words
    assert "Curves" in found.words


def test_titles_names_and_warnings_are_text_and_nothing_else(tmp_path, picture_faults):
    folder = valve_folder(tmp_path / "<img src=x onerror=hacked()>", overrides=[f"title={json.dumps(EVIL)}"])
    picture_faults.clear()  # this title is not for a picture
    summary = json.loads((folder / "summary.json").read_text())
    summary["timing"]["warnings"][0]["text"] = summary["timing"]["recoveries"][0]["reason"] = EVIL
    (folder / "summary.json").write_text(json.dumps(summary))
    (folder / "<b>.png").write_bytes((folder / "valve.png").read_bytes())
    text = html(report([folder]))
    found = Parsed(text)
    check_structure(found)
    assert " ".join(EVIL.split()) in found.words
    scripts = [named.get("type") for tag, named in found.tags if tag == "script"]
    assert scripts == [SCRIPTS["figures"]] * 2 + [SCRIPTS["library"], SCRIPTS["program"]]
    assert "<script>window.hacked" not in text
    assert "<img src=x" not in text
    data = re.findall(r'<script type="application/json">(.*?)</script>', text, re.DOTALL)
    assert [sorted(json.loads(one)) for one in data] == [["clock", "panels", "t", "unit"], ["panels", "x"]]


def test_names_in_the_data_of_a_figure_cannot_end_it(tmp_path):
    folder = run_folder(tmp_path / "run")
    lines = (folder / "history.csv").read_text().splitlines()
    lines[0] = lines[0].replace("p_z_lower_mmHg", "</script><b>_mmHg")
    (folder / "history.csv").write_text("\n".join(lines) + "\n")
    found = Parsed(html(report([folder])))
    check_structure(found)


def test_two_runs_stand_over_and_beside_one_another_with_the_numbers_of_compare(pair, run, tmp_path):
    check_structure(pair)
    norms = pair.table("How far A is from B")
    assert [row[0]["text"] for row in norms["rows"][1:]] == ["P_LV", "P_Ao", "Q_Ao", "open area"]
    assert page_numbers(norms) == pytest.approx(0.0, abs=1e-9)
    differs = pair.column("Keys of the cases that differ", "B")
    assert {key: cell["text"] for key, cell in differs.items()} == {"fluid.viscosity": "0.02"}
    kinds = [named["data-kind"] for tag, named in pair.tags if tag == "figure" and "data-kind" in named]
    assert kinds == ["chart", "scene", "chart", "chart"]
    for heading in ("Leaflets at the same moments", "Scenes side by side", "Numbers side by side"):
        assert heading in pair.words


def page_numbers(table):
    return max(abs(cell["value"]) for row in table["rows"][1:] for cell in row[1:7])


def test_a_run_and_a_record_are_compared_as_the_command_does_it(tmp_path):
    from tests.cli.test_compare import OWN

    folder = run_folder(tmp_path / "run", 2.0)
    answer = RUNNER.invoke(cli.app, ["compare", str(folder), str(OWN), "--start", "20 ms"])
    assert answer.exit_code == 0
    answer = RUNNER.invoke(cli.app, ["report", str(folder), str(OWN), "--start", "20 ms"])
    assert answer.exit_code == 0
    assert answer.stdout.startswith(f"{folder / 'report.html'}, ")
    found = Parsed((folder / "report.html").read_text())
    check_structure(found)
    compared = json.loads((folder / "comparison.json").read_text())
    for heading, kind in (("L2 [%]", "l2_percent"), ("Linf [%]", "linf_percent")):
        column = found.column("How far A is from B", heading)
        assert column["P_LV"]["value"] == compared["quantities"]["p_lv"]["as_they_are"][kind]
    numbers = found.column("Numbers of the valve side by side", "A - B")
    assert numbers["peak flow"]["value"] == compared["numbers"]["rows"]["peak_flow_ml_per_s"]["difference"]
    data = re.search(
        r'<script type="application/json">(.*?)</script>', (folder / "report.html").read_text(), re.DOTALL
    )
    assert "band" in json.loads(data[1])["panels"][0]["curves"][0], "the record's standard deviations"


def test_what_no_page_can_be_made_of_is_refused_in_one_line(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "record.csv").write_text("t_s,p_lv_mmHg\n0,1\n")
    for paths, said in (
        ([tmp_path / "gone"], "no such folder"),
        ([tmp_path / "empty"], "no results here that are known"),
        ([tmp_path / "record.csv"], "name one beside it"),
    ):
        with pytest.raises(CaseError, match=said):
            report(paths)


def one_table(rows):
    """A page of one table as HTML."""
    text = Section(title="s", blocks=[Note(text="n"), Table(caption="c", headings=("a", "b"), rows=rows)])
    return html(Page(title="t", made="m", parts=[Chapter(title="p", about="", sections=[text])]))


def test_a_cell_says_what_is_missing_or_not_a_number():
    found = Parsed(one_table([("x", None), ("y", float("nan")), ("z", 1e-7), ("w", True), ("v", 12)]))
    cells = {row[0]["text"]: row[1]["text"] for row in found.tables[0]["rows"][1:]}
    assert cells == {"x": "missing", "y": "not finite", "z": "1e-07", "w": "yes", "v": "12"}


def test_a_library_that_is_missing_is_named_before_any_work(monkeypatch, tmp_path):
    monkeypatch.setattr(writing, "NEEDED", ("jinja2", "no_such_library"))
    with pytest.raises(SurroundingsError, match=r"needs no_such_library: .*pip install .*\[report\]"):
        write_page(Page(title="t", made="m"), tmp_path / "page.html")
    assert not (tmp_path / "page.html").exists()


def test_a_page_without_figures_leaves_the_library_out_and_pages_stay_small(run):
    small = one_table([("x", 1.0)])
    assert len(small) < 30_000
    assert len(html(report([run]))) < LARGEST / 3


def test_the_page_of_a_run_does_not_load_what_runs_one():
    code = (
        "import sys; import valvefsi.cli.report; print([m for m in sys.modules if m in ('plotly', 'jinja2')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


# Scenes


def unpacked(said):
    """An array as the page reads it."""
    import base64

    raw = np.frombuffer(base64.b64decode(said["data"]), f"<{said['type']}").reshape(said["shape"])
    return said["low"] + said["step"] * raw if said["type"] == "u2" else raw


def test_an_array_is_read_back_to_half_a_step_of_its_range():
    values = np.random.default_rng(1).normal(size=(7, 5))
    said = packed(values, "u2")
    assert np.abs(unpacked(said) - values).max() <= 0.5001 * np.ptp(values) / 65535
    assert np.array_equal(unpacked(packed(values)), values)
    assert np.array_equal(unpacked(packed(np.full(3, 2.5), "u2")), [2.5] * 3)


def test_a_scene_holds_the_bodies_at_every_frame_and_the_flow_in_a_plane(run):
    found = scenes.frames_of(open_run(run))
    assert found.times == pytest.approx(np.linspace(0.0, 2.0 * PERIOD, FRAMES))
    bodies, plane = found.panels
    leaflets, housing = bodies["bodies"]
    points = unpacked(leaflets["points"])
    assert points.shape == (FRAMES, 8, 3)
    assert points[:, 0, 2] == pytest.approx(0.3 * np.arange(FRAMES), abs=1e-4)
    fields = {field["name"]: unpacked(field["values"]) for field in leaflets["fields"]}
    assert fields["displacement"][:, 0] == pytest.approx(3.0 * np.arange(FRAMES), abs=1e-3)
    assert fields["von Mises stress"][2].max() == pytest.approx(14.0, rel=1e-3), "kPa"
    assert fields["J = det F"][-1].max() == pytest.approx(1.28, rel=1e-3)
    assert len(unpacked(leaflets["triangles"])) == 3 * 12
    assert housing["still"]
    speed = unpacked(plane["values"])
    assert speed.shape == (FRAMES, 6, 4), "frames, up, across"
    assert speed[1, 2] == pytest.approx(1.0 + np.arange(4) + 20.0, abs=0.01)
    assert plane["starts"][-1] > 0, "the plane cuts the leaflets"


def test_in_a_plane_a_scene_is_the_speed_with_the_outlines_of_the_solids(tmp_path):
    points = np.array([[x, y, 0.0] for y in (0.2, 0.6) for x in (0.2, 0.5, 0.8)])
    cells = {9: np.array([[0, 1, 4, 3], [1, 2, 5, 4]])}
    write_body(tmp_path / "paraview" / "block" / "block_000000.vtu", Body(points=points, cells=cells))
    item = '<DataSet timestep="0.0" file="block/block_000000.vtu"/>'
    (tmp_path / "paraview" / "block.pvd").write_text(f"<VTKFile><Collection>{item}</Collection></VTKFile>")
    shape = (4, 3, 1)
    box = ((0.0, 0.0, 0.0), (0.25, 1.0 / 3.0, 1.0))
    fluid = FluidSeries(tmp_path / "paraview", "fluid", MPI.COMM_SELF, shape, (0, 0, 0), shape, box)
    velocity = np.zeros((*shape, 3))
    velocity[..., 0], velocity[..., 1] = 3.0, 4.0 * np.arange(3)[None, :, None]
    fluid.write(0.0, velocity, np.zeros(shape))
    found = scenes.frames_of(open_run(tmp_path))
    (plane,) = found.panels
    assert (plane["name"], plane["axes"]) == ("speed", ["x", "y"])
    assert unpacked(plane["values"])[0, :, 0] == pytest.approx([3.0, 5.0, np.hypot(3.0, 8.0)], abs=1e-3)
    pieces = unpacked(plane["cuts"])[: plane["starts"][-1]].reshape(-1, 2, 2)
    assert len(pieces) == 6, "the edge between the two cells is inside"
    length = np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1).sum()
    assert length == pytest.approx(2 * (0.6 + 0.4), abs=1e-3)


def test_a_scene_is_thinned_to_its_budget_and_to_a_window(run, monkeypatch):
    within = scenes.frames_of(open_run(run), window=(PERIOD, 2.0 * PERIOD))
    assert within.times == pytest.approx([PERIOD, 1.5 * PERIOD, 2.0 * PERIOD])
    monkeypatch.setattr(scenes, "MOST_NUMBERS", 4 * 8 * 3)
    thinned = scenes.frames_of(open_run(run))
    assert thinned.times == pytest.approx([0.0, PERIOD, 2.0 * PERIOD])
    assert thinned.count == FRAMES
    assert unpacked(thinned.panels[0]["bodies"][0]["points"])[1, 0, 2] == pytest.approx(0.6, abs=1e-4)


def test_a_large_surface_is_simplified_in_its_place():
    edge = 60
    x, y = (g.ravel() / edge for g in np.meshgrid(np.arange(edge + 1), np.arange(edge + 1)))
    points = np.stack([x, y, 0.1 * np.sin(3 * x)], axis=1)
    first = (np.arange(edge)[:, None] * (edge + 1) + np.arange(edge)).ravel()
    quads = np.stack([first, first + 1, first + edge + 2, first + edge + 1], axis=1)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    few, faces = scenes.simplified(points, triangles, 800)
    assert 200 < len(faces) <= 1200
    assert np.abs(few[:, 2] - 0.1 * np.sin(3 * few[:, 0])).max() < 5e-3
    corners = few[faces]
    area = (
        0.5
        * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    )
    assert area == pytest.approx(1.0, rel=0.15)
    same, whole = scenes.simplified(points, triangles, 10_000)
    assert len(whole) == len(triangles)
    assert np.array_equal(same, points)


def test_what_is_no_number_in_a_history_is_said(tmp_path):
    folder = valve_folder(tmp_path / "run")
    lines = (folder / "history.csv").read_text().splitlines()
    at = lines[0].split(",").index("pdva_cm2")
    for k in (101, 102, 301):
        cells = lines[k].split(",")
        cells[at] = "nan" if k < 300 else "inf"
        lines[k] = ",".join(cells)
    (folder / "history.csv").write_text("\n".join(lines) + "\n")
    (said,) = (text for text in open_run(folder).remarks if "NO NUMBER" in text)
    t = float(lines[101].split(",")[1])
    assert said == f"NO NUMBER in 3 of {len(lines) - 1} rows of pdva_cm2, the first at t = {t:.6g} s"
    assert "On reading: NO NUMBER in 3 of" in html(report([folder]))


def test_a_page_takes_the_place_of_no_results(run):
    before = (run / "history.csv").read_bytes()
    answer = RUNNER.invoke(cli.app, ["report", str(run), "--out", str(run / "history.csv")])
    assert "expected a file that ends with .html" in str(answer.exception)
    assert (run / "history.csv").read_bytes() == before
