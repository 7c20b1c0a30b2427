"""Motion in vacuum: closed forms, energy balance, orders in time, critical step, statics as the limit, ranks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mpi4py import MPI

from tests.ordering import assert_order
from valvefsi.errors import CaseError, ConvergenceError, StabilityError
from valvefsi.geometry.shapes import box, rectangle
from valvefsi.solid import statics
from valvefsi.solid.dynamics import CentralDifferences, GeneralisedAlpha, MovingSolid, run
from valvefsi.solid.loads import DeadLoad, Pressure, Ramp
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.statics.formulations import NearlyIncompressible
from valvefsi.solid.statics.supports import Fixed

MATERIAL = NeoHookean(c1=1e4)
TIP = (2.0, 0.25)


def beam(comm, elements=(8, 2), supports=None, degree=1, **options):
    mesh = rectangle(comm, size=(2.0, 0.5), elements=elements)
    fixed = [Fixed(on=("x_lower",))] if supports is None else supports
    formulation = NearlyIncompressible(degree=degree, nu_stab=0.3)
    return MovingSolid(mesh, MATERIAL, density=1.0, supports=fixed, formulation=formulation, **options)


def swinging(comm, **options):
    solid = beam(comm, **options)
    solid.set_motion(v=lambda x: np.stack([0 * x[0], 20 * (x[0] / 2) ** 2]))
    return solid


def advance(kind, solid, dt, t_end):
    """Both integrators with the same arguments; the worst imbalance of the energy over the start."""
    stepper = CentralDifferences(solid, dt) if kind == "explicit" else GeneralisedAlpha(solid, dt, 1.0)
    worst = []
    energies = run(stepper, t_end, lambda t, e: worst.append(abs(e.balance)))
    return energies, max(worst)


@pytest.mark.parametrize(("kind", "steps"), [("explicit", (100, 200, 400)), ("implicit", (50, 100, 200))])
def test_a_swinging_beam_keeps_its_energy_to_second_order(comm, kind, steps):
    def imbalance(n):
        solid = swinging(comm)
        energies, worst = advance(kind, solid, 0.04 / n, 0.04)
        return worst / energies.start

    assert_order(imbalance, steps, order=1.7, below=1e-3)


@pytest.mark.parametrize(("kind", "steps"), [("explicit", (100, 200, 400)), ("implicit", (40, 80, 160))])
def test_the_tip_of_a_swinging_beam_converges_to_second_order_in_time(comm, kind, steps):
    ends = {}
    for n in (*steps, 2 * steps[-1]):
        solid = swinging(comm)
        advance(kind, solid, 0.03 / n, 0.03)
        ends[n] = solid.displacement_at(TIP)
    assert_order(lambda n: float(np.abs(ends[n] - ends[2 * n]).max()), steps, order=1.7, below=1e-3)


def test_explicit_and_implicit_agree(comm):
    ends = []
    for kind, dt in (("explicit", 1e-4), ("implicit", 2e-4)):
        solid = swinging(comm)
        advance(kind, solid, dt, 0.03)
        ends.append(solid.displacement_at(TIP))
    np.testing.assert_allclose(*ends, atol=0.02)


@pytest.mark.parametrize(
    "load", [Pressure(on=("y_lower",), value=40.0), DeadLoad(on=("y_lower",), traction=(0, 40.0))]
)
@pytest.mark.parametrize("kind", ["explicit", "implicit"])
def test_the_work_of_loads_goes_into_the_beam(comm, kind, load):
    solid = beam(comm, loads=[load], ramp=Ramp(duration=0.02, shape="smooth"))
    energies, worst = advance(kind, solid, 1e-4, 0.05)
    assert energies.start == 0
    assert energies.work > 1.0
    assert solid.displacement_at(TIP)[1] > 0.01
    assert worst < 2e-3 * energies.work


@pytest.mark.parametrize("kind", ["explicit", "implicit"])
def test_damping_takes_what_is_missing(comm, kind):
    solid = swinging(comm)
    solid.damping = 20.0
    energies, worst = advance(kind, solid, 1e-4, 0.05)
    assert energies.lost > 0.2 * energies.start
    assert worst < 5e-3 * energies.start


def test_a_bar_vibrates_along_its_axis_with_the_frequency_of_the_text_book(comm):
    mesh = rectangle(comm, size=(2.0, 0.5), elements=(32, 1))
    slides = [Fixed(on=("x_lower",)), Fixed(on=("y_lower", "y_upper"), components=("y",))]
    formulation = NearlyIncompressible(degree=1, nu_stab=0.3)
    solid = MovingSolid(mesh, MATERIAL, density=2.0, supports=slides, formulation=formulation)
    speed = math.sqrt((solid.kappa + 4 / 3 * MATERIAL.c1) / 2.0)  # uniaxial strain
    period = 4 * 2.0 / speed
    solid.set_motion(u=lambda x: np.stack([1e-5 * np.sin(np.pi * x[0] / 4), 0 * x[1]]))
    stepper = GeneralisedAlpha(solid, period / 200, 1.0)
    run(stepper, period / 4)
    assert abs(solid.displacement_at(TIP)[0]) < 2e-8
    run(stepper, period / 2)
    assert solid.displacement_at(TIP)[0] == pytest.approx(-1e-5, rel=2e-3)


def test_free_flight_keeps_velocity_momentum_and_shape(comm):
    for make in (lambda s: CentralDifferences(s, 1e-4), lambda s: GeneralisedAlpha(s, 1e-3, 0.5)):
        solid = beam(comm, supports=[])
        solid.set_motion(v=lambda x: np.stack([3.0 + 0 * x[0], -2.0 + 0 * x[0]]))
        run(make(solid), 0.01)
        n = solid.space.dofmap.index_map.size_local * 2
        v = solid.v.x.array[:n].reshape(-1, 2)
        np.testing.assert_allclose(v, np.tile([3.0, -2.0], (len(v), 1)), atol=1e-9)
        np.testing.assert_allclose(solid.displacement_at(TIP), [0.03, -0.02], atol=1e-10)


def test_a_damped_beam_comes_to_rest_at_the_static_answer(comm):
    load = DeadLoad(on=("x_upper",), traction=(0.0, 30.0))
    solid = beam(comm, loads=[load], ramp=Ramp(duration=0.1), degree=2)
    solid.damping = 60.0
    run(GeneralisedAlpha(solid, 5e-3, 0.3), 2.0)
    mesh = rectangle(comm, size=(2.0, 0.5), elements=(8, 2))
    formulation = NearlyIncompressible(degree=2, nu_stab=0.3)
    rest = statics.solve(
        mesh, MATERIAL, fixed=[Fixed(on=("x_lower",))], loads=[load], formulation=formulation
    )
    np.testing.assert_allclose(solid.displacement_at(TIP), rest.displacement_at(TIP), rtol=1e-4, atol=1e-6)


def test_steps_just_below_the_critical_one_are_stable_and_above_it_are_refused(comm):
    solid = swinging(comm)
    critical = CentralDifferences(solid).critical
    with pytest.raises(CaseError, match="critical"):
        CentralDifferences(solid, 1.01 * critical)
    energies, worst = advance("explicit", solid, 0.9 * critical, 300 * critical)
    assert worst < 0.05 * energies.start


def test_a_step_above_the_true_critical_one_blows_up_and_says_so(comm):
    solid = swinging(comm)
    stepper = CentralDifferences(solid)
    stepper.dt = 1.2 * stepper.critical / 0.95
    with pytest.raises(StabilityError, match="smaller dt"):
        run(stepper, 2000 * stepper.dt)


def test_numerical_damping_takes_energy_away_and_never_adds_any(comm):
    stepper, last = GeneralisedAlpha(swinging(comm), 1e-3, 0.0), math.inf
    for _ in range(30):
        e = stepper.step()
        last = e.kinetic + e.stored
    assert last < e.start
    assert last > 0.9 * e.start


def test_three_dimensions_move_too(comm):
    mesh = box(comm, size=(2.0, 0.5, 0.5), elements=(6, 2, 2))
    for kind in ("explicit", "implicit"):
        solid = MovingSolid(mesh, MATERIAL, density=1.0, supports=[Fixed(on=("x_lower",))])
        solid.set_motion(v=lambda x: np.stack([0 * x[0], 0 * x[0], 10 * (x[0] / 2) ** 2]))
        energies, worst = advance(kind, solid, 2e-4, 0.01)
        assert worst < 1e-3 * energies.start
        assert solid.displacement_at((2.0, 0.25, 0.25))[2] > 0.05


@pytest.mark.parametrize("kind", ["explicit", "implicit"])
def test_the_motion_does_not_depend_on_the_number_of_ranks(comm, kind):
    load = Pressure(on=("y_lower",), value=40.0)
    ends = []
    for communicator in (comm, MPI.COMM_SELF):
        solid = beam(communicator, loads=[load], ramp=Ramp(duration=0.01))
        energies, _ = advance(kind, solid, 2e-4, 0.01)
        ends.append([*solid.displacement_at(TIP), *energies])
    np.testing.assert_allclose(*ends, rtol=1e-8, atol=1e-9)


def test_bad_parameters_are_refused(comm):
    mesh = rectangle(comm, elements=(2, 2))
    with pytest.raises(CaseError, match="density"):
        MovingSolid(mesh, MATERIAL, density=0.0)
    with pytest.raises(CaseError, match="at rest"):
        MovingSolid(mesh, MATERIAL, density=1.0, supports=[Fixed(on=("x_lower",), value=lambda X, s: 0 * X)])
    solid = MovingSolid(mesh, MATERIAL, density=1.0, supports=[Fixed(on=("x_lower",))])
    with pytest.raises(CaseError, match="rho_inf"):
        GeneralisedAlpha(solid, 1e-3, 1.5)
    with pytest.raises(CaseError, match="dt"):
        GeneralisedAlpha(solid, 0.0)


def test_a_load_that_no_step_can_take_is_a_convergence_error(comm):
    solid = beam(comm, loads=[Pressure(on=("y_lower",), value=1e9)])
    with pytest.raises(ConvergenceError, match="smaller dt"):
        run(GeneralisedAlpha(solid, 1e-2), 0.1)
