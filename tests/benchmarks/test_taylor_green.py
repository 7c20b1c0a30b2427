"""The Taylor-Green vortex: energy budget, early decay, what the command writes."""

from __future__ import annotations

import json

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.benchmarks.taylor_green import PARAMETERS, march, run
from valvefsi.errors import CaseError

WORLD = MPI.COMM_WORLD


def test_a_viscous_vortex_decays_as_its_first_order_in_the_reynolds_number():
    """At Re 1 the vortex keeps its shape but for terms of the order of Re: E = exp(-6 nu t) / 8."""
    parameters = PARAMETERS | {"reynolds": 0.5, "t_end": 0.1, "cfl": 0.02, "advection": "centred"}
    t, energy, resolved, _ = march(16, parameters, WORLD)
    np.testing.assert_allclose(energy, np.exp(-6 * t / 0.5) / 8, rtol=1e-2)
    np.testing.assert_allclose(resolved, 6 / 0.5 * energy, rtol=2e-2)


def test_what_centred_differences_lose_is_what_they_resolve():
    """Centred advection keeps energy but for errors in time: the loss is the viscous dissipation."""
    parameters = PARAMETERS | {"reynolds": 200.0, "t_end": 2.0, "advection": "centred"}
    t, energy, resolved, _ = march(16, parameters, WORLD)
    loss = -np.gradient(energy, t)
    np.testing.assert_allclose(loss[2:-2], resolved[2:-2], rtol=5e-3)


def test_the_upwind_scheme_loses_more_than_it_resolves_but_never_gains():
    t, energy, resolved, _ = march(16, PARAMETERS | {"t_end": 6.0}, WORLD)
    assert np.all(np.diff(energy) < 0.0)
    loss = -np.gradient(energy, t)
    assert np.all(loss[4:] > 0.9 * resolved[4:])
    assert loss[-1] > 1.5 * resolved[-1]


def test_the_command_writes_its_curve(shared_tmp):
    result = run(cells=8, out=shared_tmp, overrides=["t_end=1", "cfl=0.3"])
    if WORLD.rank == 0:
        assert json.loads((shared_tmp / "result.json").read_text())["benchmark"] == "taylor-green"
        curve = np.genfromtxt(shared_tmp / "decay.csv", delimiter=",", names=True)
        assert curve["energy"][0] == pytest.approx(1 / 8, rel=1e-2)
        assert (shared_tmp / "decay.png").stat().st_size > 10000
    assert result["reference"] == {}  # too short for the peak
    with pytest.raises(CaseError, match="expected one of reynolds"):
        run(cells=8, out=shared_tmp, overrides=["re=1"])
