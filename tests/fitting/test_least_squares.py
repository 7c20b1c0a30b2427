"""The driver and the uncertainty against what is known in closed form for straight lines and lost directions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from tests.fitting.biaxial_synthetic import RATIOS
from valvefsi.errors import CaseError, ConvergenceError
from valvefsi.fitting import uncertainty
from valvefsi.fitting.biaxial_problem import Biaxial, BiaxialOptions
from valvefsi.fitting.biaxial_records import BiaxialData
from valvefsi.fitting.least_squares import Parameter, Problem, draw_starts, fit, solve
from valvefsi.fitting.planar_hgo import HGO
from valvefsi.fitting.profiles import profiles
from valvefsi.fitting.report import assess

pytestmark = pytest.mark.serial  # nothing in it runs in parallel


def line(count=30, noise=0.3, seed=0, blocks=3):
    """Return a straight line with noise and its design matrix."""
    x = np.linspace(0, 1, count)
    X = np.column_stack([np.ones(count), x])
    data = X @ [2.0, 3.0] + noise * np.random.default_rng(seed).standard_normal(count)
    parameters = (
        Parameter(name="a", unit="kPa", lower=-100, upper=100, start=(-5, 5)),
        Parameter(name="b", unit="kPa", lower=-100, upper=100, start=(-5, 5)),
    )
    numbers = np.arange(count) % blocks
    problem = Problem(
        parameters=parameters, data=data, model=lambda v: X @ v, jacobian=lambda v: X, blocks=numbers
    )
    return problem, X


def inside(profile):
    """Return the distinct values of a profile in its interval, as parts of it."""
    low, high = profile.interval
    part = (profile.values[profile.costs <= profile.threshold * 1.001] - low) / (high - low)
    return np.unique(part.round(2))


def test_a_profile_has_points_all_over_its_interval():
    problem, _ = line()
    for profile in profiles(fit(problem, starts=4)):
        assert len(inside(profile)) >= 9
        assert np.diff(inside(profile)).max() < 0.25
        assert np.all(np.diff(profile.values) >= 0)
        width = np.diff(profile.interval)
        assert (profile.interval - profile.values[[0, -1]]) @ [1, -1] >= 0.199 * width, (
            "it goes on beyond both ends"
        )
        assert profile.costs[[0, -1]].min() > profile.threshold


def test_a_profile_that_begins_at_a_bound_is_not_a_line_between_its_ends():
    problem, _ = line()
    least = problem.parameters[1]
    held = replace(problem, parameters=(problem.parameters[0], replace(least, lower=4.0, start=(4.5, 5.0))))
    profile = profiles(fit(held, starts=4))[1]
    assert profile.open_ends == (True, False)
    assert profile.interval[0] == 4.0
    assert len(inside(profile)) >= 9
    assert np.diff(inside(profile)).max() < 0.25


def decay(rate=3.0, count=40, noise=0.0, **options):
    """Return a decaying exponential, its size positive and linear."""
    t = np.linspace(0, 1, count)
    data = 5 * np.exp(-rate * t) + noise * np.random.default_rng(1).standard_normal(count)
    parameters = (
        Parameter(name="size", lower=1e-6, upper=1e6, start=(1e-3, 1e3), log=True, linear=True),
        Parameter(name="rate", lower=1e-3, upper=1e3, start=(0.1, 100), log=True),
    )
    return Problem(parameters=parameters, data=data, model=lambda v: v[0] * np.exp(-v[1] * t), **options)


def test_a_straight_line_gives_the_textbook_values_and_intervals():
    problem, X = line()
    found = fit(problem, starts=4)
    values, squares, *_ = np.linalg.lstsq(X, problem.data, rcond=None)
    np.testing.assert_allclose(found.values, values, rtol=1e-9)
    assert found.cost == pytest.approx(squares[0] / 2, rel=1e-9)
    linear = uncertainty.linearised(found)
    covariance = squares[0] / 28 * np.linalg.inv(X.T @ X)
    deviation = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(linear.std, deviation, rtol=1e-8)
    reach = stats.t.ppf(0.975, 28) * deviation
    np.testing.assert_allclose(linear.intervals, np.column_stack([values - reach, values + reach]), rtol=1e-7)
    np.testing.assert_allclose(linear.correlation[0, 1], covariance[0, 1] / deviation.prod(), rtol=1e-8)
    for k, profile in enumerate(profiles(found)):  # the same interval where the model is linear
        np.testing.assert_allclose(profile.interval, [values[k] - reach[k], values[k] + reach[k]], rtol=2e-3)
    assert set(uncertainty.verdicts(found, linear, profiles(found)).values()) == {"identified"}
    half = stats.t.ppf(0.975, 28) * np.sqrt(np.einsum("ij,jk,ik->i", X, covariance, X))
    np.testing.assert_allclose(uncertainty.band(found, linear), half, rtol=1e-8)


def test_leaving_a_block_out_is_the_fit_without_it():
    problem, X = line()
    found = fit(problem, starts=2)
    for number, held in enumerate(uncertainty.leave_one_out(found)):
        out = problem.blocks == number
        values, *_ = np.linalg.lstsq(X[~out], problem.data[~out], rcond=None)
        error = X[out] @ values - problem.data[out]
        assert held.rmse == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-7)


def test_the_bootstrap_is_as_wide_as_the_scatter_of_the_blocks():
    problem, _ = line(count=600, blocks=30)
    found = fit(problem, starts=2)
    drawn = uncertainty.bootstrap(found, draws=200)
    width = np.diff(drawn.intervals, axis=1)[:, 0]
    expected = np.diff(uncertainty.linearised(found).intervals, axis=1)[:, 0]
    np.testing.assert_allclose(width, expected, rtol=0.4)
    assert uncertainty.bootstrap(fit(line(blocks=2)[0], starts=1)) is None


def test_starts_fill_their_ranges_and_repeat_with_the_seed():
    problem = decay()
    starts = np.array(draw_starts(problem, 32, 7))
    assert starts.shape == (32, 2)
    np.testing.assert_array_equal(starts, np.array(draw_starts(problem, 32, 7)))
    for k, parameter in enumerate(problem.parameters):
        low, high = np.log(parameter.start)
        counts, _ = np.histogram(starts[:, k], bins=8, range=(low, high))
        assert counts.min() >= 3  # one in eight falls in each eighth


def test_an_exponential_is_found_from_every_start_with_and_without_a_jacobian():
    t = np.linspace(0, 1, 40)
    slopes = {"jacobian": lambda v: np.column_stack([np.exp(-v[1] * t), -v[0] * t * np.exp(-v[1] * t)])}
    for options in ({}, slopes):
        found = fit(decay(**options), starts=16)
        np.testing.assert_allclose(found.values, [5, 3], rtol=1e-6)
        assert found.reached == found.converged == 16


def test_starts_at_the_best_cost_are_counted_whether_or_not_the_solver_met_its_tolerance():
    problem, _ = line()
    best = fit(problem, starts=3)
    assert best.reached == best.converged == 3
    unmet = replace(best, starts=tuple(replace(start, converged=False) for start in best.starts))
    assert (unmet.reached, unmet.converged) == (3, 0)
    worse = replace(best.starts[0], cost=1.01 * best.cost)
    assert replace(best, starts=(*best.starts[:2], worse)).reached == 2
    assert not any("tolerance" in line for line in assess(best, draws=0).remarks())
    (said,) = (line for line in assess(unmet, draws=0).remarks() if "tolerance" in line)
    assert said.startswith("warning: the best start has not met the solver's tolerance")


def fibres_along_axis_1():
    """Return a fit whose least is with the fibres along axis 1 and no dispersion: of stiffer sheets than the model's.

    Records without shear are even in the angle, and the solver creeps along a curved valley to that axis.
    """
    stretch = [(1 + 0.15 * a * s, 1 + 0.22 * b * s) for a, b in RATIOS for s in np.linspace(0, 1, 8)]
    E1, E2 = (np.array(stretch) ** 2 - 1).T / 2
    size = 5 * np.exp(20 * E1**2 + 12 * E2**2 + 6 * E1 * E2)
    P = size * [40 * E1 + 6 * E2, 24 * E2 + 6 * E1] * np.array(stretch).T
    data = BiaxialData(
        F=np.array([np.diag(pair) for pair in stretch]),
        measure="pk1",
        components=("11", "22"),
        stress=P.T,
        protocol=np.repeat(np.arange(len(RATIOS)), 8),
        names=tuple("12345"),
    )
    return Biaxial(data=data, material=HGO(), options=BiaxialOptions())


def test_a_start_that_creeps_to_an_axis_of_symmetry_ends_on_it():
    problem = fibres_along_axis_1().problem
    held = fit(problem.with_constant("angle", 0.0), starts=4)
    found = fit(problem, starts=3)
    assert found.converged == 3
    assert found.reached == 2  # the third ends in a valley of its own
    assert found.cost == pytest.approx(held.cost, rel=1e-9)
    assert found.named["angle"] % 180 == 0.0


def test_fibres_that_lie_on_no_axis_stay_there():
    """A start that is broken off beside an axis is not put on it where the least lies elsewhere."""
    t = np.linspace(-1, 1, 41)
    angle = Parameter(name="angle", unit="deg", lower=-360, upper=360, start=(0, 90), period=180, even=90)
    size = Parameter(name="size", lower=0.5, upper=2.0)
    for truth, ends in ((20.0, False), (0.0, True)):
        curve = 1.1 * (t + t**3 * np.cos(np.radians(truth)) ** 2)
        problem = Problem(
            parameters=(angle, size),
            data=curve,
            model=lambda v: v[1] * (t + t**3 * np.cos(np.radians(v[0])) ** 2),
        )
        start = solve(problem, problem.scaled(np.array([15.0, 1.1])), limit=2)
        assert (start.values[0] == 0.0) == ends


def test_two_parameters_of_which_only_the_product_counts_are_not_identified():
    t = np.linspace(0, 1, 30)
    parameters = tuple(Parameter(name=n, lower=1e-4, upper=1e4, start=(0.1, 10), log=True) for n in "pqr")
    problem = Problem(
        parameters=parameters,
        data=6 * t + 2 + 0.01 * np.random.default_rng(0).standard_normal(30),
        model=lambda v: v[0] * v[1] * t + v[2],
    )
    found = fit(problem, starts=4)
    linear = uncertainty.linearised(found)
    said = uncertainty.verdicts(found, linear, profiles(found))
    assert said["p"] == "not identified: trades against q"
    assert said["q"] == "not identified: trades against p"
    assert said["r"] == "identified"
    assert linear.singular_values[-1] < 1e-6
    assert found.values[0] * found.values[1] == pytest.approx(6, rel=0.02)


def test_a_parameter_at_its_bound_is_put_on_it_and_said_to_be_there():
    problem, X = line()
    parameters = (problem.parameters[0], Parameter(name="b", lower=3.5, upper=10, start=(4, 9)))
    found = fit(Problem(parameters=parameters, data=problem.data, model=lambda v: X @ v), starts=3)
    assert found.values[1] == 3.5
    assert found.at_bound == (None, "lower")
    linear = uncertainty.linearised(found)
    assert np.isfinite(linear.std[0])
    assert np.isnan(linear.std[1])
    said = uncertainty.verdicts(found, linear, profiles(found))
    assert said["b"] == "at bound (lower)"


@pytest.mark.parametrize(
    ("angle", "verdict"), [(0.0, "at bound (lower)"), (90.0, "at bound (upper)"), (40.0, "identified")]
)
@pytest.mark.parametrize("upper", [90.0, 180.0])
def test_an_angle_at_the_end_of_a_range_cut_by_symmetry_is_at_a_bound(angle, verdict, upper):
    t = np.linspace(-1, 1, 41)

    def model(v):
        return v[1] * (t + t**3 * np.cos(np.radians(v[0])) ** 2)

    parameters = (
        Parameter(name="angle", unit="deg", lower=0, upper=upper, start=(30, 60), period=180),
        Parameter(name="size", lower=0.5, upper=2.0),
    )
    truth = model((40.0, 1.1)) + 1e-3 * np.random.default_rng(0).standard_normal(41)
    found = fit(Problem(parameters=parameters, data=truth, model=model), starts=2)
    linear = uncertainty.linearised(found)
    said = uncertainty.verdicts(replace(found, values=np.array([angle, 1.1])), linear)["angle"]
    assert (said == verdict) == (upper == 90.0 or angle == 40.0)


def test_a_held_parameter_keeps_its_value_and_the_others_are_fitted():
    problem = decay(noise=0.01).with_constant("rate", 3.0)
    found = fit(problem, starts=2)
    assert found.named["rate"] == 3.0
    assert [p.name for p in problem.free_parameters] == ["size"]
    everything = problem.with_constant("size", 5.0)
    assert fit(everything).cost == pytest.approx(float(np.sum(everything.residual(np.empty(0)) ** 2) / 2))


def test_a_robust_loss_looks_past_outliers():
    problem = decay(noise=0.01)
    problem.data[[3, 17, 30]] += 4
    plain = fit(problem, starts=4).named["rate"]
    problem = replace(problem, loss="soft_l1", loss_scale=0.03)
    robust = fit(problem, starts=4).named["rate"]
    assert abs(robust - 3) < 0.1 < abs(plain - 3)


def test_what_cannot_be_fitted_is_named():
    with pytest.raises(CaseError, match=r"rate.*larger upper bound"):
        Parameter(name="rate", lower=2, upper=1)
    with pytest.raises(CaseError, match=r"rate.*positive bounds"):
        Parameter(name="rate", lower=0, upper=1, log=True)
    with pytest.raises(CaseError, match="unknown loss"):
        decay(loss="squares")
    with pytest.raises(CaseError, match="1 observations cannot fix 2 parameters"):
        fit(decay(count=1))
    broken = Problem(parameters=decay().parameters, data=np.ones(5), model=lambda v: np.full(5, np.nan))
    with pytest.raises(ConvergenceError, match="no start"):
        fit(broken)
