"""The lid-driven cavity at Re 100 against the table of Ghia, Ghia and Shin (1982), and what is refused."""

from __future__ import annotations

import pytest

from valvefsi.benchmarks.flows.cavity import Cavity
from valvefsi.errors import CaseError, ConvergenceError


def test_the_cavity_at_re_100_agrees_with_ghia_to_one_per_cent_of_the_lid_speed(shared_tmp):
    found = Cavity(cells=64, overrides=["steady=1e-4"]).run(out=shared_tmp)["quantities"]
    assert max(found["u_gap"], found["v_gap"]) < 0.01


def test_what_cannot_be_is_refused(shared_tmp):
    with pytest.raises(CaseError, match="expected one of 100, 1000"):
        Cavity(reynolds=300)
    with pytest.raises(ConvergenceError, match=r"still changes by .* at t = 0\.\d+; try a larger t_max"):
        Cavity(cells=8, overrides=["t_max=0.5"]).run(out=shared_tmp)
