"""Flexible posts of a case's stent: what is refused, planned and reported, the housing without them, a shut valve."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from tests.case.own_leaflets import own as own_leaflets
from tests.case.own_leaflets import written
from tests.case.test_case_valve import DEMO, coarse
from valvefsi import fsi
from valvefsi.bodies.on_posts import OnPosts
from valvefsi.case import load_case
from valvefsi.case.build import build
from valvefsi.case.valve_report import report_numbers
from valvefsi.case.writing import case_defaults
from valvefsi.errors import CaseError
from valvefsi.io.history import read_history

FIRM = "housing.posts.stiffness='2000 N/m'"
SHUT = ("circuit.ventricle.start.p_via='10 mmHg'", "circuit.aorta.start.p_wk='85 mmHg'")


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """The valve with flexible posts and with rigid ones, built once."""
    folder = MPI.COMM_WORLD.bcast(tmp_path_factory.mktemp("posts"))
    return tuple(build(coarse(2, *SHUT, *more), folder).model for more in ((FIRM,), ()))


def test_the_posts_part_of_the_stent_moves_and_all_else_stays(models):
    flexible, rigid = models
    body, (_, housing, filling) = flexible.bodies[0], flexible.bodies
    assert isinstance(body, OnPosts)
    assert (
        [b.name for b in flexible.bodies]
        == [b.name for b in rigid.bodies]
        == ["leaflets", "housing", "filling"]
    )
    assert body.oscillator.stiffness == pytest.approx(2e6)
    assert body.oscillator.damping == pytest.approx(2.0 * 0.05 * np.sqrt(2e6 * 0.02))
    whole, stays, moves = rigid.bodies[1], housing, body.wall
    said = {entry.quantity: entry for entry in body.size(flexible.grid)}["points of posts"]
    assert (said.value, said.note) == (moves.num_points, "flexible, 3 of them")
    assert [entry.note for entry in housing.size(flexible.grid)] == ["rigid"]
    assert stays.num_points + moves.num_points == whole.num_points
    np.testing.assert_array_equal(
        np.unique(np.concatenate([stays.points, moves.points]), axis=0), np.unique(whole.points, axis=0)
    )
    assert (
        (stays.stiffness, stays.damping)
        == (moves.stiffness, moves.damping)
        == (whole.stiffness, whole.damping)
    )
    assert len(stays.faces) == len(whole.faces)
    np.testing.assert_allclose(stays.points[stays.faces], whole.points[whole.faces])
    # Nothing that moves lies off the stent, nothing of the stent above the posts' feet stays.
    above = moves.points[body.places.shape(moves.points).any(axis=1)]
    assert len(above) > 0.5 * moves.num_points
    r = np.hypot(*above[:, :2].T)
    assert r.min() > 1.2
    assert r.max() < 1.35  # the sinuses are wider there, by up to 5 mm
    edge = stays.points[(stays.points[:, 2] > body.places.foot + 0.02) & (stays.points[:, 2] < 1.75)]
    assert np.hypot(*edge[:, :2].T).min() > 1.35
    assert filling.num_points == rigid.bodies[2].num_points


def test_what_hangs_on_the_posts_is_the_attached_edge_above_their_feet(models):
    body = models[0].bodies[0]
    spring = body.spring * (body.X[:, 2:] > body.places.foot)
    reach = np.abs(body.edge.springs).max(axis=1) > 0.0
    assert body.comm.allreduce(int(reach.sum())) >= 12
    assert not reach[~spring.any(axis=1)].any()
    assert (np.hypot(*body.X[reach, :2].T) > 1.15).all()
    # K of three alike posts, from the area of an edge: two straight edges, 0.4 mm thick, the bar's mean square 33/140.
    expected = 2e8 * 2.0 * 0.04 * 0.8 * 33.0 / 140.0
    np.testing.assert_allclose(body.edge.total[:, 0], expected, rtol=0.1)


def test_the_plan_says_how_far_the_posts_may_bend(models):
    body = models[0].bodies[0]
    (entry,) = (e for e in body.statics(4e-5) if e.quantity == "deflection of posts at 100 mmHg")
    pressure, length = 1.333224e5, body.places.lengths[0]
    third = np.sqrt(3.0) * 1.25 * pressure  # dyn per length of a post: the chord of a third of the circle
    s = np.linspace(0.0, 1.0, 2001)
    load = np.trapezoid(third * length * 0.5 * s**2 * (3.0 - s), s)
    assert entry.value == pytest.approx(10.0 * load / 2e6, rel=1e-4)
    assert not any(e.quantity.startswith("warning") for e in body.statics(4e-5))
    soft = OnPosts(
        body.leaflets,
        body.wall,
        body.coupling,
        places=body.places,
        oscillator=type(body.oscillator)(mass=0.02, stiffness=4e5),
        tags=("attached",),
    )
    assert "of their length" in soft.statics(4e-5)[-1].note


def test_a_run_reports_its_posts_and_goes_on_from_a_checkpoint(shared_tmp):
    case = coarse(4, FIRM, *SHUT)
    build(case, shared_tmp / "whole").run()
    half = coarse(4, FIRM, *SHUT, "time.t_end='80 us'")
    build(half, shared_tmp / "parts").run()
    build(case, shared_tmp / "parts").run(resume=True)
    mine, expected = (read_history(shared_tmp / name / "history.csv") for name in ("parts", "whole"))
    names = [f"leaflets_post_{k}_inward_mm" for k in (1, 2, 3)]
    for name in (*names, "kinetic_energy_erg", "energy_lost_leaflets_erg"):
        assert mine[name] == pytest.approx(expected[name], rel=1e-9, abs=1e-15), name
    assert expected[names[0]][-1] > 0.0
    numbers = report_numbers(case, shared_tmp / "whole")["valve"]
    assert numbers["posts"]["post_2"]["largest_inward_mm"] == max(expected[names[1]])
    assert numbers["posts"]["post_2"]["t_s"] == expected["t_s"][int(np.argmax(expected[names[1]]))]
    assert "towards the axis" in numbers["definitions"]["posts"]
    assert "posts" not in report_numbers(coarse(4, *SHUT), shared_tmp / "whole")["valve"]


def test_leaflets_of_a_file_stand_on_the_same_posts(models, shared_tmp):
    body, own = (
        models[0].bodies[0],
        build(own_leaflets(written(shared_tmp), FIRM), shared_tmp).model.bodies[0],
    )
    assert isinstance(own, OnPosts)
    np.testing.assert_allclose(own.places.azimuths, body.places.azimuths, atol=0.01)
    np.testing.assert_allclose(own.places.lengths, body.places.lengths, rtol=0.05)
    np.testing.assert_allclose(own.edge.total, body.edge.total, rtol=0.1)


def inward_pull(model, state, posts):
    """What the attached edge and the stent pull rigid posts inwards with, from springs and displacements, ``(3,)``."""
    solid, q = model.bodies[0].solid, state.bodies[0]["chi"]
    spring, _ = solid.tethers_on(("attached",))
    here = [(solid.X, spring * (q - solid.X))]
    wall = model.bodies[1]
    stent = np.hypot(*wall.X[:, :2].T) < 1.35
    force = wall.stiffness * wall.weights[:, None] * state.bodies[1]["d"]
    here.append((wall.X[stent], force[stent]))
    total = np.zeros(3)
    for X, F in here:
        s = np.clip((X[:, 2] - posts.foot) / (1.75 - posts.foot), 0.0, 1.0)
        post = np.floor(np.degrees(np.arctan2(X[:, 1], X[:, 0])) % 360.0 / 120.0).astype(int) % 3
        angle = np.radians(60.0 + 120.0 * post)
        inward = -(F[:, 0] * np.cos(angle) + F[:, 1] * np.sin(angle))
        np.add.at(total, post, 0.5 * s**2 * (3.0 - s) * inward)
    return model.grid.comm.allreduce(total)


@pytest.mark.slow
def test_posts_of_a_shut_valve_bend_inwards_by_what_pulls_at_rigid_ones_over_their_stiffness(shared_tmp):
    """Firm posts, which change the load by little: 12 ms from 75 mmHg across the valve on, mean of the last 2 ms."""
    steps, last, k = 300, 50, 2e7
    flexible, rigid = (
        build(coarse(steps, *SHUT, *more), shared_tmp / name).model
        for name, more in (("firm", ("housing.posts.stiffness='20000 N/m'",)), ("rigid", ()))
    )
    states = [fsi.initial_state(model, 4e-5) for model in (flexible, rigid)]
    bent, pull = np.zeros(3), np.zeros(3)
    for step in range(steps):
        states = [fsi.step(model, s, 4e-5) for model, s in zip((flexible, rigid), states, strict=True)]
        if step >= steps - last:
            bent += flexible.bodies[0].motion(states[0].bodies[0])[:, 0] / last
            pull += inward_pull(rigid, states[1], flexible.bodies[0].places) / last
    assert (pull > 5e3).all()  # 0.05 N and more
    np.testing.assert_allclose(k * bent, pull, rtol=0.05)


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (("housing.posts.mass='0.1 g'",), r"housing\.posts\.stiffness.*need a stiffness"),
        (("housing.posts.stiffness='2000 N'",), r"housing\.posts\.stiffness.*N measures something else"),
        (("housing.posts.stiffness='-1 N/m'",), r"housing\.posts\.stiffness.*greater than 0"),
        ((FIRM, "housing.posts.length='2 cm'"), r"housing\.posts\.length.*only 1\.75 cm high"),
        ((FIRM, "solid.leaflets.tether.0.on=['inflow']"), r"housing\.posts.*no tether of leaflets"),
        ((FIRM, "housing.posts.stifness='1 N/m'"), r"unknown key.*stiffness"),
    ],
)
def test_posts_that_cannot_be_are_said(overrides, said, tmp_path):
    with pytest.raises(CaseError, match=said):
        build(load_case(DEMO, list(overrides)), tmp_path)


def test_posts_without_a_stent_are_refused():
    with pytest.raises(CaseError, match=r"housing\.posts.*name its solid in stent"):
        load_case(DEMO, ["housing={annulus='-1 mm', posts={stiffness='1 N/mm'}}"])


def test_the_defaults_say_the_posts_keys():
    text = case_defaults()
    assert "# [housing.posts]" in text
    assert "dyn/cm" in text[text.index("# [housing.posts]") :]
