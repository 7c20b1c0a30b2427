"""Surfaces held in patches: the projection, forces that cancel, and flow in a tube whose wall must not grow."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.benchmarks.flows.tube import Tube, build
from valvefsi.bodies.patches import Patches
from valvefsi.geometry.aortic_section import AorticSection
from valvefsi.geometry.patches import SINGLE, patch_labels
from valvefsi.io.history import read_history
from valvefsi.verification.closed_forms import start_up

WORLD = MPI.COMM_WORLD
SECTION = AorticSection(inlet_radius=0.8, outlet_radius=0.9, sinus_height=1.0, sinus_depth=0.3, annulus=0.3)
SURFACE = SECTION.housing(0.1, (0.0, 1.6))
LABELS = patch_labels([SURFACE], 0.1, (0.0, 1.6))
ALL = np.arange(len(LABELS))


def projection():
    return Patches(LABELS, SURFACE.normals, SURFACE.areas).on(ALL, MPI.COMM_SELF)


def measured(folder, angle, h, *overrides):
    """Times and flow over the final flow in a tube."""
    Tube(angle=angle, grid=f"{h} cm", overrides=overrides).run(out=folder)
    history = read_history(next(folder.rglob("history.csv")))
    return np.array(history["t_s"]), np.array(history["flow_over_final"])


def vectors(seed):
    return np.random.default_rng(seed).standard_normal((len(LABELS), 3))


def test_it_is_a_projection_that_areas_make_symmetric():
    P, a, b = projection(), vectors(1), vectors(2)
    np.testing.assert_allclose(P.mean(P.mean(a)), P.mean(a), atol=1e-13)
    w = SURFACE.areas[:, None]
    assert np.vdot(w * P.mean(a), b) == pytest.approx(np.vdot(w * a, P.mean(b)), rel=1e-12)


def test_uniform_pressure_and_single_points_are_left_as_they_are():
    P, v = projection(), vectors(3)
    np.testing.assert_allclose(P.mean(SURFACE.normals), SURFACE.normals, atol=1e-13)
    single = LABELS == SINGLE
    assert 0 < single.sum() < len(single)
    np.testing.assert_array_equal(P.mean(v)[single], v[single])


def test_what_alternates_within_patches_is_not_held():
    P, v = projection(), vectors(4)
    rough = v - P.mean(v)
    assert np.abs(rough).max() > 1.0
    np.testing.assert_allclose(P.mean(rough), 0.0, atol=1e-13)


def test_ranks_share_a_patch():
    P, v = Patches(LABELS, SURFACE.normals, SURFACE.areas), vectors(5)
    ids = ALL[WORLD.rank :: WORLD.size]
    np.testing.assert_allclose(P.on(ids, WORLD).mean(v[ids]), projection().mean(v)[ids], atol=1e-13)


def test_a_patch_around_an_edge_falls_apart():
    normals = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
    P = Patches(
        np.array([0, 0, 1, 1]), np.array([[1.0, 0.0, 0.0], [-0.9, 0.1, 0.4], *normals[2:]]), np.ones(4)
    )
    np.testing.assert_array_equal(P.labels, [-1, -1, 0, 0])


def test_nothing_is_carried_that_is_not_held():
    """Springs on every point would keep what alternates, and act on it."""
    model, _, dt = build(0, 0.25, Tube().values, WORLD)
    state, wall = fsi.initial_state(model, dt), model.bodies[0]
    for _ in range(50):
        state = fsi.step(model, state, dt)
    d = state.bodies[0]["d"]
    largest = WORLD.allreduce(float(np.abs(d).max(initial=0.0)), op=MPI.MAX)
    assert largest > 1e-9
    np.testing.assert_allclose(wall.held(d), d, atol=1e-12 * largest)


@pytest.mark.parametrize("angle", [0, 45])
def test_the_wall_of_a_tube_stays_where_it_is(angle, shared_tmp):
    """Twelve cells across; springs on every point lose 4 and 7 % of the flow, and more with time."""
    t, flow = measured(shared_tmp, angle, 2.5 / 12, "t_end=1.0")
    error = 100.0 * (flow - start_up(t, 0.1))
    assert np.abs(error).max() < 1.5
    assert np.ptp(error[t > 0.8]) < 0.02


def test_the_flow_does_not_depend_on_the_step(shared_tmp):
    long, short = (
        measured(shared_tmp / str(step), 0, 0.25, "t_end=0.8", f"step={step}")[1][-1] for step in (0.8, 0.2)
    )
    assert short == pytest.approx(long, rel=2e-4)


def test_the_series_is_that_of_a_parabola_from_rest():
    """At first only the force acts, Q' = 8 nu / R^2 Q_final, less what friction in a layer of sqrt(nu t) takes."""
    relaxation = 0.1
    nu_t = 1e-3  # over R^2
    t = nu_t * 5.783185962946785 * relaxation
    layer = 1.0 - 4.0 / 1.5 * np.sqrt(nu_t / np.pi)
    assert start_up(np.array([t]), relaxation)[0] == pytest.approx(8.0 * nu_t * layer, rel=3e-3)
    assert start_up(np.array([2.0]), relaxation)[0] == pytest.approx(1.0, abs=1e-8)
