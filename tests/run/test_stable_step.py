"""The measured limit of the step: against closed forms and against what blows up."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from tests.coupled_case import block_model, heavy, slipping
from tests.run.test_planning import largest_speed_after
from valvefsi import fsi
from valvefsi.bodies.elastic import Elastic
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import StabilityError
from valvefsi.run.planning import step_limits
from valvefsi.run.stable_step import (
    RESIDUAL,
    TRACKED_PRODUCTS,
    _largest_mode,
    _unit,
    _with_others,
    has_changed,
    measured_limit,
    stable_step,
    stored_energies,
)


def products_of(a, others):
    return np.array([np.vdot(a, b) for b in others])


def test_lanczos_finds_the_largest_eigenvalue_of_a_product():
    rng = np.random.default_rng(2)
    A, B = rng.standard_normal((2, 40, 40))
    K, M = A @ A.T + np.eye(40), B @ B.T
    x = rng.standard_normal(40)
    found = _largest_mode(
        lambda x: K @ x, lambda x: M @ x, products_of, _unit(x, lambda x: K @ x, products_of)
    )
    assert found.value == pytest.approx(np.linalg.eigvals(M @ K).real.max(), rel=1e-3)
    rest = M @ K @ found.vector - found.value * found.vector
    assert np.sqrt(rest @ K @ rest) < 0.1 * found.value


def test_a_mode_that_has_outgrown_the_known_one_is_found():
    """A start from an eigenvector alone would never leave it."""
    values = np.concatenate([[2.0, 1.0], np.linspace(0.02, 0.9, 38)])
    K, known = np.diag(values), np.eye(40)[1]
    others = np.random.default_rng(5).standard_normal(40)
    unit = _unit(known, lambda x: K @ x, products_of)
    start = _with_others(unit, _unit(others, lambda x: K @ x, products_of), products_of)
    options = (TRACKED_PRODUCTS, RESIDUAL)
    assert _largest_mode(lambda x: K @ x, lambda x: x, products_of, unit, *options).value < 1.0 + 1e-9
    found = _largest_mode(lambda x: K @ x, lambda x: x, products_of, start, *options)
    assert found.value == pytest.approx(2.0, rel=RESIDUAL)


def test_where_a_compressed_solid_gives_way_a_known_mode_cannot_spoil_the_start():
    """Two displacements with stiffness, the sum of which has none: K is not positive there."""
    K = np.diag([1.0, -0.98])
    known, others = (_unit(np.array([x, 10.0]), lambda x: K @ x, products_of) for x in (10.0, -10.0))
    v, Kv = (a + 0.3 * b for a, b in zip(known, others, strict=True))
    assert v @ Kv < 0.0
    start = _with_others(known, others, products_of)
    np.testing.assert_array_equal(start[0], others[0])
    options = (TRACKED_PRODUCTS, RESIDUAL)
    found = _largest_mode(lambda x: K @ x, lambda x: x, products_of, start, *options)
    assert np.isfinite(found.value)


def test_a_measurement_from_the_last_mode_is_as_good_as_one_from_nothing():
    model = block_model(load=2.0, tether=50.0)
    dt = step_limits(model)["elastic, block"]
    state = fsi.initial_state(model, dt)
    for _ in range(3):
        now = stable_step(model, state, dt)
        state = replace(state, modes=now.modes, energies=now.energies)
        for _ in range(10):
            state = fsi.step(model, state, dt)
        fluid, solves = count_solves(model)
        tracked = stable_step(replace(model, fluid=fluid), state, dt).limit
        assert len(solves) <= 4
        assert tracked == pytest.approx(measured_limit(model, dt, 0, at=state), rel=0.02)


def count_solves(model):
    """The fluid of a model and a list that grows with its steps."""
    fluid, solves = copy(model.fluid), []

    def step(*args):
        solves.append(None)
        return model.fluid.step(*args)

    fluid.step = step
    return fluid, solves


def test_a_load_that_changes_the_energy_by_a_fifth_calls_for_a_measurement():
    model = block_model(load=2.0, tether=50.0)
    state = fsi.initial_state(model, 0.01)
    X = state.bodies[0]["chi"]

    def stretched(factor):
        moved = X.copy()
        moved[:, 1] *= factor
        return replace(state, bodies=({"chi": moved},))

    then = replace(state, energies=stored_energies(model, stretched(1.1)))
    assert not has_changed(model, replace(stretched(1.1), energies=then.energies))
    assert not has_changed(model, replace(stretched(1.105), energies=then.energies))
    assert has_changed(model, replace(stretched(1.112), energies=then.energies))
    assert has_changed(model, replace(stretched(1.088), energies=then.energies))
    assert not has_changed(model, replace(stretched(1.0 + 1e-4), energies=(0.0,)))
    # Where the longest step is half of what the limit allows, a load may take four times as much and give off all.
    assert not has_changed(model, replace(stretched(1.125), energies=then.energies), 2.0)
    assert has_changed(model, replace(stretched(1.145), energies=then.energies), 2.0)
    assert not has_changed(model, replace(stretched(1.0), energies=then.energies), 2.0)


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
