"""A flag behind a cylinder: shapes, clamp, forces, the reduction of signals, restart, what the command writes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from tests.coupled_case import moved
from valvefsi import fsi
from valvefsi.benchmarks.frame import Job
from valvefsi.benchmarks.immersed import turek
from valvefsi.benchmarks.immersed.turek import (
    CENTRE,
    CLAMP,
    CORE,
    HEIGHT,
    LENGTH,
    RADIUS,
    ROOT,
    SIGNALS,
    THICKNESS,
    TIP,
    TurekFsi,
    build,
    channel,
    cylinder_points,
    inflow,
    plate_modulus,
)
from valvefsi.benchmarks.running import attempt
from valvefsi.errors import CaseError
from valvefsi.post.diagnostics.signals import oscillation, whole_periods
from valvefsi.run.forces import ForceMeter, ForceOutput

WORLD = MPI.COMM_WORLD
QUICK = ("ramp='40 ms'",)
SHORT = TurekFsi(cells=2, overrides=QUICK)
VALUES = SHORT.values
BOTH = (ForceOutput(name="bodies", bodies=(0, 1)),)


@pytest.fixture(scope="module")
def built():
    return build(2, SHORT.kernel, VALUES, WORLD)


def test_the_flag_has_its_size_and_its_tip_is_at_a(built):
    flag = built[0].bodies[0].solid
    assert flag.reference_volume == pytest.approx(THICKNESS * (TIP - ROOT), rel=1e-12)
    held = flag.tether_report()[0].measure
    assert held == pytest.approx(THICKNESS * (CLAMP - ROOT), rel=1e-12)
    assert math.hypot(CLAMP - CENTRE[0], 0.5 * THICKNESS) == pytest.approx(RADIUS)
    tip = flag.position_of(flag.node_at((TIP, CENTRE[1])), flag.X)
    np.testing.assert_allclose(tip, (60.0, 20.0, 0.5), atol=1e-12)


def test_the_points_fill_the_cylinder_but_not_the_flag():
    X, area = cylinder_points(0.25)
    strip = THICKNESS * (CLAMP - ROOT)  # and the sliver between its end and the circle
    assert area.sum() == pytest.approx(math.pi * RADIUS**2 - strip, rel=5e-3)
    assert np.hypot(*(X[:, :2] - CENTRE).T).max() < RADIUS
    assert not np.any((X[:, 0] > ROOT) & (np.abs(X[:, 1] - CENTRE[1]) < 0.5 * THICKNESS))


@pytest.mark.parametrize("cells", [2, 3, 4, 8, 12])
def test_the_finest_cells_cover_cylinder_and_swept_region(cells):
    grid = channel(cells, WORLD)
    np.testing.assert_allclose(grid.upper[:2] - grid.lower[:2], (LENGTH, HEIGHT))
    for axis, (low, high) in enumerate(CORE):
        assert grid.fine[axis][0] <= low + 1e-9
        assert grid.fine[axis][1] >= high - 1e-9
        assert grid.spacing[axis] == pytest.approx(THICKNESS / cells, rel=0.02)


def test_the_inflow_is_a_parabola_of_mean_u_that_starts_smoothly():
    velocity = inflow(VALUES)
    y = (np.arange(1000) + 0.5) * HEIGHT / 1000
    zero = np.zeros_like(y)
    assert velocity(zero, y, zero, 0.0)[0].max() == 0.0
    assert velocity(zero, y, zero, 0.02)[0].mean() == pytest.approx(0.5 * VALUES["U"], rel=1e-5)
    full = velocity(zero, y, zero, 1.0)[0]
    assert full.mean() == pytest.approx(VALUES["U"], rel=1e-5)
    assert full.max() == pytest.approx(1.5 * VALUES["U"], rel=1e-5)


def test_the_plate_is_as_stiff_as_the_published_one():
    E = 2.0 * 2e7 * 1.4
    assert modulus() == pytest.approx(E / (4.0 * (1.0 - 0.4**2)))
    assert modulus("nu=0.5") == pytest.approx(2e7)
    assert TurekFsi(case="fsi2").values["mu_s"] == 5e6


def modulus(*overrides):
    return plate_modulus(TurekFsi(overrides=overrides).values)


def test_the_inflow_drags_and_the_clamp_stays(built, shared_tmp):
    dt = built[1]
    benchmark = replace(SHORT, t_end=200 * dt)
    simulation, *_ = benchmark.simulation(2, shared_tmp, WORLD)
    simulation.output = replace(simulation.output, history_every=20)
    h = attempt(simulation, Job(folder=shared_tmp, comm=WORLD)).history
    drag, lift = (h[SIGNALS[key][0]][1:] for key in ("drag", "lift"))
    assert np.isfinite(drag).all()
    assert drag.mean() > 0.0, "it rings along x, with the mass of the flag"
    assert drag[:5].min() > 0.0, "while the flow grows"
    assert np.abs(lift).max() < 0.05 * drag.max()
    assert h["clamp_cm"].max() < 0.1
    assert max(1.0 - h["flag_J_min"].min(), h["flag_J_max"].max() - 1.0) < 0.05
    assert h["u_x_tip_cm"].max() > 0.0


def force(model, state, later):
    """The mean force between two states."""
    meter = ForceMeter(model, BOTH)
    meter.row(state)
    meter.keep()
    found = meter.row(later)
    return [found[SIGNALS[key][0]] for key in ("drag", "lift")]


def test_forces_come_from_what_holds_the_bodies_and_the_momentum_of_the_flag(built):
    """The flag moving as a whole at a speed that grows by a dt feels rho A a from the fluid."""
    model, dt = built
    state, u = fsi.initial_state(model, dt), model.grid.zero_faces()
    u[0][...] = 30.0
    given = 0.01 * np.array([[-1.0, 3.0, 0.0, 0.0], [-7.0, 2.0, 0.0, 0.0]])
    drag, lift = force(model, state, replace(state, t=0.01, u=u, given=given))
    inertia = VALUES["rho"] * THICKNESS * (TIP - ROOT) * 30.0 / 0.01
    assert drag == pytest.approx(inertia + 8.0, rel=1e-12)
    assert lift == pytest.approx(-5.0, abs=1e-6)


def test_a_heavy_flag_takes_the_force_that_its_whole_mass_needs():
    """At a speed that grows by a dt the flag of FSI2 feels rho_s A a."""
    model, dt = build(2, SHORT.kernel, TurekFsi(case="fsi2", cells=2).values, WORLD)
    state, u = fsi.initial_state(model, dt), model.grid.zero_faces()
    u[0][...] = 30.0
    faster = moved(state, V=0.0 * state.bodies[0]["V"] + (30.0, 0.0, 0.0))
    excess = model.bodies[0].excess_momentum(faster.bodies[0])  # given by the fluid
    given = np.array([[*-excess, 0.0], np.zeros(4)])
    drag, _ = force(model, state, replace(faster, t=0.01, u=u, given=given))
    assert drag == pytest.approx(10.0 * THICKNESS * (TIP - ROOT) * 30.0 / 0.01, rel=1e-12)


def test_a_steady_case_is_compared_by_its_means_alone(shared_tmp):
    result = TurekFsi(case="fsi1", cells=2, t_end=0.02).run(out=shared_tmp)
    references = [line["reference"] for line in result["table"][:12]]
    assert references == [0.0227, None, None, 0.8209, None, None, 14.295, None, None, 0.7638, None, None]


def test_mean_amplitude_and_frequency_of_a_known_signal():
    t = np.linspace(0.0, 6.0, 6001)
    uy = 1.5 + 34.0 * (1.0 - np.exp(-3.0 * t)) * np.sin(2.0 * np.pi * 5.3 * t)
    begin, end, count = whole_periods(t, uy)
    assert count == 5
    assert end - begin == pytest.approx(5 / 5.3, rel=1e-5)
    assert oscillation(t, uy, (begin, end, count)) == pytest.approx((1.5, 34.0, 5.3), rel=1e-3)
    ux = -2.7 + 2.5 * np.cos(2.0 * np.pi * 10.6 * t) + 0.3 * np.cos(2.0 * np.pi * 5.3 * t)
    mean, amplitude, frequency = oscillation(t, ux, (begin, end, count))
    assert frequency == pytest.approx(10.6, rel=1e-3)
    assert mean + amplitude == pytest.approx(ux.max(), abs=0.01)
    assert mean - amplitude == pytest.approx(ux.min(), abs=0.01)
    whole = whole_periods(t, uy + 2.0 * np.random.default_rng(1).standard_normal(len(t)))
    assert whole[2] / (whole[1] - whole[0]) == pytest.approx(5.3, rel=0.01), "noise is no period"
    noisy = uy + 10.0 * np.sin(2.0 * np.pi * 217.0 * t)
    assert oscillation(t, noisy, (begin, end, count))[1] == pytest.approx(34.0, rel=0.01)


def test_a_record_without_a_period_has_no_frequency():
    t = np.linspace(0.0, 1.0, 101)
    assert whole_periods(t, t) is None
    mean, amplitude, frequency = oscillation(t, t, None)
    assert (mean, amplitude) == pytest.approx((0.75, 0.25))
    assert math.isnan(frequency)


def test_a_resumed_run_ends_where_the_whole_run_does(built, shared_tmp, monkeypatch):
    _, dt = built
    monkeypatch.setattr(turek, "SAVED", 1)
    histories = {}
    for name, times in {"whole": (24,), "parts": (12, 24)}.items():
        for steps in times:
            simulation, *_ = replace(SHORT, t_end=steps * dt).simulation(2, shared_tmp / name, WORLD)
            job = Job(folder=shared_tmp / name, comm=WORLD, resume=name == "parts" and steps == 24)
            done = attempt(simulation, job)
            assert (done.failed, done.steps) == (None, 12 if name == "parts" else 24)
        histories[name] = done.history
    whole, parts = histories["whole"], histories["parts"]
    assert parts["t_s"][-1] == pytest.approx(whole["t_s"][-1], rel=1e-12)
    for column in ("u_x_tip_cm", "u_y_tip_cm"):
        np.testing.assert_allclose(parts[column][-1], whole[column][-1], rtol=1e-9, atol=1e-14)
    other, *_ = replace(SHORT, overrides=("ramp='21 ms'",)).simulation(2, shared_tmp / "parts", WORLD)
    with pytest.raises(CaseError, match="another run"):
        attempt(other, Job(folder=shared_tmp / "parts", comm=WORLD, resume=True))


def test_a_run_that_breaks_down_says_why_and_keeps_its_record(built, shared_tmp):
    simulation, *_ = SHORT.simulation(2, shared_tmp, WORLD)
    steps = 40 * simulation.schedule.dt
    simulation.schedule = replace(simulation.schedule, dt=steps, t_end=100 * steps)
    simulation.output = replace(simulation.output, history_every=1)
    done = attempt(simulation, Job(folder=shared_tmp, comm=WORLD))
    assert done.failed
    assert done.outcome is None
    assert len(done.history["t_s"]) >= 1


def test_published_numbers_are_compared_with_where_the_flag_is_the_published_one():
    assert turek.published("fsi3")["ux"] == (-2.69, 2.53, 10.9)
    assert TurekFsi(case="fsi2").comparable
    light = TurekFsi(case="fsi2", overrides=["rho_s=1"])
    assert not light.comparable, "without its own density FSI2 is not compared"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"overrides": ["rho_s=0.5"]}, "rho_s = 0.5: expected the fluid's density"),
        ({"kernel": "ib7"}, "--kernel = 'ib7': expected one of"),
        ({"t_end": 0.0}, "above 0"),
        ({"overrides": ["rampp=1"]}, "ramp"),
        ({"overrides": ["nu=0.6"]}, "at most"),
    ],
)
def test_what_cannot_be_used_is_refused(options, message):
    with pytest.raises(CaseError, match=message):
        TurekFsi(**options)
