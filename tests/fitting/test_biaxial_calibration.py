"""The leaflet studies of calibration/: rerun from their records, they give what is stored, and hold the truth."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

import pytest

CALIBRATION = Path(__file__).parents[2] / "calibration"
pytestmark = pytest.mark.serial  # nothing in it runs in parallel


@pytest.fixture(params=["porcine_leaflet", "bovine_leaflet"])
def study(request, monkeypatch):
    monkeypatch.syspath_prepend(str(CALIBRATION))
    yield importlib.import_module(request.param)
    for name in (request.param, "leaflet_model"):
        sys.modules.pop(name, None)


def test_a_study_gives_again_what_is_stored_and_holds_the_truth(study, tmp_path):
    found = study.study(tmp_path)
    stored = json.loads((study.RESULTS / "result.json").read_text())
    assert found["half_sum_of_squares"] == pytest.approx(stored["half_sum_of_squares"], rel=1e-6)
    for name, entry in stored["parameters"].items():
        now = found["parameters"][name]
        assert now["value"] == pytest.approx(entry["value"], rel=1e-3, abs=1e-9)
        assert now["verdict"] == entry["verdict"]
        if now["ci95"] is not None:
            assert now["inside"], name
    assert found["starts"]["reached_best"] >= 0.8 * found["starts"]["converged"]
    assert (tmp_path / "material.toml").exists()


def test_a_record_says_where_it_is_from_and_can_be_made_again(study, tmp_path):
    lines = study.RECORD.read_text().splitlines()
    assert lines[0].startswith("# origin: made by calibration/")
    assert "unverified" in lines[1]
    again = study.make_record(tmp_path / "again.csv").read_text().splitlines()
    assert again[:5] == lines[:5]
    numbers = [[[float(x) for x in line.split(",")] for line in part[5:]] for part in (again, lines)]
    for one, other in zip(*numbers, strict=True):
        assert one == pytest.approx(other, rel=2e-6, abs=1e-6)
