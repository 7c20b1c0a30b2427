"""The measured limit of the step: against closed forms and against what blows up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.coupled_case import block_model, heavy, slipping
from tests.run.test_planning import largest_speed_after
from valvefsi.bodies.elastic import Elastic
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import StabilityError
from valvefsi.run.planning import step_limits
from valvefsi.run.stable_step import _largest_mode, measured_limit


def products_of(a, others):
    return np.array([np.vdot(a, b) for b in others])


def test_lanczos_finds_the_largest_eigenvalue_of_a_product():
    rng = np.random.default_rng(2)
    A, B = rng.standard_normal((2, 40, 40))
    K, M = A @ A.T + np.eye(40), B @ B.T
    x = rng.standard_normal(40)
    found = _largest_mode(lambda x: K @ x, lambda x: M @ x, products_of, (x, K @ x))
    assert found.value == pytest.approx(np.linalg.eigvals(M @ K).real.max(), rel=1e-3)
    rest = M @ K @ found.vector - found.value * found.vector
    assert np.sqrt(rest @ K @ rest) < 0.1 * found.value


def stays_calm(model, dt):
    try:
        return largest_speed_after(model, dt, steps=400) < 0.1
    except StabilityError:
        return False


@pytest.mark.parametrize(
    ("kernel", "density"), [("piecewise_linear", 1.0), ("bspline3", 1.0), ("ib6", 1.0), ("bspline3", 7.0)]
)
def test_it_parts_what_is_stable_from_what_is_not(kernel, density):
    """The penalty of the excess mass of a heavy block take a part of its limit."""
    model = block_model(load=2.0, tether=50.0)
    body = Elastic(model.bodies[0].solid, Coupling(model.grid, kernel))
    model = replace(model, bodies=(body,))
    if density > 1.0:
        model = heavy(model, density)
    limit = step_limits(model)["elastic, block"]
    assert measured_limit(model, limit, 0) > limit
    for _ in range(6):  # the step at which the dampers are taken
        limit = measured_limit(model, limit, 0)
    assert stays_calm(model, 0.95 * limit)
    assert not stays_calm(model, 1.12 * limit)


def test_the_viscosity_of_a_solid_is_in_it():
    model = block_model(load=2.0, tether=50.0, viscosity=400.0)
    limits = step_limits(model)
    assert limits["viscosity, block"] < 0.3 * limits["elastic, block"]
    limit = limits["viscosity, block"]
    assert measured_limit(model, limit, 0) > limit
    for _ in range(12):
        limit = measured_limit(model, limit, 0)
    assert stays_calm(model, 0.95 * limit)
    assert not stays_calm(model, 1.12 * limit)


def test_what_slips_through_the_fluid_is_in_it():
    model = slipping(block_model(load=2.0, tether=50.0, damping=0.0), 2.0)
    limits = step_limits(model)
    assert limits["Darcy slip, block"] < 0.5 * limits["elastic, block"]
    limit = limits["Darcy slip, block"]
    assert measured_limit(model, limit, 0) > limit
    for _ in range(12):
        limit = measured_limit(model, limit, 0)
    assert limit < 0.7 * measured_limit(slipping(model, None), limit, 0)
    assert stays_calm(model, 0.95 * limit)
    assert not stays_calm(model, 1.12 * limit)


def test_stiff_tethers_are_in_it():
    model = block_model(load=2.0)
    limit = step_limits(model)["tether, block"]
    assert measured_limit(model, limit, 0) == pytest.approx(limit, rel=0.3)
