"""Uncertain inputs: distributions by their moments, fits by their intervals and correlation, what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy import stats

from tests.studies.conftest import CASE
from valvefsi.case.sample_tables import load_samples
from valvefsi.errors import CaseError
from valvefsi.studies.polynomial_chaos import latin_hypercube
from valvefsi.studies.sample_inputs import inputs_of

FIT = {
    "parameters": {
        "R": {
            "value": 2.0,
            "unit": "mmHg*s/ml",
            "ci95": [1.5, 3.0],
            "ci95_covariance": [1.6, 2.5],
            "bounds": [1e-5, 100.0],
            "verdict": "identified",
        },
        "C": {
            "value": 0.5,
            "unit": "ml/mmHg",
            "ci95": [0.3, 0.8],
            "ci95_covariance": [0.35, 0.7],
            "bounds": [1e-5, 100.0],
            "verdict": "weak",
        },
        "kappa": {
            "value": 0.0,
            "unit": "-",
            "ci95": [0.0, 0.02],
            "ci95_covariance": [None, None],
            "bounds": [0.0, 0.3333],
            "verdict": "at bound (lower)",
        },
        "held": {"value": 1.0, "unit": "deg", "ci95": None, "verdict": "held"},
    },
    "correlation": {"names": ["R", "C", "kappa"], "matrix": [[1, -0.8, None], [-0.8, 1, None], [None] * 3]},
}
INPUT = "[[input]]\nname = 'mu'\nkey = 'fluid.viscosity'\n"
FROM_FIT = "[[fit]]\nname = 'outlet'\nfile = 'fit.json'\n"


@pytest.fixture
def study(tmp_path):
    """Return a function that reads a study of some tables."""
    (tmp_path / "case.toml").write_text(CASE)
    (tmp_path / "fit.json").write_text(json.dumps(FIT))

    def read(text, *changes):
        (tmp_path / "study.toml").write_text(f"case = 'case.toml'\n{text}")
        return load_samples(tmp_path / "study.toml", changes)

    read.folder = tmp_path
    return read


def drawn(study, count=20_000):
    inputs = inputs_of(study)
    return inputs, inputs.values(latin_hypercube(len(inputs.germs), count, 0))


@pytest.mark.parametrize(
    ("text", "unit", "law"),
    [
        ("distribution='normal'\nmean='3 cP'\nstd='0.02 P'", "cP", stats.norm(3.0, 2.0)),
        ("distribution='uniform'\nlow=0.1\nhigh=0.3", "", stats.uniform(0.1, 0.2)),
        (
            "distribution='lognormal'\nmean='4 cP'\nstd='2 cP'",
            "cP",
            stats.lognorm(np.sqrt(np.log(1.25)), scale=4 / np.sqrt(1.25)),
        ),
    ],
)
def test_a_distribution_has_the_moments_and_quantiles_it_is_given_by(study, text, unit, law):
    inputs, values = drawn(study(INPUT + text))
    assert (inputs.names, inputs.keys, inputs.units) == (("mu",), ("fluid.viscosity",), (unit,))
    assert values.mean() == pytest.approx(law.mean(), rel=1e-3)
    assert values.std() == pytest.approx(law.std(), rel=5e-3)
    assert np.quantile(values, [0.025, 0.5, 0.9]) == pytest.approx(law.ppf([0.025, 0.5, 0.9]), rel=5e-3)


def test_the_parameters_of_a_fit_have_its_intervals_and_its_correlation(study):
    text = FROM_FIT + "keys = { R = 'circuit.a.R_p', C = 'circuit.a.C' }\n"
    inputs, values = drawn(study(text))
    (group,) = inputs.groups
    assert (inputs.names, inputs.units) == (("outlet.R", "outlet.C"), ("mmHg*s/ml", "ml/mmHg"))
    assert inputs.of_variates == ("outlet", "outlet")
    assert np.quantile(values[:, 0], [0.025, 0.5, 0.975]) == pytest.approx([1.5, 2.0, 3.0], rel=0.01)
    assert np.quantile(values[:, 1], [0.025, 0.5, 0.975]) == pytest.approx([0.3, 0.5, 0.8], rel=0.01)
    assert stats.spearmanr(values[:, 0], values[:, 1])[0] == pytest.approx(
        6 / np.pi * np.arcsin(-0.8 / 2), abs=0.01
    )
    assert any("the fit calls it weak" in note for note in group.notes)
    assert any("correlated by up to 0.8" in note for note in group.notes)
    _, by_covariance = drawn(study(text + "take = 'covariance'\n"))
    assert np.quantile(by_covariance[:, 0], [0.025, 0.5, 0.975]) == pytest.approx([1.6, 2.0, 2.5], rel=0.01)


def test_a_parameter_at_its_bound_stays_on_its_side(study):
    _, values = drawn(study(FROM_FIT + "keys = { kappa = 'solid.s.material.kappa' }\n"))
    assert values.min() >= 0.0
    assert np.quantile(values, 0.95) == pytest.approx(0.02, rel=0.01)
    assert np.quantile(values, 0.5) == pytest.approx(
        0.02 * stats.norm.ppf(0.75) / stats.norm.ppf(0.975), rel=0.02
    )


def test_parameters_taken_alone_must_not_be_correlated_much(study):
    text = FROM_FIT + "joint = false\nkeys = { R = 'circuit.a.R_p', C = 'circuit.a.C' }\n"
    with pytest.raises(CaseError, match=r"correlated by 0.8, more than 0.3: they cannot be taken alone"):
        inputs_of(study(text))
    weak = {**FIT, "correlation": {"names": ["R", "C"], "matrix": [[1, 0.2], [0.2, 1]]}}
    (study.folder / "fit.json").write_text(json.dumps(weak))
    inputs = inputs_of(study(text))
    assert inputs.of_variates == ("outlet.R", "outlet.C")
    assert "correlations of up to 0.2 are left out" in " ".join(inputs.groups[0].notes)


def test_rows_of_a_table_are_drawn_together_and_a_column_by_its_quantiles(study):
    rows = np.array([[1.0, 10.0], [2.0, 20.0], [4.0, 40.0]])
    np.savetxt(study.folder / "draws.csv", rows, delimiter=",", header="R,C", comments="")
    text = "[[fit]]\nname='outlet'\nfile='draws.csv'\ntake='samples'\nunits={R='mmHg*s/ml'}\n"
    inputs, values = drawn(study(text + "keys={R='circuit.a.R_p', C='circuit.a.C'}"), 300)
    assert (inputs.germs, inputs.units) == (("none",), ("mmHg*s/ml", ""))
    assert {tuple(row) for row in values} == {tuple(row) for row in rows}
    assert np.unique(values[:, 0], return_counts=True)[1].tolist() == [100, 100, 100]
    inputs, values = drawn(study(text + "keys={C='circuit.a.C'}"))
    assert inputs.germs == ("uniform",)
    assert np.median(values) == pytest.approx(20.0, rel=1e-3)
    with pytest.raises(CaseError, match="expected numbers under X"):
        inputs_of(study(text + "keys={X='circuit.a.C'}"))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            INPUT + "distribution='normal'\nmean=1",
            r"input.mu.std: a normal distribution is given by mean and std",
        ),
        (INPUT + "distribution='normal'\nmean=1\nstd=0.1\nlow=0", "given by mean and std"),
        (INPUT + "distribution='uniform'\nlow=2\nhigh='1'", "expected a number, or a number and its unit"),
        (INPUT + "distribution='uniform'\nlow=2\nhigh=1", "expected low below high"),
        (INPUT + "distribution='normal'\nmean='1 cP'\nstd='1 s'", "s measures something else"),
        (INPUT + "distribution='lognormal'\nmean=-1\nstd=1", "expected a number above 0"),
        (2 * (INPUT + "distribution='normal'\nmean=1\nstd=0.1\n"), "two inputs have this name"),
        ("", "expected inputs"),
        ("target='circuit'\n" + INPUT + "distribution='normal'\nmean=1\nstd=0.1", "an orifice is needed"),
        (
            "design={method='sobol', size=100}\n" + INPUT + "distribution='normal'\nmean=1\nstd=1",
            "power of two",
        ),
        (
            FROM_FIT.replace("fit.json", "fti.json") + "keys={R='a.b'}",
            r"fit.outlet.file = 'fti.json': no such file",
        ),
    ],
)
def test_a_study_that_says_nothing_usable_is_refused(study, text, said):
    with pytest.raises(CaseError, match=said):
        study(text)


@pytest.mark.parametrize(
    ("keys", "take", "said"),
    [
        ("{ Q = 'a.b' }", "profile", "Q: the fit has R, C, kappa, held"),
        ("{ held = 'a.b' }", "profile", r"no interval of it from its profile \(held\)"),
        ("{ kappa = 'a.b' }", "covariance", r"no interval of it from its covariance \(at bound"),
    ],
)
def test_what_a_fit_does_not_say_is_refused_by_name(study, keys, take, said):
    with pytest.raises(CaseError, match=said):
        inputs_of(study(FROM_FIT + f"keys = {keys}\ntake = '{take}'\n"))


def test_values_on_the_command_line_take_the_place_of_those_in_the_file(study):
    found = study(INPUT + "distribution='normal'\nmean=1\nstd=0.1", "design.size=128", "input.mu.std=0.2")
    assert (found.design.size, found.input[0].std) == (128, 0.2)
