"""Plates thinner than the kernel: the closed forms among themselves, and coupled runs beside them."""

from __future__ import annotations

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.benchmarks.immersed.plate import Plate, decay
from valvefsi.benchmarks.immersed.plate_model import incompressible_deflection
from valvefsi.benchmarks.immersed.plate_theory import (
    ImmersedPlate,
    immersed_wave,
    kernel_wave,
    slowing,
)
from valvefsi.errors import CaseError

THIN = ImmersedPlate(thickness=0.2, length=100.0, height=400.0, modulus=1.0)


def with_layer(plate, layer):
    """The plate in a fluid with a Stokes layer of its wave."""
    return replace(plate, mu=0.5 * plate.rho * plate.potential_frequency() * layer**2)


def test_long_waves_with_a_thin_stokes_layer_are_those_of_potential_theory():
    plate = with_layer(THIN, 0.02)
    s = immersed_wave(plate)
    assert s.imag == pytest.approx(plate.potential_frequency(), rel=1e-3)
    assert 0.0 < -s.real < 1e-3 * s.imag


def test_waves_of_a_thin_plate_drag_the_stokes_layer_of_an_inextensible_sheet():
    plate = with_layer(THIN, 6.0)
    s, k = immersed_wave(plate), plate.wave_number
    layer = cmath.sqrt(k**2 + plate.rho * s / plate.mu)
    mass = plate.rho * (plate.thickness + 2.0 / (k * (1.0 - k / layer)))
    assert s**2 * mass == pytest.approx(-plate.stiffness * k**4, rel=0.02)
    assert -s.real / s.imag > 0.05  # what the sheet's condition has to know


def test_short_waves_yield_to_shear_as_timoshenko_says():
    plate = with_layer(replace(THIN, thickness=8.0), 0.02)
    k = plate.wave_number
    shear = 1.0 + plate.stiffness * k**2 / (5.0 / 6.0 * plate.modulus * plate.thickness)
    expected = plate.potential_frequency() / math.sqrt(shear)
    assert immersed_wave(plate).imag == pytest.approx(expected, rel=0.03)
    assert expected < 0.97 * plate.potential_frequency()


def test_a_slender_span_of_incompressible_elements_yields_as_the_closed_form_says():
    plate = replace(THIN, thickness=2.0)
    assert incompressible_deflection(plate, 1e-9, MPI.COMM_WORLD) == pytest.approx(
        1e-9 * plate.yielding(), rel=0.01
    )
    assert plate.yielding() == pytest.approx(plate.length**4 / (384.0 * plate.stiffness), rel=0.01)


def test_what_the_kernel_adds_falls_with_the_spacing():
    errors = []
    for length in (32.0, 64.0, 128.0):
        plate = with_layer(replace(THIN, thickness=0.5, length=length, height=length), 0.25)
        s = kernel_wave(plate, kernel="bspline3", h=1.0, edge=0.5)
        errors.append(1.0 - s.imag / immersed_wave(plate).imag)
    ratios = np.array(errors[:-1]) / errors[1:]
    assert errors[-1] < 0.02
    assert ratios == pytest.approx(2.0, abs=0.35)  # first order


@pytest.mark.parametrize(("kernel", "boxes"), [("bspline3", 6), ("bspline4", 8), ("composite_bspline43", 8)])
def test_a_kernel_adds_twice_the_mean_distance_of_two_points_drawn_from_it(kernel, boxes):
    """The mass of a long wave, against the sum of uniform deviates: each of both points is one of half of them."""
    plate = replace(THIN, thickness=1e-3, length=2000.0, height=4000.0)
    cells = 200
    density = np.ones(cells) / cells
    for _ in range(boxes - 1):
        density = np.convolve(density, np.ones(cells) / cells)
    z = (np.arange(len(density)) - 0.5 * (len(density) - 1)) / cells
    mass = 2.0 / plate.wave_number
    added = mass * (slowing(plate, kernel=kernel, h=1.0).across ** -2 - 1.0)
    assert added == pytest.approx(2.0 * density @ np.abs(z), rel=0.01)


def test_what_a_thick_plate_adds_is_its_own_mass_and_half_of_that():
    """Half of the pairs of points lie in one row, half in both, farther apart than the kernel is wide."""
    thin, thick = (replace(THIN, thickness=t, length=2000.0, height=4000.0) for t in (1e-3, 8.0))
    added = [
        (plate.thickness + 2.0 / plate.wave_number)
        * (slowing(plate, kernel="bspline3", h=1.0).across ** -2 - 1.0)
        for plate in (thin, thick)
    ]
    assert added[1] == pytest.approx(0.5 * added[0], rel=0.03)


@pytest.mark.parametrize("length", [16.0, 64.0])
@pytest.mark.parametrize("kernel", ["bspline3", "composite_bspline43"])
def test_the_parts_of_the_slowing_are_all_of_it(kernel, length):
    """The theory of the kernel without viscosity, of a plate that does not yield to shear, over potential theory."""
    plate = with_layer(replace(THIN, thickness=0.25, length=length, height=length), 2e-3)
    s = kernel_wave(plate, kernel=kernel, h=1.0, edge=0.5)
    parts = slowing(plate, kernel=kernel, h=1.0)
    product = parts.across * parts.along * parts.turning
    assert product == pytest.approx(s.imag / plate.potential_frequency(), rel=0.005)
    assert parts.turning < 1.0 - 0.3 / length
    assert parts.along < 1.0 - 2.0 / length**2


def test_a_kernel_without_a_transform_is_refused():
    with pytest.raises(ValueError, match="ib4 is none"):
        kernel_wave(THIN, kernel="ib4", h=1.0, edge=0.5)
    with pytest.raises(ValueError, match="ib4 is none"):
        slowing(THIN, kernel="ib4", h=1.0)


@pytest.mark.parametrize("rest", [0.0, 0.4])
def test_a_decaying_oscillation_is_found_with_what_it_swings_about(rest):
    t, s = np.linspace(0.0, 0.3, 200), -0.9 + 47.0j
    history = {"t_s": t, "amplitude_cm": 0.002 * (rest + (1.0 - rest) * np.exp(s * t).real)}
    found = decay(history, -2.0 + 40.0j)
    assert found.s == pytest.approx(s, rel=1e-6)
    assert found.rest == pytest.approx(rest, abs=1e-6)


def run(folder, **options):
    """The quantities of one plate."""
    (found,) = Plate(**options).run(out=folder)["quantities"].values()
    return found


def test_waves_on_the_grid_are_those_of_the_theory_of_the_kernel(shared_tmp):
    found = run(shared_tmp, thickness=(1.0,), length=12, kinds=("wave",))
    assert found["frequency_ratio"] == pytest.approx(found["kernel_ratio"], rel=0.01)
    assert found["kernel_ratio"] < 0.93  # not those of a sharp plate
    assert found["damping"] == pytest.approx(found["kernel_damping"], rel=0.1)
    assert abs(found["rest"]) < 0.01


@pytest.mark.parametrize(
    ("kernel", "low", "high"), [("bspline3", 0.96, 1.02), ("composite_bspline32", 0.5, 0.92)]
)
def test_a_plate_at_rest_yields_as_it_should_and_less_with_a_kernel_linear_across(
    shared_tmp, kernel, low, high
):
    found = run(shared_tmp, thickness=(1.0,), length=8, kinds=("static",), kernel=kernel)
    assert low < found["over_own"] < high
    assert abs(found["settling"]) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("angle", [0, 45])
def test_a_plate_of_a_quarter_of_the_spacing_keeps_its_bending(shared_tmp, angle):
    """Minutes."""
    found = run(shared_tmp, thickness=(0.25,), kinds=("static",), angle=angle)
    assert found["over_incompressible"] == pytest.approx(1.0, abs=0.05)
    assert found["closed_form"] == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(
    ("options", "message"),
    [({"thickness": (0.01,)}, "--thickness = 0.01"), ({"kinds": ("dance",)}, "expected one of static, wave")],
)
def test_what_is_no_plate_is_refused(options, message):
    with pytest.raises(CaseError, match=message):
        Plate(**options)
