"""The positive direction of every flow, and each equation of the source (S4-S10) as it is printed."""

from __future__ import annotations

import numpy as np
import pytest

from valvefsi.circulation.pump import UpstreamBovine, UpstreamPorcine, pump_pressure
from valvefsi.circulation.windkessel import Downstream, FourElement, TwoElement


def test_equations_s9_and_s10_as_printed():
    R_c, R_p, C, p_wk, q_ao = 0.09, 1.1, 1.3, 85.0, 210.0
    system = Downstream(R_c=R_c, R_p=R_p, C=C).system()
    assert C * (system.A @ [p_wk] + system.B @ [q_ao])[0] == pytest.approx(q_ao - p_wk / R_p, rel=1e-13)
    assert system.C @ [p_wk] + system.D @ [q_ao] == pytest.approx(p_wk + q_ao * R_c, rel=1e-13)


def test_equations_s4_and_s5_as_printed_with_their_flow_into_the_circuit():
    R_1, R_2, C, p_pump, p_via, q_source = 0.2, 0.05, 0.4, 130.0, 110.0, -250.0
    system = UpstreamPorcine(R_1=R_1, R_2=R_2, C_VIA=C).system()
    u = [p_pump, -q_source]
    assert C * (system.A @ [p_via] + system.B @ u)[0] == pytest.approx(
        (p_pump - p_via) / R_1 + q_source, rel=1e-13
    )
    p_lv = system.C @ [p_via] + system.D @ u
    assert p_lv / R_2 == pytest.approx(p_via / R_2 + q_source, rel=1e-13)


def test_equations_s6_to_s8_as_printed_with_their_flow_out_of_the_circuit():
    C1, C2, R_VIA, R_out, R_MV = 0.15, 0.25, 0.08, 0.05, 4.0
    p1, p2, p_la, q_pump, q_lv = 120.0, 115.0, 9.0, 330.0, 280.0
    system = UpstreamBovine(C_VIA1=C1, C_VIA2=C2, R_VIA=R_VIA, R_out=R_out, R_MV=R_MV).system()
    u = [q_pump, q_lv, p_la]
    rate = system.A @ [p1, p2] + system.B @ u
    assert C1 * rate[0] == pytest.approx(q_pump - (p1 - p2) / R_VIA, rel=1e-13)
    leaving = (p2 - p_la + q_lv * R_MV) / (R_out + R_MV)
    assert C2 * rate[1] == pytest.approx((p1 - p2) / R_VIA - leaving, rel=1e-13)
    printed = (p2 * R_MV + p_la * R_out - q_lv * R_out * R_MV) / (R_out + R_MV)
    assert system.C @ [p1, p2] + system.D @ u == pytest.approx(printed, rel=1e-13)


@pytest.mark.parametrize("kind", ["porcine", "bovine"])
def test_more_flow_out_of_the_ventricle_lowers_its_pressure(kind):
    if kind == "porcine":
        system, before, after = (
            UpstreamPorcine(R_1=0.2, R_2=0.05, C_VIA=0.4).system(),
            [120.0, 0.0],
            [120.0, 300.0],
        )
    else:
        circuit = UpstreamBovine(C_VIA1=0.2, C_VIA2=0.2, R_VIA=0.1, R_out=0.05, R_MV=4.0)
        system, before, after = circuit.system(), [300.0, 0.0, 8.0], [300.0, 300.0, 8.0]
    start = system.start(np.full(len(system.states), 100.0), before)
    rest, drawn = system.advance(start, before, 0.01), system.advance(start, after, 0.01)
    assert system.observe(drawn) < system.observe(rest)


def test_flow_into_the_outlet_raises_its_pressure():
    for circuit in (
        Downstream(R_c=0.1, R_p=1.0, C=1.0),
        TwoElement(R_p=1.0, C=1.0),
        FourElement(R_c=0.1, R_p=1.0, C=1.0, L=0.01),
    ):
        system = circuit.system()
        start = system.start([80.0, 0.0][: len(system.states)], [0.0])
        assert system.observe(system.advance(start, [300.0], 0.01)) > system.observe(
            system.advance(start, [0.0], 0.01)
        )


def test_four_elements_become_two_and_three_in_their_limits():
    t = np.linspace(0, 0.8, 81)
    u = (300 * np.maximum(np.sin(2 * np.pi * t / 0.8), 0))[:, None]

    def curve(circuit):
        system = circuit.system()
        return system.outputs(system.simulate(t, u, system.periodic_state(t, u)), u)

    values = {"R_p": 1.0, "C": 1.3}
    assert np.allclose(curve(FourElement(R_c=0.1, L=0.0, **values)), curve(TwoElement(**values)), rtol=1e-12)
    two, three = curve(TwoElement(**values)), curve(Downstream(R_c=0.1, **values))
    four = curve(FourElement(R_c=0.1, L=0.01, **values))
    assert np.abs(four - two).max() > 1.0
    assert np.abs(four - three).max() > 1.0
    # from rest, a large inertance lets nothing past R_c; in the periodic state it carries the mean
    x = Downstream(R_c=0.1, **values).system().periodic_state(t, u)
    systems = [FourElement(R_c=0.1, L=1e7, **values).system(), Downstream(R_c=0.1, **values).system()]
    large, none = (s.outputs(s.simulate(t, u, [x[0], 0.0][: len(s.states)]), u) for s in systems)
    assert np.allclose(large, none, atol=1e-5)


@pytest.mark.parametrize("C_VIA", [0.4, 0.0])
@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_the_derived_pump_pressure_gives_the_ventricle_back(C_VIA, noise):
    rng = np.random.default_rng(5)
    t = np.sort(np.concatenate([[0.0, 0.86], rng.uniform(0, 0.86, 300)]))
    q = 380 * np.maximum(np.sin(2 * np.pi * t / 0.86), 0) ** 1.5
    p = 8 + 110 * np.maximum(np.sin(2 * np.pi * t / 0.86), 0) + noise * rng.normal(size=len(t))
    circuit = UpstreamPorcine(R_1=0.15, R_2=0.05, C_VIA=C_VIA)
    pump, system = pump_pressure(circuit, t, q, p), circuit.system()
    u = np.stack([pump.p_pump, q], axis=1)
    back = system.outputs(system.simulate(t, u, pump.p_via[: len(system.states)]), u)
    assert np.abs(back - p).max() < 1e-9


def test_the_derived_pump_pressure_of_a_smooth_record_is_the_one_of_the_equations():
    t = np.linspace(0, 0.8, 401)
    phase = 2 * np.pi * t / 0.8
    q, p = 150 * (1 - np.cos(phase)), 70 - 50 * np.cos(phase + 0.3)
    circuit = UpstreamPorcine(R_1=0.15, R_2=0.05, C_VIA=0.4)
    slope = (50 * np.sin(phase + 0.3) + 0.05 * 150 * np.sin(phase)) * 2 * np.pi / 0.8
    p_via = p + 0.05 * q
    exact = p_via + 0.15 * (0.4 * slope + q)
    assert np.abs(pump_pressure(circuit, t, q, p).p_pump - exact).max() < 1e-3 * np.abs(exact).max()
