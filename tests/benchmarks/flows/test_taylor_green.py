"""The Taylor-Green vortex: energy budget, early decay, what the command writes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from scipy.interpolate import CubicSpline

from tests.ordering import assert_order
from valvefsi.benchmarks.flows.taylor_green import PARAMETERS, Curves, TaylorGreen, compare, published
from valvefsi.benchmarks.flows.taylor_green import march as run
from valvefsi.benchmarks.frame import Job
from valvefsi.benchmarks.options import defaults
from valvefsi.errors import CaseError

WORLD = MPI.COMM_WORLD


def march(cells, parameters):
    return run(cells, parameters, Job(folder=Path(), comm=WORLD))[0]


def test_a_viscous_vortex_decays_as_its_first_order_in_the_reynolds_number():
    """At Re 1 the vortex keeps its shape but for terms of the order of Re: E = exp(-6 nu t) / 8."""
    parameters = defaults(PARAMETERS) | {"reynolds": 0.5, "t_end": 0.1, "cfl": 0.02, "advection": "centred"}
    c = march(16, parameters)
    np.testing.assert_allclose(c.energy, np.exp(-6 * c.t / 0.5) / 8, rtol=1e-2)
    np.testing.assert_allclose(c.resolved, 6 / 0.5 * c.energy, rtol=2e-2)


def test_what_centred_differences_lose_is_what_they_resolve():
    """Centred advection keeps energy but for errors in time: the loss is the viscous dissipation."""
    parameters = defaults(PARAMETERS) | {"reynolds": 200.0, "t_end": 2.0, "advection": "centred"}
    c = march(16, parameters)
    np.testing.assert_allclose(c.loss[2:-2], c.resolved[2:-2], rtol=5e-3)


def test_the_upwind_scheme_loses_more_than_it_resolves_but_never_gains():
    c = march(16, defaults(PARAMETERS) | {"t_end": 6.0})
    assert np.all(np.diff(c.energy) < 0.0)
    assert np.all(c.loss[4:] > 0.9 * c.resolved[4:])
    assert c.loss[-1] > 1.5 * c.resolved[-1]


def test_the_published_loss_is_the_derivative_of_the_published_energy():
    """A wrong digit in either column shows: splines agree to 0.25 %, and in the integral between rows."""
    table = published()
    t, energy, loss = table.t, table.energy, table.loss
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
    assert table.energy[0] == 1 / 8
    assert table.loss[0] == pytest.approx(6 / 1600 / 8, rel=1e-9)  # 2 nu times the enstrophy 3 / 8
    top = np.argmax(table.loss)
    assert table.loss[top] == pytest.approx(0.01286, abs=5e-6)
    assert table.t[top] == pytest.approx(8.98)


def test_a_curve_is_compared_with_the_table_as_far_as_it_goes():
    table = published()
    same = compare(table)
    assert same["energy_l2"] == same["loss_l2"] == 0.0
    assert same["rows"] == len(table.t)
    assert same["peak"] == table.loss.max()
    assert same["t_peak"] == table.t[np.argmax(table.loss)]
    scaled = compare(replace(table, energy=1.02 * table.energy, loss=0.9 * table.loss))
    assert scaled["energy_l2"] == pytest.approx(0.02, rel=1e-9)
    assert scaled["loss_l2"] == pytest.approx(0.1, rel=1e-9)
    # A constant c more over 20 units of time: ||c|| = c sqrt(20), whatever the spacing of the rows.
    norm = np.sqrt(np.sum(np.diff(table.t) * 0.5 * (table.loss[1:] ** 2 + table.loss[:-1] ** 2)))
    shifted = compare(replace(table, loss=table.loss + 1e-3))
    assert shifted["loss_l2"] == pytest.approx(1e-3 * np.sqrt(20.0) / norm, rel=1e-9)
    early = table.t <= 5.0
    part = Curves(**{name: curve[early] for name, curve in vars(table).items()})
    found = compare(replace(part, loss=1.1 * part.loss))
    assert found["loss_l2"] == pytest.approx(0.1, rel=1e-9)
    assert (found["rows"], found["t_last"]) == (26, 5.0)
    assert "peak" not in found  # not reached
    assert compare(Curves(**{name: curve[:1] for name, curve in vars(table).items()})) == {}


def test_the_laminar_vortex_converges_to_the_published_loss_at_second_order():
    def gap(cells):
        found = compare(march(cells, defaults(PARAMETERS) | {"t_end": 2.5}))
        assert found["t_last"] == 2.4
        assert found["energy_l2"] < 0.01 * found["loss_l2"]
        return found["loss_l2"]

    assert_order(gap, (16, 24, 32), order=1.9, below=0.15)


def test_a_run_too_short_for_the_peak_or_at_another_reynolds_number_is_not_compared_there(shared_tmp):
    result = TaylorGreen(cells=8, overrides=["t_end=1", "cfl=0.3"]).run(out=shared_tmp)
    if WORLD.rank == 0:
        curve = np.genfromtxt(shared_tmp / "decay.csv", delimiter=",", names=True)
        assert curve["energy"][0] == pytest.approx(1 / 8, rel=1e-2)
    assert "peak" not in result["reference"]
    lines = {line["quantity"]: line for line in result["table"]}
    assert lines["largest loss of energy"]["reference"] is None
    found = lines["energy, relative L2 difference from the table"]["computed"]
    assert found == result["reference"]["energy_l2"]
    assert 0.0 < found < 0.05
    other = TaylorGreen(cells=8, overrides=["t_end=0.5", "reynolds=800"]).run(out=shared_tmp)
    assert other["reference"] == {}
    with pytest.raises(CaseError, match="re = 1: unknown parameter; there are 'reynolds'"):
        TaylorGreen(overrides=["re=1"])
