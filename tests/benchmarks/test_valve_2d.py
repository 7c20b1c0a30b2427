"""Two leaflets in a channel: their mesh and stiffness, the gap, their roots, a few steps, what the command writes."""

from __future__ import annotations

import json

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.benchmarks import valve_2d
from valvefsi.benchmarks.parameters import defaults
from valvefsi.benchmarks.polygon_gap import gap
from valvefsi.benchmarks.valve_2d import COLUMNS, HEIGHT, PARAMETERS, ROOT, Setup, Watch, numbers
from valvefsi.coupling.kernels import KERNELS
from valvefsi.errors import CaseError, StabilityError

WORLD = MPI.COMM_WORLD
VALUES = defaults(PARAMETERS)
CELLS, KERNEL = 32, "bspline3"
SQUARE = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])


@pytest.fixture(scope="module")
def built():
    return valve_2d.build(CELLS, KERNEL, VALUES, WORLD)


def test_leaflets_have_their_size_and_face_each_other(built):
    model, _, _ = built
    watch, solid = Watch(model, VALUES), model.bodies[0].solid
    area = VALUES["thickness"] * VALUES["length"]
    assert solid.reference_volume == pytest.approx(2.0 * area, rel=1e-12)
    np.testing.assert_allclose(watch.X[watch.lower.tip, :2], (ROOT, 0.7), atol=1e-12)
    np.testing.assert_allclose(watch.X[watch.upper.tip, :2], (ROOT, HEIGHT - 0.7), atol=1e-12)
    assert gap(*(watch.X[leaf.outline, :2] for leaf in (watch.lower, watch.upper))) == pytest.approx(0.21)
    for leaf in (watch.lower, watch.upper):
        x, y = watch.X[leaf.outline, :2].T
        assert 0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) == pytest.approx(area, rel=1e-12)
        assert len(leaf.root) == 3
        np.testing.assert_allclose(watch.X[leaf.root, 1], HEIGHT if leaf is watch.upper else 0.0, atol=1e-12)


def test_the_upper_leaflet_is_the_mirror_image_of_the_lower_one(built):
    watch = Watch(built[0], VALUES)
    lower, upper = (watch.X[leaf.nodes, :2] for leaf in (watch.lower, watch.upper))
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
    mesh = valve_2d.leaflets(MPI.COMM_SELF, size=(thickness, length), elements=(1, 20))
    solid = valve_2d.solid_of(mesh, VALUES | {"nu_stab": nu_stab}, KERNEL)
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


def test_both_leaflets_bend_downstream_alike_and_their_roots_stay(built):
    model, dt, _ = built
    watch = Watch(model, VALUES)
    steps, failed = valve_2d.march(model, dt, 150 * dt, watch)
    assert failed is None
    assert steps in (150, 151)
    last = dict(zip(COLUMNS, watch.rows[-1], strict=True))
    assert last["upper_dx"] > 0.01
    assert last["upper_dx"] == pytest.approx(last["lower_dx"], abs=1e-9)
    assert last["upper_dy"] == pytest.approx(-last["lower_dy"], abs=1e-9)
    assert last["J_off"] < 0.05
    assert [s["t"] for s in watch.snapshots] == pytest.approx(valve_2d.snapshot_times(150 * dt), abs=dt)
    lower, upper = watch.snapshots[-1]["outlines"]
    ends = [leaf.outline[[0, -1]] for leaf in (watch.lower, watch.upper)]
    for outline, root in zip((lower, upper), ends, strict=True):
        assert np.abs(outline[[0, -1]] - watch.X[root, :2]).max() < 1e-12, "the walls hold their ends"


def test_a_run_that_breaks_down_says_why_and_keeps_its_record(built):
    model, dt, _ = built
    watch = Watch(model, VALUES)
    steps, failed = valve_2d.march(model, 40.0 * dt, 4000.0 * dt, watch)
    assert 0 < steps < 100
    assert failed
    assert len(watch.rows) >= 1
    bad = fsi.initial_state(model, dt)
    bad.u[0][...] = np.nan
    with pytest.raises(StabilityError, match="smaller share"):
        watch.record(bad)


def test_extremes_are_read_off():
    t = np.linspace(0.0, 1.0, 101)
    row = dict.fromkeys(COLUMNS, 0.0 * t) | {"t": t, "upper_dx": np.sin(2 * np.pi * t), "gap": 0.2 + t}
    row["lower_dx"] = row["upper_dx"] - 0.01
    row["area_change"] = -0.02 * t
    found = numbers(np.stack([row[name] for name in COLUMNS], axis=1))
    assert found["max_dx"] == pytest.approx(1.0)
    assert found["t_max_dx"] == pytest.approx(0.25)
    assert found["smallest_gap"] == pytest.approx(0.2)
    assert found["asymmetry"] == pytest.approx(0.01)
    assert found["area_change"] == pytest.approx(-0.02)


def test_the_command_writes_its_files(shared_tmp):
    setup = Setup(cells=CELLS, t_end=0.002, overrides=["nu_stab=0.4"])
    result = valve_2d.run(setup, out=shared_tmp)
    if WORLD.rank == 0:
        assert json.loads((shared_tmp / "result.json").read_text())["benchmark"] == "valve-2d"
        with (shared_tmp / f"N{CELLS}" / "tip.csv").open() as lines:
            assert next(lines).strip() == ",".join(COLUMNS)
        for name in ("tips.png", "flow.png"):
            assert (shared_tmp / f"N{CELLS}" / name).stat().st_size > 10000
    assert result["table"][0]["reference"] is None, "a run shorter than a period is not compared"


def test_what_cannot_be_used_is_refused(shared_tmp):
    with pytest.raises(CaseError, match="thickness"):
        valve_2d.run(Setup(overrides=["thicknes=0.1"]), out=shared_tmp)
    with pytest.raises(CaseError, match="overlap"):
        valve_2d.run(Setup(overrides=["length='1 cm'"]), out=shared_tmp)
    with pytest.raises(CaseError, match="a kernel is one of"):
        Setup(kernel="ib7")
    with pytest.raises(CaseError, match="above 0"):
        Setup(t_end=0.0)
    assert KERNEL in KERNELS
