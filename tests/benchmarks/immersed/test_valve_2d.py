"""Two leaflets in a channel: their mesh and stiffness, the gap, their roots, a few steps, what the command writes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.benchmarks.frame import Job
from valvefsi.benchmarks.immersed import valve_2d
from valvefsi.benchmarks.immersed.valve_2d import (
    COLUMNS,
    HEIGHT,
    PARAMETERS,
    ROOT,
    Valve2D,
    leaflet_of,
    numbers,
)
from valvefsi.benchmarks.options import defaults
from valvefsi.benchmarks.running import attempt, gathered
from valvefsi.errors import CaseError
from valvefsi.geometry.flow_shapes import two_leaflets
from valvefsi.geometry.polygon_gap import gap

WORLD = MPI.COMM_WORLD
VALUES = defaults(PARAMETERS)
CELLS, KERNEL = 32, "bspline3"
SIZE = VALUES["thickness"], VALUES["length"]
SQUARE = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])


@pytest.fixture(scope="module")
def built():
    return valve_2d.build(CELLS, KERNEL, VALUES, WORLD)[0]


@pytest.fixture(scope="module")
def nodes(built):
    """Places of all nodes."""
    solid = built.bodies[0].solid
    return gathered(solid, WORLD, solid.X)


def leaflets(nodes):
    """The lower and the upper one."""
    return [leaflet_of(nodes, SIZE, upper=upper) for upper in (False, True)]


def test_leaflets_have_their_size_and_face_each_other(built, nodes):
    (lower, upper), solid = leaflets(nodes), built.bodies[0].solid
    area = VALUES["thickness"] * VALUES["length"]
    assert solid.reference_volume == pytest.approx(2.0 * area, rel=1e-12)
    np.testing.assert_allclose(nodes[lower.tip, :2], (ROOT, 0.7), atol=1e-12)
    np.testing.assert_allclose(nodes[upper.tip, :2], (ROOT, HEIGHT - 0.7), atol=1e-12)
    assert gap(*(nodes[leaf.outline, :2] for leaf in (lower, upper))) == pytest.approx(0.21)
    for leaf, wall in ((lower, 0.0), (upper, HEIGHT)):
        x, y = nodes[leaf.outline, :2].T
        assert 0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) == pytest.approx(area, rel=1e-12)
        assert np.sum(np.abs(nodes[leaf.nodes, 1] - wall) < 1e-12) == 3, "a quadratic element at the root"


def test_the_upper_leaflet_is_the_mirror_image_of_the_lower_one(nodes):
    lower, upper = (nodes[leaf.nodes, :2] for leaf in leaflets(nodes))
    upper = upper * (1.0, -1.0) + (0.0, HEIGHT)
    assert np.abs(upper[:, None] - lower).sum(axis=2).min(axis=1).max() < 1e-12


def test_the_finest_cells_cover_what_the_leaflets_sweep_and_the_box_is_whole():
    grid = valve_2d.channel(92, WORLD)
    np.testing.assert_allclose(grid.upper[:2] - grid.lower[:2], (8.0, HEIGHT))
    assert grid.uniform[1]
    assert grid.fine[0][0] <= 1.6 + 1e-9
    assert grid.fine[0][1] >= 2.8 - 1e-9
    assert grid.spacing[0] == pytest.approx(HEIGHT / 92, rel=0.02)


@pytest.mark.parametrize(
    ("other", "known"),
    [
        (SQUARE + (1.5, 0.0), 0.5),
        (SQUARE + (1.3, 1.4), 0.5),
        (SQUARE * (0.5, 0.4) + (0.9, 0.3), -0.1),
        (SQUARE * (0.2, 0.2) + (0.3, 0.4), -0.4),
        (SQUARE * (3.0, 0.2) + (-1.0, 0.4), 0.0),
        (np.array([(1.2, 0.5), (2.0, 0.0), (2.0, 1.0)]), 0.2),
    ],
    ids=["beside", "across a corner", "one end inside", "wholly inside", "a cross", "corner to edge"],
)
def test_the_gap_of_known_shapes(other, known):
    assert gap(SQUARE, other) == pytest.approx(known, abs=1e-12)
    assert gap(other[::-1], SQUARE) == pytest.approx(known, abs=1e-12)


def stiffness(nu_stab):
    """Tip force over tip displacement of the lower leaflet, clamped in vacuum, in that of a plate, 3 E' I / L^3."""
    thickness, length = VALUES["thickness"], VALUES["length"]
    plate = VALUES["E"] / (1.0 - VALUES["nu"] ** 2)
    mesh = two_leaflets(MPI.COMM_SELF, root=ROOT, height=HEIGHT, size=(thickness, length), elements=(1, 20))
    solid = valve_2d.solid_of(mesh, VALUES | {"nu_stab": nu_stab})
    free = np.flatnonzero((solid.X[:, 1] > 1e-9) & (solid.X[:, 1] < 0.5 * HEIGHT))
    K, nudge, rest = np.zeros((2 * len(free), 2 * len(free))), 1e-6, np.zeros_like(solid.X)
    for k, (node, axis) in enumerate((node, axis) for node in free for axis in (0, 1)):
        moved = np.zeros_like(solid.X)
        moved[node, axis] = nudge
        forth, back = (solid.force(solid.X + part * moved, rest, 0.0).copy() for part in (1.0, -1.0))
        K[:, k] = (back - forth)[free, :2].ravel() / (2.0 * nudge)
    end = np.flatnonzero(solid.X[free, 1] > length - 1e-9)
    aside = np.abs(solid.X[free][end, 0] - ROOT)
    load = np.zeros((len(free), 2))
    load[end, 0] = np.where(aside < 1e-9, 4.0, 1.0) / 6.0
    tip = np.linalg.solve(K, load.ravel()).reshape(-1, 2)[end[np.argmin(aside)], 0]
    return length**3 / (3.0 * plate * thickness**3 / 12.0) / tip


def test_a_leaflet_bends_as_the_published_plate_without_help_of_the_fluid():
    """The fluid keeps the volume of what its kernels see, not of the two halves of a leaflet thinner than they are."""
    assert stiffness(VALUES["nu_stab"]) == pytest.approx(1.0, abs=0.02)
    assert stiffness(0.4) == pytest.approx(2.0 * 0.25 / (1.0 - 0.4), rel=0.02), (
        "as a plate of Poisson's ratio 0.4"
    )


def march(factor, steps, folder):
    """A run of so many steps, each so many times as long as the benchmark's."""
    benchmark = Valve2D(cells=CELLS, overrides=[f"share={factor * VALUES['share']}"])
    dt = benchmark.simulation(CELLS, folder, WORLD)[0].schedule.dt
    simulation, sights, _ = replace(benchmark, t_end=steps * dt).simulation(CELLS, folder, WORLD)
    return attempt(simulation, Job(folder=folder, comm=WORLD)), sights, dt


def test_both_leaflets_bend_downstream_alike_and_their_roots_stay(nodes, shared_tmp):
    done, sights, dt = march(1.0, 150, shared_tmp)
    assert done.failed is None
    assert done.steps in (150, 151)
    last = {name: column[-1] for name, column in done.history.items()}
    assert last["upper_dx_cm"] > 0.01
    assert last["upper_dx_cm"] == pytest.approx(last["lower_dx_cm"], abs=1e-9)
    assert last["upper_dy_cm"] == pytest.approx(-last["lower_dy_cm"], abs=1e-9)
    assert max(1.0 - last["leaflets_J_min"], last["leaflets_J_max"] - 1.0) < 0.05
    assert [s.t for s in sights.snapshots] == pytest.approx(valve_2d.snapshot_times(150 * dt), abs=dt)
    for outline, leaf in zip(sights.snapshots[-1].outlines, leaflets(nodes), strict=True):
        ends = nodes[leaf.outline[[0, -1]], :2]
        assert np.abs(outline[[0, -1]] - ends).max() < 1e-12, "the walls hold their ends"


def test_a_run_that_breaks_down_says_why_and_keeps_its_record(shared_tmp):
    done, *_ = march(40.0, 100, shared_tmp)
    assert 0 < done.steps < 100
    assert done.failed
    assert len(done.history["t_s"]) >= 1


def test_extremes_are_read_off():
    t = np.linspace(0.0, 1.0, 101)
    h = dict.fromkeys((*COLUMNS, "leaflets_area_change_percent"), 0.0 * t)
    h |= {"t_s": t, "upper_dx_cm": np.sin(2 * np.pi * t), "gap_cm": 0.2 + t, "leaflets_J_min": 1.0 - 0.1 * t}
    h |= {"lower_dx_cm": h["upper_dx_cm"] - 0.01, "leaflets_area_change_percent": -2.0 * t}
    found = numbers(h | {"leaflets_J_max": 1.0 + 0.05 * t})
    assert found["largest_J_off"] == pytest.approx(0.1)
    assert found["max_dx"] == pytest.approx(1.0)
    assert found["t_max_dx"] == pytest.approx(0.25)
    assert found["smallest_gap"] == pytest.approx(0.2)
    assert found["asymmetry"] == pytest.approx(0.01)
    assert found["area_change"] == pytest.approx(-0.02)


def test_a_run_shorter_than_a_period_or_of_other_leaflets_is_not_compared():
    assert Valve2D().comparable
    assert not Valve2D(t_end=0.5).comparable
    assert not Valve2D(overrides=["E=1e7"]).comparable


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"overrides": ["thicknes=0.1"]}, "thickness"),
        ({"overrides": ["length='1 cm'"]}, "overlap"),
        ({"kernel": "ib7"}, "--kernel = 'ib7': expected one of"),
        ({"t_end": 0.0}, "above 0"),
    ],
)
def test_what_cannot_be_used_is_refused(options, message):
    with pytest.raises(CaseError, match=message):
        Valve2D(**options)
