"""Flexible posts as oscillators: closed forms, balance of energy and momentum, stability beside a mass of fluid."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mpi4py import MPI

from tests.ordering import assert_order
from valvefsi.bodies.posts import Attachment, Oscillator

NOTHING = np.zeros((1, 2))


def swing(bar, motion, load, dt, steps, attachment=NOTHING):
    """Steps of one post under a constant load: q and q' after each, ``(steps + 1, 2)``."""
    states = [np.array([motion])]
    for _ in range(steps):
        middle = bar.midpoint(states[-1], np.array([load]), attachment, dt)
        states.append(2.0 * middle - states[-1])
    return np.array(states)[:, 0]


def attachment(rng, count=3, points=40):
    """Points on posts, held by springs and dampers of different strength along the axes."""
    post, shape = rng.integers(0, count, points), rng.standard_normal((points, 3))
    stiff, damp = rng.uniform(0.5, 2.0, (2, points, 3))
    held = Attachment(post, shape, stiff * shape, damp * shape, count=count, comm=MPI.COMM_SELF)
    return held, stiff, damp


def test_a_load_bends_a_post_by_load_over_stiffness():
    bar = Oscillator(mass=0.02, stiffness=2e6, damping=200.0)
    assert swing(bar, (0.0, 0.0), 1e5, 1e-4, 400)[-1] == pytest.approx([0.05, 0.0], abs=1e-12)


def test_a_free_post_swings_with_its_frequency_and_damping():
    """q = a e^(-z w t) cos(w sqrt(1 - z^2) t) + ..., of second order in the step."""
    m, k, z = 0.02, 2e6, 0.05
    bar = Oscillator(mass=m, stiffness=k, damping=2.0 * z * math.sqrt(k * m))
    w, t, a = math.sqrt(k / m), 1e-3, 0.03
    wd = w * math.sqrt(1.0 - z * z)
    exact = a * math.exp(-z * w * t) * (math.cos(wd * t) + z * w / wd * math.sin(wd * t))
    assert_order(
        lambda n: abs(swing(bar, (a, 0.0), 0.0, t / n, n)[-1, 0] - exact) / a,
        [100, 200, 400],
        order=1.95,
        below=1e-2,
    )


def test_a_free_post_without_damper_keeps_its_energy_to_round_off():
    bar = Oscillator(mass=0.02, stiffness=2e6)
    states = swing(bar, (0.03, 10.0), 0.0, 1e-4, 200)
    energy = [bar.energy(state[None]) for state in states]
    assert energy[0] == pytest.approx(0.5 * 2e6 * 0.03**2 + 0.5 * 0.02 * 100.0)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-11)
    assert np.abs(np.diff(states[:, 0])).max() > 0.01


def test_what_posts_springs_and_fluid_exchange_balances_to_round_off():
    """Points carried by a velocity U: work on the fluid, what is stored and what the dampers take add up to nothing."""
    rng, dt, bar = np.random.default_rng(3), 0.3, Oscillator(mass=0.7, stiffness=3.0, damping=0.4)
    held, stiff, damp = attachment(rng)
    motion, d, U = rng.standard_normal((3, 2)), *rng.standard_normal((2, 40, 3))
    at = d + 0.5 * dt * U
    still = -stiff * at - damp * U
    middle = bar.midpoint(motion, held.load(still), held.total, dt)
    F, after = still + held.force(middle), 2.0 * middle - motion

    def stored(motion, d):
        return bar.energy(motion) + 0.5 * np.vdot(stiff * d, d) + held.energy(motion, d)

    assert stored(motion, d) == pytest.approx(
        bar.energy(motion) + 0.5 * (stiff * (d - held.shift(motion)) ** 2).sum()
    )
    slip = U - held.shape * middle[held.post, 1:]
    lost = dt * (0.4 * (middle[:, 1] ** 2).sum() + (damp * slip**2).sum())
    change = stored(after, d + dt * U) - stored(motion, d)
    assert lost > 1.0
    assert change + dt * np.vdot(F, U) + lost == pytest.approx(0.0, abs=1e-11 * lost)
    # Newton: what accelerates the posts is what they are given, less what they bear themselves.
    bears = 3.0 * middle[:, 0] + 0.4 * middle[:, 1]
    np.testing.assert_allclose(
        0.7 * (after - motion)[:, 1] / dt, held.load(F) - bears, rtol=1e-12, atol=1e-12
    )


def test_what_hangs_on_posts_adds_up_over_parts():
    rng = np.random.default_rng(5)
    held, _, _ = attachment(rng)
    F = rng.standard_normal((40, 3))
    parts = [
        Attachment(held.post[p], held.shape[p], held.springs[p], held.dampers[p], count=3, comm=MPI.COMM_SELF)
        for p in (slice(0, 25), slice(25, 40), slice(40, 40))
    ]
    np.testing.assert_allclose(sum(p.total for p in parts), held.total)
    forces = (F[:25], F[25:], F[40:])
    np.testing.assert_allclose(sum(p.load(f) for p, f in zip(parts, forces, strict=True)), held.load(F))


@pytest.mark.parametrize(("spring", "damper"), [(3.9, 0.0), (1.0, 0.25), (2.0, 0.9)])
@pytest.mark.parametrize("ratio", [0.0, 0.05])
def test_beside_a_mass_of_fluid_posts_of_any_mass_and_stiffness_leave_the_step_its_limit(
    spring, damper, ratio
):
    """A unit mass of fluid and a step of one: stable for spring + 2 damper < 4 where the post stands still."""
    unit = np.ones((1, 3)) / math.sqrt(3.0)
    held = Attachment(np.zeros(1, np.int64), unit, spring * unit, damper * unit, count=1, comm=MPI.COMM_SELF)
    worst = 0.0
    for m in np.logspace(-4, 3, 29):
        for k in np.logspace(-4, 4, 17):
            bar = Oscillator(mass=m, stiffness=k, damping=2.0 * ratio * math.sqrt(k * m))

            def step(x, bar=bar):
                chi, v = x[0] + 0.5 * x[1], x[1]
                still = -(spring * chi + damper * v) * unit
                middle = bar.midpoint(x[None, 2:], held.load(still), held.total, 1.0)
                v_new = v + float(((still + held.force(middle)) * unit).sum())
                return np.array([x[0] + 0.5 * (v + v_new), v_new, *(2.0 * middle[0] - x[2:])])

            A = np.stack([step(e) for e in np.eye(4)], axis=1)
            worst = max(worst, float(np.abs(np.linalg.eigvals(A)).max()))
    assert 0.9 < worst < 1.0 + 1e-6


@pytest.mark.parametrize("wrong", [{"mass": 0.0}, {"stiffness": -1.0}, {"damping": -1.0}, {"mass": math.nan}])
def test_posts_that_cannot_stand_are_refused(wrong):
    with pytest.raises(ValueError, match="expected mass > 0"):
        Oscillator(**{"mass": 1.0, "stiffness": 1.0, **wrong})
