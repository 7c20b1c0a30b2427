"""What many strips say together."""

from __future__ import annotations

from dataclasses import asdict

import pytest

from valvefsi.benchmarks.statics.bending import Strip
from valvefsi.benchmarks.statics.strips import Strips, grouped

PORCINE = "porcine_leaflet_hgo"


def record(ratios, **strip):
    return {"strip": asdict(Strip(**strip)), "ratios": ratios}


RECORDS = [
    record({"stiffness_ratio": 0.94, "membrane_ratio": 1.012}, thickness=0.02),
    record({"stiffness_ratio": 1.03, "membrane_ratio": 1.005}, thickness=0.06, layers=2),
    record({"stiffness_ratio": 1.01}, thickness=0.06, radius=1.2, material=PORCINE, angle=45.0),
    record({"stiffness_ratio": "reference: no equilibrium"}, edge=0.05, material=PORCINE, angle=90.0),
]


def test_groups_of_strips_have_a_median_the_worst_and_how_many_pass():
    groups = grouped(RECORDS)
    bending = groups["all"]["stiffness_ratio"]
    assert bending == {"found": 3, "not_found": 1, "passed": 2, "median": 1.01, "worst": 0.94}
    membrane = groups["flat"]["membrane_ratio"]
    assert (membrane["found"], membrane["passed"], membrane["worst"]) == (2, 1, 1.012)
    assert membrane["median"] == pytest.approx(1.0085)
    assert groups["2 x 1 mm"]["stiffness_ratio"]["worst"] == 1.03
    assert groups["0.6 mm thick"]["stiffness_ratio"]["found"] == 2
    assert groups["curved"] == groups[f"{PORCINE} 45 deg"] == groups[f"{PORCINE} 45 deg, 1 x 1 mm"]


def test_a_group_without_an_answer_has_counts_only():
    assert grouped(RECORDS)["1 x 0.5 mm"]["stiffness_ratio"] == {"found": 0, "not_found": 1, "passed": 0}


def test_the_matrix_holds_each_strip_once():
    strips = Strips().runs()
    assert len(strips) == len(set(strips)) == 168
    assert {strip.angle for strip in strips if strip.material == PORCINE} == {0.0, 45.0, 90.0}
    assert {strip.radius for strip in strips} == {None, 1.2}
