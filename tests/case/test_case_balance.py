"""Walls that let fluid into a box that nothing leaves are refused; the flow named is that of the expression."""

from __future__ import annotations

import numpy as np
import pytest

from valvefsi.case.build import build_fluid, build_grid
from valvefsi.case.reading import parse_case
from valvefsi.errors import CaseError

PARABOLA = "6 * y * (1 - y)"


def case_of(dim=2, **sides):
    size = {"lower": [0] * dim, "upper": [3, 1, 2][:dim], "cells": [60, 20, 40][:dim]}
    return parse_case({"grid": size, "time": {"dt": "1 ms", "t_end": "1 s"}, "fluid": {"sides": sides}})


def expression(*parts):
    return {"velocity_expression": [*parts, *["0"] * (2 - len(parts))]}


def build(case, comm):
    return build_fluid(case, build_grid(case, comm))


def test_a_parabola_into_a_closed_box_is_refused_with_its_flow(comm):
    with pytest.raises(
        CaseError, match="fluid.sides: the walls let ([0-9.]+) cm\\^2/s into the box at t = 0 s"
    ) as caught:
        build(case_of(x_lower=expression(PARABOLA)), comm)
    flow = float(str(caught.value).split("let ")[1].split(" ")[0])
    assert flow == pytest.approx(1.0, rel=2e-3)  # int 6 y (1 - y) dy, by midpoints of 20 cells


def test_a_flow_that_begins_later_is_seen_too(comm):
    with pytest.raises(CaseError, match="into the box"):
        build(case_of(x_lower=expression("max(0, sin(2 * pi * t - pi)) * y")), comm)


def test_in_three_dimensions_the_area_of_the_side_counts(comm):
    with pytest.raises(CaseError, match=r"the walls let -?4 cm\^3/s into the box"):
        build(case_of(3, x_upper={"velocity_expression": ["-2", "0", "0"]}), comm)


@pytest.mark.parametrize(
    "sides",
    [
        {"x_lower": expression(PARABOLA), "x_upper": expression(PARABOLA)},
        {"x_lower": expression(PARABOLA), "x_upper": {"velocity": [1, 0]}},
        {
            "x_lower": expression("sin(40 * t) * " + PARABOLA),
            "y_upper": {"velocity_expression": ["0", "sin(40 * t) / 3"]},
        },
        {"x_lower": expression("0", "sin(t)")},
        {"x_lower": expression(PARABOLA), "x_upper": {"type": "open"}},
    ],
)
def test_walls_in_balance_and_open_boxes_are_taken(comm, sides):
    assert np.isfinite(build(case_of(**sides), comm).grid.spacing).all()
