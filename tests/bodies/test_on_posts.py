"""Leaflets on flexible posts in the coupled step: energy, statics, the rigid limit, ranks, restart."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.bodies.elastic import Elastic
from valvefsi.bodies.heavy import Heavy
from valvefsi.bodies.on_posts import OnPosts, post_columns
from valvefsi.bodies.patches import PatchedSurface
from valvefsi.bodies.posts import Oscillator
from valvefsi.coupling.transfer import Coupling
from valvefsi.fluid.boundary import Boundary
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.fsi import Model
from valvefsi.geometry.aortic_section import PointSurface
from valvefsi.geometry.patches import patch_labels
from valvefsi.geometry.shapes import box
from valvefsi.geometry.stent_posts import StentPosts
from valvefsi.grid import MacGrid
from valvefsi.io.history import read_history
from valvefsi.run.recording import Output
from valvefsi.run.regridding import regridded
from valvefsi.run.schedule import Schedule
from valvefsi.run.simulation import Simulation
from valvefsi.run.stable_step import measured_limit
from valvefsi.solid.loads import DeadLoad, Tether
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.structure import Structure

WORLD = MPI.COMM_WORLD
H, DT = 0.25, 1e-3
TETHER, ETA = 1e5, 50.0
"""Of the block [dyn/cm^3, dyn s/cm^3]."""
KAPPA, DAMPER = 2e5, 100.0
"""Of the posts' wall [dyn/cm^3, dyn s/cm^3]."""
PLACES = StentPosts(
    azimuths=np.array([0.0, np.pi]), tips=np.array([1.5, 1.5]), radii=np.array([1.0, 1.0]), foot=0.5
)
BAR = Oscillator(mass=0.05, stiffness=4e4, damping=5.0)


def plate(x):
    """The wall of a post at x, upright."""
    y, z = (part.ravel() for part in np.meshgrid(np.arange(-3, 4) * 0.5 * H, 0.375 + np.arange(9) * 0.5 * H))
    points = np.stack([np.full_like(y, x), y, z], axis=1)
    normals = np.tile([np.sign(x), 0.0, 0.0], (len(y), 1))
    return PointSurface(
        points=points, areas=np.full(len(y), 0.25 * H**2), normals=normals, faces=np.zeros((0, 4), int)
    )


def parts(comm=WORLD, *, firm=1.0, traction=-400.0):
    """Grid and fluid, a block that hangs on a wall at x = 1 by its outer side, and two such walls in patches."""
    grid = MacGrid([-2, -1, 0], [2, 1, 2], (16, 8, 8), [True] * 3, comm)
    fluid = NavierStokes(grid, Boundary(grid), rho=1.0, mu=0.1)
    mesh = box(comm, lower=(0.5, -0.25, 0.75), size=(0.5, 0.5, 0.75), elements=(2, 2, 3))
    solid = Structure(
        mesh,
        NeoHookean(c1=400.0),
        name="block",
        tethers=[Tether(on=("x_upper",), stiffness=TETHER, damping=ETA)],
        loads=[DeadLoad(on=("x_lower",), traction=(traction, 0.0, 0.0))],
    )
    walls = [plate(1.0), plate(-1.0)]
    whole = PointSurface(
        points=np.concatenate([w.points for w in walls]),
        areas=np.concatenate([w.areas for w in walls]),
        normals=np.concatenate([w.normals for w in walls]),
        faces=walls[0].faces,
    )
    coupling = Coupling(grid, "composite_bspline32")
    labels = patch_labels(walls, H)
    wall = PatchedSurface(whole, labels, coupling, name="wall", stiffness=firm * KAPPA, damping=firm * DAMPER)
    assert (wall.patches.labels >= 0).mean() > 0.5 or comm.size > 1
    return grid, fluid, Elastic(solid, Coupling(grid, "bspline3")), wall, coupling


def on_posts(comm=WORLD, *, bar=BAR, heavy=None, **options):
    """The model on flexible posts."""
    grid, fluid, block, wall, coupling = parts(comm, **options)
    block = block if heavy is None else Heavy(block.solid, block.coupling, rho=1.0, density=heavy)
    body = OnPosts(block, wall, coupling, places=PLACES, oscillator=bar, tags=("x_upper",))
    return Model(grid=grid, fluid=fluid, bodies=(body,))


def march(model, steps, state=None, dt=DT):
    state = fsi.initial_state(model, dt) if state is None else state
    for _ in range(steps):
        state = fsi.step(model, state, dt)
    return state


def motion(model, state):
    return model.bodies[0].motion(state.bodies[0])


@pytest.mark.parametrize("heavy", [None, 3.0])
def test_everything_exchanged_in_a_step_balances_to_round_off(heavy):
    """A uniform flow carries block and walls as they are: work, stored energy and what dampers take add up to none."""
    model = on_posts(heavy=heavy, traction=0.0)
    body, rng = model.bodies[0], np.random.default_rng(1)
    grid, wall = model.grid, body.wall
    u = tuple(np.full(grid.shape, v) for v in (2.0, -0.7, 0.4))
    q = body.start(u)
    start = np.array([[0.02, 3.0], [-0.01, 1.0]])
    q |= {"chi": q["chi"] + [0.03, 0.01, -0.02], "posts": start[body.rows("posts")[0]]}
    q["d"] = wall.held(np.array([0.01, 0.02, 0.0]) + 0.01 * rng.standard_normal(wall.X.shape))
    if heavy:
        q["Y"] = q["Y"] + [0.03, 0.01, -0.02]
    half = body.half(q, u, 0.0, DT, DT)
    U = half.velocity(u)
    after = half.whole(U)
    middle = 0.5 * (start + body.motion(after))
    np.testing.assert_allclose(middle[:, 1], (body.motion(after) - start)[:, 0] / DT, rtol=1e-9)
    # What the dampers take, from areas and shapes: the tether's side of the block, and the walls in their patches.
    w = PLACES.shape(body.X) * middle[PLACES.nearest(body.X), 1:]
    area = body.solid.tethers_on(("x_upper",))[0] / TETHER
    slip = wall.held(U[len(w) :] - PLACES.shape(wall.X) * middle[PLACES.nearest(wall.X), 1:])
    lost = ETA * (area * (U[: len(w)] - w) ** 2).sum() + DAMPER * (wall.weights[:, None] * slip**2).sum()
    lost = DT * (grid.comm.allreduce(lost) + BAR.damping * (middle[:, 1] ** 2).sum())
    work = DT * grid.comm.allreduce(np.vdot(half.force, U))
    change = body.stored(after) - body.stored(q)
    assert grid.comm.allreduce(area.sum()) == pytest.approx(3 * 0.5 * 0.75)
    assert min(abs(work), abs(change), lost) > 1e-2 * abs(work)
    assert change + work + lost == pytest.approx(0.0, abs=1e-9 * lost)


def test_the_kernels_of_the_wall_go_with_the_posts():
    """In a flow u_y = x the points feel x where they are: at the beginning of the step, and at its middle."""
    model = on_posts(bar=Oscillator(mass=1e9, stiffness=1.0))
    body, grid = model.bodies[0], model.grid
    u = grid.zero_faces()
    u[1][:] = grid.coordinates(0, on_faces=False)[:, None, None]
    start = np.array([[0.2, 40.0], [-0.1, 0.0]])
    half = body.half(body.start(u) | {"posts": start[body.rows("posts")[0]]}, u, 0.0, DT, DT)
    shape, post = PLACES.shape(body.wall.X)[:, 0], PLACES.nearest(body.wall.X)
    first, middle = (body.wall.X[:, 0] + shape * q[post] for q in (start[:, 0], np.array([0.22, -0.1])))
    V, V_half = (body.wall.held(x[:, None] * [0.0, 1.0, 0.0]) for x in (first, middle))
    np.testing.assert_allclose(half.wall.velocity(u), V_half, atol=1e-6)
    still = body.wall.force(np.zeros_like(V), V, 0.5 * DT)
    np.testing.assert_allclose(half.wall.force[:, 1], still[:, 1], rtol=1e-9, atol=1e-9)


def test_springs_in_series_hold_a_block_that_is_pushed_inwards():
    """Fluid and block held still, the block's side off by d: q (k + K) = K d of the tether, the walls unloaded."""
    model = on_posts(traction=0.0)
    body, u, d = model.bodies[0], model.grid.zero_faces(), 0.04
    q = body.start(u) | {"chi": body.X - [d, 0.0, 0.0]}
    for _ in range(400):
        half = body.half(q, u, 0.0, DT, DT)
        q = half.whole(np.zeros_like(half.force)) | {"chi": q["chi"]}
    phi = np.polynomial.Polynomial(
        [0.0, 0.0, 1.5, -0.5]
    )  # on the side of the block, from s = 0.25 to 1, 0.5 wide
    z = np.linspace(0.75, 1.5, 4) - PLACES.foot  # nodes, with half the weight at the ends
    weights = 0.5 * 0.25 * np.array([0.5, 1.0, 1.0, 0.5])
    edge, pull = TETHER * weights @ phi(z) ** 2, TETHER * weights @ phi(z) * d
    walls = KAPPA * body.comm.allreduce(
        (body.stent.springs * body.stent.shape / KAPPA)[PLACES.nearest(body.wall.X) == 0].sum()
    )
    expected = pull / (BAR.stiffness + edge + walls)
    np.testing.assert_allclose(body.motion(q), [[expected, 0.0], [0.0, 0.0]], rtol=1e-6, atol=1e-9)


def test_a_block_that_pulls_inwards_bends_its_post_and_no_other():
    state = march(model := on_posts(), 60)
    q = motion(model, state)[:, 0]
    assert q[0] > 1e-3
    assert abs(q[1]) < 0.05 * q[0]


def test_stiffer_posts_come_to_rigid_ones_as_one_over_their_stiffness():
    """Against the block and the wall as bodies of their own, whose kernel stays: the velocity of the fluid."""
    grid, fluid, block, wall, _ = parts()
    rigid = march(Model(grid=grid, fluid=fluid, bodies=(block, wall)), 15)

    def apart(k):
        state = march(on_posts(bar=Oscillator(mass=1e-3, stiffness=k, damping=0.0)), 15)
        far = max(float(np.abs(a - b).max()) for a, b in zip(state.u, rigid.u, strict=True))
        return grid.comm.allreduce(far, op=MPI.MAX)

    size = grid.comm.allreduce(float(np.abs(rigid.u[0]).max()), op=MPI.MAX)
    soft, firm = apart(1e8), apart(1e9)
    assert 9.0 < soft / firm < 11.0
    assert 0.0 < firm < 1e-3 * size


def test_one_rank_gives_the_same():
    together, alone = on_posts(), on_posts(MPI.COMM_SELF)
    states = [march(model, 10) for model in (together, alone)]
    mine, expected = (motion(model, state) for model, state in zip((together, alone), states, strict=True))
    np.testing.assert_allclose(mine, expected, rtol=1e-9)
    np.testing.assert_allclose(states[0].given, states[1].given, rtol=1e-8, atol=1e-8)
    stored = [m.bodies[0].stored(s.bodies[0]) for m, s in zip((together, alone), states, strict=True)]
    assert stored[0] == pytest.approx(stored[1], rel=1e-9)
    assert np.abs(mine).min() > 0.0


def test_a_run_goes_on_from_its_checkpoint_as_if_it_had_not_stopped(shared_tmp):
    def run(folder, steps, *, resume=False):
        output = Output(directory=folder, history_every=2, energy=True)
        simulation = Simulation(on_posts(), Schedule(dt=DT, t_end=steps * DT), output)
        return simulation.run(resume=resume).state

    whole = run(shared_tmp / "whole", 12)
    run(shared_tmp / "parts", 6)
    again = run(shared_tmp / "parts", 12, resume=True)
    for key, table in whole.bodies[0].items():
        np.testing.assert_array_equal(again.bodies[0][key], table, err_msg=key)
    columns = [read_history(shared_tmp / name / "history.csv") for name in ("whole", "parts")]
    assert columns[0] == columns[1]
    tips = [columns[0][name][-1] for name in post_columns("block", 2)]
    np.testing.assert_allclose(tips, 10.0 * on_posts().bodies[0].motion(whole.bodies[0])[:, 0], rtol=1e-9)
    assert abs(tips[0]) > 1e-4


def test_another_grid_begins_with_the_posts_where_they_are_and_no_load_of_their_walls():
    coarse = on_posts(MPI.COMM_SELF)
    state = march(coarse, 20)
    fine = on_posts()
    q = regridded(coarse, state, fine, DT).bodies[0]
    body, before = fine.bodies[0], coarse.bodies[0].motion(state.bodies[0])
    np.testing.assert_array_equal(body.motion(q), before)
    assert body.stored(q) == pytest.approx(
        body.leaflets.stored(q)
        + BAR.energy(before)
        + body.comm.allreduce(body.edge.energy(before, q["chi"] - body.X)),
        rel=1e-9,
    )


def test_the_stable_step_is_that_of_posts_that_stand_still():
    """Measured with posts at rest; a post of next to no mass, and walls that leave the limit to the tether."""
    model = on_posts(firm=1e-3, bar=Oscillator(mass=1e-6, stiffness=1e3))
    grid, fluid, block, wall, _ = parts(firm=1e-3)
    still = Model(grid=grid, fluid=fluid, bodies=(block, wall))
    limit = measured_limit(model, DT, 0)
    assert limit == pytest.approx(measured_limit(still, DT, 0), rel=1e-9)
    state = march(model, 60, dt=0.9 * limit)
    assert model.bodies[0].fault(state.bodies[0], model.bodies[0].row(state.bodies[0])) is None
    assert 1e-3 < np.abs(motion(model, state)[:, 0]).max() < 0.1


def test_a_block_that_no_tether_holds_is_refused():
    _, _, block, wall, coupling = parts()
    with pytest.raises(ValueError, match="no tether holds block on x_lower alone"):
        OnPosts(block, wall, coupling, places=PLACES, oscillator=BAR, tags=("x_lower",))
