"""A flag behind a cylinder: shapes, clamp, forces, the reduction of signals, restart, what the command writes."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from tests.coupled_case import moved
from valvefsi import fsi
from valvefsi.benchmarks import turek
from valvefsi.benchmarks.turek import COLUMNS, Setup, Watch
from valvefsi.benchmarks.turek_model import (
    CENTRE,
    CLAMP,
    CORE,
    HEIGHT,
    LENGTH,
    RADIUS,
    ROOT,
    THICKNESS,
    TIP,
    build,
    channel,
    cylinder_points,
    inflow,
)
from valvefsi.benchmarks.turek_signals import oscillation, whole_periods
from valvefsi.errors import CaseError, StabilityError
from valvefsi.run.recording import Output

WORLD = MPI.COMM_WORLD
QUICK = ("ramp='40 ms'",)
SETUP = Setup(cells=2, overrides=QUICK)
VALUES = SETUP.values()


@pytest.fixture(scope="module")
def built():
    return build(2, SETUP.kernel, VALUES, WORLD)


@pytest.fixture(scope="module")
def ran(built):
    model, dt = built
    watch, state = Watch(model), fsi.initial_state(model, dt)
    watch.begin(state)
    for k in range(1, 201):
        state = fsi.step(model, state, dt)
        if k % 20 == 0:
            watch.record(state)
    return watch, state


def test_the_flag_has_its_size_and_its_tip_is_at_a(built):
    flag = built[0].bodies[0].solid
    assert flag.reference_volume == pytest.approx(THICKNESS * (TIP - ROOT), rel=1e-12)
    held = flag.tether_report()[0].measure
    assert held == pytest.approx(THICKNESS * (CLAMP - ROOT), rel=1e-12)
    assert math.hypot(CLAMP - CENTRE[0], 0.5 * THICKNESS) == pytest.approx(RADIUS)
    tip = flag.position_of(Watch(built[0]).tip, flag.X)
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
    assert Setup(case="fsi2").values()["mu_s"] == 5e6


def modulus(*overrides):
    from valvefsi.benchmarks.turek_model import plate_modulus

    return plate_modulus(Setup(overrides=overrides).values())


def test_the_stream_drags_and_the_clamp_stays(ran):
    watch, _ = ran
    h = dict(zip(COLUMNS, np.array(watch.rows).T, strict=True))
    assert np.isfinite(watch.rows).all()
    assert h["drag_dyn_per_cm"].mean() > 0.0, "it rings along x, with the mass of the flag"
    assert h["drag_dyn_per_cm"][:5].min() > 0.0, "while the stream grows"
    assert np.abs(h["lift_dyn_per_cm"]).max() < 0.05 * h["drag_dyn_per_cm"].max()
    assert h["clamp_cm"].max() < 0.1
    assert h["J_off"].max() < 0.05
    assert h["ux_cm"].max() > 0.0


def test_forces_come_from_what_holds_the_bodies_and_the_momentum_of_the_flag(built):
    """The flag moving as a whole at a speed that grows by a dt feels rho A a from the fluid."""
    model, dt = built
    watch, state = Watch(model), fsi.initial_state(model, dt)
    watch.begin(state)
    u = model.grid.zero_faces()
    u[0][...] = 30.0
    given = 0.01 * np.array([[-1.0, 3.0, 0.0, 0.0], [-7.0, 2.0, 0.0, 0.0]])
    found = watch.record(replace(state, t=0.01, u=u, given=given))
    inertia = VALUES["rho"] * THICKNESS * (TIP - ROOT) * 30.0 / 0.01
    assert found["drag_dyn_per_cm"] == pytest.approx(inertia + 8.0, rel=1e-12)
    assert found["lift_dyn_per_cm"] == pytest.approx(-5.0, abs=1e-6)


def test_a_heavy_flag_takes_the_force_that_its_whole_mass_needs():
    """At a speed that grows by a dt the flag of FSI2 feels rho_s A a."""
    values = Setup(case="fsi2", cells=2).values()
    model, dt = build(2, SETUP.kernel, values, WORLD)
    watch, state = Watch(model), fsi.initial_state(model, dt)
    watch.begin(state)
    u = model.grid.zero_faces()
    u[0][...] = 30.0
    V = 0.0 * state.bodies[0]["V"] + (30.0, 0.0, 0.0)
    state = moved(state, V=V)
    excess = model.bodies[0].excess_momentum(state.bodies[0])  # given by the fluid
    given = np.array([[*-excess, 0.0], np.zeros(4)])
    found = watch.record(replace(state, t=0.01, u=u, given=given))
    inertia = 10.0 * THICKNESS * (TIP - ROOT) * 30.0 / 0.01
    assert found["drag_dyn_per_cm"] == pytest.approx(inertia, rel=1e-12)


def test_a_steady_case_is_compared_by_its_means_alone(shared_tmp):
    result = turek.run(Setup(case="fsi1", cells=2, t_end=0.02), out=shared_tmp)
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
    rows = {}
    for name, times in {"whole": (24,), "parts": (12, 24)}.items():
        for steps in times:
            model, dt = build(2, SETUP.kernel, VALUES, WORLD)
            setup = Setup(cells=2, t_end=steps * dt, overrides=QUICK, resume=steps == 24 and len(times) > 1)
            output = Output(
                directory=shared_tmp / name, provenance=turek.provenance(setup, 2, setup.values())
            )
            watch, taken = Watch(model), []
            found = turek.march((model, dt), watch, setup, output, lambda *step, to=taken: to.append(step[0]))
            assert found == (steps, None)
            assert len(taken) == (12 if name == "parts" else 24)
        rows[name] = watch.rows
    assert [r[0] for r in rows["parts"]][-1] == pytest.approx(rows["whole"][-1][0], rel=1e-12)
    np.testing.assert_allclose(rows["parts"][-1][1:3], rows["whole"][-1][1:3], rtol=1e-9, atol=1e-14)
    other = Setup(cells=2, t_end=30 * dt, overrides=("ramp='21 ms'",), resume=True)
    output = Output(directory=shared_tmp / "parts", provenance=turek.provenance(other, 2, other.values()))
    with pytest.raises(CaseError, match="another run"):
        turek.march((model, dt), Watch(model), other, output)


def test_a_run_that_breaks_down_says_why(ran):
    watch, state = ran
    bad = fsi.initial_state(watch.model, state.dt)
    bad.u[0][...] = np.nan
    watch.count = 1
    with pytest.raises(StabilityError, match="smaller share"):
        watch.record(bad)


def test_the_command_writes_its_files(shared_tmp):
    result = turek.run(Setup(cells=2, t_end=0.003, overrides=QUICK), out=shared_tmp)
    if WORLD.rank == 0:
        assert json.loads((shared_tmp / "result.json").read_text())["benchmark"] == "turek-fsi"
        with (shared_tmp / "N2" / "history.csv").open() as lines:
            assert next(lines).strip() == ",".join(COLUMNS)
        for name in ("history.png", "vorticity.png"):
            assert (shared_tmp / "N2" / name).stat().st_size > 10000
    assert result["table"][0]["reference"] == -2.69
    assert turek.comparable(Setup(case="fsi2"), Setup(case="fsi2").values())
    light = Setup(case="fsi2", overrides=["rho_s=1"])
    assert not turek.comparable(light, light.values()), "without its own density FSI2 is not compared"


def test_what_cannot_be_used_is_refused():
    with pytest.raises(CaseError, match="a case is one of"):
        Setup(case="fsi4")
    with pytest.raises(CaseError, match=r"the fluid's density.*rho_s|rho_s.*the fluid's density"):
        Setup(overrides=["rho_s=0.5"]).values()
    with pytest.raises(CaseError, match="a kernel is one of"):
        Setup(kernel="ib7")
    with pytest.raises(CaseError, match="above 0"):
        Setup(t_end=0.0)
    with pytest.raises(CaseError, match="ramp"):
        Setup(overrides=["rampp=1"]).values()
    with pytest.raises(CaseError, match="at most"):
        Setup(overrides=["nu=0.6"]).values()
