"""A target: what is chosen, against a loop written down anew, closed forms, and a valve that is no orifice."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

from tests.case.test_valve_cycles import DEMO
from valvefsi.case import load_case, parse_case, to_toml
from valvefsi.case.circulation import build_circulation
from valvefsi.case.target import at_target, flow_at, plan_target
from valvefsi.case.target_beat import correct_target
from valvefsi.cli.target import target as command
from valvefsi.errors import CaseError
from valvefsi.units import LITRE_PER_MINUTE, MMHG

STEPS = 4000
FIVE = (
    "target.beats_per_minute=70",
    "target.cardiac_output='5 l/min'",
    "target.mean_aortic_pressure='100 mmHg'",
)


def by_hand(case, beats, *, area, inertance, leak=0.0, start=None):
    """The loop of S4, S5, S9, S10 with an orifice, by Euler steps: time, P_LV, P_Ao and Q of some beats.

    The record of the pump is stretched to the beat and scaled above its smallest value here, not by the package. While
    the orifice is shut, fluid leaks back in proportion to the pressure.
    """
    up, down = case.circuit
    rows = np.loadtxt(up.pump.file, delimiter=",", skiprows=1)
    own, T = rows[-1, 0], 60.0 / case.target.beats_per_minute
    a, b = up.parameters, down.parameters
    lowest = rows[:, 1].min()
    pump = lowest + up.pump.amplitude * (
        np.interp(np.linspace(0, own, STEPS), rows[:, 0], rows[:, 1]) - lowest
    )
    pump = np.tile(MMHG * pump, beats)
    p_via, p_wk, q, dt = up.start["p_via"], down.start["p_wk"], 0.0, T / STEPS
    if start is not None:
        p_via, p_wk = start
    loss, found = case.fluid.density / (2 * area**2), []
    for n in range(beats * STEPS + 1):
        p_lv, p_ao = p_via - a["R_2"] * q, p_wk + b["R_c"] * q
        found.append((n * dt, p_lv, p_ao, q))
        if q > 0.0 or p_lv > p_ao:
            q = max(q + dt * (p_lv - p_ao - loss * q * abs(q)) / inertance, 0.0)
        if q == 0.0 and p_ao > p_lv:
            q = -leak * (p_ao - p_lv)
        p_via += dt * ((pump[min(n, len(pump) - 1)] - p_via) / a["R_1"] - q) / a["C_VIA"]
        p_wk += dt * (q - p_wk / b["R_p"]) / b["C"]
    return np.array(found).T, (p_via, p_wk)


def means(waves, beat):
    """Mean flow [l/min] and mean P_Ao [mmHg] of a beat, from 0."""
    _, _, p_ao, q = waves[:, beat * STEPS : (beat + 1) * STEPS]
    return q.mean() / LITRE_PER_MINUTE, p_ao.mean() / MMHG


@pytest.fixture(scope="module")
def five():
    """The demo at 70 beats a minute, 5 l/min, 100 mmHg."""
    return at_target(load_case(DEMO, FIVE))


def area_of(case):
    """The orifice of the documents: 0.6 of the area of the diameter, and the column of fluid in the box."""
    whole = np.pi * 2.5**2 / 4
    return {"area": 0.6 * whole, "inertance": case.fluid.density * 8.0 / whole}


def test_the_loop_written_down_anew_reaches_the_target(five):
    case, chosen = five
    waves, end = by_hand(case, 2, **area_of(case))
    for beat in (0, 1):
        output, pressure = means(waves, beat)
        assert output == pytest.approx(5.0, rel=0.01)
        assert pressure == pytest.approx(100.0, rel=0.01)
    assert end[1] == pytest.approx(case.circuit[1].start["p_wk"], rel=0.01), "it starts periodic"
    assert chosen.period == case.circuit[0].pump.period == 60.0 / 70.0


@pytest.mark.parametrize(
    ("rate", "output", "pressure"), [(60, 2.5, 85.0), (120, 7.0, 110.0)], ids=["slow", "fast"]
)
def test_another_condition_is_one_override_away(rate, output, pressure):
    more = (
        f"beats_per_minute={rate}",
        f"cardiac_output='{output} l/min'",
        f"mean_aortic_pressure='{pressure} mmHg'",
    )
    case, _ = at_target(load_case(DEMO, [*FIVE, *(f"target.{text}" for text in more)]))
    found = means(by_hand(case, 1, **area_of(case))[0], 0)
    assert found == pytest.approx((output, pressure), rel=0.01)
    assert case.time.t_end == max(0.857, 60.0 / rate), "a whole beat is run"


def test_the_peripheral_resistance_is_that_of_the_means(five):
    """mean P_Ao = (R_c + R_p) mean Q."""
    case, chosen = five
    R_c, R_p = (case.circuit[1].parameters[name] for name in ("R_c", "R_p"))
    assert R_c + R_p == pytest.approx(100 * MMHG / (5 * LITRE_PER_MINUTE), rel=1e-12)
    assert chosen.mean_aortic_pressure == pytest.approx((R_c + R_p) * chosen.cardiac_output, rel=1e-3)
    assert case.circuit[1].target_pressure == 100 * MMHG


def test_all_that_a_pump_of_given_flow_gives_passes_a_valve_beside_which_little_leaks(tmp_path):
    """Mean Q = amplitude x mean Q_pump, but for some P_LV / R_MV."""
    t = np.linspace(0.0, 0.8, 81)
    rows = "".join(f"{a:g},{250 * np.sin(np.pi * a / 0.8) ** 2:g},8\n" for a in t)
    (tmp_path / "pump.csv").write_text("t_s,q_pump_ml_s,p_la_mmHg\n" + rows)
    pump = f"circuit.ventricle.pump={{file='{tmp_path}/pump.csv', period=0.8}}"
    case = load_case(DEMO.with_name("pericardial_valve_bovine.toml"), [*FIVE, pump])
    case, chosen = at_target(
        parse_case(tomllib.loads(to_toml(case)), ["circuit.ventricle.R_MV='200 mmHg*s/ml'"])
    )
    leak = 100 / 200
    assert chosen.amplitude == pytest.approx((5 * LITRE_PER_MINUTE + leak) / 125, rel=0.005)


def test_what_was_chosen_is_the_same_when_it_is_chosen_again(five):
    case, chosen = five
    again = parse_case(tomllib.loads(to_toml(case)), file=DEMO)
    assert to_toml(again) == to_toml(case)
    twice, same = at_target(again)
    assert (to_toml(twice), same) == (to_toml(case), chosen)
    case, none = at_target(load_case(DEMO))
    assert none is None
    assert plan_target(case, none) == []


def test_one_override_of_a_case_without_the_table_leaves_the_rest_usual():
    """70 beats a minute, 5 l/min, 100 mmHg."""
    target = load_case(DEMO, ["target.cardiac_output='7 l/min'"]).target
    found = (
        target.beats_per_minute,
        target.cardiac_output / LITRE_PER_MINUTE,
        target.mean_aortic_pressure / MMHG,
    )
    assert found == pytest.approx((70.0, 7.0, 100.0))


def test_a_record_is_stretched_and_scaled_above_its_smallest_value():
    def drive(*changes):
        case = load_case(DEMO, [f"circuit.ventricle.pump.{change}" for change in changes])
        return next(c.drive for c in build_circulation(case).connections if c.side == "z_lower")

    plain = drive("phase='0.1 s'")
    slow = drive("phase='0.1 s'", "period='1.714 s'", "record_period='0.857 s'", "amplitude=1.5")
    for t in (0.0, 0.2, 0.7, 1.4, 2.1):
        assert slow(t)["p_pump"] == pytest.approx(
            8 * MMHG + 1.5 * (plain(t / 2)["p_pump"] - 8 * MMHG), rel=1e-12
        )


def run_of(case, folder, **valve):
    """A folder as a run leaves it, of a valve that is no orifice of the documents; its beat's mean flow [l/min]."""
    waves, _ = by_hand(case, 1, **valve)
    history = np.stack([np.arange(STEPS + 1), waves[0], waves[1] / MMHG, waves[2] / MMHG, waves[3]])
    history = np.vstack([history, np.where(waves[3] > 0, 3.0, 0.0)])[:, ::10]
    head = "step,t_s,p_z_lower_mmHg,p_z_upper_mmHg,q_z_upper_ml_s,pdva_cm2"
    np.savetxt(folder / "history.csv", history.T, delimiter=",", header=head, comments="")
    (folder / "case.toml").write_text(to_toml(case), encoding="utf-8")
    return means(waves, 0)[0]


def test_a_beat_of_another_valve_corrects_the_pump(five, tmp_path, capsys):
    other = {"area": 1.6, "inertance": 3.0, "leak": 0.1 / MMHG}
    case = five[0]
    first = run_of(case, tmp_path, **other)
    assert first < 0.92 * 5.0, "the valve is narrower and leaks"
    found = correct_target(tmp_path)
    assert found.cardiac_output / LITRE_PER_MINUTE == pytest.approx(first, rel=5e-3)
    assert found.response == pytest.approx(
        first / (flow_at(case, found.mean_aortic_pressure, 80.0) / LITRE_PER_MINUTE), rel=5e-3
    )
    output, pressure = means(by_hand(found.case, 8, **other)[0], 7)
    assert output == pytest.approx(5.0, rel=0.015)
    assert pressure == pytest.approx(100.0, rel=0.015)
    command(tmp_path)
    written = load_case(tmp_path / "corrected.toml")
    assert written.target.response == pytest.approx(found.response, rel=1e-12)
    assert at_target(written)[0].circuit[0].pump.amplitude == found.chosen.amplitude
    assert "cardiac output" in capsys.readouterr().out


def test_a_run_without_a_target_has_none_to_correct(tmp_path, five):
    run_of(five[0], tmp_path, **area_of(five[0]))
    text = to_toml(five[0].model_copy(update={"target": None}))
    (tmp_path / "case.toml").write_text(text, encoding="utf-8")
    with pytest.raises(CaseError, match="case.toml: target: the run has no target"):
        correct_target(tmp_path)


WRONG = [
    (
        "target.mean_aortic_pressure='4 mmHg'",
        r"expected more than the 4\.8 mmHg that the flow takes through aorta\.R_c",
    ),
    (
        "target.cardiac_output='60 l/min'",
        r"cardiac_output = 1000\.0+\d: it takes \d+\.?\d* mmHg upstream of the valve",
    ),
    ("target.beats_per_minute=0", r"target\.beats_per_minute = 0: expected a number greater than 0"),
    ("target.cardiac_output='5 l'", r"target\.cardiac_output = '5 l': expected a quantity in cm\^3/s"),
    (
        "target.cardiac_outpt='5 l/min'",
        r"target\.cardiac_outpt = '5 l/min': unknown key; did you mean 'cardiac_output'",
    ),
    ("circuit.ventricle.pump.phase='0.9 s'", r"pump\.phase = 0\.9: expected less than the period"),
    (
        "circuit.ventricle.pump={file='pericardial_valve_pump.csv'}",
        r"ventricle\.pump\.period: .* and its period",
    ),
    ("fluid.sides.z_lower.circuit=''", "a target needs a circuit with a pump upstream of the valve"),
    ("circuit.ventricle.pump={record_period=1.0}", r"record_period = 1\.0: there is no period to stretch"),
]


@pytest.mark.parametrize(("change", "message"), WRONG, ids=[change for change, _ in WRONG])
def test_a_target_that_cannot_be_is_one_line(change, message):
    with pytest.raises(CaseError, match=message) as error:
        at_target(load_case(DEMO, [*FIVE, change]))
    assert "\n" not in str(error.value)
