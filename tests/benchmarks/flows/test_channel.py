"""Channel flows: the closed forms solve their equations, second order, what the command writes."""

from __future__ import annotations

import numpy as np
import pytest

from valvefsi.benchmarks.flows.channel import Channel
from valvefsi.errors import CaseError
from valvefsi.verification.closed_forms import poiseuille, womersley


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
    result = Channel(cells=16, refine=2, overrides=["womersley=4"]).run(out=shared_tmp)
    orders = [entry["computed"] for entry in result["table"] if "order" in entry["quantity"]]
    assert len(orders) == 2
    assert min(orders) > 1.85
    assert result["quantities"]["womersley"][-1] < 5e-3
    assert result["quantities"]["poiseuille"][-1] < 2e-3
    with pytest.raises(CaseError, match="mu = 1: unknown parameter; there are 'womersley'"):
        Channel(cells=8, overrides=["mu=1"])
