"""An orifice with inertance: closed forms, order of the step, energy, and what is read off a record."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid, solve_ivp

from tests.ordering import assert_order
from valvefsi.circulation.loop import Connection
from valvefsi.circulation.orifice import Orifice, OrificeLoop, orifice_of
from valvefsi.circulation.pump import UpstreamPorcine
from valvefsi.circulation.windkessel import Downstream

VALVE = Orifice(area=2.0, inertance=4.0, rho=1.1)
UPSTREAM = UpstreamPorcine(R_1=130.0, R_2=50.0, C_VIA=2e-4)
OUTLET = Downstream(R_c=80.0, R_p=1500.0, C=1.8e-3)
P_VIA, P_WK, PERIOD = 1.0e5, 1.1e5, 0.8


def pump(t):
    return {"p_pump": 2.5e5 * max(np.sin(2 * np.pi * t / PERIOD), 0.0) ** 2 + 1e4}


def steady(t):
    return {"p_pump": 2.0e5 + 2e4 * np.sin(2 * np.pi * t / PERIOD)}


def loop(drive=pump, p_via=P_VIA):
    inlet = Connection(side="z_lower", system=UPSTREAM.system(), start={"p_via": p_via}, drive=drive)
    outlet = Connection(side="z_upper", system=OUTLET.system(), start={"p_wk": P_WK})
    return OrificeLoop(VALVE, inlet, outlet)


def flows(drop, q, steps, t_end):
    """The flow under a constant pressure difference, no circuits."""
    found = [q]
    for _ in range(steps):
        found.append(VALVE.step(found[-1], drop, (drop, 0.0), t_end / steps))
    return np.array(found)


def test_a_steady_drop_is_that_of_bernoulli():
    """A sqrt(2 dp / rho), whatever the inertance."""
    drop = 8e3
    assert flows(drop, 0.0, 400, 4.0)[-1] == pytest.approx(2.0 * np.sqrt(2 * drop / 1.1), rel=1e-12)


def test_a_flow_that_starts_follows_its_closed_form():
    """q = sqrt(dp / B) tanh(t sqrt(dp B) / L)."""
    drop, loss = 8e3, 1.1 / (2 * 2.0**2)

    def error(steps):
        t = np.linspace(0.0, 0.2, steps + 1)
        exact = np.sqrt(drop / loss) * np.tanh(t * np.sqrt(drop * loss) / 4.0)
        return np.abs(flows(drop, 0.0, steps, 0.2) - exact).max() / exact.max()

    assert_order(error, (20, 40, 80), order=1.95, below=1e-4)


def test_a_flow_that_is_left_alone_decays_against_its_inertance():
    """q = q_0 / (1 + B q_0 t / L)."""
    loss = 1.1 / (2 * 2.0**2)

    def error(steps):
        exact = 400.0 / (1.0 + loss * 400.0 * np.linspace(0.0, 0.3, steps + 1) / 4.0)
        return np.abs(flows(0.0, 400.0, steps, 0.3) - exact).max() / 400.0

    assert_order(error, (30, 60, 120), order=1.95, below=1e-4)


def test_a_flow_against_the_pressure_comes_to_rest_in_time_and_stays_there():
    """It stops at t = L / sqrt(d B) atan(q_0 sqrt(B / d)) under a difference d against it; nothing flows back."""
    against, loss, steps = 2e4, 1.1 / (2 * 2.0**2), 2000
    found = flows(-against, 300.0, steps, 0.1)
    stop = 4.0 / np.sqrt(against * loss) * np.arctan(300.0 * np.sqrt(loss / against))
    at = np.flatnonzero(found == 0.0)
    assert 0.1 * at[0] / steps == pytest.approx(stop, abs=2 * 0.1 / steps)
    assert np.all(found[at[0] :] == 0.0)
    assert np.all(np.diff(found[: at[0] + 1]) < 0.0)


def test_a_shut_orifice_passes_nothing_and_leaves_the_circuits_to_themselves():
    own = loop(lambda t: {"p_pump": 1e4})
    found, state = own.run(own.begin(), 100, 1e-3)
    assert np.all(found["q_ao"] == 0.0)
    assert found["t"][-1] == pytest.approx(0.1)
    assert state.outlet.x[0] == pytest.approx(P_WK * np.exp(-0.1 / (1500.0 * 1.8e-3)))
    assert state.inlet.x[0] == pytest.approx(1e4 + (P_VIA - 1e4) * np.exp(-0.1 / (130.0 * 2e-4)))


def rates(t, y, drive, shut):
    """The loop as one system of equations, written out."""
    p_via, q, p_wk = y[0], 0.0 if shut else y[1], y[2]
    drop = p_via - 50.0 * q - p_wk - 80.0 * q
    gained = 0.0 if shut else (drop - 1.1 / (2 * 2.0**2) * q * abs(q)) / 4.0
    return [((drive(t)["p_pump"] - p_via) / 130.0 - q) / 2e-4, gained, (q - p_wk / 1500.0) / 1.8e-3]


def reference(times, drive, p_via):
    """The flow by an integrator of order eight that finds when the valve opens and shuts."""
    y, t, shut, parts = [p_via, 0.0, P_WK], 0.0, p_via < P_WK, []
    while t < times[-1]:

        def turns(t, y, drive, shut):
            return y[0] - y[2] if shut else y[1]

        turns.terminal, turns.direction = True, 1 if shut else -1
        there = times[times >= t]
        found = solve_ivp(
            rates,
            (t, times[-1]),
            y,
            "DOP853",
            there,
            events=turns,
            args=(drive, shut),
            rtol=1e-10,
            atol=1e-8,
            max_step=2e-3,
        )
        parts.append(np.where(shut, 0.0, found.y[1]))
        if found.status != 1:
            break
        t, y = found.t_events[0][0], [*found.y_events[0][0]]
        y[1], shut = 0.0, not shut
    return np.concatenate(parts)


@pytest.mark.parametrize(
    ("drive", "p_via", "order"),
    [(steady, 1.2e5, 1.95), (pump, P_VIA, 1.7)],
    ids=["stays open", "opens and shuts"],
)
def test_the_loop_is_second_order_in_the_step(drive, p_via, order):
    """Mean square error over one and a half cycles against the equations of the whole loop.

    Where in a step the valve opens and shuts is chance: the rate wobbles about two, less over eight steps to one.
    """
    exact = reference(np.linspace(0.0, 1.2, 301), drive, p_via)
    assert np.any(exact[50:] == 0.0) == (drive is pump)
    assert exact.max() > 100.0

    def error(steps):
        own = loop(drive, p_via)
        q = own.run(own.begin(), steps, 1.2 / steps)[0]["q_ao"][:: steps // 300]
        return np.sqrt(np.mean((q - exact) ** 2)) / exact.max()

    assert_order(error, (300, 2400), order=order, below=1e-5)


def test_the_work_of_the_pressures_is_what_the_orifice_takes_and_what_the_flow_holds():
    own = loop()
    found, _ = own.run(own.begin(), 2400, 5e-4)
    t, q = found["t"], found["q_ao"]
    work = cumulative_trapezoid((found["p_lv"] - found["p_ao"]) * q, t, initial=0.0)
    taken = cumulative_trapezoid(1.1 / (2 * 2.0**2) * q**3, t, initial=0.0)
    assert np.abs(work - taken - 0.5 * 4.0 * q**2).max() < 1e-3 * taken[-1]
    assert taken[-1] > 0.0


def test_a_run_goes_on_where_it_stopped():
    own = loop()
    whole, _ = own.run(own.begin(), 200, 2e-3)
    first, state = own.run(own.begin(), 90, 2e-3)
    rest, _ = own.run(state, 110, 2e-3)
    for name in whole:
        assert np.allclose(whole[name], np.concatenate([first[name], rest[name][1:]]), rtol=1e-12)


def test_inertance_and_area_are_read_off_forward_flow():
    t = np.linspace(0.0, 0.3, 601)
    q = 400.0 * np.sin(np.pi * t / 0.3)
    drop = 4.0 * 400.0 * np.pi / 0.3 * np.cos(np.pi * t / 0.3) + 0.1375 * q**2
    assert orifice_of(t, drop, q) == pytest.approx((4.0, 0.1375), rel=1e-4)
    assert orifice_of(t, drop, q, 0.1375) == (pytest.approx(4.0, rel=1e-4), 0.1375)
    assert orifice_of(t, drop, q, 0.15)[0] < 3.9, "what a larger loss takes is missing"
    with pytest.raises(ValueError, match="q: expected a flow that changes, found 0"):
        orifice_of(t, drop, 0.0 * t)


@pytest.mark.parametrize("name", ["area", "inertance", "rho"])
def test_an_orifice_that_means_nothing_is_refused(name):
    with pytest.raises(ValueError, match=f"{name} = 0.0: expected a finite number above zero"):
        Orifice(**{"area": 2.0, "inertance": 4.0, "rho": 1.1, name: 0.0})


def test_circuits_at_the_wrong_end_are_refused():
    own = loop()
    with pytest.raises(ValueError, match="side z_upper: expected a circuit with the input q_lv, got q_ao"):
        OrificeLoop(VALVE, own.outlet, own.inlet)
