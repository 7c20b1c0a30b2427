"""The Taylor-Green vortex: energy budget, early decay, what the command writes."""

from __future__ import annotations

import json

import numpy as np
import pytest
from mpi4py import MPI
from scipy.interpolate import CubicSpline

from tests.ordering import assert_order
from valvefsi.benchmarks.parameters import defaults
from valvefsi.benchmarks.taylor_green import PARAMETERS, compare, march, published, run
from valvefsi.errors import CaseError

WORLD = MPI.COMM_WORLD


def test_a_viscous_vortex_decays_as_its_first_order_in_the_reynolds_number():
    """At Re 1 the vortex keeps its shape but for terms of the order of Re: E = exp(-6 nu t) / 8."""
    parameters = defaults(PARAMETERS) | {"reynolds": 0.5, "t_end": 0.1, "cfl": 0.02, "advection": "centred"}
    t, energy, resolved, _ = march(16, parameters, WORLD)
    np.testing.assert_allclose(energy, np.exp(-6 * t / 0.5) / 8, rtol=1e-2)
    np.testing.assert_allclose(resolved, 6 / 0.5 * energy, rtol=2e-2)


def test_what_centred_differences_lose_is_what_they_resolve():
    """Centred advection keeps energy but for errors in time: the loss is the viscous dissipation."""
    parameters = defaults(PARAMETERS) | {"reynolds": 200.0, "t_end": 2.0, "advection": "centred"}
    t, energy, resolved, _ = march(16, parameters, WORLD)
    loss = -np.gradient(energy, t)
    np.testing.assert_allclose(loss[2:-2], resolved[2:-2], rtol=5e-3)


def test_the_upwind_scheme_loses_more_than_it_resolves_but_never_gains():
    t, energy, resolved, _ = march(16, defaults(PARAMETERS) | {"t_end": 6.0}, WORLD)
    assert np.all(np.diff(energy) < 0.0)
    loss = -np.gradient(energy, t)
    assert np.all(loss[4:] > 0.9 * resolved[4:])
    assert loss[-1] > 1.5 * resolved[-1]


def test_the_published_loss_is_the_derivative_of_the_published_energy():
    """A wrong digit in either column shows: splines agree to 0.25 %, and in the integral between rows."""
    table = published()
    t, energy, loss = table["t"], table["kinetic_energy"], table["dissipation"]
    assert len(t) == 119
    assert t[0] == 0.0
    assert t[-1] == 20.0
    assert np.diff(t).max() < 0.2 + 1e-9
    assert np.all(np.diff(energy) < 0.0)
    np.testing.assert_allclose(-CubicSpline(t, energy)(t, 1), loss, rtol=2.5e-3)
    lost = CubicSpline(t, loss).antiderivative()(t)
    np.testing.assert_allclose(np.diff(lost), -np.diff(energy), rtol=2e-3)
    dense = np.diff(t) < 0.03  # the rows around the peak
    assert dense.sum() == 20
    np.testing.assert_allclose(np.diff(lost)[dense], -np.diff(energy)[dense], rtol=1e-4)


def test_the_published_curves_start_from_the_vortex_and_peak_where_the_paper_says():
    table = published()
    assert table["kinetic_energy"][0] == 1 / 8
    assert table["dissipation"][0] == pytest.approx(6 / 1600 / 8, rel=1e-9)  # 2 nu times the enstrophy 3 / 8
    top = np.argmax(table["dissipation"])
    assert table["dissipation"][top] == pytest.approx(0.01286, abs=5e-6)
    assert table["t"][top] == pytest.approx(8.98)


def test_a_curve_is_compared_with_the_table_as_far_as_it_goes():
    table = published()
    t, energy, loss = (table[name].copy() for name in ("t", "kinetic_energy", "dissipation"))
    same = compare((t, energy, loss), table)
    assert same["energy_l2"] == same["loss_l2"] == 0.0
    assert same["rows"] == len(table)
    assert same["peak"] == loss.max()
    assert same["t_peak"] == t[np.argmax(loss)]
    scaled = compare((t, 1.02 * energy, 0.9 * loss), table)
    assert scaled["energy_l2"] == pytest.approx(0.02, rel=1e-9)
    assert scaled["loss_l2"] == pytest.approx(0.1, rel=1e-9)
    # A constant c more over 20 units of time: ||c|| = c sqrt(20), whatever the spacing of the rows.
    norm = np.sqrt(np.sum(np.diff(t) * 0.5 * (loss[1:] ** 2 + loss[:-1] ** 2)))
    shifted = compare((t, energy, loss + 1e-3), table)
    assert shifted["loss_l2"] == pytest.approx(1e-3 * np.sqrt(20.0) / norm, rel=1e-9)
    early = t <= 5.0
    part = compare((t[early], energy[early], 1.1 * loss[early]), table)
    assert part["loss_l2"] == pytest.approx(0.1, rel=1e-9)
    assert (part["rows"], part["t_last"]) == (26, 5.0)
    assert "peak" not in part  # not reached
    assert compare((t[:1], energy[:1], loss[:1]), table) == {}


def test_the_laminar_vortex_converges_to_the_published_loss_at_second_order():
    table = published()

    def gap(cells):
        t, energy, _, _ = march(cells, defaults(PARAMETERS) | {"t_end": 2.5}, WORLD)
        found = compare((t, energy, -np.gradient(energy, t)), table)
        assert found["t_last"] == 2.4
        assert found["energy_l2"] < 0.01 * found["loss_l2"]
        return found["loss_l2"]

    assert_order(gap, (16, 24, 32), order=1.9, below=0.15)


def test_the_command_writes_its_curve(shared_tmp):
    result = run(cells=8, out=shared_tmp, overrides=["t_end=1", "cfl=0.3"])
    if WORLD.rank == 0:
        assert json.loads((shared_tmp / "result.json").read_text())["benchmark"] == "taylor-green"
        curve = np.genfromtxt(shared_tmp / "decay.csv", delimiter=",", names=True)
        assert curve["energy"][0] == pytest.approx(1 / 8, rel=1e-2)
        assert (shared_tmp / "decay.png").stat().st_size > 10000
    assert "peak" not in result["reference"]  # too short for it
    assert result["reference"]["rows"] == 6
    lines = {line["quantity"]: line for line in result["table"]}
    assert lines["largest loss of energy"]["reference"] is None
    found = lines["energy, relative L2 difference from the table"]["computed"]
    assert found == result["reference"]["energy_l2"]
    assert 0.0 < found < 0.05
    other = run(cells=8, out=shared_tmp, overrides=["t_end=0.5", "reynolds=800"])
    assert other["reference"] == {}  # the table is for Re 1600
    with pytest.raises(CaseError, match="re = 1: unknown parameter; there are 'reynolds'"):
        run(cells=8, out=shared_tmp, overrides=["re=1"])
