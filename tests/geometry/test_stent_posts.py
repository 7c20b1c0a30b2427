"""The posts of a stent: where they stand, and the shape in which they bend."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from valvefsi.errors import CaseError
from valvefsi.geometry.leaflets import TYPES, pericardial
from valvefsi.geometry.stent import FormulaEdge, LineEdge
from valvefsi.geometry.stent_posts import MEAN_SHAPE, cantilever_shape, stent_posts


def wave(rise, count=3, points=200):
    """Edges of leaflets around a circle of 1.2 cm, their ends 0.2 rad apart and ``rise`` above their middles."""
    lines = []
    for k in range(count):
        u = np.linspace(-1.0, 1.0, points)
        phi = 2.0 * math.pi * k / count + u * (math.pi / count - 0.1)
        z = rise * np.abs(u) ** 3
        lines.append(np.stack([1.2 * np.cos(phi), 1.2 * np.sin(phi), z], axis=1))
    return LineEdge(lines)


def test_the_shape_is_that_of_a_bar_under_a_load_at_its_tip():
    """E I w'''' = 0 (Euler, Bernoulli), clamped at the foot, a force F at the tip and no moment, E I = L = F = 1."""

    def slopes(s, y):
        return np.stack([y[1], y[2], y[3], np.zeros_like(s)])

    def ends(foot, tip):
        return np.array([foot[0], foot[1], tip[2], tip[3] + 1.0])

    s = np.linspace(0.0, 1.0, 21)
    bar = solve_bvp(slopes, ends, s, np.zeros((4, 21)))
    w = bar.sol(s)[0]
    assert w[-1] == pytest.approx(1.0 / 3.0, rel=1e-9)  # F / k of k = 3 E I / L^3
    np.testing.assert_allclose(cantilever_shape(s), w / w[-1], atol=1e-9)
    assert np.trapezoid(w, s) / w[-1] == pytest.approx(MEAN_SHAPE, rel=2e-3)
    np.testing.assert_array_equal(cantilever_shape(np.array([-0.5, 0.0, 1.0, 1.1])), [0.0, 0.0, 1.0, 1.0])


@pytest.mark.parametrize("kind", TYPES)
def test_the_posts_of_a_parametric_valve_are_its_commissures(kind):
    valve = TYPES[kind]()
    posts = stent_posts(FormulaEdge(valve, 0.3))
    np.testing.assert_allclose(np.degrees(posts.azimuths), [60.0, 180.0, 300.0], atol=0.2)
    np.testing.assert_allclose(posts.tips, 0.3 + valve.height)
    np.testing.assert_allclose(posts.radii, valve.radius)
    np.testing.assert_allclose(posts.lengths, valve.commissure, rtol=0.02)  # seen in steps around the axis


def test_posts_of_lines_stand_between_their_ends_and_are_as_long_as_asked():
    posts = stent_posts(wave(0.6), 0.2)
    np.testing.assert_allclose(np.degrees(posts.azimuths), [60.0, 180.0, 300.0], atol=0.5)
    np.testing.assert_allclose(posts.lengths, 0.2, rtol=1e-6)
    assert len(stent_posts(wave(0.6, count=2), 0.2).azimuths) == 2


@pytest.mark.parametrize(("length", "said"), [(None, "nowhere steeply"), (0.7, "only 0.6 cm high")])
def test_posts_that_are_not_there_are_refused(length, said):
    with pytest.raises(CaseError, match=said):
        stent_posts(wave(0.6), length)


def test_a_post_moves_towards_the_axis_as_one_piece_and_by_its_height_only():
    posts = stent_posts(FormulaEdge(pericardial(), 0.0))
    angle = posts.azimuths[1] + np.array([-0.3, 0.0, 0.2])
    for z in (posts.foot - 0.1, posts.foot + 0.4 * posts.lengths[1], posts.tips[1]):
        X = np.stack([1.25 * np.cos(angle), 1.25 * np.sin(angle), np.full(3, z)], axis=1)
        assert (posts.nearest(X) == 1).all()
        phi = cantilever_shape((z - posts.foot) / posts.lengths[1:2])[0]
        np.testing.assert_allclose(
            posts.shape(X), np.tile([phi, 0.0, 0.0], (3, 1)), atol=2e-3
        )  # it stands at 180 deg
    assert phi == 1.0
