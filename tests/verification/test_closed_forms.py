"""Closed forms: their differential equations, and what they tend to where the theory is linear."""

from __future__ import annotations

import math

import numpy as np
import pytest

from valvefsi.verification.closed_forms import (
    FINAL,
    cylinder_pressure,
    elastica,
    poiseuille,
    sphere_pressure,
    start_up,
    womersley,
)

Y = np.linspace(0.0, 1.0, 2001)


def test_the_oscillating_flow_obeys_its_equation_and_sticks_to_the_walls():
    number, mu, t, dt = 3.0, 0.1, 0.4, 1e-5
    w = mu * (2.0 * number) ** 2
    u = womersley(Y, t, number, mu)
    rate = (womersley(Y, t + dt, number, mu) - womersley(Y, t - dt, number, mu)) / (2.0 * dt)
    curvature = np.diff(u, 2) / (Y[1] - Y[0]) ** 2
    np.testing.assert_allclose(rate[1:-1], math.cos(w * t) + mu * curvature, atol=1e-5)
    np.testing.assert_allclose(u[[0, -1]], 0.0, atol=1e-14)


def test_a_slow_oscillation_is_the_steady_flow():
    np.testing.assert_allclose(womersley(Y, 0.0, 0.01, 0.1), poiseuille(Y, 0.1), atol=1e-6)
    np.testing.assert_allclose(0.1 * np.diff(poiseuille(Y, 0.1), 2) / (Y[1] - Y[0]) ** 2, -1.0, rtol=1e-6)


def test_the_flow_in_a_tube_starts_as_the_force_and_layers_at_its_wall_let_it():
    """Q / Q_final = 8 s (1 - 8/3 (s / pi)^0.5), s = nu t / R^2: the layer at the wall is that of a plane one."""
    part = 1e-4  # nu t / R^2
    late = start_up(np.array([part * FINAL, 0.0, 50.0]), 1.0)
    assert late[0] == pytest.approx(8.0 * part * (1.0 - 8.0 / 3.0 * math.sqrt(part / math.pi)), rel=2e-3)
    assert late[1:] == pytest.approx([0.0, 1.0], abs=1e-5)


def test_thick_shells_yield_at_first_as_linear_elasticity_says():
    """p = 2 mu u A (1/A^2 - 1/B^2) of a cylinder, 4 mu u A^2 (1/A^3 - 1/B^3) of a sphere, mu = c1."""
    A, B, u = 1.0, 1.5, 1e-6
    assert cylinder_pressure(u, A, B) == pytest.approx(2.0 * u * A * (1 / A**2 - 1 / B**2), rel=1e-5)
    assert sphere_pressure(u, A, B) == pytest.approx(4.0 * u * A**2 * (1 / A**3 - 1 / B**3), rel=1e-5)


def test_a_small_force_bends_a_beam_as_linear_theory_says():
    """P L^3 / 3 B down, and back by half of the mean square of the slope: P^2 L^5 / 15 B^2."""
    force, length, stiffness = 1e-3, 2.0, 5.0
    back, down = elastica(force, length, stiffness)
    assert down == pytest.approx(force * length**3 / (3.0 * stiffness), rel=1e-6)
    assert back == pytest.approx(force**2 * length**5 / (15.0 * stiffness**2), rel=1e-3)
