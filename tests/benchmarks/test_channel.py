"""Channel flows: the closed forms solve their equations, second order, what the command writes."""

from __future__ import annotations

import json

import numpy as np
import pytest
from mpi4py import MPI
from typer.testing import CliRunner

from valvefsi.benchmarks.channel import poiseuille, run, womersley
from valvefsi.cli import app
from valvefsi.errors import CaseError

WORLD = MPI.COMM_WORLD


def test_the_closed_forms_solve_the_momentum_equation():
    """u_t = G cos(w t) + mu u_yy with u = 0 on both walls, by differences."""
    mu, number, e = 0.1, 4.0, 1e-4
    w = mu * (2 * number) ** 2
    y, t = np.linspace(0.1, 0.9, 9), 0.7
    u_t = (womersley(y, t + e, number, mu) - womersley(y, t - e, number, mu)) / (2 * e)
    u_yy = sum(s * womersley(y + d * e, t, number, mu) for s, d in ((1, 1), (-2, 0), (1, -1))) / e**2
    np.testing.assert_allclose(u_t, np.cos(w * t) + mu * u_yy, atol=1e-5)
    assert np.abs(womersley(np.array([0.0, 1.0]), t, number, mu)).max() < 1e-14
    p_yy = sum(s * poiseuille(y + d * e, mu) for s, d in ((1, 1), (-2, 0), (1, -1))) / e**2
    np.testing.assert_allclose(mu * p_yy, -1.0, rtol=1e-5)


def test_both_flows_converge_with_order_two(shared_tmp):
    result = run(cells=16, refine=2, out=shared_tmp, overrides=["womersley=4"])
    orders = [entry["computed"] for entry in result["table"] if "order" in entry["quantity"]]
    assert len(orders) == 2
    assert min(orders) > 1.85
    assert result["quantities"]["womersley"][-1] < 5e-3
    assert result["quantities"]["poiseuille"][-1] < 2e-3
    if WORLD.rank == 0:
        assert json.loads((shared_tmp / "result.json").read_text())["benchmark"] == "channel"
        assert (shared_tmp / "profiles.png").stat().st_size > 10000
    with pytest.raises(CaseError, match="mu = 1: unknown parameter; there are 'womersley'"):
        run(cells=8, out=shared_tmp, overrides=["mu=1"])


def test_the_command_hands_over_what_it_was_given(shared_tmp):
    options = ["--grid", "4", "--refine", "1", "--set", "womersley=2", "--out", str(shared_tmp)]
    done = CliRunner().invoke(app, ["bench", "channel", *options], catch_exceptions=False)
    assert done.exit_code == 0
    if WORLD.rank == 0:
        parameters = json.loads((shared_tmp / "result.json").read_text())["parameters"]
        assert (parameters["cells"], parameters["womersley"]) == ([4, 8], 2.0)
