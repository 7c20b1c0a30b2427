"""The external valve-tissue record: the least sums of squares, reached from nearly every start."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from valvefsi.fitting.biaxial import fit_biaxial
from valvefsi.fitting.biaxial_records import read_biaxial

FOLDER = os.environ.get("VALVEFSI_DATA", "")
pytestmark = [
    pytest.mark.skipif(not FOLDER, reason="VALVEFSI_DATA is not set: no external records"),
    pytest.mark.serial,
]

CASES = {
    "one family, free angle": ({}, 18674.31, 0.957),
    "two orthogonal families": ({"families": "2"}, 1084.91, 0.9975),
    "protocols 1 to 5": ({"protocols": "12345"}, 2132.49, 0.99),
}


@pytest.fixture(scope="module")
def record():
    path = Path(FOLDER) / "biaxial_valve_tissue.csv"
    if not path.exists():
        pytest.skip(f"{path.name} is not in VALVEFSI_DATA")
    return read_biaxial(path)


@pytest.mark.parametrize("case", CASES)
def test_the_least_sum_of_squares_is_reached_from_nearly_every_start(record, case):
    options, half_squares, r_squared = CASES[case]
    found = fit_biaxial(record, "hgo", profiles=False, draws=0, **options)
    written = found.report.as_dict()
    assert found.fit.half_squares <= half_squares
    assert written["r_squared"] >= r_squared
    assert len(found.fit.starts) == 32
    assert found.fit.reached >= 0.8 * found.fit.converged
    assert found.fit.converged >= 0.8 * 32


def test_the_protocols_that_were_left_out_are_predicted(record):
    found = fit_biaxial(record, "hgo", protocols=["1", "2", "3", "4", "5"], starts=4, profiles=False, draws=0)
    assert list(found.predictions) == ["6", "7"]
    alone = record.select(["7"])
    error = found.predict(alone) - alone.stress
    relative = float((error**2).sum() ** 0.5 / (alone.stress**2).sum() ** 0.5)
    assert found.predictions["7"]["relative_l2"] == pytest.approx(relative, rel=1e-12)
    assert "protocol 7, predicted" in found.summary()
