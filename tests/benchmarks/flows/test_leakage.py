"""The closed test section: what its springs do first, what leaks in the end, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.benchmarks.flows.leakage import Leakage
from valvefsi.errors import CaseError
from valvefsi.io.history import read_history

COARSE = ["h=2 mm", "dt=0.1 ms"]


def test_the_springs_yield_and_then_hold(shared_tmp):
    result = Leakage(overrides=[*COARSE, "t_end=60 ms"]).run(out=shared_tmp)
    history = read_history(shared_tmp / "history.csv")
    t, flow = (np.array(history[name])[1:] for name in ("t_s", "leak_ml_s"))
    assert t[-1] == pytest.approx(0.06)
    # At first inertia alone holds the fluid back: that of the whole box is the least there can be, rho L / A.
    pressure, (nx, ny, nz) = result["parameters"]["pressure"], np.multiply(0.2, result["size"]["cells"])
    least = pressure * nx * ny * 1e-4 / nz
    assert 0.3 * least < flow[0] < least
    late = flow[-150:]
    assert result["quantities"]["leak_ml_s"] == pytest.approx(abs(late.mean()), rel=1e-12)
    # The mean of what sways through is small against what an open tube would let through by then, p A t / (rho L).
    assert abs(late.mean()) < 1e-3 * pressure * np.pi * 1.25**2 * 0.05 / nz
    assert result["table"][0]["reference"] is None  # not h = 1 mm


@pytest.mark.parametrize(
    ("given", "key"),
    [(["hold=1.5"], "hold"), (["dt=1 s"], "dt"), (["sinuses=maybe"], "sinuses"), (["length=2"], "length")],
)
def test_what_cannot_be_is_refused(tmp_path, given, key):
    with pytest.raises(CaseError, match=key):
        Leakage(overrides=[*COARSE, *given]).simulation(tmp_path, MPI.COMM_SELF)
