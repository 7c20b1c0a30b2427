"""Values that are made to hang, to fill the memory or to end in a traceback: each is one line."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.case import case_defaults, load_case, parse_case
from valvefsi.case.expressions import Expression
from valvefsi.case.quantities import Quantity
from valvefsi.case.sides import build_fluid, build_grid
from valvefsi.errors import CaseError

LID = {
    "grid": {"lower": [0, 0], "upper": [1, 1], "cells": [8, 8]},
    "time": {"dt": "1 ms", "t_end": "10 ms"},
}


def built(raw):
    case = parse_case(raw)
    return build_fluid(case, build_grid(case, MPI.COMM_SELF))


def refused(raw):
    with pytest.raises(CaseError) as caught:
        built(raw)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "1 s**9**9**9",
        "1 s^9^9^9",
        "1 (s^9)^99999999",
        "1 s**(9**9**9)",
        "1 s*9**9**9",
        "1 s " + "*s/s" * 50_000,
        "1 " + "(" * 5000 + "s" + ")" * 5000,
        "1 s^1e9",
        "1e999 s",
        "1 s.__class__",
        "1 degC",
        10**400,
        -(10**400),
        float("nan"),
        True,
    ],
)
def test_a_unit_that_would_not_end_is_refused(text):
    assert "time.t_end" in refused({**LID, "time": {"dt": "1 ms", "t_end": text}})


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2 ms", 2e-3),
        ("2 s^2/s", 2.0),
        ("3 m * s / m", 3.0),
        ("1 1/(1/s)", 1.0),
        ("4 kg*m^-1*s^-1/Pa", 4.0),
        ("1 min", 60.0),
    ],
)
def test_units_with_powers_and_parentheses_are_read(text, value):
    assert Quantity("s").parse(text) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    "text",
    [
        "1/0",
        "9**9**9",
        "(-8)**0.5",
        "0**-1",
        "t/t",
        "1/t",
        "log(0)",
        "9" * 1500,
        "+".join(["1"] * 20_000),
        "-" * 900 + "1",
        "(" * 500 + "1" + ")" * 500,
        "sin(" * 150 + "x" + ")" * 150,
        "1e400",
        "\0",
        "",
        "1j",
        "x if t else y",
        "().__class__",
    ],
)
def test_an_expression_that_has_no_finite_value_is_refused(text):
    sides = {"y_upper": {"velocity_expression": [text, "0"]}, "y_lower": {"velocity": [1.0, 0.0]}}
    assert "fluid.sides.y_upper" in refused({**LID, "fluid": {"sides": sides}})


def test_a_blank_before_an_expression_is_no_indent():
    assert Expression("  2*x + t")({"x": np.array([1.0, 2.0]), "y": 0.0, "z": 0.0, "t": 0.5}).tolist() == [
        2.5,
        4.5,
    ]
    for text in (" sin(x)", "\tsin(x) ", "\n  sin(x)\n"):
        assert Expression(text)({"x": 0.5, "y": 0.0, "z": 0.0, "t": 0.0}) == np.sin(0.5)


@pytest.mark.parametrize(
    ("table", "key"),
    [
        ({"grid": {"lower": [0, 0], "upper": [1, 1], "cells": [32_000_000, 32_000_000]}}, "grid.cells.0"),
        ({"grid": {"lower": [0, 0, 0], "upper": [1, 1, 1], "cells": [32_000] * 3}}, "grid.cells"),
        ({"grid": {"lower": [0, 0], "upper": [1, 1], "h": "1e-12 cm"}}, "grid.h"),
        ({"grid": {"lower": [0, 0], "upper": [1e300, 1], "h": "1e-300 cm"}}, "grid.h"),
        ({"grid": {"x": [[0, 1e-12], [1, 1e-12]], "y": [[0, 1e-12], [1, 1e-12]]}}, "grid.x"),
        ({"output": {"frames": 10**13}}, "output.frames"),
        ({"output": {"keep_checkpoints": 10**30}}, "output.keep_checkpoints"),
        (
            {"output": {"line": [{"name": "a", "start": [0, 0], "end": [1, 1], "points": 10**12}]}},
            "output.line",
        ),
        ({"time": {"dt": "1e-15 s", "t_end": "1 s"}}, "time.t_end"),
        ({"time": {"dt": "1e-300 s", "t_end": "1e300 s"}}, "time.t_end"),
    ],
)
def test_sizes_beyond_any_machine_are_refused_before_they_are_allocated(table, key):
    assert key in refused({**LID, **table})


def test_meshes_beyond_the_memory_are_refused_before_they_are_made():
    raw = tomllib.loads(case_defaults())
    raw["solid"][0]["mesh"]["elements"] = [90_000, 90_000]
    assert "solid.block.mesh.elements = '90000 x 90000'" in refused(raw)


@pytest.mark.parametrize(
    "text",
    [
        "a = " + "[" * 5000,
        "a = " + "[" * 300 + "]" * 300,
        "a = " + "{b=" * 300 + "1" + "}" * 300,
        "a = " + "9" * 5000,
        "[" + "a." * 3000 + "b]\nc = 1",
        "a = '\ud800'",
        "\0",
        "title = 0x" + "f" * 10_000,
        '"a\\nb" = 1',
        '"a\\u2028b" = 1',
    ],
)
def test_toml_that_is_too_deep_or_too_long_is_one_line(tmp_path, text):
    (tmp_path / "case.toml").write_bytes(text.encode("utf-8", "surrogatepass"))
    with pytest.raises(CaseError) as caught:
        load_case(tmp_path / "case.toml")
    assert len(str(caught.value).splitlines()) == 1
    assert len(str(caught.value)) < 1000


def test_a_folder_or_a_device_is_no_case_file(tmp_path):
    for path in (tmp_path, "/dev/zero"):
        with pytest.raises(CaseError, match="not a file"):
            load_case(path)


def test_a_spacing_that_does_not_fit_proposes_the_nearest_that_does():
    grid = {"lower": [0, 0], "upper": ["3 cm", "1.5 cm"], "h": "0.39 mm"}
    said = refused({**LID, "grid": grid})
    assert said.startswith("grid.h = 0.039")
    assert ": an axis is not a whole number of cells of this spacing; 0.0394736842 cm is" in said
    adjusted = parse_case({**LID, "grid": {**grid, "adjust": True}}).grid  # 1.5 / 38
    assert adjusted.spacing == pytest.approx(1.5 / 38, rel=1e-14)
    assert [len(edges) - 1 for edges in adjusted.edges] == [76, 38]
    assert build_grid(parse_case({**LID, "grid": {**grid, "adjust": True}}), MPI.COMM_SELF).cells == (
        76,
        38,
        1,
    )
    none = {"lower": [0, 0], "upper": [1, 2**0.5], "h": "0.39 mm"}
    assert "nor of a near one" in refused({**LID, "grid": none})
    fits = parse_case({**LID, "grid": {**grid, "h": "0.5 mm", "adjust": True}}).grid
    assert fits.spacing == pytest.approx(0.05, rel=1e-14)
