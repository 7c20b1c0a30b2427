"""At which distance of its nodes a plug in a channel leaks, with linear and quadratic elements: what a run warns by."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.bodies.elastic import Elastic
from valvefsi.coupling.transfer import Coupling
from valvefsi.fluid.boundary import Boundary, Open
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.geometry.shapes import rectangle
from valvefsi.grid import MacGrid
from valvefsi.run.health import LONGEST_GAP
from valvefsi.solid.loads import Tether
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.structure import Discretisation, Structure

CELLS, MU = 12, 1.0
SLOTS = 0.5 / (12.0 * MU * CELLS**2)
"""Flow under 1 dyn/cm^2 if each cell across the channel, 1 cm wide and 2 cm long, were a slot (Poiseuille) [cm^2/s]."""


def leak(intervals, degree, steps=400):
    """Flow past a plug with this many intervals between nodes across the channel, in `SLOTS`; the gap over h."""
    h = 1.0 / CELLS
    grid = MacGrid((0, 0), (2, 1), [2 * CELLS, CELLS], [False, False], MPI.COMM_SELF)
    sides = Boundary(grid, {"x_lower": Open(pressure=1.0), "x_upper": Open(pressure=0.0)})
    fluid = NavierStokes(grid, sides, rho=1.0, mu=MU)
    size, dt = degree / intervals, 0.05 * h
    along = 2 // degree * max(1, round(h * intervals))  # two intervals, or as many as fill two cells
    mesh = rectangle(
        MPI.COMM_SELF,
        lower=(1 - 0.5 * along * size, 0.0),
        size=(along * size, 1.0),
        elements=(along, intervals // degree),
    )
    plug = Structure(
        mesh,
        NeoHookean(c1=20.0),
        nu_stab=0.4,
        discretisation=Discretisation(degree=degree),
        tethers=[Tether(stiffness=0.05 / dt**2)],
    )
    coupling = Coupling(grid, "piecewise_linear", sides.signs)
    model = fsi.Model(grid=grid, fluid=fluid, bodies=(Elastic(plug, coupling),))
    state, flows = fsi.initial_state(model, dt), []
    for _ in range(steps):
        state = fsi.step(model, state, dt)
        flows.append(sides.outflow(state.u, "x_upper"))
    return float(np.mean(flows[-steps // 3 :])) / SLOTS, plug.longest_gap(plug.X) / h


@pytest.mark.parametrize("degree", [1, 2])
def test_a_plug_is_tight_below_the_gap_that_is_warned_of_and_leaks_above(degree):
    tight, below = leak(10, degree)
    leaky, above = leak(4, degree)
    assert below < LONGEST_GAP < above
    assert tight < 1.0
    assert leaky > 5.0


def test_quadratic_elements_leak_as_linear_ones_with_nodes_at_the_same_places():
    (linear, gap), (quadratic, same) = leak(6, 1), leak(6, 2)
    assert gap == pytest.approx(same)
    assert quadratic == pytest.approx(linear, rel=0.1)
