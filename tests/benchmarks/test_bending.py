"""The strip of ``bench bending``: what it writes, and what it refuses."""

from __future__ import annotations

import json

import pytest

from valvefsi.benchmarks import bending
from valvefsi.errors import CaseError


def test_a_study_writes_the_ratios_and_their_convergence(comm, shared_tmp, monkeypatch):
    monkeypatch.setattr(bending, "REFERENCE", (10, 4, 1))
    monkeypatch.setattr(bending, "TURNED", (8, 2, 1))
    monkeypatch.setattr(bending, "QUADRATURE", 5)
    bending.study(bending.Strip(), out=shared_tmp, comm=comm)
    result = json.loads((shared_tmp / "result.json").read_text())
    assert result["quantities"]["stiffness_ratio"] == pytest.approx(1.0, abs=0.05)
    assert result["quantities"]["stiffness_ratio_90"] == pytest.approx(1.0, abs=0.05)
    assert result["quantities"]["twist_ratio"] == pytest.approx(1.0, abs=0.05)
    assert result["series"]["layers_1"][1] == pytest.approx(result["quantities"]["stiffness_ratio"], rel=1e-6)
    assert min(result["series"]["linear_hexahedra"]) > 3.0  # they lock
    assert (shared_tmp / "bending.png").stat().st_size > 0


def test_a_strip_that_cannot_be_bent_is_refused():
    with pytest.raises(CaseError, match="material.*expected one of bovine_pericardium_hgo"):
        bending.Strip(material="rubber")
    with pytest.raises(CaseError, match="radius.*at least two thicknesses"):
        bending.Strip(radius=0.05)
