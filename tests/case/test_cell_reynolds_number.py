"""What a plan says of the cell Reynolds number, and of centred advection above 2; the scheme of a case by default."""

from __future__ import annotations

from pathlib import Path

import pytest

from valvefsi.benchmarks.immersed.compression import Compression
from valvefsi.case import load_case, parse_case
from valvefsi.case.cell_reynolds import cell_reynolds_number
from valvefsi.case.sides import largest_given_speed

VALVE = Path(__file__).parents[2] / "valvefsi" / "cli" / "starts" / "valve" / "valve.toml"
RAW = {
    "grid": {"lower": [0, 0], "upper": [2, 1], "cells": [16, 8]},
    "time": {"dt": 0.001, "t_end": 1.0},
}


def case_of(sides, **fluid):
    return parse_case(RAW | {"fluid": {"density": 2.0, "viscosity": 0.5, "sides": sides, **fluid}})


LID = {"y_upper": {"velocity": [3.0, 0.0]}, "y_lower": {"velocity": [-4.0, 0.0]}}
INFLOW = {"x_lower": {"velocity_expression": ["8 * y * (1 - y) * t", "0"]}, "x_upper": {"type": "open"}}


@pytest.mark.parametrize(("sides", "speed", "within"), [(LID, 4.0, 0.0), (INFLOW, 2.0, 0.05), ({}, 0.0, 0.0)])
def test_the_largest_speed_given_at_the_sides(sides, speed, within):
    """The lids', and the parabola's 2 t at t = 1: in the middle of 8 faces it is 1.97, at the last time 0.99 s."""
    assert largest_given_speed(case_of(sides)) == pytest.approx(speed, rel=within)


def test_the_plan_gives_the_cell_reynolds_number():
    """|u| h rho / mu = 4 * 0.125 * 2 / 0.5."""
    (entry,) = cell_reynolds_number(case_of(LID))
    assert (entry.quantity, entry.value) == ("cell Reynolds number", pytest.approx(2.0))
    (entry,) = cell_reynolds_number(case_of({}))
    assert (entry.value, entry.unit) == (pytest.approx(2.0), "cm/s")


def test_the_plan_warns_of_centred_advection_above_two():
    slow, fast = {"viscosity": 0.51}, {"viscosity": 0.49}
    assert len(cell_reynolds_number(case_of(LID, advection="centred", **slow))) == 1
    warning = cell_reynolds_number(case_of(LID, advection="centred", **fast))[-1]
    assert warning.quantity == "warning, fluid"
    assert "xsppm7" in warning.note
    assert len(cell_reynolds_number(case_of(LID, **fast))) == 1


def test_the_plan_warns_of_layers_thinner_than_four_cells():
    """The layer of a plate of 2 cm is 5 sqrt(0.25 mu) cm thick at 4 cm/s: four cells of 0.125 cm at mu = 0.04."""
    assert len(cell_reynolds_number(case_of(LID, viscosity=0.0401))) == 1
    warning = cell_reynolds_number(case_of(LID, viscosity=0.01))[-1]
    assert warning.quantity == "warning, fluid"
    assert "xsppm7 stays stable" in warning.note
    assert "2.5 mm thick, 2 cells; 4 need a spacing of 0.62 mm" in warning.note


def test_a_flow_that_pressures_drive_has_the_speed_of_a_jet_as_an_example():
    """sqrt(2 * 10 mmHg / 2) = 115.5 cm/s."""
    (entry,) = cell_reynolds_number(case_of({"x_lower": {"type": "open"}, "x_upper": {"type": "open"}}))
    assert "10 mmHg make a jet of 115 cm/s, at which it is 57.7" in entry.note


def test_a_target_gives_the_speed_of_its_flow_through_the_orifice():
    """The start's 5 l/min, in a third of the beat through 2.5 cm^2: 250 ml/s, 100 cm/s."""
    case = load_case(VALVE, ["target.cardiac_output='6 l/min'", "target.orifice_area='2.5 cm^2'"])
    (entry, *_) = cell_reynolds_number(case)
    one = case.fluid.viscosity / (case.fluid.density * case.grid.spacing)
    assert entry.value * one == pytest.approx(120.0)


def test_a_case_is_upwind_unless_it_says_otherwise_and_the_compressed_block_is_centred():
    """The published numbers of the block are those of centred advection."""
    assert case_of({}).fluid.advection == "xsppm7"
    assert Compression().case().fluid.advection == "centred"
