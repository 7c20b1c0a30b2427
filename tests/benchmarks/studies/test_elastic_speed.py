"""The comparison of the assembled elastic force with the hand-written loop."""

from __future__ import annotations

import pytest

from valvefsi.benchmarks.studies.elastic_speed import measure


def test_the_comparison_reports_both_times_and_that_the_forces_agree(comm):
    found = measure(comm, elements=(2, 2, 2), repeats=2)
    assert found["cells"] == 48
    assert found["difference"] < 1e-11
    assert found["ratio"] == pytest.approx(found["form_ns"] / found["loop_ns"])
    assert found["row"]["computed"] == found["ratio"]
