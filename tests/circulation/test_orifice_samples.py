"""Many loops at once: each as the loop by itself; the periodic state is that of many beats."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.circulation.test_orifice import OUTLET, P_VIA, P_WK, PERIOD, UPSTREAM, VALVE, pump
from valvefsi.circulation.loop import Connection
from valvefsi.circulation.orifice import OrificeLoop
from valvefsi.circulation.orifice_samples import OrificeLoops, Orifices, Side
from valvefsi.circulation.windkessel import FourElement

STEPS = 80
RESISTANCES, AREAS = (1300.0, 1500.0, 1800.0), (1.6, 2.0, 2.4)


def outlets(kind):
    made = [replace(OUTLET, R_p=R_p) for R_p in RESISTANCES]
    return made if kind == "three" else [FourElement(R_c=c.R_c, R_p=c.R_p, C=c.C, L=8.0) for c in made]


def loops(kind="three", p_wk=P_WK):
    valves = [replace(VALVE, area=area) for area in AREAS]
    drive = np.array([[pump(PERIOD * k / STEPS)["p_pump"], 0.0] for k in range(STEPS + 1)])
    systems = [outlet.system() for outlet in outlets(kind)]
    start = np.zeros(len(systems[0].states))
    start[0] = p_wk
    return OrificeLoops(
        Orifices(loss=np.array([v.loss for v in valves]), inertance=np.full(3, VALVE.inertance)),
        Side(systems=[UPSTREAM.system()] * 3, start=np.array([P_VIA]), drive=drive),
        Side(systems=systems, start=start, drive=np.zeros((STEPS + 1, 1))),
        PERIOD,
    )


def alone(k, kind="three"):
    """The loop of sample k by itself."""
    inlet = Connection(side="z_lower", system=UPSTREAM.system(), start={"p_via": P_VIA}, drive=pump)
    outlet = Connection(side="z_upper", system=outlets(kind)[k].system(), start={"p_wk": P_WK})
    return OrificeLoop(replace(VALVE, area=AREAS[k]), inlet, outlet)


@pytest.mark.parametrize("kind", ["three", "four"])
def test_each_sample_goes_as_its_loop_does_by_itself(kind):
    together = loops(kind)
    first, second = together.beat(), together.beat()
    for k in range(3):
        loop = alone(k, kind)
        waves, state = loop.run(loop.begin(), STEPS, PERIOD / STEPS)
        for name in ("p_lv", "p_ao", "q_ao"):
            assert first[name][:, k] == pytest.approx(waves[name], rel=1e-9, abs=1e-6)
        waves, _ = loop.run(replace(state), STEPS, PERIOD / STEPS)
        assert second["q_ao"][:, k] == pytest.approx(waves["q_ao"], rel=1e-7, abs=1e-5)
    assert first["q_ao"].max() > 100.0


def test_the_periodic_state_is_that_of_many_beats_in_fewer():
    far = loops(p_wk=0.5 * P_WK)
    waves, apart = far.periodic(60, 1e-7)
    assert (apart <= 1e-7).all()
    slow = loops()
    for _ in range(60):
        many = slow.beat()
    for name, wave in waves.items():
        assert wave == pytest.approx(many[name], rel=1e-5, abs=1e-5 * np.ptp(many[name]))


def test_what_is_not_periodic_yet_says_by_how_much():
    _, apart = loops(p_wk=0.2 * P_WK).periodic(2, 1e-7)
    assert (apart > 1e-3).all()
