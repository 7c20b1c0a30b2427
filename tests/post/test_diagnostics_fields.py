"""Flow, pressure, gradients, averages and profiles, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from valvefsi.fluid.boundary import Boundary
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.grid import MacGrid
from valvefsi.grid.grading import graded_edges
from valvefsi.post import diagnostics
from valvefsi.post.diagnostics import Averages, Section

GRADED = graded_edges([(0.0, 0.05), (0.5, 0.03), (1.0, 0.05)])


def make(dim, *, graded=False, periodic=False):
    if graded:
        return MacGrid.graded([GRADED] * dim, [periodic] * dim)
    return MacGrid([0] * dim, [1] * dim, [13, 12, 11][:dim], [periodic] * dim)


def linear(grid, matrix, shift=(0.0, 0.0, 0.0)):
    """u_d = shift_d + sum_a matrix[d, a] x_a on all faces, ghosts included."""
    faces = grid.zero_faces()
    for d in range(grid.dim):
        x = grid.points(d)
        faces[d][...] = shift[d] + sum(matrix[d, a] * x[a] for a in range(grid.dim))
    return faces


MATRIX = np.array([[1.0, -2.0, 0.5], [3.0, 0.25, -1.0], [-0.75, 2.0, -1.25]])


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("graded", [False, True])
def test_gradient_vorticity_and_q_are_exact_for_linear_fields(dim, graded):
    grid = make(dim, graded=graded)
    A = np.zeros((3, 3))
    A[:dim, :dim] = MATRIX[:dim, :dim]
    u = linear(grid, MATRIX)
    # next to a side a graded grid mirrors widths, the linear field does not care
    np.testing.assert_allclose(diagnostics.velocity_gradient(grid, u) - A, 0.0, atol=1e-11)
    spin = [A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]]
    np.testing.assert_allclose(diagnostics.vorticity(grid, u) - spin, 0.0, atol=1e-11)
    S, W = 0.5 * (A + A.T), 0.5 * (A - A.T)
    expected = 0.5 * ((W**2).sum() - (S**2).sum())
    np.testing.assert_allclose(diagnostics.q_criterion(grid, u), expected, atol=1e-10)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("graded", [False, True])
def test_dissipation_and_enstrophy_of_a_linear_field_fill_the_box(dim, graded):
    grid = make(dim, graded=graded)
    A = MATRIX[:dim, :dim]
    u = linear(grid, MATRIX)
    S = 0.5 * (A + A.T)
    assert diagnostics.dissipation(grid, u, 0.3) == pytest.approx(0.6 * (S**2).sum(), rel=1e-11)
    W = A - A.T
    assert diagnostics.enstrophy(grid, u) == pytest.approx(0.25 * (W**2).sum(), rel=1e-11)


@pytest.mark.parametrize("periodic", [True, False])
def test_viscosity_takes_from_the_energy_what_is_dissipated(periodic):
    """Without advection, over a step of Crank-Nicolson, up to what vanishes with the step."""
    grid = MacGrid([0, 0], [1, 1], [24, 20], [periodic] * 2)
    fluid = NavierStokes(grid, Boundary(grid), rho=1.3, mu=0.05)
    edge = lambda x, y: np.sin(np.pi * x) ** 2 * np.sin(np.pi * y) ** 2 * (1 + x * (1 - x) * (y < 2))  # noqa: E731
    u = grid.zero_faces()
    hx, hy = grid.spacing[:2]
    x, y, _ = grid.points(0)
    u[0][...] = (edge(x, y + hy / 2) - edge(x, y - hy / 2)) / hy
    x, y, _ = grid.points(1)
    u[1][...] = -(edge(x + hx / 2, y) - edge(x - hx / 2, y)) / hx
    u = fluid.fill(u, 0.0)
    zero, p, gaps = grid.zero_faces(), grid.zeros(), []
    for dt in (1e-3, 5e-4):
        new, q, t = u, p, 0.0
        for _ in range(4):  # the pressure settles
            old = new
            new, q = fluid.step(old, q, (zero, zero, 1.0), zero, t, dt)
            t += dt
        half = tuple(0.5 * (a + b) for a, b in zip(old, new, strict=True))
        lost = diagnostics.kinetic_energy(grid, old, 1.3) - diagnostics.kinetic_energy(grid, new, 1.3)
        gaps.append(abs(lost / (dt * diagnostics.dissipation(grid, half, 0.05)) - 1.0))
    assert gaps[0] < 1e-3
    assert gaps[1] < 0.6 * gaps[0] or gaps[1] < 1e-10


def test_budget_of_the_taylor_green_vortex_with_advection_closes():
    n, mu = 32, 0.02
    grid = MacGrid([0, 0], [2 * np.pi] * 2, [n, n], [True, True])
    fluid = NavierStokes(grid, Boundary(grid), rho=1.0, mu=mu)
    u = grid.zero_faces()
    for d, sign in ((0, 1.0), (1, -1.0)):
        x, y, _ = grid.points(d)
        u[d][...] = sign * (np.cos(x) * np.sin(y) if d == 0 else np.sin(x) * np.cos(y))
    u, p, dt = fluid.fill(u, 0.0), grid.zeros(), 0.01
    N_old, zero = fluid.advection(u), grid.zero_faces()
    assert diagnostics.kinetic_energy(grid, u, 1.0) == pytest.approx(np.pi**2, rel=1e-12)
    for k in range(5):
        N, old = fluid.advection(u), u
        u, p = fluid.step(u, p, (N, N_old, 1.0), zero, k * dt, dt)
        N_old = N
    half = tuple(0.5 * (a + b) for a, b in zip(old, u, strict=True))
    lost = diagnostics.kinetic_energy(grid, old, 1.0) - diagnostics.kinetic_energy(grid, u, 1.0)
    assert lost == pytest.approx(dt * diagnostics.dissipation(grid, half, mu), rel=1e-9)
    # 2 nu E of the continuous flow, up to (sin(h/2)/(h/2))^2 of the differences
    discrete = (np.sin(np.pi / n) / (np.pi / n)) ** 2
    E = diagnostics.kinetic_energy(grid, half, 1.0)
    assert diagnostics.dissipation(grid, half, mu) == pytest.approx(4.0 * mu * E * discrete, rel=1e-9)


@pytest.mark.parametrize("graded", [False, True])
def test_flow_through_planes_and_disks_of_a_uniform_stream_is_velocity_times_area(graded):
    grid = make(3, graded=graded)
    u = tuple(np.full(grid.shape, v) for v in (2.0, -3.0, 5.0))
    for axis, speed in enumerate((2.0, -3.0, 5.0)):
        for position in (0.0, 0.37, 1.0):
            plane = Section(axis=axis, position=position)
            assert diagnostics.flow(grid, u, plane) == pytest.approx(speed)
            disk = Section(axis=axis, position=position, centre=(0.41, 0.52, 0.6), radius=0.317)
            assert diagnostics.flow(grid, u, disk) == pytest.approx(speed * np.pi * 0.317**2, rel=1e-12)


def test_flow_through_a_part_of_a_plane_follows_small_moves_smoothly():
    grid = make(3)
    u = linear(grid, MATRIX, (0.0, 0.0, 1.0))
    radii = 0.3 + 1e-6 * np.arange(5)
    flows = [
        diagnostics.flow(grid, u, Section(axis=2, position=0.5, centre=(0.5, 0.5, 0), radius=r))
        for r in radii
    ]
    steps = np.diff(flows)
    assert np.ptp(steps) < 1e-3 * abs(steps.mean())


def test_in_two_dimensions_a_disk_is_an_interval():
    grid = make(2, graded=True)
    u = tuple(np.full(grid.shape, v) for v in (2.0, -3.0))
    part = Section(axis=0, position=0.5, centre=(0.5, 0.43), radius=0.2)
    assert diagnostics.flow(grid, u, part) == pytest.approx(0.8)


@pytest.mark.parametrize("graded", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_mean_pressure_of_a_linear_field_is_that_at_the_centre(graded, dim):
    grid = make(dim, graded=graded)
    x = grid.points()[0]
    p = np.broadcast_to(7.0 + 3.0 * x, grid.shape).copy()
    for position in (0.0, 0.31, 1.0):
        disk = Section(axis=0, position=position, centre=(0.0, 0.5, 0.5), radius=0.3)
        assert diagnostics.mean_pressure(grid, p, disk) == pytest.approx(7.0 + 3.0 * position, rel=1e-12)
        assert diagnostics.mean_pressure(grid, p, Section(axis=0, position=position)) == pytest.approx(
            7.0 + 3.0 * position, rel=1e-12
        )


def test_mean_pressure_wraps_around_a_periodic_box():
    grid = MacGrid([0, 0], [1, 1], [8, 8], [True, True])
    p = np.broadcast_to(np.cos(2 * np.pi * grid.points()[0]), grid.shape).copy()
    ends = [diagnostics.mean_pressure(grid, p, Section(axis=0, position=x)) for x in (0.0, 1.0)]
    assert ends[0] == pytest.approx(np.cos(np.pi / 8), rel=1e-12)
    assert ends[1] == pytest.approx(ends[0], rel=1e-12)


def test_sections_outside_the_box_are_refused():
    grid = make(2)
    for section in (
        Section(axis=2, position=0.5),
        Section(axis=0, position=1.5),
        Section(axis=0, position=0.5, centre=(0.5, 0.9), radius=0.2),
        Section(axis=0, position=0.5, centre=(0.5, 0.5)),
    ):
        with pytest.raises(ValueError):
            section.check(grid)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("graded", [False, True])
def test_profiles_are_exact_for_linear_fields(dim, graded):
    grid = make(dim, graded=graded)
    u = linear(grid, MATRIX, (1.0, 2.0, 3.0))
    points = diagnostics.line((0.0, 0.1, 0.9)[:dim], (1.0, 0.8, 0.2)[:dim], 23)
    expected = np.zeros((23, 3))
    expected[:, :dim] = np.array([1.0, 2.0, 3.0])[:dim] + points[:, :dim] @ MATRIX[:dim, :dim].T
    np.testing.assert_allclose(diagnostics.sample_velocity(grid, u, points), expected, atol=1e-12)
    x, y, _ = grid.points()
    field = np.broadcast_to(1.0 + 2.0 * x - y, grid.shape)[grid.owned]
    got = diagnostics.sample_cells(grid, field, points)
    np.testing.assert_allclose(got, 1.0 + 2.0 * points[:, 0] - points[:, 1], atol=1e-12)


def oscillating(grid, t):
    """Mean (1, 2) and fluctuation (3, 4) cos(2 pi t)."""
    c = np.cos(2.0 * np.pi * t)
    return tuple(np.full(grid.shape, m + a * c) for m, a in ((1.0, 3.0), (2.0, 4.0)))


def test_averages_over_periods_are_the_mean_and_half_the_variance():
    grid = MacGrid([0, 0], [1, 1], [8, 8], [True, True])
    averages = Averages(grid, start=1.0)
    for t in np.arange(0, 241) / 80.0:  # from t = 1 on: two periods
        averages.add(t, oscillating(grid, t), np.full(grid.shape, 6.0 + np.cos(2 * np.pi * t)))
    assert averages.time == pytest.approx(2.0)
    np.testing.assert_allclose(
        averages.mean, np.broadcast_to([1.0, 2.0, 0.0], averages.mean.shape), atol=1e-12
    )
    np.testing.assert_allclose(averages.kinetic_energy_of_turbulence, 0.25 * 25.0, rtol=1e-12)
    np.testing.assert_allclose(averages.pressure, 6.0, rtol=1e-12)


def test_averages_of_uneven_steps_weigh_each_sample_with_its_time_and_go_on_after_a_restart():
    grid = MacGrid([0, 0], [1, 1], [8, 8], [True, True])
    times = np.cumsum([0.0, 0.3, 0.1, 0.25, 0.02, 0.4])
    whole, first = Averages(grid), Averages(grid)
    for k, t in enumerate(times):
        whole.add(t, oscillating(grid, t), grid.zeros())
        if k < 3:
            first.add(t, oscillating(grid, t), grid.zeros())
    second = Averages(grid)
    second.restore({name: array.copy() for name, array in first.fields().items()}, first.meta())
    for t in times[3:]:
        second.add(t, oscillating(grid, t), grid.zeros())
    c, w = np.cos(2 * np.pi * times[1:]), np.diff(times)
    mean = (w * c).sum() / w.sum()
    tke = 0.5 * 25.0 * (w * (c - mean) ** 2).sum() / w.sum()
    np.testing.assert_allclose(whole.kinetic_energy_of_turbulence, tke, rtol=1e-12)
    np.testing.assert_array_equal(second.mean, whole.mean)
    np.testing.assert_array_equal(second.kinetic_energy_of_turbulence, whole.kinetic_energy_of_turbulence)


def test_the_reynolds_number_of_a_pipe():
    assert diagnostics.reynolds_number(404.0, 2.5, 1.0, 0.01) == pytest.approx(20576, rel=1e-4)
