"""The stress of dispersed fibres jumps where they begin to bear: who says so, and what is written without the jump."""

from __future__ import annotations

import pytest

from valvefsi.case import parse_case
from valvefsi.case.plan_warnings import jumping_stress
from valvefsi.fitting import planar_hgo
from valvefsi.solid.materials import presets

RAW = {
    "grid": {"lower": [0, 0, 0], "upper": [1, 1, 1], "cells": [8, 8, 8]},
    "fluid": {"density": 1.0, "viscosity": 0.1},
    "time": {"dt": 0.001, "t_end": 1.0},
}


def warned(**material):
    box = {"shape": "box", "lower": [0, 0, 0], "size": [0.2, 0.2, 0.2], "elements": [1, 1, 1]}
    solid = {"name": "leaf", "mesh": box, "material": material}
    return [entry.quantity for entry in jumping_stress(parse_case(RAW | {"solid": [solid]}))]


def hgo(kappa, **more):
    family = {"k1": 1e5, "k2": 2.0, "kappa": kappa, "fibre": 0.0}
    return {"model": "hgo", "c10": 1e3, "c01": 1.0, "families": [family], **more}


@pytest.mark.parametrize(
    ("material", "expected"),
    [
        (hgo(0.2), ["warning, leaf"]),
        (hgo(0.2, width=0.01), []),
        (hgo(0.0), []),
        ({"model": "neo_hookean", "c1": 1e4}, []),
        ({"preset": "bovine_pericardium_hgo"}, []),
        ({"preset": "bovine_pericardium_hgo", "width": 0.0}, ["warning, leaf"]),
    ],
)
def test_the_plan_warns_of_dispersed_fibres_that_begin_to_bear_with_a_jump(material, expected):
    assert warned(**material) == expected


@pytest.mark.parametrize(("kappa", "rounded"), [(0.1, True), (0.0, False)])
def test_a_fit_writes_dispersed_fibres_without_the_jump(kappa, rounded):
    material = planar_hgo.HGO()
    names = ("c10", "c01", "kappa", "angle", "k1", "k2")
    written = material.entries(dict(zip(names, (1.5, 5.0, kappa, 0.0, 20.0, 8.0), strict=True)))
    assert ("width" in written) is rounded
    assert written.get("width", presets.ROUNDING) == presets.ROUNDING
