"""Exact stepping of linear circuits, against closed forms and a generic integrator of high order."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from valvefsi.circulation.linear import reduce
from valvefsi.circulation.pump import UpstreamBovine, UpstreamPorcine
from valvefsi.circulation.windkessel import Downstream, FourElement, TwoElement

# in mmHg, ml and s; any coherent set does
CIRCUITS = {
    "three": Downstream(R_c=0.0883, R_p=1.085, C=1.279),
    "two": TwoElement(R_p=1.1, C=1.3),
    "four": FourElement(R_c=0.09, R_p=1.05, C=1.2, L=0.006),
    "porcine": UpstreamPorcine(R_1=0.15, R_2=0.05, C_VIA=0.4),
    "bovine": UpstreamBovine(C_VIA1=0.15, C_VIA2=0.25, R_VIA=0.08, R_out=0.05, R_MV=4.0),
}


def record(num_inputs, n=24, seed=3, period=0.8):
    """Return uneven times and inputs, the last equal to the first."""
    rng = np.random.default_rng(seed)
    t = np.concatenate([[0.0], np.sort(rng.uniform(0.02, period - 0.02, n - 2)), [period]])
    u = rng.normal(60.0, 80.0, (n, num_inputs))
    u[-1] = u[0]
    return t, u


def integrate(system, t, u, x):
    """Integrate piece by piece with DOP853."""
    found = [x]
    for a, b, left, right in zip(t[:-1], t[1:], u[:-1], u[1:], strict=True):

        def slope(s, y, a=a, b=b, left=left, right=right):
            return system.A @ y + system.B @ (left + (right - left) * (s - a) / (b - a))

        done = solve_ivp(slope, (a, b), found[-1], method="DOP853", rtol=3e-14, atol=1e-13)
        found.append(done.y[:, -1])
    return np.array(found)


@pytest.mark.parametrize("name", CIRCUITS)
def test_the_exact_update_agrees_with_an_integrator_of_high_order(name):
    system = CIRCUITS[name].system()
    t, u = record(len(system.inputs))
    x = np.linspace(80.0, 95.0, len(system.states))
    exact, generic = system.simulate(t, u, x), integrate(system, t, u, x)
    assert np.abs(exact - generic).max() < 1e-12 * np.abs(exact).max()


@pytest.mark.parametrize("name", CIRCUITS)
def test_steps_one_by_one_are_the_record_at_once(name):
    system = CIRCUITS[name].system()
    t, u = record(len(system.inputs))
    x = np.linspace(80.0, 95.0, len(system.states))
    states = system.simulate(t, u, x)
    state = system.start(x, u[0], t[0])
    for n in range(1, len(t)):
        before = state
        state = system.advance(state, u[n], t[n] - t[n - 1])
        assert np.allclose(before.x, states[n - 1], rtol=1e-12)
    assert state.t == pytest.approx(t[-1], rel=1e-14)
    assert np.allclose(state.x, states[-1], rtol=1e-12)
    assert system.observe(state) == pytest.approx(system.outputs(states, u)[-1], rel=1e-12)


def test_steps_do_not_depend_on_how_an_interval_is_divided():
    system = CIRCUITS["bovine"].system()
    start = system.start([80.0, 75.0], [300.0, 250.0, 10.0])
    end = np.array([100.0, 400.0, 4.0])
    whole, parts = system.advance(start, end, 0.05), start
    for share in (0.1, 0.45, 0.8, 1.0):
        u = start.u + share * (end - start.u)
        parts = system.advance(parts, u, share * 0.05 - parts.t)
    assert np.allclose(whole.x, parts.x, rtol=1e-13)


def test_a_windkessel_empties_as_its_closed_form_says():
    circuit = CIRCUITS["three"]
    system = circuit.system()
    t = np.linspace(0, 2.0, 37)
    p = system.outputs(system.simulate(t, np.zeros((37, 1)), [100.0]), np.zeros((37, 1)))
    assert np.allclose(p, 100.0 * np.exp(-t / (circuit.R_p * circuit.C)), rtol=1e-13)


def test_a_rising_flow_gives_the_closed_form():
    circuit = CIRCUITS["three"]
    system = circuit.system()
    t = np.array([0.0, 0.3, 0.9])
    u = 50.0 * t[:, None]
    tau = circuit.R_p * circuit.C
    exact = 50.0 * circuit.R_p * (t - tau * (1 - np.exp(-t / tau)))
    p = system.outputs(system.simulate(t, u, [0.0]), u)
    assert np.allclose(p, exact + circuit.R_c * u[:, 0], rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("name", CIRCUITS)
def test_the_periodic_state_returns_and_is_where_cycles_lead(name):
    system = CIRCUITS[name].system()
    t, u = record(len(system.inputs))
    x = system.periodic_state(t, u)
    assert np.allclose(system.simulate(t, u, x)[-1], x, rtol=1e-12)
    far = np.zeros(len(system.states))
    for _ in range(60):
        far = system.simulate(t, u, far)[-1]
    assert np.allclose(far, x, rtol=1e-10)


def test_the_periodic_mean_pressure_is_the_mean_flow_through_both_resistances():
    circuit = CIRCUITS["three"]
    system = circuit.system()
    t, u = record(1)
    x = system.periodic_state(t, u)
    fine = np.linspace(0, t[-1], 20001)
    flow = np.interp(fine, t, u[:, 0])[:, None]
    p = system.outputs(system.simulate(fine, flow, x), flow)
    mean_q = np.trapezoid(flow[:, 0], fine) / t[-1]
    assert np.trapezoid(p, fine) / t[-1] == pytest.approx((circuit.R_c + circuit.R_p) * mean_q, rel=1e-6)


def test_a_circuit_that_cannot_empty_has_no_periodic_state():
    system = reduce([1.0], [[0.0]], [[1.0]], [1.0], [0.0], (("p",), ("q",), ("p_out",)))
    with pytest.raises(ValueError, match="cannot empty"):
        system.periodic_state(*record(1))


@pytest.mark.parametrize("name", CIRCUITS)
def test_constant_inputs_lead_to_the_steady_state(name):
    system = CIRCUITS[name].system()
    u = np.linspace(40.0, 70.0, len(system.inputs))
    x = system.steady_state(u)
    assert np.allclose(system.advance(system.start(x, u), u, 0.3).x, x, rtol=1e-12)


@pytest.mark.parametrize("name", CIRCUITS)
def test_a_complex_step_gives_the_derivative_to_round_off(name):
    circuit = CIRCUITS[name]
    t, u = record(len(circuit.system().inputs))

    def curve(values):
        system = type(circuit)(**values).system()
        return system.outputs(system.simulate(t, u, system.periodic_state(t, u)), u)

    values = vars(circuit)
    for key, value in values.items():
        exact = curve({**values, key: value + 1e-30j}).imag / 1e-30
        rough = []
        for h in (2e-3, 1e-3):
            ends = [curve({**values, key: value * (1 + s * h)}) for s in (1, -1)]
            rough.append((ends[0] - ends[1]) / (2 * h * value))
        better = (4 * rough[1] - rough[0]) / 3
        assert np.abs(exact - better).max() < 1e-8 * np.abs(exact).max() + 1e-9, key


@pytest.mark.parametrize(
    ("rigid", "soft"),
    [
        (Downstream(R_c=0.1, R_p=1.0, C=0.0), Downstream(R_c=0.1, R_p=1.0, C=1e-9)),
        (TwoElement(R_p=1.0, C=0.0), TwoElement(R_p=1.0, C=1e-9)),
        (UpstreamPorcine(R_1=0.2, R_2=0.1, C_VIA=0.0), UpstreamPorcine(R_1=0.2, R_2=0.1, C_VIA=1e-9)),
        *(
            (
                UpstreamBovine(C_VIA1=a, C_VIA2=b, R_VIA=0.08, R_out=0.05, R_MV=4.0),
                UpstreamBovine(C_VIA1=a or 1e-9, C_VIA2=b or 1e-9, R_VIA=0.08, R_out=0.05, R_MV=4.0),
            )
            for a, b in ((0.0, 0.2), (0.2, 0.0), (0.0, 0.0))
        ),
    ],
)
def test_a_rigid_chamber_is_the_limit_of_a_stiff_one(rigid, soft):
    stiff, limit = soft.system(), rigid.system()
    assert len(limit.states) < len(stiff.states)
    t, u = record(len(stiff.inputs))
    answers = [s.outputs(s.simulate(t, u, s.periodic_state(t, u)), u) for s in (stiff, limit)]
    assert np.abs(answers[0] - answers[1]).max() < 1e-4 * np.abs(answers[1]).max()


def test_times_that_do_not_increase_are_refused():
    system = CIRCUITS["three"].system()
    with pytest.raises(ValueError, match="increasing"):
        system.simulate(np.array([0.0, 0.1, 0.1]), np.zeros((3, 1)), [80.0])
    with pytest.raises(ValueError, match="p_wk"):
        system.start([80.0, 70.0], [1.0])


@pytest.mark.parametrize(
    ("kind", "values", "name"),
    [
        (Downstream, {"R_c": 0.1, "R_p": 0.0, "C": 1.0}, "R_p"),
        (Downstream, {"R_c": -0.1, "R_p": 1.0, "C": 1.0}, "R_c"),
        (TwoElement, {"R_p": 1.0, "C": float("nan")}, "C"),
        (FourElement, {"R_c": 0.1, "R_p": 1.0, "C": 1.0, "L": -1.0}, "L"),
        (UpstreamPorcine, {"R_1": 0.0, "R_2": 0.1, "C_VIA": 0.1}, "R_1"),
    ],
)
def test_values_that_mean_nothing_are_refused(kind, values, name):
    with pytest.raises(ValueError, match=f"{name} = "):
        kind(**values)
