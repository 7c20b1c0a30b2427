"""The lid-driven cavity at Re 100 against the table of Ghia, Ghia and Shin (1982), and what is refused."""

from __future__ import annotations

import pytest

from valvefsi.benchmarks.flows.cavity import Cavity
from valvefsi.errors import CaseError


def test_the_cavity_at_re_100_agrees_with_ghia_to_one_per_cent_of_the_lid_speed(shared_tmp):
    found = Cavity(cells=64, overrides=["steady=1e-4"]).run(out=shared_tmp)["quantities"]
    assert max(found["u_gap"], found["v_gap"]) < 0.01


def test_what_cannot_be_is_refused(shared_tmp):
    with pytest.raises(CaseError, match="expected one of 100, 1000"):
        Cavity(reynolds=300)


def test_an_early_end_is_said(shared_tmp):
    result = Cavity(cells=16, overrides=["t_end='0.5 s'"]).run(out=shared_tmp)  # 26.7 steps of cfl 0.3
    assert result["quantities"]["t_steady"] == pytest.approx(0.5, rel=1e-12)
    assert result["table"][-1]["quantity"].startswith("not steady yet")
