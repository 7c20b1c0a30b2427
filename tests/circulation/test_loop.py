"""Circuits at open sides: a rigid tube between them follows the circuit of all of it."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from scipy.integrate import solve_ivp

from tests.ordering import assert_order
from valvefsi import fsi
from valvefsi.circulation.loop import Connection, FlowLoop
from valvefsi.circulation.pump import UpstreamPorcine
from valvefsi.circulation.windkessel import Downstream
from valvefsi.fluid.boundary import Boundary, FreeSlip, Open
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.grid import MacGrid

UPSTREAM = UpstreamPorcine(R_1=3.0, R_2=0.5, C_VIA=0.02)
OUTLET = Downstream(R_c=2.0, R_p=20.0, C=0.05)
LENGTH, HEIGHT, RHO, T_END = 2.0, 0.5, 1.3, 1.0


def pump(t):
    return {"p_pump": 40.0 * np.sin(2 * np.pi * t) ** 2}


def make_loop():
    return FlowLoop(
        [
            Connection(side="x_lower", system=UPSTREAM.system(), start={"p_via": 5.0}, drive=pump),
            Connection(side="x_upper", system=OUTLET.system(), start={"p_wk": 8.0}),
        ]
    )


def tube_run(steps, comm=MPI.COMM_WORLD):
    """A tube with walls that slip: the fluid in it is an inertance rho length / area and nothing else."""
    grid = MacGrid([0, 0], [LENGTH, HEIGHT], [16, 4], [False, False], comm)
    sides = {
        "x_lower": Open(backflow=0.0),
        "x_upper": Open(backflow=0.0),
        "y_lower": FreeSlip(),
        "y_upper": FreeSlip(),
    }
    fluid = NavierStokes(grid, Boundary(grid, sides), rho=RHO, mu=0.1)
    model = fsi.Model(grid=grid, fluid=fluid, circulation=make_loop())
    state = fsi.initial_state(model, T_END / steps)
    flow = []
    for _ in range(steps):
        state = fsi.step(model, state, T_END / steps)
        flow.append(fluid.boundary.outflow(state.u, "x_upper"))
    return np.array(flow), state


def circuit_run(times):
    """The whole loop as one circuit: P_VIA, Q and P_Wk."""
    inertance = RHO * LENGTH / HEIGHT

    def rates(t, y):
        p_via, q, p_wk = y
        p_in, p_out = p_via - UPSTREAM.R_2 * q, p_wk + OUTLET.R_c * q
        return [
            ((pump(t)["p_pump"] - p_via) / UPSTREAM.R_1 - q) / UPSTREAM.C_VIA,
            (p_in - p_out) / inertance,
            (q - p_wk / OUTLET.R_p) / OUTLET.C,
        ]

    found = solve_ivp(rates, (0, T_END), [5.0, 0.0, 8.0], t_eval=times, rtol=1e-10, atol=1e-10)
    return found.y[1]


def test_a_tube_between_two_circuits_follows_the_circuit_of_all_of_it():
    """First order in the step, as the splitting is."""

    def error(steps):
        flow, _ = tube_run(steps)
        exact = circuit_run(np.linspace(0, T_END, steps + 1)[1:])
        assert np.ptp(exact) > 1.0
        return np.abs(flow - exact).max() / np.abs(exact).max()

    assert_order(error, (200, 400, 800), order=0.95, below=5e-3)


def test_the_state_is_what_a_restart_needs():
    _, state = tube_run(20)
    loop = make_loop()
    assert state.circuits.shape == loop.start.shape == (4,)
    (p_via, q_in), (p_wk, q_out) = loop.parts(state.circuits)
    assert q_out == pytest.approx(-q_in, rel=1e-10)
    pressures = loop.pressures(state.circuits, state.t)
    assert pressures["x_upper"] == pytest.approx(float(p_wk[0]) + OUTLET.R_c * q_out)
    assert pressures["x_lower"] == pytest.approx(float(p_via[0]) + UPSTREAM.R_2 * q_in)


def test_flows_carry_their_sign():
    """Out of the box is into the outlet's circuit and out of the chamber's into the box."""
    loop = make_loop()
    new = loop.step(loop.start, {"x_lower": -3.0, "x_upper": 3.0}, 0.0, 0.01)
    still = loop.step(loop.start, {"x_lower": 0.0, "x_upper": 0.0}, 0.0, 0.01)
    assert loop.parts(new)[0][0][0] < loop.parts(still)[0][0][0]
    assert loop.parts(new)[1][0][0] > loop.parts(still)[1][0][0]


def test_what_cannot_be_connected_is_refused():
    with pytest.raises(ValueError, match="nothing drives the input p_pump"):
        Connection(side="x_lower", system=UPSTREAM.system())
    outlet = Connection(side="x_upper", system=OUTLET.system())
    with pytest.raises(ValueError, match="each side takes one circuit"):
        FlowLoop([outlet, outlet])
