"""Pages of studies of grids and of uncertain inputs: orders, indices, waveforms over one another, what failed."""

from __future__ import annotations

import json
import re

import pytest

from tests.report.folders import Parsed, grids_folder, sample_folder
from tests.report.test_pages import unpacked
from valvefsi.errors import CaseError
from valvefsi.report.blocks import Table
from valvefsi.report.folders import report
from valvefsi.report.runs import open_run
from valvefsi.report.writing import html


def figures(path):
    """The data of the charts of a page."""
    text = html(report([path]))
    found = [
        json.loads(d) for d in re.findall(r'<script type="application/json">(.*?)</script>', text, re.DOTALL)
    ]
    return Parsed(text), [data for data in found if "x" in data]


def test_a_study_of_grids_has_its_orders_its_waveforms_over_one_another_and_its_finest_grid(tmp_path):
    folder = grids_folder(tmp_path / "study", notes=["TWO GRIDS: no observed order"])
    page, charts = figures(folder)
    assert page.column("Numbers that change", "order")["last.u_cm"]["value"] == 1.0
    assert page.column("Numbers that change", "GCI [%]")["last.u_cm"]["value"] == 4.0
    assert page.column("Numbers that change", "h=1mm")["last.u_cm"]["value"] == 3.2
    assert list(page.column("Numbers for which an order means nothing", "order")) == ["last.at_s"]
    assert list(page.column("Differences of waveforms", "order")) == ["p_z_lower_mmHg, L2"]
    kernel = page.column("What else than the spacing", "changed")
    assert kernel["kernel"]["text"] == "solid.x.kernel=ib4"
    assert kernel["time step"]["text"] == "NOT VARIED: --steps does"
    assert page.column("What beats", "error of the last beat")["peak_flow_ml_per_s"]["value"] == 0.3333
    curves = charts[0]["panels"][0]["curves"]
    assert [curve["name"] for curve in curves] == ["h=2mm", "h=1mm", "h=0.5mm"]
    history = open_run(folder / "h=0.5mm").history
    assert unpacked(curves[2]["x"])[-1] == pytest.approx(history["t_s"][-1])
    warned = [
        text for text in re.findall(r'class="warning">([^<]*)', html(report([folder]))) if "GRIDS" in text
    ]
    assert warned == ["TWO GRIDS: no observed order"]
    for heading in ("What was run", "Scene", "Evidence", "The case", "Pictures"):
        assert f"{heading}, the finest grid (h=0.5mm)" in page.words
    given = {row[0]["text"]: row for row in page.table("Values that were given")["rows"]}
    assert given["solid.leaflets.kappa"][3]["text"] == "not recorded", "the origin of every value is there"
    assert "no study of several grids" not in page.words


def test_a_page_of_samples_has_intervals_indices_what_failed_and_the_samples(tmp_path):
    page, charts = figures(sample_folder(tmp_path / "study"))
    assert page.column("Outputs", "2.5 %")["u_cm"]["value"] == 1.1
    assert page.column("Outputs", "97.5 %")["u_cm"]["value"] == 1.9
    assert page.column("Sobol", "total")["u_cm, mu"]["value"] == 0.9
    assert page.column("Sobol", "total, 95 % to")["u_cm, mu"]["value"] == 1.05
    assert page.column("Samples that failed", "reason")["sample 2"]["text"] == "it <broke> down"
    assert page.column("Inputs and outputs of 3", "mu")["sample 1"]["value"] == 2.5
    assert page.column("Inputs and outputs of 3", "u_cm")["sample 2"]["text"] == "-"
    drawn = page.column("Uncertain inputs", "largest drawn")
    assert drawn["mu"]["value"] == 3.0
    assert [curve["name"] for curve in charts[0]["panels"][0]["curves"]] == ["s0000", "s0001"]
    assert "Of 3 samples 2 are drawn" in page.words


@pytest.mark.parametrize("stage", ["leaflet", "upstream", "case"])
def test_a_validation_that_has_begun_says_that_there_is_no_verdict_yet(tmp_path, stage):
    (tmp_path / stage).mkdir()
    (tmp_path / stage / "stage.json").write_text("{}")
    assert "there is no verdict.json yet" in Parsed(html(report([tmp_path]))).words


@pytest.mark.parametrize("name", ["sample.json", "verification.json", "fit.json", "compare/verdict.json"])
def test_a_result_that_cannot_be_read_is_refused_and_named(tmp_path, name):
    (tmp_path / "compare").mkdir()
    (tmp_path / "compare" / "stage.json").write_text("{}")
    (tmp_path / name).write_text('{"samples": 3, "fail')
    with pytest.raises(CaseError, match=f"{name}.*cannot be read"):
        report([tmp_path])


def test_a_sample_without_a_record_of_failures_does_not_say_that_none_failed(tmp_path):
    (tmp_path / "sample.json").write_text('{"samples": 3}')
    words = Parsed(html(report([tmp_path]))).words
    assert "No sample failed" not in words
    assert "Which samples failed is not recorded." in words


def test_samples_without_a_value_are_warned_of(tmp_path):
    folder = sample_folder(tmp_path / "study")
    result = json.loads((folder / "sample.json").read_text())
    note = "NO VALUE of u_cm in 1 of 2 samples"
    (folder / "sample.json").write_text(json.dumps(result | {"notes": [note]}))
    assert f'<p class="warning">{note}</p>' in html(report([folder]))


def test_the_columns_of_a_table_are_looked_at_once(monkeypatch, tmp_path):
    looked, of_numbers = [], Table.of_numbers.fget
    monkeypatch.setattr(Table, "of_numbers", property(lambda table: looked.append(0) or of_numbers(table)))
    page = report([sample_folder(tmp_path / "study", runs=False)])
    html(page)
    blocks = [block for part in page.parts for section in part.sections for block in section.blocks]
    assert len(looked) == sum(block.kind == "table" for block in blocks)


def test_a_file_of_a_grid_that_is_gone_is_named_on_the_page(tmp_path):
    folder = grids_folder(tmp_path / "study")
    assert "cannot be read." not in Parsed(html(report([folder]))).words
    (folder / "h=1mm" / "history.csv").unlink()
    (folder / "h=0.5mm,kernel=ib4" / "summary.json").write_text("{")
    warned = re.findall(r'class="warning">([^<]*cannot be read[^<]*)', html(report([folder])))
    assert warned == [
        "h=1mm/history.csv is not there or cannot be read.",
        "h=0.5mm,kernel=ib4/summary.json is not there or cannot be read.",
    ]
