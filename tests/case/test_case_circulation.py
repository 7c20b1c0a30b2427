"""A case file with circuits at its sides, run and resumed."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from tests.case_text import stream, written
from valvefsi.case.build import build, run_case
from valvefsi.case.circulation import build_circulation
from valvefsi.errors import CaseError
from valvefsi.io.history import read_history

CASE = f"""title = "tube between two circuits"
{stream(4, (16, 4))}"""
CASE += """x_lower = {type = "open", circuit = "chamber", backflow = 0}
x_upper = {type = "open", circuit = "outlet", backflow = 0}
[time]
dt = "2 ms"
t_end = "0.4 s"
[output]
history_every = 10
frames = 0
[[circuit]]
name = "outlet"
model = "downstream"
R_c = "0.05 mmHg*s/ml"
R_p = "1 mmHg*s/ml"
C = "1 ml/mmHg"
start = {p_wk = "3 mmHg"}
[[circuit]]
name = "chamber"
model = "upstream-porcine"
R_1 = "0.05 mmHg*s/ml"
R_2 = "0.02 mmHg*s/ml"
C_VIA = "0.1 ml/mmHg"
pump = {file = "pump.csv", period = "0.2 s"}
"""


@pytest.fixture
def write(shared_tmp):
    """Return a function that writes the case, with changes, and reads it back."""

    def write(*changes):
        text = CASE
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        t = np.linspace(0.0, 0.2, 21)
        rows = "".join(f"{a:g},{10 * np.sin(5 * np.pi * a) ** 2:g}\n" for a in t)
        return written(shared_tmp, text, pump="t_s,p_pump_mmHg\n" + rows)

    return write


def test_circuits_drive_a_run_and_a_restart_goes_on_with_them(write, shared_tmp):
    case = write()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run_case(case, out=shared_tmp / "whole")
    rows = read_history(shared_tmp / "whole" / "history.csv")
    q_in, q_out = np.array(rows["q_x_lower_ml_s"]), np.array(rows["q_x_upper_ml_s"])
    np.testing.assert_allclose(q_in, -q_out, atol=1e-9)
    assert np.ptp(q_out) > 1.0
    assert rows["p_x_upper_mmHg"][0] == pytest.approx(3.0)

    def stop(step, *_):
        if step == 120:
            raise StopIteration

    folder = shared_tmp / "halves"
    halves = write(("frames = 0", "frames = 0\ncheckpoint_every = 100"))
    with pytest.raises(StopIteration):
        build(halves, folder).run(progress=stop)
    build(halves, folder).run(resume=True)
    again = read_history(folder / "history.csv")
    for column in ("t_s", "q_x_upper_ml_s", "p_x_upper_mmHg", "p_x_lower_mmHg"):
        np.testing.assert_allclose(again[column], rows[column], rtol=1e-11, atol=1e-11)


def test_a_run_may_start_at_any_phase_of_the_pump(write):
    drives = [
        {c.side: c.drive for c in build_circulation(write(change)).connections}["x_lower"]
        for change in (('"0.2 s"}', '"0.2 s", phase = "70 ms"}'), ('"0.2 s"}', '"0.2 s"}'))
    ]
    for t in (0.0, 0.05, 0.13, 0.1999, 0.4):
        assert drives[0](t)["p_pump"] == pytest.approx(drives[1](t + 0.07)["p_pump"], rel=1e-12)
    once = build_circulation(write(('period = "0.2 s"', 'phase = "70 ms"'))).connections
    drive = {c.side: c.drive for c in once}["x_lower"]
    assert drive(0.03)["p_pump"] == pytest.approx(drives[1](0.1)["p_pump"])
    assert drive(0.3)["p_pump"] == pytest.approx(drives[1](0.2)["p_pump"], abs=1e-9), "held at its end"


WRONG = [
    (('"0.2 s"}', '"0.2 s", phase = "0.2 s"}'), r"pump\.phase = 0\.2: expected less than the period"),
    (('"0.2 s"}', '"0.2 s", phase = "-1 ms"}'), r"pump\.phase"),
    (('"pump.csv", period = "0.2 s"', '"pump.csv", phase = "0.3 s"'), r"pump\.phase = 0\.3: .*shorter"),
    (('file = "pump.csv", period = "0.2 s"', 'phase = "0.1 s"'), r"pump\.phase = 0\.1: there is no record"),
    (('circuit = "outlet"', 'circuit = "outlt"'), r"x_upper\.circuit = 'outlt': .*did you mean 'outlet'"),
    (('circuit = "outlet"', 'circuit = "chamber"'), "another side has this circuit"),
    (('circuit = "outlet"', 'circuit = "outlet", pressure = 3'), "not both"),
    (('"pump.csv", period = "0.2 s"', '"pump.csv", period = "0.3 s"'), r"pump\.period = 0\.3: .*shorter"),
    (('pump = {file = "pump.csv", period = "0.2 s"}', ""), "nothing drives the input p_pump"),
    (('y_lower = {type = "free_slip"}', 'y_lower = {type = "free_slip", circuit = "outlet"}'), "no such key"),
]


@pytest.mark.parametrize(("change", "message"), WRONG, ids=[m for _, m in WRONG])
def test_a_connection_that_cannot_be_is_told(change, message, write, shared_tmp):
    with pytest.raises(CaseError, match=message):
        build(write(change), shared_tmp / "out")
