"""Texts ``key=value`` that change a benchmark's parameters."""

from __future__ import annotations

import pytest

from valvefsi.benchmarks.options import UNSET, defaults, quantities, read_parameters, read_quantities
from valvefsi.benchmarks.registry import ENTRIES
from valvefsi.errors import CaseError

PARAMETERS = {"c1": (250.0, "dyn/cm^2"), "t_end": (2.0, "s"), "scheme": ("centred", ("centred", "upwind"))}


def test_what_is_not_given_keeps_its_default():
    assert read_parameters(PARAMETERS, []) == {"c1": 250.0, "t_end": 2.0, "scheme": "centred"}
    assert defaults(PARAMETERS) == read_parameters(PARAMETERS, [])


def test_numbers_units_and_words_are_read_and_the_last_one_counts():
    values = read_parameters(PARAMETERS, ["c1=1 Pa", "t_end=1", "t_end = '50 ms'", "scheme=upwind"])
    assert values == {"c1": pytest.approx(10.0), "t_end": pytest.approx(0.05), "scheme": "upwind"}
    assert read_parameters(PARAMETERS, ["scheme='upwind'"])["scheme"] == "upwind"


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("t_edn=3", "--set: t_edn = 3: unknown parameter; did you mean 't_end'"),
        ("x=3", "--set: x = 3: unknown parameter; there are 'c1', 't_end', 'scheme'"),
        ("c1=3 cm", "--set: c1 = '3 cm': expected a quantity in dyn"),
        ("c1=soft", "--set: c1 = 'soft': expected a quantity in dyn"),
        ("c1=-1", "--set: c1 = -1: expected a positive value"),
        ("c1=0", "--set: c1 = 0: expected a positive value"),
        ("c1=nan", "--set: c1 = nan: expected a finite number"),
        ("scheme=upwnd", "--set: scheme = 'upwnd': expected one of centred, upwind"),
        ("scheme=1", "--set: scheme = 1: expected one of centred, upwind"),
        ("c1", "--set: c1: expected key=value"),
    ],
)
def test_a_wrong_parameter_is_one_clear_error(override, message):
    with pytest.raises(CaseError) as caught:
        read_parameters(PARAMETERS, [override])
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


def test_quantities_may_have_any_sign():
    assert read_quantities(PARAMETERS, ["c1=-1 Pa", "t_end=0"]) == {
        "c1": pytest.approx(-10.0),
        "t_end": 0.0,
        "scheme": "centred",
    }


def test_parameters_are_written_as_on_the_command_line():
    text = """t_end = 2 s, c1 = 1.21e4 dyn/cm^2,
    inflow = 5 1/(cm*s), nu = 1/3, ratio = 0.0212"""
    words = ("centred", ("centred", "upwind"))
    parameters = quantities(text, scheme=words)
    assert list(parameters) == ["t_end", "c1", "inflow", "nu", "ratio", "scheme"]
    assert parameters["t_end"] == (2.0, "s")
    assert parameters["c1"] == (12100.0, "dyn/cm^2")
    assert parameters["inflow"] == (5.0, "1/(cm*s)")
    assert parameters["nu"] == (1 / 3, "1")
    assert parameters["ratio"] == (0.0212, "1"), "to the last digit, as Python reads it"
    assert parameters["scheme"] == words
    assert read_parameters(parameters, ["inflow=1 1/(m*s)"])["inflow"] == 0.01


TIMED = (
    "channel",
    "plate",
    "sphere-in-cavity",
    "cavity",
    "taylor-green",
    "cylinder",
    "cylinder-fitted",
    "tube",
    "leakage",
    "torsion",
    "cook",
)
TIMED += ("shell", "disk-in-cavity", "valve-2d", "turek-fsi")


SHORT = ("cylinder", "cylinder-fitted", "plate", "sphere-in-cavity", "disk-in-cavity", "torsion", "cook")
OTHERS = ("compression", "kernels")
"""A case has its own end; of the problems of a study each has one."""


@pytest.mark.parametrize("name", TIMED)
def test_every_run_in_time_is_shortened_in_the_same_way(name):
    kind = next(entry for entry in ENTRIES if entry.name == name).load()
    assert kind(overrides=["t_end=2 s"]).values["t_end"] == 2.0
    if name in ("disk-in-cavity", "valve-2d", "turek-fsi"):
        assert kind(t_end=0.5).values["t_end"] == 0.5
        assert kind().values["t_end"] == kind.parameters["t_end"][0]


@pytest.mark.parametrize("name", SHORT)
def test_a_run_too_short_to_be_read_is_refused_with_the_shortest_one(name):
    kind = next(entry for entry in ENTRIES if entry.name == name).load()
    with pytest.raises(CaseError, match=r"--set: t_end = 1e-05: expected at least .* s"):
        kind(overrides=["t_end=0.01 ms"])


@pytest.mark.parametrize("name", [e.name for e in ENTRIES if e.name not in (*TIMED, *OTHERS)])
def test_what_does_not_march_in_time_says_so(name):
    kind = next(entry for entry in ENTRIES if entry.name == name).load()
    with pytest.raises(CaseError, match="t_end = '2 s': this benchmark does not march in time"):
        _ = kind(overrides=["t_end=2 s"]).values


def test_the_shortest_cylinder_is_twelve_steps():
    """A step is 0.2 / (1.6 * 8) s: twelve are 0.1875 s."""
    kind = next(entry for entry in ENTRIES if entry.name == "cylinder").load()
    with pytest.raises(CaseError, match=r"expected at least 0.188 s, 12 steps"):
        kind(cells=8, overrides=["t_end=0.187"])
    assert kind(cells=8, overrides=["t_end=0.1875"]).values["t_end"] == 0.1875


def test_what_is_unset_is_no_value_until_it_is_set():
    parameters = {"a": (1.0, "1"), "t_end": (UNSET, "s")}
    assert read_parameters(parameters, []) == {"a": 1.0}
    assert read_parameters(parameters, ["t_end=2 ms"]) == {"a": 1.0, "t_end": 0.002}
