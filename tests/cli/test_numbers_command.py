"""``valvefsi numbers``: words and units on the screen, names with units in the file."""

from __future__ import annotations

import pytest

from valvefsi.cli.numbers import groups
from valvefsi.post.columns import Units
from valvefsi.post.valve_numbers import CycleNumbers

pytestmark = pytest.mark.serial
VALVE = {
    "cycles": [
        {"cycle": 0, "start_s": 9.0},
        {"cycle": 1, "start_s": 1.714, "rms_forward_flow_ml_per_s": 274.13808},
    ],
    "flutter": {"leaflet_1": {"frequency_Hz": 21.65, "amplitude_mm": None}},
    "coaptation": {},
    "places": {"shut": {"free_edge": {"green_strain_p99": {"value": 0.32073, "t_s": 2.2}}}},
    "shear": {"p50_Pa": {"value": 0.56887, "t_s": 1.9}, "max_Pa": {"value": 4.5605, "t_s": 2.0}},
    "exposure": {"p50_Pa_s": 0.05239, "mean_time_ms": 266.28},
}


def test_numbers_are_printed_in_groups_with_words_and_units():
    found = dict(groups(VALVE, Units()))
    assert found == {
        "last cycle": [("cycle", "1", ""), ("start", "1.714", "s"), ("rms forward flow", "274.14", "ml/s")],
        "flutter": [("leaflet 1, frequency", "21.65", "Hz"), ("leaflet 1, amplitude", "-", "")],
        "strain and stress by place": [("shut, free edge, Green strain, 99th percentile", "0.32073", "")],
        "shear stress in the fluid": [("50th percentile", "0.56887", "Pa"), ("max", "4.5605", "Pa")],
        "exposure to shear stress": [("50th percentile", "0.05239", "Pa*s"), ("mean time", "266.28", "ms")],
    }


def test_every_number_of_a_cycle_is_shown_without_its_unit_in_the_name():
    names = CycleNumbers(cycle=0, start=0.0).in_lab_units()
    ((_, rows),) = groups({"cycles": [dict.fromkeys(names, 1.0)]}, Units())
    assert len(rows) == len(names)
    assert not [
        words
        for words, *_ in rows
        if "_" in words or words.endswith((" s", " ms", " ml", " mmHg", " percent"))
    ]
    assert sum(unit == "" for *_, unit in rows) <= 4, (
        "number of the cycle, repeated, times from, Reynolds number"
    )
