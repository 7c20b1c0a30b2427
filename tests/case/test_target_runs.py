"""A run with a target: what was chosen stands in its case, its plan and its summary, and it goes on with it."""

from __future__ import annotations

import numpy as np
import pytest

from tests.case.test_case_circulation import CASE
from tests.case_text import written
from valvefsi.case import load_case
from valvefsi.case.build import plan_case, run_case
from valvefsi.case.target import at_target
from valvefsi.errors import CaseError
from valvefsi.units import LITRE_PER_MINUTE, MMHG

TARGET = """[target]
beats_per_minute = 600
cardiac_output = "0.4 l/min"
mean_aortic_pressure = "8 mmHg"
orifice_area = "1 cm^2"
inertance = "2 g/cm^4"
"""


@pytest.fixture
def write(shared_tmp):
    """Return a function that writes the tube with a target, and reads it back."""

    def write(*changes, target=TARGET):
        t = np.linspace(0.0, 0.2, 21)
        rows = "".join(f"{a:g},{10 * np.sin(5 * np.pi * a) ** 2:g}\n" for a in t)
        text = CASE.replace('t_end = "0.4 s"', 't_end = "20 ms"') + target
        text = text.replace("frames = 0", "frames = 0\ncheckpoint_every = 10")
        return written(shared_tmp, text, changes, pump="t_s,p_pump_mmHg\n" + rows)

    return write


def test_what_was_chosen_is_in_case_plan_and_summary(write, shared_tmp):
    case = write()
    _, chosen = at_target(case)
    result = run_case(case, out=shared_tmp / "out")
    ran = load_case(shared_tmp / "out" / "case.toml")
    outlet, inlet = ran.circuit
    assert inlet.pump.period == pytest.approx(0.1)
    assert inlet.pump.record_period == pytest.approx(0.2)
    assert inlet.pump.amplitude == chosen.amplitude
    assert outlet.parameters["R_p"] == pytest.approx(
        8 * MMHG / (0.4 * LITRE_PER_MINUTE) - 0.05 * MMHG, rel=1e-12
    )
    assert outlet.start["p_wk"] == chosen.start["outlet"]["p_wk"]
    assert ran.time.t_end == pytest.approx(0.1), "a beat is run"
    assert result["last"]["t_s"] == pytest.approx(0.1)
    if "target" in result:  # on the first rank
        assert result["target"]["amplitude"] == chosen.amplitude
        assert result["target"]["cardiac_output"] == pytest.approx(0.4 * LITRE_PER_MINUTE, rel=1e-3)
    entries = {entry.quantity: entry for entry in plan_case(case)["plan"]}
    assert entries["target: amplitude of the pump"].value == chosen.amplitude
    assert entries["target: cardiac output of the loop"].note.endswith("% from the target, 0.4 l/min")
    assert entries["target: mean aortic pressure of the loop"].value == pytest.approx(8.0, rel=1e-3)


def test_a_run_goes_on_with_its_target_and_another_one_must_be_allowed(write, shared_tmp):
    longer = {"out": shared_tmp / "out", "resume": True}
    run_case(write(), out=shared_tmp / "out")
    assert run_case(write("target.beats=2"), **longer)["last"]["t_s"] == pytest.approx(0.2)
    own = load_case(shared_tmp / "out" / "case.toml", ["time.t_end='0.22 s'"])
    assert run_case(own, **longer)["last"]["t_s"] == pytest.approx(0.22), "from the folder's own case"
    another = ("target.cardiac_output='0.5 l/min'", "time.t_end='0.24 s'")
    with pytest.raises(
        CaseError, match=r"circuit\.outlet\.start\.p_wk: the checkpoint is of a run where this was"
    ):
        run_case(write(*another), **longer)
    run_case(write(*another), allow_change=True, **longer)
    ran = load_case(shared_tmp / "out" / "case.toml")
    assert ran.circuit[0].parameters["R_p"] == pytest.approx(
        8 * MMHG / (0.5 * LITRE_PER_MINUTE) - 0.05 * MMHG
    )


def test_a_case_without_a_valve_says_what_its_orifice_is(write, shared_tmp):
    text = TARGET.replace('orifice_area = "1 cm^2"\n', "")
    with pytest.raises(
        CaseError, match=r"target\.orifice_area: this key is required in a case without a valve"
    ):
        run_case(write(target=text), out=shared_tmp / "out")
