"""Sections and dissipation of a case file, as columns of the history."""

from __future__ import annotations

import pytest

from valvefsi.case import parse_case
from valvefsi.case.build import build, run_case
from valvefsi.case.writing import to_toml
from valvefsi.errors import CaseError
from valvefsi.io.history import read_history

RAW = {
    "grid": {"lower": [0.0, 0.0], "upper": [1.0, 1.0], "cells": [16, 16]},
    "fluid": {
        "viscosity": 0.5,
        "sides": {"x_lower": {"type": "open", "pressure": 4.0, "backflow": 0.0}, "x_upper": {"type": "open"}},
    },
    "time": {"dt": 0.01, "t_end": 2.0},
    "output": {
        "frames": 0,
        "history_every": 50,
        "dissipation": True,
        "section": [
            {"name": "middle", "axis": "x", "position": 0.5},
            {"name": "core", "axis": "x", "position": 0.53, "centre": [0.0, 0.5], "radius": 0.25},
        ],
    },
}


def test_history_of_a_channel_holds_flow_pressure_and_dissipation(shared_tmp):
    """Poiseuille: Q = G/(12 mu) but for the n^-2 of the grid, the core carries 11/16 of it, dissipation is G Q."""
    run_case(parse_case(RAW, []), out=shared_tmp)
    last = {name: values[-1] for name, values in read_history(shared_tmp / "history.csv").items()}
    Q = 4.0 / (12.0 * 0.5)
    assert last["flow_middle_cm3_per_s"] == pytest.approx(Q, rel=0.01)
    assert last["flow_core_cm3_per_s"] == pytest.approx(Q * 11 / 16, rel=0.01)
    assert last["dissipation_erg_per_s"] == pytest.approx(4.0 * last["flow_middle_cm3_per_s"], rel=0.01)
    drop = last["pressure_middle_dyn_per_cm2"] - last["pressure_core_dyn_per_cm2"]
    assert drop == pytest.approx(0.03 * 4.0, rel=0.02)


def test_a_case_with_sections_reads_back_as_the_same(shared_tmp):
    import tomllib

    case = parse_case(RAW, [])
    again = parse_case(tomllib.loads(to_toml(case)), [])
    assert again.output == case.output


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"position": 1.5}, "output.section.middle"),
        ({"axis": "z"}, "output.section.middle"),
        ({"centre": [0.0, 0.5]}, "radius"),
        ({"centre": [0.0], "radius": 0.1}, "output.section.middle.centre"),
        ({"centre": [0.0, 0.9], "radius": 0.2}, "output.section.middle"),
        ({"name": "core"}, "output.section.1.name"),
    ],
)
def test_a_section_that_cannot_be_is_refused_with_its_key(change, key, shared_tmp):
    first, second = RAW["output"]["section"]
    raw = RAW | {"output": RAW["output"] | {"section": [first | change, second]}}
    with pytest.raises(CaseError) as caught:
        build(parse_case(raw, []), shared_tmp)
    assert key in str(caught.value)
