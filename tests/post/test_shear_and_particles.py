"""Viscous shear stress and particles in velocities of closed form."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from tests.ordering import assert_order
from valvefsi.post.diagnostics.particles import Particles, Written, seeds_on_disk
from valvefsi.post.diagnostics.shear import cell_gradient, shear_stress, volume_percentiles

MU = 0.035


def box(cells=(24, 24, 24), low=-1.0, high=1.0, grade=0.0):
    """Edges and centres of cells, wider away from the middle where graded."""
    edges = []
    for n in cells:
        s = np.linspace(low, high, n + 1)
        edges.append(s + grade * s**3)
    return tuple(edges), [0.5 * (e[1:] + e[:-1]) for e in edges]


def written(t, velocity, cells=(24, 24, 24), **shape):
    """A velocity written in cells with its shear stress."""
    edges, centres = box(cells, **shape)
    x = np.stack(np.meshgrid(*centres, indexing="ij"), axis=-1)
    u = velocity(x, t)
    tau = shear_stress(cell_gradient(u, centres), MU)
    return Written(t=t, edges=edges, values=np.concatenate([u, tau[..., None]], axis=-1))


def couette(x, t):
    return np.stack([7.0 * x[..., 1], 0 * x[..., 0], 0 * x[..., 0]], axis=-1)


def rotation(x, t):
    return 2 * np.pi * np.stack([-x[..., 1], x[..., 0], 0 * x[..., 0]], axis=-1)


def poiseuille(x, t):
    return np.stack([0 * x[..., 0], 0 * x[..., 0], 4.0 * (1 - x[..., 0] ** 2 - x[..., 1] ** 2)], axis=-1)


@pytest.mark.parametrize("grade", [0.0, 0.3])
def test_simple_shear_has_mu_times_its_rate_and_rotation_none(grade):
    assert written(0.0, couette, grade=grade).values[..., 3] == pytest.approx(7.0 * MU, rel=1e-12)
    assert np.abs(written(0.0, rotation, grade=grade).values[..., 3]).max() < 1e-12


def test_stretching_has_the_stress_of_its_strain_rates():
    """u = (a x, -a y, 0): 2 S:S = 4 a^2, the stress of the simple shear that it is at 45 degrees."""

    def stretched(x, t):
        return 3.0 * np.stack([x[..., 0], -x[..., 1], 0 * x[..., 0]], axis=-1)

    assert written(0.0, stretched).values[..., 3] == pytest.approx(2 * 3.0 * MU, rel=1e-12)


def test_the_shear_of_a_pipe_is_that_of_its_parabola():
    _edges, centres = box()
    x = np.stack(np.meshgrid(*centres, indexing="ij"), axis=-1)
    tau = written(0.0, poiseuille).values[..., 3]
    assert tau == pytest.approx(MU * 8.0 * np.hypot(x[..., 0], x[..., 1]), abs=1e-12)


@pytest.mark.parametrize("grade", [0.0, 0.3])
def test_percentiles_go_by_the_volume_of_the_cells(grade):
    edges, centres = box((96, 4, 4), grade=grade)
    x = np.broadcast_to(centres[0][:, None, None], (96, 4, 4))
    inside = np.broadcast_to(centres[1][:, None] > 0.0, (96, 4, 4))
    half, most, largest = volume_percentiles(x, edges, inside, (0.5, 0.95, 1.0))
    width = float(np.diff(edges[0]).max())
    low, high = edges[0][[0, -1]]
    assert half == pytest.approx(0.5 * (low + high), abs=width)
    assert most == pytest.approx(low + 0.95 * (high - low), abs=width)
    assert largest == centres[0][-1]


def test_a_particle_goes_round_once_without_a_dose():
    frame = [written(t, rotation) for t in (0.0, 1.0)]
    particles = Particles(np.array([[0.5, 0.0, 0.1], [0.0, -0.8, -0.3]]))
    start = particles.x.copy()
    particles.advance(*frame)
    assert particles.x == pytest.approx(start, abs=2e-5)
    assert np.abs(particles.dose).max() < 1e-11
    assert particles.age == pytest.approx(1.0)


def test_the_dose_in_a_pipe_is_its_shear_over_the_time():
    """A particle at r bears mu 8 r for as long as it drifts."""
    frames = [written(t, poiseuille) for t in (0.0, 0.05, 0.1)]
    x, y, _ = frames[0].edges
    seeds = np.array([[0.5 * (x[k] + x[k + 1]), 0.5 * (y[12] + y[13]), -0.9] for k in (12, 16, 21)])
    particles = Particles(seeds)
    for pair in itertools.pairwise(frames):
        particles.advance(*pair)
    r2 = seeds[:, 0] ** 2 + seeds[:, 1] ** 2
    assert particles.x[:, 2] - seeds[:, 2] == pytest.approx(0.1 * 4 * (1 - r2), rel=1e-9)
    assert particles.dose == pytest.approx(0.1 * MU * 8 * np.sqrt(r2), rel=1e-9)


def test_the_dose_of_a_field_that_changes_along_the_path_is_its_integral():
    """Along z = -0.5 + 8 t the field z/10 has the integral of that."""
    edges, centres = box((4, 4, 24))
    z = np.broadcast_to(centres[2], (4, 4, 24))
    values = np.stack([0 * z, 0 * z, 8.0 + 0 * z, z / 10], axis=-1)
    particles = Particles(np.array([[0.0, 0.0, -0.5]]))
    particles.advance(*(Written(t=t, edges=edges, values=values) for t in (0.0, 0.1)))
    assert particles.x[0, 2] == pytest.approx(0.3)
    assert particles.dose[0] == pytest.approx((-0.5 * 0.1 + 8 * 0.1**2 / 2) / 10, rel=1e-9)


def test_the_dose_converges_with_the_cells():
    """Between the centres of cells interpolation is of second order; on the axis the shear has a kink."""
    seeds = seeds_on_disk(0.8, -0.9, 200)[20:]
    r = np.hypot(*seeds[:, :2].T)

    def error(cells):
        frames = [written(t, poiseuille, (cells, cells, 12)) for t in (0.0, 0.1)]
        particles = Particles(seeds)
        particles.advance(*frames)
        height = np.abs(particles.x[:, 2] + 0.9 - 0.4 * (1 - r**2)).mean()
        return height + np.abs(particles.dose - 0.1 * MU * 8 * r).mean()

    assert_order(error, (12, 24, 48), order=1.8, below=4e-4)


def test_a_velocity_that_grows_between_two_times_is_linear_there():
    def growing(x, t):
        return np.broadcast_to([0.6 * t, 0.0, 0.0], (*x.shape[:-1], 3))

    frames = [written(t, growing) for t in (0.0, 1.0)]
    particles = Particles(np.zeros((1, 3)))
    particles.advance(*frames)
    assert particles.x[0] == pytest.approx([0.3, 0.0, 0.0], abs=1e-12)
    late = Particles(np.zeros((1, 3)))
    late.advance(*frames, since=0.5)
    assert late.x[0, 0] == pytest.approx(0.3 * (1 - 0.25), abs=1e-12)
    assert late.age == pytest.approx(0.5)


def test_a_particle_that_leaves_the_box_is_left_there():
    frames = [written(t, poiseuille) for t in (0.0, 1.0, 2.0)]
    particles = Particles(np.array([[0.0, 0.0, 0.9], [0.9, 0.0, -0.9]]))
    particles.advance(*frames[:2])
    assert list(particles.inside) == [False, True]
    left, dose = particles.x[0].copy(), particles.dose[0]
    particles.advance(*frames[1:])
    assert particles.x[0] == pytest.approx(left)
    assert particles.dose[0] == dose
    assert 0.02 < particles.age[0] < 0.06


def test_a_velocity_beyond_reason_is_refused():
    frames = [written(t, lambda x, t: 1e6 + 0 * x) for t in (0.0, 1.0)]
    with pytest.raises(ValueError, match="steps of the particles from t = 0 s to 1 s"):
        Particles(np.zeros((1, 3))).advance(*frames)


def test_seeds_stand_for_equal_parts_of_a_disk():
    seeds = seeds_on_disk(1.2, -0.5, 400)
    r = np.hypot(seeds[:, 0], seeds[:, 1])
    assert (seeds[:, 2] == -0.5).all()
    assert (r < 1.2).all()
    for inner in (0.4, 0.8, 1.1):
        assert (r < inner).mean() == pytest.approx((inner / 1.2) ** 2, abs=0.01)
    assert np.abs(seeds[:, :2].mean(axis=0)).max() < 0.01
